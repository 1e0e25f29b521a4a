from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from fgpose.monocular.clips import Clip

# Of variable rate, as phones write it: every image at another distance.
TIMES_S = np.cumsum([0.0, 0.04, 0.06, 0.04, 0.05, 0.04, 0.06, 0.05, 0.04, 0.06])
CLIP = Clip("a", Path("a.mkv"), (64, 48), len(TIMES_S), 20.0)


def times_s(stamps_s: np.ndarray, said: str) -> np.ndarray:
    with pytest.warns(UserWarning, match=said) as caught:
        found = CLIP.times_s(stamps_s)
    assert len(caught) == 1
    return found


def changed(stamps: dict[int, float]) -> np.ndarray:
    stamps_s = TIMES_S.copy()
    stamps_s[list(stamps)] = list(stamps.values())
    return stamps_s


@pytest.mark.parametrize("stamp_s", [TIMES_S[4], 0.0, 99.0, np.nan])
def test_one_wrong_stamp_leaves_the_others(stamp_s: float) -> None:
    """That of the image before, of the beginning, far ahead, or none."""
    found = times_s(
        changed({5: stamp_s}), r"a\.mkv: 1 of 10 time stamps do not increase, first that of image 5; they are"
    )
    np.testing.assert_allclose(np.delete(found, 5), np.delete(TIMES_S, 5))
    assert found[5] == pytest.approx((TIMES_S[4] + TIMES_S[6]) / 2)


def test_wrong_stamps_at_the_ends_are_a_usual_step_away() -> None:
    found = times_s(changed({0: 0.3, 9: 0.0}), "2 of 10 time stamps do not increase, first that of image 0")
    np.testing.assert_allclose(found[[0, 9]], [TIMES_S[1] - 0.05, TIMES_S[8] + 0.05])
    np.testing.assert_allclose(found[1:9], TIMES_S[1:9])


@pytest.mark.parametrize(("end", "stamp_s"), [(-1, 1e6), (0, -1e6)])
def test_a_far_stamp_at_an_end_is_wrong_although_it_increases(end: int, stamp_s: float) -> None:
    stamps_s = np.arange(30) / 20
    stamps_s[end] = stamp_s
    np.testing.assert_allclose(times_s(stamps_s, "1 of 30 time stamps do not increase"), np.arange(30) / 20, atol=1e-9)


@pytest.mark.parametrize("stamps_s", [np.zeros(10), np.repeat([0.0, 0.1, 0.2, 0.3], 3)[:10], TIMES_S[::-1]])
def test_where_most_are_wrong_the_images_are_counted(stamps_s: np.ndarray) -> None:
    np.testing.assert_allclose(times_s(stamps_s, "all are taken at 20 images a second"), np.arange(10) / 20)


def test_a_clock_that_was_put_back_is_not_believed() -> None:
    """Its last images would lie between two others."""
    stamps_s = np.concatenate([np.arange(60), np.arange(20, 80)]) / 20
    np.testing.assert_allclose(times_s(stamps_s, "40 of 120 .* all are taken at"), np.arange(120) / 20)


def test_stamps_that_increase_and_none_at_all_are_not_said() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(CLIP.times_s(TIMES_S), TIMES_S)
        np.testing.assert_allclose(CLIP.times_s(np.full(10, np.nan)), np.arange(10) / 20)
