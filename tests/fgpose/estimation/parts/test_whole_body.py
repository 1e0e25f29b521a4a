"""Whole bodies in batch and online against hands and faces whose motion is known."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.gathered import Gathered
from fgpose.estimation.smoother import smooth_evidence
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic import NO_NOISE, DetectionNoise, Scene, embedded_motion, ring_rig
from fgpose_benchmarks.synthetic.whole_body import simulate_whole_body, whole_body_of

N_FRAMES = 40
WINDOW = fgpose.Config(online={"solver": "window"})


def scene_of(skeleton: Skeleton, noise: DetectionNoise, n_frames: int = N_FRAMES) -> Scene:
    motion_m, fps = embedded_motion("cmu_02_05")
    truth_m = whole_body_of(motion_m[:n_frames], fps, skeleton)
    return simulate_whole_body(truth_m, skeleton, ring_rig(), fps, noise)


@pytest.fixture(scope="module")
def skeleton() -> Skeleton:
    return fgpose.load_skeleton("coco_wholebody_133")


@pytest.fixture(scope="module")
def scene(skeleton: Skeleton) -> Scene:
    return scene_of(skeleton, DetectionNoise())


@pytest.fixture(scope="module")
def smoothed(scene: Scene) -> fgpose.Trajectory:
    return fgpose.smooth(scene.observations, scene.rig)


def error_m(found: fgpose.Trajectory, scene: Scene, joints: tuple[int, ...]) -> np.ndarray:
    return np.linalg.norm(found.positions_m - scene.truth_m, axis=-1)[:, list(joints)]


def coverage(found: fgpose.Trajectory, scene: Scene, joints: tuple[int, ...]) -> float:
    """Share of the errors within the 90 % ellipsoids."""
    assert found.covariance_m2 is not None
    away_m, covariance_m2 = (found.positions_m - scene.truth_m)[:, list(joints)], found.covariance_m2[:, list(joints)]
    squared = np.einsum("tja,tja->tj", away_m, np.linalg.solve(covariance_m2, away_m[..., None])[..., 0])
    return float(np.mean(squared < 6.25))  # chi-squared of three degrees of freedom


def test_exact_detections_give_the_truth(skeleton: Skeleton):
    scene = scene_of(skeleton, NO_NOISE, 30)
    found = fgpose.smooth(scene.observations, scene.rig)
    errors_m = np.linalg.norm(found.positions_m - scene.truth_m, axis=-1)
    # The motion model smooths a little what it knows to a pixel; lips and chin are taken for rigid, and open by 6 mm.
    assert np.median(errors_m) < 0.001
    moving = [joint for joint, name in enumerate(skeleton.joints) if "lower_lip" in name]
    assert np.delete(errors_m, moving, axis=1).max() < 0.006


def test_every_part_is_better_than_triangulated_and_within_what_it_states(
    scene: Scene, smoothed: fgpose.Trajectory, skeleton: Skeleton
):
    triangulated_m = gather(scene.observations, scene.rig, fgpose.Config()).guess_m
    alone_m = np.linalg.norm(triangulated_m - scene.truth_m, axis=-1)
    for part in skeleton.parts:
        assert np.mean(error_m(smoothed, scene, part.joints)) < 0.75 * np.nanmean(alone_m[:, list(part.joints)])
        # Errors last for 0.15 s, the recording for 0.8 s: few independent ones.
        assert 0.7 <= coverage(smoothed, scene, part.joints) <= 1.0
    assert smoothed.convergence is not None
    assert smoothed.convergence.converged
    assert smoothed.skeleton == skeleton


def test_the_body_is_estimated_as_alone(scene: Scene, smoothed: fgpose.Trajectory, skeleton: Skeleton):
    body = skeleton.of_joints(skeleton.body)
    alone = fgpose.smooth(scene.observations.of_joints(body, skeleton.body), scene.rig)
    # What the whole body decides together are frames that make no body; there are none.
    np.testing.assert_array_equal(smoothed.positions_m[:, list(skeleton.body)], alone.positions_m)


def test_lengths_of_fingers_are_the_true_ones(scene: Scene, smoothed: fgpose.Trajectory, skeleton: Skeleton):
    assert smoothed.bone_lengths_m is not None
    true_m = skeleton.bone_lengths(scene.truth_m)[0]
    numbers = np.array(skeleton.length_of_bone)
    fingers = [bone for bone, pair in enumerate(skeleton.bones) if "pip" in skeleton.bone_name(pair)]
    # Noise of 5 mm on joints 2 to 5 cm apart, in 60 frames of correlated errors.
    np.testing.assert_allclose(smoothed.bone_lengths_m[numbers[fingers]], true_m[fingers], atol=0.004)


def test_what_is_known_of_all_bones_goes_to_its_part(scene: Scene, smoothed: fgpose.Trajectory):
    bones = smoothed.bones
    assert bones is not None
    again = fgpose.smooth(scene.observations.frames(slice(0, 10)), scene.rig, bones=bones)
    assert again.other_bone is None
    assert again.bone_length_sigma_m is not None
    known = np.isfinite(bones.lengths_m)
    assert known.sum() > 30  # body and fingers
    assert (again.bone_length_sigma_m[known] <= bones.sigma_m[known]).all()


def test_a_hand_that_no_camera_sees_follows_the_wrist(scene: Scene, skeleton: Skeleton):
    hand = next(part for part in skeleton.parts if part.name == "left_hand")
    hidden = slice(15, 30)  # 0.3 s
    points2d_px = scene.observations.points2d_px.copy()
    points2d_px[hidden, :, list(hand.joints)] = np.nan
    found = fgpose.smooth(replace(scene.observations, points2d_px=points2d_px), scene.rig)
    assert (found.status[hidden][:, list(hand.joints)] == Status.PREDICTED).all()
    # Fingers bend and stretch by centimetres meanwhile.
    assert np.mean(error_m(found, scene, hand.joints)[hidden]) < 0.03
    meanwhile = found.crop(float(found.time_s[hidden.start]), float(found.time_s[hidden.stop - 1]))
    assert coverage(meanwhile, replace(scene, truth_m=scene.truth_m[hidden]), hand.joints) >= 0.9


@pytest.mark.slow
def test_a_hand_that_is_never_seen_is_not_there(scene: Scene, skeleton: Skeleton):
    points2d_px = scene.observations.points2d_px.copy()
    for part in skeleton.parts:
        points2d_px[:, :, list(part.joints)] = np.nan
    found = fgpose.smooth(replace(scene.observations, points2d_px=points2d_px), scene.rig)
    parts = [joint for part in skeleton.parts for joint in part.joints]
    assert np.isnan(found.positions_m[:, parts]).all()
    assert (found.status[:, parts] == Status.UNOBSERVABLE).all()
    assert np.isfinite(found.positions_m[:, list(skeleton.body)]).all()


@pytest.mark.slow
def test_two_cameras(scene: Scene, skeleton: Skeleton):
    names = scene.rig.names[:2]
    found = fgpose.smooth(scene.observations.subset(names), scene.rig.subset(names))
    for part in skeleton.parts:
        # Twice the errors of four cameras, and what two do not see of the depth.
        assert np.nanmean(error_m(found, scene, part.joints)) < 0.015
        # 0.8 s of errors that last for 0.15 s: five independent ones.
        assert coverage(found, scene, part.joints) >= 0.6


@pytest.mark.slow
def test_a_long_recording_gives_the_same(scene: Scene, smoothed: fgpose.Trajectory, skeleton: Skeleton):
    long = Gathered.of(scene.observations, scene.rig, fgpose.Config())
    found = smooth_evidence(long, skeleton, scene.rig, fgpose.Config())
    np.testing.assert_allclose(found.positions_m, smoothed.positions_m, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_hand_that_bones_join_to_the_wrist_of_the_body():
    """SAM 3D Body's hands have no root of their own."""
    skeleton = fgpose.load_skeleton("mhr_70")
    scene = scene_of(skeleton, DetectionNoise())
    body = skeleton.of_joints(skeleton.body)
    alone = fgpose.smooth(scene.observations.of_joints(body, skeleton.body), scene.rig)
    found = fgpose.smooth(scene.observations, scene.rig)
    np.testing.assert_array_equal(found.positions_m[:, list(skeleton.body)], alone.positions_m)
    online = fgpose.Trajectory.from_estimates(
        run(fgpose.Estimator(scene.rig, skeleton, WINDOW), scene, range(30)), scene.rig.names
    )
    for part in skeleton.parts:
        # As of hands with a root.
        assert np.mean(error_m(found, scene, part.joints)) < 0.007
        assert coverage(found, scene, part.joints) >= 0.7
        assert np.mean(error_m(online, replace(scene, truth_m=scene.truth_m[:30]), part.joints)[20:]) < 0.012
    assert found.bone_lengths_m is not None
    assert np.isfinite(found.bone_lengths_m).all()


