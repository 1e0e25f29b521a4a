"""Who stands still for most of the time tells little of clocks and cameras: nothing false is said, and what is told is
found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

import fgpose
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, real_errors, simulate
from tests.fgpose.calibration.changes.changing import (
    FPS,
    RIG,
    SKELETON,
    exchanged,
    filmed,
    late,
    lost,
    moved_rig,
    walk_m,
)

DETECTORS = ("openpose", "blazepose_heavy", "blazepose_full")
NAMES = RIG.names[:3]
SWAY_M = 0.008


def moving_m(seed: int, *seconds: tuple[bool, float]) -> np.ndarray:
    """Somebody who walks, or stands and sways, for so long in turn; starts and stops within a second."""
    speed = np.concatenate([np.full(int(length_s * FPS), float(walks)) for walks, length_s in seconds])
    second = int(FPS)
    speed = np.convolve(np.pad(speed, second, mode="edge"), np.ones(second) / second, mode="same")[second:-second]
    walk = walk_m(3)
    posture_m = CubicSpline(np.arange(len(walk)), walk)(100 + np.cumsum(speed))
    sway = gaussian_filter1d(np.random.default_rng(seed).standard_normal((len(speed), 1, 3)), FPS, axis=0)
    return posture_m + SWAY_M * sway / sway.std() * [1, 1, 0.2]


def filmed_by_each(truth_m: np.ndarray, seed: int, rig: CameraRig = RIG) -> fgpose.Observations:
    """With another detector behind every camera: what they err by is not alike at any lag."""
    views = []
    for c, camera in enumerate(rig.subset(NAMES).cameras):
        rng = np.random.default_rng(10 * seed + c)
        errors = real_errors(rng, len(truth_m), 1, SKELETON, FPS, (DETECTORS[c],))
        alone = CameraRig((camera,))
        views.append(simulate(truth_m, SKELETON, alone, FPS, DetectionNoise(), NO_OCCLUSION, seed, None, errors))
    seen = [each.observations for each in views]
    points2d_px, confidence = (
        np.concatenate([getattr(each, name) for each in seen], axis=1) for name in ("points2d_px", "confidence")
    )
    own = replace(seen[0], points3d_m=None, covariance3d_m2=None)
    return replace(own, camera_names=NAMES, points2d_px=points2d_px, confidence=confidence)


def changes(seen: fgpose.Observations) -> tuple[Change, ...]:
    return find_changes([seen], RIG.subset(NAMES)).changes


STANDS_FIRST = ((False, 10.0), (True, 6.0))
MOVES_BETWEEN = ((False, 15.0), (True, 8.0), (False, 15.0))
STANDS_BETWEEN = ((True, 6.0), (False, 10.0), (True, 6.0))


@pytest.mark.parametrize("seed", [22, pytest.param(36, marks=pytest.mark.slow)])
def test_nothing_is_said_of_clocks_while_somebody_stands(seed: int) -> None:
    """Cameras were said to have lost 44 and 20 frames."""
    assert changes(filmed_by_each(moving_m(seed, *STANDS_FIRST), seed)) == ()


@pytest.mark.parametrize("seed", [0, pytest.param(25, marks=pytest.mark.slow)])
def test_nor_by_one_detector(seed: int) -> None:
    """Which errs alike in several views: 37 and 23 frames."""
    assert find_changes([filmed(moving_m(seed, *STANDS_FIRST), seed=seed)], RIG).changes == ()


@pytest.mark.parametrize(
    ("seed", "number"), [(2, 20), (3, 6), *(pytest.param(s, n, marks=pytest.mark.slow) for s, n in ((1, 20), (4, 6)))]
)
def test_frames_that_were_lost_while_somebody_stands(seed: int, number: int) -> None:
    seen = lost(filmed_by_each(moving_m(seed, *STANDS_BETWEEN), seed), 1, int(11 * FPS), number)
    (found,) = changes(seen)
    assert (found.kind, found.camera) == (Kind.JUMP, 1)
    # Whole ones; of 20 seeds 19 and 20 were measured.
    assert found.offset_s * FPS == pytest.approx(number, abs=1.01)
    assert found.between_s is not None
    begin_s, end_s = found.between_s
    # Nothing tells when, from 6 s to 16 s; blocks are a second long, and it begins and stops within one.
    assert 4.0 <= begin_s <= 7.0
    assert 15.0 <= end_s <= 18.0


@pytest.mark.parametrize("seed", [0, pytest.param(5, marks=pytest.mark.slow)])
def test_a_late_camera_is_told_by_the_seconds_in_which_somebody_moves(seed: int) -> None:
    (found,) = changes(late(filmed_by_each(moving_m(seed, *MOVES_BETWEEN), seed), 1, 3))
    assert (found.kind, found.camera) == (Kind.OFFSET, 1)
    # 0.01 to 0.6 frames beside it were measured (12 seeds).
    assert found.offset_s * FPS == pytest.approx(-3, abs=0.7)


@pytest.mark.parametrize("seed", [4, pytest.param(9, marks=pytest.mark.slow)])
def test_errors_of_a_posture_are_no_bump(seed: int) -> None:
    """What a network errs by of who stands lasts as long as they do: by 12 px (6 cm), other ones before and after, they
    looked like cameras that were bumped when the person began to walk, or stopped."""
    seen = filmed_by_each(moving_m(seed, *MOVES_BETWEEN), seed)
    of_posture_px = np.random.default_rng(seed).normal(0, 12, (2, *seen.points2d_px.shape[1:]))
    points2d_px = seen.points2d_px.copy()
    stands = int(15 * FPS)
    points2d_px[:stands] += of_posture_px[0]
    points2d_px[-stands:] += of_posture_px[1]
    assert changes(replace(seen, points2d_px=points2d_px)) == ()


@pytest.mark.slow
def test_a_bump_while_somebody_stands() -> None:
    truth_m, at = moving_m(0, *MOVES_BETWEEN), int(8 * FPS)
    seen = filmed_by_each(truth_m, 0)
    (found,) = changes(exchanged(seen, 1, filmed_by_each(truth_m, 0, moved_rig(1, 1.5)), slice(at, None)))
    assert (found.kind, found.camera) == (Kind.BUMP, 1)
    assert found.at_s == pytest.approx(8.0, abs=1.0)
