"""Bone lengths that are learned while a recording is running."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.covariances.variance_components import ErrorComponents
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.factors.prior import length_prior
from fgpose.estimation.initial_guess import median_lengths
from fgpose.estimation.online import bone_lengths
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose_benchmarks.synthetic import (
    NO_NOISE,
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    motion_from_npz,
    simulate,
)
from tests.conftest import MOCAP
from tests.fgpose.calibration.changes.changing import RIG, SKELETON, filmed, walk_m
from tests.fgpose.estimation.guessed_legs import shorter_legs

CONFIG = Config()


def scene(
    rig: CameraRig, skeleton: Skeleton, noise: DetectionNoise, occlusion: Occlusion = NO_OCCLUSION, n_frames: int = 150
) -> Scene:
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return simulate(truth_m[:n_frames], skeleton, rig, fps, noise, occlusion, seed=0)


def learned(
    scene: Scene, every: int = 1, config: Config = CONFIG, lengths: RunningLengths | None = None
) -> Iterator[RunningLengths]:
    """The lengths after each frame."""
    lengths = lengths or RunningLengths(scene.observations.skeleton, config)
    for frame in range(0, scene.observations.n_frames, every):
        lengths.add(gather(scene.observations.frames(slice(frame, frame + 1)), scene.rig, config))
        lengths.improve(scene.rig, ErrorComponents.usual(scene.observations.skeleton.joints))
        yield lengths


def last(scene: Scene, every: int = 1) -> RunningLengths:
    return [*learned(scene, every)][-1]


def true_lengths_m(scene: Scene) -> Float[np.ndarray, " length"]:
    return median_lengths(scene.observations.skeleton, scene.truth_m)


def test_nothing_is_known_before_the_first_sample(skeleton: Skeleton) -> None:
    lengths = RunningLengths(skeleton, CONFIG)
    assert np.isnan(lengths.learned.lengths_m).all()


def test_exact_detections_give_exact_lengths(rig: CameraRig, skeleton: Skeleton) -> None:
    exact = scene(rig, skeleton, NO_NOISE)
    # The markers on a real body let a bone vary by some millimetres, the proportions of others move one by as much.
    varies_m = skeleton.bone_lengths(exact.truth_m).std(axis=0).max()
    np.testing.assert_allclose(last(exact).learned.lengths_m, true_lengths_m(exact), atol=3 * varies_m + 2e-3)


def test_hallucinations_do_not_make_bones_longer(rig: CameraRig, skeleton: Skeleton) -> None:
    """Two cameras, both occluded."""
    occluded = scene(rig.subset(rig.names[:2]), skeleton, DetectionNoise(), Occlusion(n_views=2))
    truth_m = true_lengths_m(occluded)
    guess_m = gather(occluded.observations, occluded.rig, CONFIG).guess_m
    median_error_m = np.abs(median_lengths(skeleton, guess_m) - truth_m)
    error_m = np.abs(last(occluded).learned.lengths_m - truth_m)
    # On average 9 and 46 mm, at most 30 and 169 mm
    assert error_m.mean() < 0.4 * median_error_m.mean()
    assert error_m.max() < 0.4 * median_error_m.max()


def test_sigma_falls_and_covers_the_error(rig: CameraRig, skeleton: Skeleton) -> None:
    noisy = scene(rig, skeleton, DetectionNoise())
    after = [lengths.learned.sigma_m for lengths in learned(noisy)]
    assert (after[-1] < after[20]).all()
    error_m = last(noisy).learned.lengths_m - true_lengths_m(noisy)
    # Ten lengths that are nearly independent: the root of the mean square of ten normal errors is below 1.7 with
    # 99.9 %.
    assert np.sqrt(np.mean((error_m / after[-1]) ** 2)) < 1.7


def test_sigma_depends_on_the_time_and_not_on_the_number_of_frames(rig: CameraRig, skeleton: Skeleton) -> None:
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=100)
    # Frames are taken every 0.05 s at the earliest: at 50 Hz every 0.06 s, at 25 Hz every 0.08 s.
    np.testing.assert_allclose(last(noisy).learned.sigma_m, last(noisy, every=2).learned.sigma_m, rtol=0.3)


def test_an_update_makes_one_step_at_most(rig: CameraRig, skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole optimisation would hold up the update by tens of milliseconds."""
    steps = []

    class Counted(bone_lengths.Search):
        def descend(self) -> float | None:
            steps[-1] += 1
            return super().descend()

    monkeypatch.setattr(bone_lengths, "Search", Counted)
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=60)
    steps.append(0)
    for _ in learned(noisy):
        steps.append(0)
    assert sum(steps) > 20
    assert max(steps) == 1


