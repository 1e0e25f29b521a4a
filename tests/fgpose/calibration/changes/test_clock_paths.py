"""Images that are lost again and again, in one camera or in all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.changes.change import Change, Kind, later_s
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.calibration.changes.lost_images.clock_paths import Price
from tests.fgpose.calibration.changes.changing import FPS, RIG, filmed, lost, moved_rig, walk_m

Bursts = Mapping[int, tuple[tuple[float, int], ...]]
BURSTS: Bursts = {0: ((3.0, 2), (8.0, 3)), 1: ((4.5, 4), (7.0, 3)), 2: ((6.0, 5), (9.5, 2))}
DURATION_S = 12.0


def with_bursts(seen: fgpose.Observations, bursts: Bursts) -> fgpose.Observations:
    """Cameras that lost so many images at these times of the others."""
    for c, own in bursts.items():
        for at_s, number in reversed(own):  # the last first: those before move what is after them
            seen = lost(seen, c, int(at_s * FPS), number)
    return seen


def left_frames(changes: tuple[Change, ...], bursts: Bursts) -> float:
    """By how much the clocks still differ, root mean square, in frames."""
    stamp_s = np.arange(1.0, DURATION_S - 1.0, 0.2)
    differ = []
    for c in range(RIG.n_cameras):
        true_s = sum((np.where(stamp_s >= at_s, number / FPS, 0.0) for at_s, number in _by_stamps(bursts, c)), 0.0)
        differ.append(true_s - later_s(changes, c, stamp_s) + 0 * stamp_s)
    # What all have in common nothing depends on.
    return float(FPS * np.sqrt(np.mean((np.array(differ) - np.median(differ, axis=0)) ** 2)))


def _by_stamps(bursts: Bursts, c: int) -> list[tuple[float, int]]:
    own = bursts.get(c, ())
    return [(at_s - sum(n for _, n in own[:k]) / FPS, number) for k, (at_s, number) in enumerate(own)]


def test_images_that_several_cameras_lose_again_and_again() -> None:
    """One by one, cameras were late all through the recording."""
    found = find_changes([with_bursts(filmed(walk_m(3, DURATION_S)), BURSTS)], RIG).changes
    assert {each.kind for each in found} <= {Kind.JUMP, Kind.OFFSET}
    assert {each.camera for each in found if each.kind is Kind.JUMP} == {0, 1, 2}
    # 2.7 frames before; jumps by three frames are found to two tenths of a second, others later while nobody walks.
    assert left_frames((), BURSTS) > 2.0
    assert left_frames(found, BURSTS) < 0.8


def test_bursts_of_one_camera_are_no_other_rate() -> None:
    bursts: Bursts = {1: ((2.5, 3), (5.0, 2), (7.5, 4))}
    found = find_changes([with_bursts(filmed(walk_m(3, DURATION_S)), bursts)], RIG).changes
    assert {each.kind for each in found} <= {Kind.JUMP, Kind.OFFSET}
    assert {each.camera for each in found} == {1}
    assert left_frames(found, bursts) < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 6])
def test_lost_images_beside_a_moved_camera(seed: int) -> None:
    seen = with_bursts(filmed(walk_m(seed, DURATION_S)), BURSTS)
    found = find_changes([seen], moved_rig(3, 2.0)).changes
    assert [each.camera for each in found if not each.is_of_clock] == [3]
    assert left_frames(tuple(each for each in found if each.is_of_clock), BURSTS) < 0.8


@pytest.mark.slow
def test_images_that_are_missing_are_not_lost() -> None:
    """Their numbers are those of when they were taken."""
    seen = filmed(walk_m(3, DURATION_S))
    missing = np.random.default_rng(4).random(seen.confidence.shape[:2]) < 0.1
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[missing], confidence[missing] = np.nan, 0.0
    assert find_changes([replace(seen, points2d_px=points2d_px, confidence=confidence)], RIG).changes == ()


def test_a_price_is_learned_from_how_often_and_how_many() -> None:
    frames = np.array([1, 3, 2])
    price = Price.learned(frames, 99, 2.0)
    # Three and a half of a hundred, of which a geometric distribution with mean 2 has half at one image.
    assert price.first == pytest.approx(np.log(96.5 / 3.5) + np.log(2))
    assert price.more == pytest.approx(np.log(2))
    assert price.of(frames) == pytest.approx(3 * price.first + 3 * price.more)
    assert Price.learned(frames[:0], 99, 2.0) == Price.strict()
