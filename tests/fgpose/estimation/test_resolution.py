"""The same scene in images of another resolution: nothing in the estimators is a number of pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, simulate, walking

# Rounding alone grows to this where kernels and gates decide; a threshold in pixels makes centimetres.
SAME_M = 1e-5
N_FRAMES = 25


@pytest.fixture(scope="module")
def scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Noisy enough that thresholds decide."""
    noise = DetectionNoise(sigma_px=12.0)
    scene = simulate(walking(N_FRAMES, 25.0), skeleton, rig, 25.0, noise, NO_OCCLUSION, seed=0)
    return replace(scene, observations=replace(scene.observations, points3d_m=None, covariance3d_m2=None))


def enlarged(scene: Scene, by: int) -> tuple[fgpose.Observations, fgpose.CameraRig]:
    cameras = tuple(
        replace(camera, K=np.diag([by, by, 1]) @ camera.K, size_px=(camera.size_px[0] * by, camera.size_px[1] * by))
        for camera in scene.rig.cameras
    )
    seen = replace(scene.observations, points2d_px=by * scene.observations.points2d_px)
    return seen, fgpose.CameraRig(cameras)


def by_frames(seen: fgpose.Observations, rig: fgpose.CameraRig) -> np.ndarray:
    estimator = fgpose.Estimator(rig, seen.skeleton, fgpose.Config(online={"covariance": False}))
    return np.array([estimator.update(frame).positions_m for frame in seen])


def by_images(seen: fgpose.Observations, rig: fgpose.CameraRig) -> np.ndarray:
    estimator = fgpose.Estimator(rig, seen.skeleton, fgpose.Config(online={"covariance": False}))
    return np.array(
        [
            estimator.update_camera(name, time_s, seen.points2d_px[t, c], seen.confidence[t, c]).positions_m
            for t, time_s in enumerate(seen.frame_time_s[:10])
            for c, name in enumerate(rig.names)
        ]
    )


def clocks(seen: fgpose.Observations, rig: fgpose.CameraRig) -> np.ndarray:
    config = fgpose.Config(online={"covariance": False, "estimate_time_offsets": True})
    estimator = fgpose.Estimator(rig, seen.skeleton, config)
    for frame in seen:
        estimator.update(frame)
    return estimator.rig_with_offsets.time_offsets_s


def batch(seen: fgpose.Observations, rig: fgpose.CameraRig) -> np.ndarray:
    return fgpose.smooth(seen, rig).positions_m


@pytest.mark.parametrize("estimated", [pytest.param(by_frames, marks=pytest.mark.slow), by_images, clocks, batch])
def test_resolution_changes_nothing(
    estimated: Callable[[fgpose.Observations, fgpose.CameraRig], np.ndarray], scene: Scene
) -> None:
    np.testing.assert_allclose(estimated(*enlarged(scene, 4)), estimated(*enlarged(scene, 1)), atol=SAME_M)