def test_the_sample_is_bounded_and_spread_over_everything(rig: CameraRig, skeleton: Skeleton) -> None:
    still = scene(rig, skeleton, DetectionNoise(), n_frames=2)
    lengths, evidence = RunningLengths(skeleton, CONFIG), gather(still.observations, rig, CONFIG).frames(slice(0, 1))
    for number in range(400):
        lengths.add(replace(evidence, time_s=np.array([0.1 * number])))
    times_s = np.array([*lengths._sample])
    assert 16 <= len(times_s) <= 32
    assert times_s[0] == 0.0
    assert times_s[-1] > 36.0
    gaps_s = np.diff(times_s)
    assert gaps_s.max() < 3 * gaps_s.min(), "evenly"


def test_frames_that_know_no_bone_are_no_sample(rig: CameraRig, skeleton: Skeleton) -> None:
    """More than one camera in every third frame only: samples at fixed steps might miss all of these."""
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=60)
    lengths = RunningLengths(skeleton, CONFIG)
    for frame in range(60):
        observations = replace(noisy.observations.frames(slice(frame, frame + 1)), points3d_m=None)
        if frame % 3 != 1:
            points_px = observations.points2d_px.copy()
            points_px[:, 1:] = np.nan
            observations = replace(observations, points2d_px=points_px)
        lengths.add(gather(observations, rig, CONFIG))
        lengths.improve(rig, ErrorComponents.usual(skeleton.joints))
    assert np.isfinite(lengths.learned.lengths_m).all()


@pytest.mark.parametrize("form", ["none", "frame"])
def test_nothing_is_learned_where_no_length_is_shared(rig: CameraRig, skeleton: Skeleton, form: str) -> None:
    config = Config(symmetry={"form": form})
    for lengths in learned(scene(rig, skeleton, DetectionNoise(), n_frames=10), config=config):
        assert np.isnan(lengths.learned.lengths_m).all()


def test_images_of_nobody_are_no_sample(rig: CameraRig, skeleton: Skeleton) -> None:
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=10)
    nothing_px = np.full_like(noisy.observations.points2d_px, np.nan)
    nobody = replace(noisy.observations, points2d_px=nothing_px, points3d_m=None)
    for lengths in learned(replace(noisy, observations=nobody)):
        assert np.isnan(lengths.learned.lengths_m).all()
        assert not lengths._sample


def test_a_hallucination_that_was_taken_back_counts_no_more(rig: CameraRig, skeleton: Skeleton) -> None:
    """In one of two frames, all cameras see the wrists 0.2 m too low."""
    exact = scene(rig, skeleton, NO_NOISE, n_frames=11)
    right, other = (gather(exact.observations.frames(slice(at, at + 1)), rig, CONFIG) for at in (0, 10))
    is_wrist = np.isin(np.arange(skeleton.n_joints), [skeleton.index("left_wrist"), skeleton.index("right_wrist")])
    low_m = exact.truth_m[10:] - 0.2 * is_wrist[:, None] * [0.0, 0.0, 1.0]
    hallucinated = replace(other, undistorted_px=rig.project(low_m), guess_m=low_m)
    forearm = skeleton.length_names.index("left_elbow-left_wrist")

    def forearm_m(*revisions: Evidence) -> float:
        lengths = RunningLengths(skeleton, CONFIG)
        lengths.add(right)
        lengths.add(hallucinated)
        for revision in revisions:
            lengths.revise(revision)
        while np.isnan(lengths.learned.lengths_m).any():
            lengths.improve(rig, ErrorComponents.usual(skeleton.joints))
        return float(lengths.learned.lengths_m[forearm])

    truth_m = true_lengths_m(exact)[forearm]
    taken_back = hallucinated.trusted(np.where(is_wrist, 1e-6, 1.0)[None, None])
    assert abs(forearm_m() - truth_m) > 0.02
    # The bone varies by millimetres from frame to frame.
    assert abs(forearm_m(taken_back) - truth_m) < 0.005


