"""Which camera is wrong, from angles as simulated rooms give them."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.calibration.disagreement import Disagreement, allowed_mrad, allowed_third_view_mrad, disagreement

NONE = np.nan


def without(*worst_mrad: float) -> np.ndarray:
    """Third views of the others where each camera is left out, all as large as the worst."""
    angles = np.repeat(np.array(worst_mrad)[:, None], len(worst_mrad), axis=1)
    np.fill_diagonal(angles, np.nan)
    return angles


def test_what_is_allowed() -> None:
    assert allowed_mrad(0.1, 1.0) == 1.0
    assert allowed_mrad(2.0, 1.0) == 7.0
    assert allowed_mrad(100.0, 1.0) == 15.0
    assert allowed_third_view_mrad(1.0) == allowed_third_view_mrad(3.0) == 10.5


@pytest.mark.parametrize(
    ("third_view", "left_out", "expected"),
    [
        ((4.7, 4.4, 5.5, 5.6), without(6.4, 6.9, 6.1, 5.5), None),
        # The second was turned by a degree; the fourth is opposite and looks nearly as bad.
        ((6.0, 18.8, 7.2, 16.9), without(21.2, 6.7, 22.3, 19.3), Disagreement(1, 18.8)),
        ((14.3, 18.3, 16.3), without(9.3, 2.1, 8.6), Disagreement(1, 18.3)),
        # Of three at one height that see the person in one plane.
        ((14.3, 18.3, 16.3), without(2.3, 2.1, 2.6), Disagreement(None, 18.3)),
        # Two were turned: the rest never agrees.
        ((25.0, 24.0, 20.0, 22.0), without(16.0, 18.0, 28.0, 28.0), Disagreement(None, 25.0)),
        # A detector whose bias is everywhere.
        ((9.0, 10.0, 11.0, 9.5), without(10.0, 11.0, 10.0, 12.0), None),
        ((6.4, 7.4), np.full((2, 2), NONE), None),
        ((12.2, 15.4), np.full((2, 2), NONE), Disagreement(None, 15.4)),
        ((NONE, 15.4, NONE), np.full((3, 3), NONE), None),
        ((NONE, NONE, NONE), np.full((3, 3), NONE), None),
    ],
)
def test_who_is_wrong(third_view: tuple[float, ...], left_out: np.ndarray, expected: Disagreement | None) -> None:
    assert disagreement(np.array(third_view), left_out) == expected


def test_what_was_seen_before_is_seen_longer() -> None:
    third_view, left_out = np.array([5.0, 13.0, 5.0, 8.0]), without(15.0, 5.0, 15.0, 15.0)
    assert disagreement(third_view, left_out) is None
    assert disagreement(third_view, left_out, given=0.8) == Disagreement(1, 13.0)


def test_the_same_again() -> None:
    assert Disagreement(1, 20.0).is_like(Disagreement(1, 17.0), 0.25)
    assert not Disagreement(1, 50.0).is_like(Disagreement(1, 17.0), 0.25)
    assert not Disagreement(None, 17.0).is_like(Disagreement(1, 17.0), 0.25)
