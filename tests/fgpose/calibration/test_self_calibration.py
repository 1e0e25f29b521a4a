"""A late camera and a bumped one, told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turned_cameras import turned

import fgpose
from fgpose.synthetic import NO_OCCLUSION, DetectionNoise, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP
from tests.fgpose.calibration.test_rig_refinement import direction_error_deg

LATE, BUMPED = 1, 2
OFFSETS_S = np.array([0.0, 0.06, 0.0, 0.0])
STRIDE = 4  # 12.5 frames a second: what 2.4 s tell in the least time


@pytest.fixture(scope="module")
def filmed(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """A walk with a turn; one camera is 60 ms late."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    scene = simulate(truth_m[150:270], skeleton, rig, fps, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=OFFSETS_S)
    frames = slice(None, None, STRIDE)
    return replace(
        scene,
        truth_m=scene.truth_m[frames],
        observations=scene.observations.frames(frames),
        occluded=scene.occluded[frames],
    )


def error_m(observations: fgpose.Observations, rig: fgpose.CameraRig, scene: Scene) -> float:
    return float(np.mean(np.linalg.norm(fgpose.smooth(observations, rig).positions_m - scene.truth_m, axis=-1)))


def test_a_late_camera_and_a_bumped_one(filmed: Scene, rig: fgpose.CameraRig) -> None:
    wrong = turned(rig, BUMPED, 1.0)
    found = fgpose.self_calibrate(filmed.observations, wrong)
    # A fifth of a frame of 50 Hz was measured; 20 ms are a third of the delay.
    np.testing.assert_allclose(found.time_offsets.offsets_s, OFFSETS_S, atol=0.02)
    assert direction_error_deg(found.rig, rig, BUMPED) < 0.6
    others = [0, LATE, 3]
    assert found.refinement.rotation_deg[BUMPED] > 0.4
    assert found.refinement.rotation_deg[others].max() < 0.1  # as far as the calibration may be wrong
    np.testing.assert_array_equal(found.rig.time_offsets_s, found.time_offsets.offsets_s)
    perfect_m = error_m(filmed.observations, rig.with_time_offsets(OFFSETS_S), filmed)
    calibrated_m = error_m(found.observations, found.rig, filmed)
    # Found, they cost a tenth at most; not found, 45 mm instead of 17.
    assert calibrated_m < min(1.1 * perfect_m, 0.6 * error_m(filmed.observations, wrong, filmed))


def test_per_view_3d_moves_with_its_camera(filmed: Scene, rig: fgpose.CameraRig) -> None:
    """Seen from the cameras nothing moved; and where no camera was touched, hardly any is moved."""
    found = fgpose.self_calibrate(filmed.observations, rig)
    np.testing.assert_allclose(found.time_offsets.offsets_s, OFFSETS_S, atol=0.02)
    assert found.refinement.rotation_deg.max() < 0.1
    assert found.refinement.translation_m.max() < 0.005
    before_m, after_m = filmed.observations.points3d_m, found.observations.points3d_m
    assert before_m is not None
    assert after_m is not None
    for index, (old, new) in enumerate(zip(rig.cameras, found.rig.cameras, strict=True)):
        in_camera_m = new.to_camera_frame(after_m[:, index])
        np.testing.assert_allclose(in_camera_m, old.to_camera_frame(before_m[:, index]), atol=1e-9)


def test_nothing_to_learn_from(skeleton: fgpose.Skeleton, rig: fgpose.CameraRig) -> None:
    observations = fgpose.Observations(skeleton, np.arange(3) / 50, np.full((3, 4, 17, 2), np.nan))
    with pytest.raises(ValueError, match="no joint is seen by two cameras"):
        fgpose.self_calibrate(observations, rig)