@pytest.mark.parametrize("size", [0.65, *(pytest.param(size, marks=pytest.mark.slow) for size in (1.0, 1.2))])
def test_children_and_tall_people_are_within_what_is_stated(rig: CameraRig, skeleton: Skeleton, size: float) -> None:
    """From the first tenth of a second on, in which most of what is known are the proportions of other people; where
    detections are hallucinated, when half a second has told which."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    for n_views, first in ((0, 5), (2, 25)):
        occluded = simulate(
            size * truth_m[:100], skeleton, rig.subset(rig.names[:2]), fps, DetectionNoise(), Occlusion(n_views), seed=0
        )
        for frame, lengths in enumerate(learned(occluded)):
            known = lengths.learned
            if frame < first or np.isnan(known.lengths_m).any():
                continue
            # The root of the mean square of ten normal errors is below 1.7 with 99.9 %; these are correlated.
            error_m = known.lengths_m - true_lengths_m(occluded)
            assert np.sqrt(np.mean((error_m / known.sigma_m) ** 2)) < 2.0, (n_views, frame)


def test_what_was_known_before_is_there_at_once_and_improved(rig: CameraRig, skeleton: Skeleton) -> None:
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=60)
    before = BoneLengths(true_lengths_m(noisy) + 0.02, np.full(skeleton.n_lengths, 0.02))
    known = RunningLengths(skeleton, CONFIG)
    known.know(before)
    np.testing.assert_array_equal(known.learned.lengths_m, before.lengths_m)
    assert all(lengths is known for lengths in learned(noisy, lengths=known))
    assert (known.learned.sigma_m < before.sigma_m).all()
    assert (known.learned.sigma_m < last(noisy).learned.sigma_m).all()
    assert np.abs(known.learned.lengths_m - true_lengths_m(noisy)).max() < 0.02
    known.forget()
    assert np.isnan(known.learned.lengths_m).all()


def test_a_bone_that_is_known_tells_of_the_others(skeleton: Skeleton) -> None:
    """Who has short thighs is small."""
    thigh = skeleton.length_names.index("left_hip-left_knee")
    shank = skeleton.length_names.index("left_knee-left_ankle")
    guess = np.full(skeleton.n_lengths, 0.3), 0.3
    vague_m, vague_m2 = length_prior(skeleton, None, *guess)
    lengths_m, sigma_m = np.full((2, skeleton.n_lengths), np.nan)
    lengths_m[thigh], sigma_m[thigh] = 0.26, 0.01
    of_child_m, of_child_m2 = length_prior(skeleton, BoneLengths(lengths_m, sigma_m), *guess)
    assert of_child_m[thigh] == pytest.approx(0.26, abs=0.01)
    assert of_child_m[shank] == pytest.approx(vague_m[shank] * 0.26 / vague_m[thigh], rel=0.15)
    assert of_child_m2[shank, shank] < 0.5 * vague_m2[shank, shank]
    assert np.linalg.eigvalsh(of_child_m2).min() > 0


def test_what_was_known_before_counts_once(skeleton: Skeleton) -> None:
    """Also of the head, of which the proportions say nothing: its first guess is known to 0.3 m only."""
    before = BoneLengths(np.full(skeleton.n_lengths, 0.2), np.full(skeleton.n_lengths, 0.01))
    mean_m, covariance_m2 = length_prior(skeleton, before, np.full(skeleton.n_lengths, 0.1), 0.3)
    head = skeleton.length_names.index("neck_base-head")
    assert mean_m[head] == pytest.approx(0.2, abs=1e-3)
    assert np.sqrt(covariance_m2[head, head]) == pytest.approx(0.01, rel=0.01)


def test_joints_at_one_place_have_no_length_yet(rig: CameraRig, skeleton: Skeleton) -> None:
    """The first guess of a bone is zero where all views detect its ends at one pixel."""
    noisy = scene(rig, skeleton, DetectionNoise(), n_frames=40)
    points_px = noisy.observations.points2d_px.copy()
    head, neck = skeleton.index("head"), skeleton.index("neck_base")
    points_px[:20, :, head] = points_px[:20, :, neck]
    observations = replace(noisy.observations, points2d_px=points_px, points3d_m=None)
    (*_, lengths) = learned(replace(noisy, observations=observations))
    known_m = lengths.learned.lengths_m
    assert ((known_m > 0) | np.isnan(known_m)).all()
    thigh = skeleton.length_names.index("left_hip-left_knee")
    assert known_m[thigh] == pytest.approx(true_lengths_m(noisy)[thigh], abs=0.03)


def test_lengths_of_guessed_legs_are_not_kept() -> None:
    """Somebody behind a table, whose legs all networks put too short, comes forward: two seconds later the lengths are
    those that are seen, and it is said. What is learned of one person does not contradict itself."""
    truth_m = walk_m(1, 9.0)
    guessed_m = shorter_legs(truth_m, slice(0, 150), 0.75)
    for filmed_m, others in ((guessed_m, 1), (truth_m, 0)):
        seen = replace(filmed(filmed_m), points3d_m=None)
        lengths = RunningLengths(SKELETON, CONFIG)
        told = set()
        for frame in seen:
            lengths.add(gather(frame, RIG, CONFIG))
            lengths.improve(RIG, ErrorComponents.usual(SKELETON.joints))
            told |= {lengths.other_bone} - {None}
        assert len(told) == others
        away_m = lengths.learned.lengths_m - median_lengths(SKELETON, truth_m)
        assert np.nanmax(np.abs(away_m)) < 0.02  # a detector has the joints elsewhere; the guess is off by 10 cm