def test_progress_goes_through_all_parts(scene: Scene):
    told: list[tuple[int, int]] = []
    fgpose.smooth(scene.observations, scene.rig, progress=lambda done, n: told.append((done, n)))
    assert told == [(N_FRAMES * part // 4, N_FRAMES) for part in range(1, 5)]


def run(estimator: fgpose.Estimator, scene: Scene, frames: range) -> list[fgpose.Estimate]:
    return [estimator.update(scene.observations.frames(slice(frame, frame + 1))) for frame in frames]


@pytest.fixture(scope="module")
def online(scene: Scene, skeleton: Skeleton) -> list[fgpose.Estimate]:
    return run(fgpose.Estimator(scene.rig, skeleton, WINDOW), scene, range(N_FRAMES))


def test_online_every_part_follows(online: list[fgpose.Estimate], scene: Scene, skeleton: Skeleton):
    found = fgpose.Trajectory.from_estimates(online[20:], scene.rig.names)
    later = replace(scene, truth_m=scene.truth_m[20:])
    for part, limit_m in zip(skeleton.parts, (0.01, 0.01, 0.006), strict=True):
        # Batch has 4.5 and 2 mm; the newest pose knows nothing of what comes.
        assert np.mean(error_m(found, later, part.joints)) < limit_m
        assert coverage(found, later, part.joints) >= 0.7


def test_online_one_lag_later_is_smoother(online: list[fgpose.Estimate], scene: Scene, skeleton: Skeleton):
    by_frame = {estimate.frame: estimate for estimate in online}
    pairs = [(by_frame[e.smoothed.frame], e.smoothed) for e in online if e.smoothed and e.smoothed.frame >= 10]
    for part in skeleton.parts[:2]:
        joints = list(part.joints)
        newest, later = (
            np.mean([np.linalg.norm((e.positions_m - scene.truth_m[e.frame])[joints], axis=-1) for e in each])
            for each in zip(*pairs, strict=True)
        )
        assert later < newest


def test_an_estimator_of_a_whole_body_is_continued_elsewhere(scene: Scene, skeleton: Skeleton):
    estimator = fgpose.Estimator(scene.rig, skeleton, WINDOW)
    run(estimator, scene, range(12))
    copy = pickle.loads(pickle.dumps(estimator))
    newest = estimator.newest
    assert newest is not None
    np.testing.assert_array_equal(copy.newest.positions_m, newest.positions_m)
    for one, other in zip(*(run(each, scene, range(12, 15)) for each in (estimator, copy)), strict=True):
        np.testing.assert_array_equal(one.positions_m, other.positions_m)


@pytest.mark.slow
def test_isam2_and_the_images_of_single_cameras(scene: Scene, skeleton: Skeleton):
    estimator, observations = fgpose.Estimator(scene.rig, skeleton), scene.observations
    for frame in range(12):
        for camera, name in enumerate(observations.camera_names):
            image = observations.points2d_px[frame, camera], observations.confidence[frame, camera]
            estimator.update_camera(name, float(observations.frame_time_s[frame]), *image)
        estimator.tidy()
    estimate = estimator.newest
    assert estimate is not None
    assert estimate.frame == 11
    # Each camera's image came alone; the frame is what they all saw.
    assert (estimate.status == Status.OBSERVED).all()
    assert estimate.residual_px is not None
    np.testing.assert_array_equal(np.isfinite(estimate.residual_px), observations.seen[11])
    assert np.nanmean(np.linalg.norm(estimate.positions_m - scene.truth_m[11], axis=-1)) < 0.02
    with pytest.raises(TypeError, match="iSAM2 has no serialisation"):
        pickle.dumps(estimator)


@pytest.mark.slow
def test_a_face_that_no_camera_sees_any_more_is_predicted(scene: Scene, skeleton: Skeleton):
    """One lag later too."""
    face = next(list(part.joints) for part in skeleton.parts if part.name == "face")
    points2d_px = scene.observations.points2d_px.copy()
    points2d_px[15:, :, face] = np.nan
    hidden = replace(scene, observations=replace(scene.observations, points2d_px=points2d_px))
    config = fgpose.Config(online={"solver": "window", "lag_s": 0.2})
    last = run(fgpose.Estimator(scene.rig, skeleton, config), hidden, range(30))[-1]
    assert last.smoothed is not None
    assert last.smoothed.frame >= 18
    for estimate in (last, last.smoothed):
        assert (estimate.status[face] == Status.PREDICTED).all()


def test_known_lengths_of_hands_are_expected(scene: Scene, skeleton: Skeleton):
    true_m = np.zeros(skeleton.n_lengths)
    true_m[list(skeleton.length_of_bone)] = skeleton.bone_lengths(scene.truth_m)[0]
    estimator = fgpose.Estimator(scene.rig, skeleton, WINDOW)
    estimator.know(BoneLengths(true_m, np.full(skeleton.n_lengths, 1e-4)))
    known = run(estimator, scene, range(3))[-1].bone_lengths
    assert known is not None
    fingers = [number for number, name in enumerate(skeleton.length_names) if "pip" in name]
    # They move by what three frames tell against a prior of 0.1 mm.
    np.testing.assert_allclose(known.lengths_m[fingers], true_m[fingers], atol=0.0005)
    with pytest.raises(ValueError, match="bone lengths are needed"):
        estimator.know(BoneLengths.unknown(3))


def test_times_in_another_unit_are_said_once_of_all_parts(scene: Scene, skeleton: Skeleton) -> None:
    estimator = fgpose.Estimator(scene.rig, skeleton, fgpose.Config(online={"covariance": False}))
    in_milliseconds = replace(scene.observations.first_frames(12), time_s=1000 * scene.observations.time_s[:12])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        for frame in in_milliseconds:
            estimator.update(frame)
    assert [str(each.message)[-45:] for each in told] == [" these in milliseconds, or numbers of frames?"]
