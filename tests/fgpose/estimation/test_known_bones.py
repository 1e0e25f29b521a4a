"""Bone lengths of an earlier recording, in batch and online: of the same person, and of somebody else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.assessment.metrics import mpjpe_m
from fgpose.estimation.evidence.other_bones import other_bone, without_known
from fgpose.estimation.initial_guess import median_lengths
from fgpose.trajectory import OtherBone
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, Scene, motion_from_npz, simulate
from tests.conftest import MOCAP

CLOSE_M = 0.005
FAST = fgpose.Config(solver={"covariance": False})


def scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Less than a second of somebody whom two cameras see, both with occluders."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return simulate(truth_m[:40], skeleton, rig.subset(rig.names[:2]), fps, DetectionNoise(), Occlusion(n_views=2), 0)


@pytest.fixture(scope="module")
def short(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    return scene(rig, skeleton)


@pytest.fixture(scope="module")
def true_bones(short: Scene) -> fgpose.BoneLengths:
    lengths_m = median_lengths(short.observations.skeleton, short.truth_m)
    return fgpose.BoneLengths(lengths_m, np.full_like(lengths_m, CLOSE_M))


@pytest.fixture(scope="module")
def alone(short: Scene) -> fgpose.Trajectory:
    """By this recording alone."""
    return fgpose.smooth(short.observations, short.rig, FAST)


def of_child(bones: fgpose.BoneLengths) -> fgpose.BoneLengths:
    return fgpose.BoneLengths(0.7 * bones.lengths_m, bones.sigma_m.copy())


def test_the_result_states_how_well_it_knows_the_lengths(
    alone: fgpose.Trajectory, true_bones: fgpose.BoneLengths
) -> None:
    assert alone.bone_lengths_m is not None
    assert alone.bone_length_sigma_m is not None
    error = (alone.bone_lengths_m - true_bones.lengths_m) / alone.bone_length_sigma_m
    # The root of the mean square of ten normal errors is between 0.4 and 1.7 with 99.9 %; taken for independent from
    # frame to frame, errors of this noise are 1.5 to 4.
    assert np.sqrt(np.mean(error**2)) < 1.7
    assert (alone.bone_length_sigma_m > 0.003).all()


def test_known_bones_make_a_short_recording_better(
    short: Scene, alone: fgpose.Trajectory, true_bones: fgpose.BoneLengths
) -> None:
    known = fgpose.smooth(short.observations, short.rig, FAST, bones=true_bones)
    assert known.other_bone is None
    assert mpjpe_m(known.positions_m, short.truth_m) < 0.97 * mpjpe_m(alone.positions_m, short.truth_m)
    assert known.bone_lengths_m is not None
    assert known.bone_length_sigma_m is not None
    # They stay where they were known, as well as they were: this recording tells less.
    np.testing.assert_allclose(known.bone_lengths_m, true_bones.lengths_m, atol=2 * CLOSE_M)
    assert (known.bone_length_sigma_m <= true_bones.sigma_m).all()


def test_bones_of_somebody_else_change_nothing_and_that_is_said(
    short: Scene, alone: fgpose.Trajectory, true_bones: fgpose.BoneLengths
) -> None:
    with pytest.warns(UserWarning, match=r"and are not used: \S+-\S+ is \d+ mm as known before and \d+ mm"):
        result = fgpose.smooth(short.observations, short.rig, FAST, bones=of_child(true_bones))
    np.testing.assert_array_equal(result.positions_m, alone.positions_m)
    assert result.other_bone is not None
    assert result.other_bone.seen_m > result.other_bone.known_m
    assert result.other_bone.sigmas > 3
    (finding,) = (
        each for each in fgpose.diagnose(short.observations, short.rig, result).findings if each.code == "other-bones"
    )
    assert result.other_bone.name in finding.reason


@pytest.mark.slow
def test_a_long_recording_begins_with_them_too(short: Scene, true_bones: fgpose.BoneLengths, tmp_path: Path) -> None:
    """In windows, whose lengths are held."""
    windows = FAST.replace(solver={"window_s": 0.5, "overlap_s": 0.1})
    known = fgpose.smooth(short.observations, short.rig, windows, bones=true_bones)
    assert known.bone_lengths_m is not None
    assert known.bone_length_sigma_m is not None
    np.testing.assert_allclose(known.bone_lengths_m, true_bones.lengths_m, atol=2 * CLOSE_M)
    assert (known.bone_length_sigma_m <= true_bones.sigma_m).all()
    for _ in range(2):  # the second time all windows are there, from a run that was killed before it wrote its result
        with pytest.warns(UserWarning, match="somebody else's|of 2 windows were solved"):
            other = fgpose.smooth(
                short.observations, short.rig, windows, unfinished=tmp_path, bones=of_child(true_bones)
            )
        assert other.other_bone is not None


def test_of_nobody_no_length_is_known(short: Scene) -> None:
    """In windows, or in one."""
    seen = short.observations
    nobody = seen.without(np.ones(seen.confidence.shape, dtype=bool))
    for config in (FAST, FAST.replace(solver={"window_s": 0.5, "overlap_s": 0.1})):
        result = fgpose.smooth(nobody, short.rig, config)
        assert result.bone_length_sigma_m is not None
        assert np.isnan(result.bone_length_sigma_m).all()


def test_the_online_estimator_forgets_bones_of_somebody_else(short: Scene, true_bones: fgpose.BoneLengths) -> None:
    estimator = fgpose.Estimator(short.rig, short.observations.skeleton)
    estimator.know(of_child(true_bones))
    estimates = [estimator.update(frame) for frame in short.observations]
    assert estimates[0].other_bone is None
    assert estimates[-1].other_bone is not None
    assert fgpose.Trajectory.from_estimates(estimates).other_bone is not None
    learned = estimates[-1].bone_lengths
    assert learned is not None
    # Learned as if nothing had been known, within what is stated.
    error = (learned.lengths_m - true_bones.lengths_m) / learned.sigma_m
    assert np.sqrt(np.mean(error**2)) < 2.0


def test_bones_of_another_skeleton_are_refused(short: Scene) -> None:
    with pytest.raises(ValueError, match="10 bone lengths are needed"):
        fgpose.smooth(short.observations, short.rig, bones=fgpose.BoneLengths.unknown(3))


def test_who_differs_by_chance_is_the_same_and_who_differs_by_far_is_not() -> None:
    rng = np.random.default_rng(0)
    names = [str(length) for length in range(10)]
    factor = rng.normal(size=(10, 10)) * 0.01
    known, seen_m2 = fgpose.BoneLengths(np.full(10, 0.3), np.full(10, 0.01)), factor @ factor.T + 1e-5 * np.eye(10)
    spread = np.linalg.cholesky(seen_m2 + 1e-4 * np.eye(10))

    def found(away: np.ndarray) -> OtherBone | None:
        """Where independent directions differ by so many standard deviations."""
        return other_bone(known, known.lengths_m + spread @ away, seen_m2, names)

    assert not any(found(rng.normal(size=10)) for _ in range(300))
    for away in (10 * np.eye(10)[0], np.full(10, 3.5)):
        assert found(away) is not None
    unknown = fgpose.BoneLengths.unknown(10)
    assert other_bone(unknown, known.lengths_m, seen_m2, names) is None


def test_what_was_a_prior_can_be_taken_out_again() -> None:
    rng = np.random.default_rng(0)
    factor, seen_m = rng.normal(size=(4, 4)) * 0.01, rng.uniform(0.2, 0.5, 4)
    seen_m2 = factor @ factor.T + 1e-5 * np.eye(4)
    known = fgpose.BoneLengths(np.array([0.2, np.nan, 0.3, 0.4]), np.array([0.01, np.inf, 0.02, 0.01]))
    of_known = np.array([1e4, 0.0, 2500.0, 1e4])
    both_m2 = np.linalg.inv(np.linalg.inv(seen_m2) + np.diag(of_known))
    both_m = both_m2 @ (np.linalg.inv(seen_m2) @ seen_m + of_known * np.nan_to_num(known.lengths_m))
    # Errors of what was seen may be larger than the graph has taken them for.
    gain = both_m2 @ np.linalg.inv(seen_m2)
    for larger in (1.0, 5.0):
        stated_m2 = both_m2 + gain @ ((larger - 1.0) * seen_m2) @ gain.T
        without_m, without_m2 = without_known(known, both_m, stated_m2, both_m2)
        np.testing.assert_allclose(without_m, seen_m, rtol=1e-9)
        np.testing.assert_allclose(without_m2, larger * seen_m2, rtol=1e-6)


def test_a_file_of_an_older_version_has_lengths_of_usual_deviations(alone: fgpose.Trajectory) -> None:
    bones, older = alone.bones, replace(alone, bone_length_sigma_m=None).bones
    assert bones is not None
    assert older is not None
    np.testing.assert_array_equal(older.lengths_m, bones.lengths_m)
    assert ((older.sigma_m >= 0.01) & (older.sigma_m < 0.02)).all()
    assert replace(alone, bone_lengths_m=None).bones is None
