"""Wrong stamps, and clocks that are set while it runs."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import fgpose
from fgpose.estimation.online.arrivals import TooLateError
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, simulate, walking

FPS, WRONG_S = 25.0, 1.7e9
CONFIG = fgpose.Config(online={"covariance": False, "lag_s": 0.2, "solver": "window"})
N_FRAMES = 30
# Without noise the filter is within a millimetre of a walker; who is somewhere else by a frame is 5 cm away.
CLOSE_M = 0.01
FRAMES = np.arange(N_FRAMES)
TIME_S = FRAMES / FPS


@pytest.fixture(scope="module")
def truth_m() -> np.ndarray:
    return walking(N_FRAMES, FPS)


@pytest.fixture(scope="module")
def seen(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, truth_m: np.ndarray) -> fgpose.Observations:
    return simulate(truth_m, skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0).observations


def taken(
    estimator: fgpose.Estimator, seen: fgpose.Observations, stamps_s: np.ndarray, *, one_by_one: bool
) -> tuple[dict[int, fgpose.Estimate], list[ValueError], list[str]]:
    """The estimate after each frame of which something was used, what was raised, and what was warned of."""
    estimates, refused = dict[int, fgpose.Estimate](), list[ValueError]()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for frame in range(N_FRAMES):
            time_s, points_px = float(stamps_s[frame]), seen.points2d_px[frame]
            for camera, name in enumerate(seen.camera_names if one_by_one else ("all",)):
                try:
                    estimates[frame] = (
                        estimator.update_camera(name, time_s, points_px[camera])
                        if one_by_one
                        else estimator.update_arrays(time_s, points_px)
                    )
                except ValueError as error:
                    refused.append(error)
    return estimates, refused, [str(each.message) for each in told]


def error_m(estimates: dict[int, fgpose.Estimate], truth_m: np.ndarray) -> float:
    """Of the last ten frames, the largest of any joint."""
    last = range(N_FRAMES - 10, N_FRAMES)
    return max(float(np.linalg.norm(estimates[frame].positions_m - truth_m[frame], axis=-1).max()) for frame in last)


def test_one_wrong_stamp_of_a_frame_changes_nothing_else(seen: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    estimator, other = (fgpose.Estimator(rig, seen.skeleton, CONFIG) for _ in range(2))
    for frame in range(10):
        estimator.update_arrays(TIME_S[frame], seen.points2d_px[frame])
        other.update_arrays(TIME_S[frame], seen.points2d_px[frame])
    with pytest.raises(ValueError, match=r"a frame at 1700000000 s is 1.7e\+09 s after all before; it was not used"):
        estimator.update_arrays(WRONG_S, seen.points2d_px[10])
    for frame in range(11, 14):
        ours = estimator.update_arrays(TIME_S[frame], seen.points2d_px[frame])
        theirs = other.update_arrays(TIME_S[frame], seen.points2d_px[frame])
        np.testing.assert_array_equal(ours.positions_m, theirs.positions_m)


@pytest.mark.parametrize("one_by_one", [False, True])
def test_a_clock_that_was_set_forward_is_followed(
    seen: fgpose.Observations, rig: fgpose.CameraRig, truth_m: np.ndarray, *, one_by_one: bool
) -> None:
    estimator = fgpose.Estimator(rig, seen.skeleton, CONFIG)
    later_s = TIME_S + 3600.0 * (FRAMES >= 10)
    estimates, refused, told = taken(estimator, seen, later_s, one_by_one=one_by_one)
    assert len(refused) == 1, "the first; the next confirms it"
    assert not told
    assert error_m(estimates, truth_m) < CLOSE_M


def test_a_stamp_that_stays_wrong_is_never_believed(seen: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    estimator = fgpose.Estimator(rig, seen.skeleton, CONFIG)
    stuck_s = np.where(FRAMES >= 10, WRONG_S, TIME_S)
    estimates, refused, _ = taken(estimator, seen, stuck_s, one_by_one=False)
    assert (len(estimates), len(refused)) == (10, N_FRAMES - 10)


@pytest.mark.parametrize("one_by_one", [False, True])
@pytest.mark.parametrize("first_wrong", [False, True])
def test_after_a_clock_was_set_back_all_begins_anew(
    seen: fgpose.Observations, rig: fgpose.CameraRig, truth_m: np.ndarray, *, one_by_one: bool, first_wrong: bool
) -> None:
    """Also where the very first stamp was wrong, and all others are right."""
    estimator = fgpose.Estimator(rig, seen.skeleton, CONFIG)
    back_s, wrong_s = TIME_S - 3600.0 * (FRAMES >= 5), np.where(FRAMES == 0, WRONG_S, TIME_S)
    stamps_s, first_frame = (wrong_s, 1) if first_wrong else (back_s, 5)
    estimates, refused, told = taken(estimator, seen, stamps_s, one_by_one=one_by_one)
    assert sorted(set(range(N_FRAMES)) - set(estimates)) == [*range(first_frame, first_frame + 9)]
    assert all(isinstance(each, TooLateError) for each in refused)
    (message,) = told
    assert message.startswith("the clock was set back by about")
    assert error_m(estimates, truth_m) < CLOSE_M
    if not first_wrong:
        assert estimates[14].bone_lengths is not None
        assert np.isfinite(estimates[14].bone_lengths.lengths_m).all(), "those of before"


def test_a_camera_whose_clock_is_late_sets_nothing_back(seen: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    estimator, (name, other) = fgpose.Estimator(rig, seen.skeleton, CONFIG), rig.names[:2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for frame in range(N_FRAMES):
            estimator.update_camera(name, frame / FPS, seen.points2d_px[frame, 0])
            with pytest.raises(TooLateError):
                estimator.update_camera(other, frame / FPS - 3600.0, seen.points2d_px[frame, 1])


def test_a_recording_may_pause(seen: fgpose.Observations, rig: fgpose.CameraRig) -> None:
    estimator = fgpose.Estimator(rig, seen.skeleton, CONFIG, times_are_checked=True)
    for time_s in (0.0, 1000.0):
        assert estimator.update_arrays(time_s, seen.points2d_px[0]).time_s == time_s
