"""Somebody with other bones comes while the one before is not forgotten yet."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.presence import Returns
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, motion_from_npz, simulate
from tests.conftest import MOCAP

FPS = 25.0
# Each stay is two seconds; in the one between, nobody is there for half a second.
STAY, AWAY, FIRST_SECOND = 50, 13, 25
CONFIG = fgpose.Config(online={"solver": "window"})
INSIDE_95 = 7.815
"""95 % of the squared lengths of three standard normal errors are less."""


def returning(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, scale: float, estimator: fgpose.Estimator
) -> tuple[list[fgpose.Estimate], np.ndarray]:
    """The first second of who comes, so many times as large as the one before, and the truth."""
    truth_m = motion_from_npz(MOCAP / "cmu_03_03_b.npz")[0][::2]
    stays = truth_m[:STAY], np.repeat(truth_m[STAY - 1 : STAY], AWAY, axis=0), scale * truth_m[STAY : 2 * STAY]
    moved_m = np.concatenate(stays)
    seen = simulate(moved_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=3).observations
    points_px = seen.points2d_px.copy()
    points_px[STAY : STAY + AWAY] = np.nan
    n_frames = STAY + AWAY + FIRST_SECOND
    poses = [estimator.update_arrays(frame / FPS, points_px[frame]) for frame in range(n_frames)]
    return poses[STAY + AWAY :], moved_m[STAY + AWAY : n_frames]


def share_inside(poses: list[fgpose.Estimate], truth_m: np.ndarray) -> float:
    """Of the joints, whose 95 % ellipsoid holds the truth."""
    error_m = np.stack([pose.positions_m for pose in poses]) - truth_m
    covariance_m2 = np.stack([np.asarray(pose.covariance_m2) for pose in poses])
    squared = np.einsum("fji,fji->fj", error_m, np.linalg.solve(covariance_m2, error_m[..., None])[..., 0])
    return float(np.mean(squared < INSIDE_95))


@pytest.mark.parametrize("scale", [0.85, 1.0])
def test_bones_of_who_was_there_are_not_used_of_who_comes(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, scale: float
) -> None:
    """With those of the one before, 0.3 of the joints of somebody smaller are inside."""
    poses, truth_m = returning(rig, skeleton, scale, fgpose.Estimator(rig, skeleton, CONFIG))
    assert share_inside(poses, truth_m) > 0.9


def test_of_one_person_bones_stay_known(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    estimator = fgpose.Estimator(rig, skeleton, CONFIG, is_one_person=True)
    (first, *_), _ = returning(rig, skeleton, 1.0, estimator)
    assert first.bone_lengths is not None
    assert np.isfinite(first.bone_lengths.lengths_m).all()


SOMEBODY, NOBODY = np.ones((2, 17), dtype=bool), np.zeros((2, 17), dtype=bool)


def test_images_and_frames_that_are_missing_are_no_absence() -> None:
    """One camera does not see somebody whom the other one sees, in frames that its image begins; and images pause."""
    returns = Returns()
    for frame in range(20):
        assert not returns.is_one(NOBODY, 0.04 * frame)
        assert not returns.is_one(SOMEBODY, 0.04 * frame)
    assert not returns.is_one(SOMEBODY, 5.0)


def test_a_moment_without_anybody_is_an_absence_if_it_lasts() -> None:
    returns = Returns()
    assert not returns.is_one(SOMEBODY, 0.0)
    assert not returns.is_one(NOBODY, 0.04)
    assert not returns.is_one(SOMEBODY, 0.08), "too short"
    assert not returns.is_one(NOBODY, 0.12)
    assert returns.is_one(SOMEBODY, 0.6)
    assert not returns.is_one(SOMEBODY, 0.64)
