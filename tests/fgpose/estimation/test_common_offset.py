"""What all cameras are late by changes the time of a result, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.config import Config
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

# Half a number in base 2: adding and subtracting it makes no rounding errors.
LATE_S = 0.25
OFFSETS_S = np.array([0.0, 0.01, -0.01, 0.0])
WITHOUT_COVARIANCE = Config(solver={"covariance": False}, online={"covariance": False})  # type: ignore[arg-type]


def walk(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, offsets_s: np.ndarray, n_frames: int) -> Scene:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    return simulate(truth_m[:n_frames], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=offsets_s)


@pytest.mark.parametrize("method", [fgpose.smooth, fgpose.refine])
def test_a_common_offset_changes_nothing_in_batch(
    method: type, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    scene = walk(rig, skeleton, OFFSETS_S, 15)
    on_time, late = (
        method(scene.observations, rig.with_time_offsets(OFFSETS_S + by), WITHOUT_COVARIANCE) for by in (0.0, LATE_S)
    )
    # The mean of the offsets is rounded: 1e-16 s, whose effect the iterations of the optimiser multiply.
    np.testing.assert_allclose(late.positions_m, on_time.positions_m, atol=1e-9)
    np.testing.assert_allclose(late.time_s, on_time.time_s + LATE_S, atol=1e-12)


@pytest.mark.slow
def test_a_common_offset_changes_nothing_online(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Nor in the offsets that are learned from 0.5 s on."""
    scene = walk(rig, skeleton, OFFSETS_S, 30)
    offsets_s = np.zeros(4)
    config = WITHOUT_COVARIANCE.replace(online={"estimate_time_offsets": True, "lag_s": 0.1})
    estimators = [fgpose.Estimator(rig.with_time_offsets(offsets_s + by), skeleton, config) for by in (0.0, LATE_S)]
    for frame in scene.observations:
        on_time, late = (estimator.update(frame) for estimator in estimators)
        np.testing.assert_allclose(late.positions_m, on_time.positions_m, atol=1e-9)
        assert late.time_s == pytest.approx(on_time.time_s + LATE_S, abs=1e-12)
        assert (late.smoothed is None) == (on_time.smoothed is None)
        if late.smoothed is not None and on_time.smoothed is not None:
            assert late.smoothed.time_s == pytest.approx(on_time.smoothed.time_s + LATE_S, abs=1e-12)
    assert estimators[0].rig_with_offsets.time_offsets_s.any()
    learned_s = [estimator.rig_with_offsets.time_offsets_s for estimator in estimators]
    np.testing.assert_allclose(learned_s[1], learned_s[0] + LATE_S, atol=1e-9)


@pytest.mark.slow
def test_a_common_offset_changes_nothing_image_by_image(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    observations = walk(rig, skeleton, np.zeros(4), 8).observations
    estimators = [
        fgpose.Estimator(rig.with_time_offsets(np.full(4, by)), skeleton, WITHOUT_COVARIANCE) for by in (0.0, LATE_S)
    ]
    for t, time_s in enumerate(observations.frame_time_s.tolist()):
        for c, name in enumerate(rig.names):
            points_px = observations.points2d_px[t, c]
            on_time, late = (each.update_camera(name, time_s + 1e-3 * c, points_px) for each in estimators)
            np.testing.assert_allclose(late.positions_m, on_time.positions_m, atol=1e-9)


@pytest.mark.slow
def test_a_common_offset_changes_nothing_for_a_tracker(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    observations = walk(rig, skeleton, np.zeros(4), 20).observations
    config = WITHOUT_COVARIANCE.replace(tracking={"max_processes": 1})
    found: list[list[fgpose.people.Tracked]] = []
    for late_s in (0.0, LATE_S):
        found.append([])
        with fgpose.Tracker(rig.with_time_offsets(np.full(4, late_s)), skeleton, config) as tracker:
            for t, time_s in enumerate(observations.frame_time_s.tolist()):
                seen = zip(rig.names, observations.points2d_px[t], observations.confidence[t], strict=True)
                found[-1] = tracker.update(
                    [
                        fgpose.people.Detections(name, time_s, px[None], confidence[None])
                        for name, px, confidence in seen
                    ]
                )
    (on_time,), (late,) = found
    np.testing.assert_allclose(late.estimate.positions_m, on_time.estimate.positions_m, atol=1e-9)
    assert late.estimate.time_s == pytest.approx(on_time.estimate.time_s + LATE_S, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offsets_s", "kept"),
    [
        ([0.0, 0.3, 0.3, 0.3], slice(None)),
        ([0.0, 0.0, 0.3, 0.3], slice(None)),
        ([0.0, 0.5, 0.52, 0.48], slice(1, None)),
    ],
)
def test_a_frame_has_the_time_at_which_it_was_taken(
    offsets_s: list[float], kept: slice, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Whichever camera gives the clock, and also if that is none of those that are used."""
    scene = walk(rig, skeleton, np.array(offsets_s), 45)
    names = rig.names[kept]
    late = rig.with_time_offsets(np.array(offsets_s)).subset(names)
    observations = replace(scene.observations.subset(names), points3d_m=None, covariance3d_m2=None)
    trajectory = fgpose.smooth(observations, late, WITHOUT_COVARIANCE)
    truth = CubicSpline(observations.frame_time_s, scene.truth_m)
    seen_by_all = (trajectory.time_s > 0.3) & (trajectory.time_s < observations.frame_time_s[-1])
    error_m = np.linalg.norm(trajectory.positions_m - truth(trajectory.time_s), axis=-1)[seen_by_all]
    # 12 mm if nobody is late, 20 mm where only two cameras see a moment; with all images later than their frame 500 to
    # 5,000 mm.
    assert np.nanmean(error_m) < 0.03
