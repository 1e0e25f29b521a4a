"""Of cameras that are calibrated on a recording: how far they are off afterwards, in what is stated."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import gtsam
import numpy as np
import pytest

import fgpose
from fgpose.calibration import self_calibrate
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, real_errors, simulate, walking
from tests.wrong_rigs import turned

FPS, DURATION_S = 50.0, 4.0
BIASED = DetectionNoise(min_bias_m=0.01, max_bias_m=0.03)
REAL = ("openpose", "blazepose_full", "blazepose_heavy")


class Errors(NamedTuple):
    """In standard deviations, but for sigma_s."""

    rotation: np.ndarray
    translation: np.ndarray
    offset: np.ndarray
    sigma_s: np.ndarray


def off(rig: CameraRig, skeleton: fgpose.Skeleton, seed: int, real: tuple[str, ...] = ()) -> Errors:
    """A walk, filmed by cameras that are off as much as the parameters expect, and not synchronised."""
    rng, truth_m = np.random.default_rng(seed), walking(int(DURATION_S * FPS), FPS, skeleton)
    true_rig = rig
    for camera in range(rig.n_cameras):
        axis = rng.standard_normal(3)
        true_rig = turned(true_rig, camera, 0.1 * float(np.linalg.norm(axis)), axis / np.linalg.norm(axis))
    true_rig = CameraRig(tuple(moved(each, 0.005 * rng.standard_normal(3)) for each in true_rig.cameras))
    offsets_s = np.array([0.0, *rng.uniform(-0.03, 0.03, rig.n_cameras - 1)])
    errors = real_errors(rng, len(truth_m), rig.n_cameras, skeleton, FPS, real) if real else None
    scene = simulate(truth_m, skeleton, true_rig, FPS, BIASED, NO_OCCLUSION, seed, offsets_s, errors)
    found = self_calibrate(scene.observations, rig)
    refined, pairs = found.refinement, list(zip(true_rig.cameras, found.rig.cameras, strict=True))
    turn_deg = [
        np.rad2deg(gtsam.Rot3.Logmap(gtsam.Rot3(a.world_T_camera[:3, :3].T @ b.world_T_camera[:3, :3])))
        for a, b in pairs
    ]
    shift_m = np.stack([b.position_m - a.position_m for a, b in pairs])
    return Errors(
        (np.stack(turn_deg) / refined.rotation_sigma_deg[:, None]).ravel(),
        (shift_m / refined.translation_sigma_m[:, None]).ravel(),
        (found.time_offsets.offsets_s - offsets_s)[1:] / found.time_offsets.sigma_s[1:],
        found.time_offsets.sigma_s[1:],
    )


def moved(camera: Camera, by_m: np.ndarray) -> Camera:
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[:3, 3] += by_m
    return replace(camera, world_T_camera=world_T_camera)


def test_a_walk_tells_the_clocks(rig: CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Poses that are refined too do not hide them: a fifth of an image is what would be doubtful."""
    found = off(rig, skeleton, 0)
    assert found.sigma_s.max() < 0.2 / FPS
    assert np.abs(found.offset).max() < 2.5  # one of 27 such triples is beyond, if the sigmas are right


@pytest.mark.slow
@pytest.mark.parametrize("real", [(), REAL], ids=["biased", "real"])
def test_nineteen_errors_of_twenty_are_within_two_sigmas(
    rig: CameraRig, skeleton: fgpose.Skeleton, real: tuple[str, ...]
) -> None:
    found = [off(rig, skeleton, seed, real) for seed in range(5)]
    for errors in (np.concatenate(each) for each in list(zip(*found, strict=True))[:3]):
        assert np.mean(np.abs(errors) < 2) > 0.9  # of fifteen offsets one may be beyond
        # Of fifteen errors that depend on each other; sigmas that are three times too large have a third.
        assert 0.4 < np.sqrt(np.mean(errors**2)) < 1.3
