"""Joints that one camera alone sees: how far away they are, and what is claimed of it, against the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.covariances.uncertainty import at_least
from fgpose.estimation.visibility.posture import Posture, bone_directions
from fgpose.estimation.visibility.single_view import DistanceFilter, Sight, smoothed
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, embedded_motion, simulate, walking

NOISE = DetectionNoise(outlier_share=0.0)
IN_99 = 11.345  # of the chi-squared distribution with three degrees of freedom


def seen_by_one(observations: fgpose.Observations, camera: int, first: int) -> fgpose.Observations:
    """The other cameras see nothing from a frame on; no view has 3D."""
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    others = np.arange(points2d_px.shape[1]) != camera
    points2d_px[first:, others], confidence[first:, others] = np.nan, 0.0
    return replace(observations, points2d_px=points2d_px, confidence=confidence, points3d_m=None, covariance3d_m2=None)


def estimated(observations: fgpose.Observations, rig: fgpose.CameraRig, how: str) -> fgpose.Trajectory:
    if how == "batch":
        return fgpose.smooth(observations, rig)
    estimator = fgpose.Estimator(rig, observations.skeleton)
    return fgpose.Trajectory.from_estimates([estimator.update(frame) for frame in observations], rig.names)


def errors(
    trajectory: fgpose.Trajectory, truth_m: np.ndarray, joints: slice | list[int] = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """Of the joints that are there: distance from the truth in m, and whether it is within the ellipsoid of 99 %."""
    assert trajectory.covariance_m2 is not None
    error_m = (trajectory.positions_m - truth_m)[:, joints]
    covariance_m2 = trajectory.covariance_m2[:, joints]
    known = np.isfinite(error_m).all(axis=-1)
    error_m, covariance_m2 = error_m[known], covariance_m2[known]
    squared = np.einsum("ni,nij,nj->n", error_m, np.linalg.inv(covariance_m2), error_m)
    return np.linalg.norm(error_m, axis=-1), squared < IN_99


def of_frames(trajectory: fgpose.Trajectory, frames: slice) -> fgpose.Trajectory:
    assert trajectory.covariance_m2 is not None
    return fgpose.Trajectory(
        trajectory.skeleton,
        trajectory.time_s[frames],
        trajectory.positions_m[frames],
        trajectory.status[frames],
        trajectory.covariance_m2[frames],
    )


BOTH = ["batch", pytest.param("online", marks=pytest.mark.slow)]


@pytest.mark.slow
@pytest.mark.parametrize("how", BOTH)
def test_who_walks_keeps_the_distance_from_the_only_camera(
    how: str, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """Two seconds on a circle seen by four cameras, then two and a half by one. Without the filter the body is up to
    3 m too near by the end."""
    fps, first = 30.0, 60
    truth_m = walking(135, fps, skeleton)
    scene = simulate(truth_m, skeleton, rig, fps, NOISE, NO_OCCLUSION, seed=0)
    trajectory = estimated(seen_by_one(scene.observations, 0, first), rig, how)
    alone = of_frames(trajectory, slice(first, None))
    assert (alone.status == Status.PREDICTED).all()
    error_m, is_within = errors(alone, truth_m[first:])
    # A body of 17 joints in noise of 5 px at 5 m tells its distance to some 0.2 m.
    assert np.median(error_m) < 0.3
    assert np.quantile(error_m, 0.95) < 0.7
    assert is_within.mean() > 0.95
    assert trajectory.covariance_m2 is not None
    along_m = np.sqrt(np.median(np.linalg.eigvalsh(trajectory.covariance_m2)[..., -1], axis=1))
    assert along_m[58] < 0.03  # four cameras know it to centimetres
    assert along_m[58] < along_m[66] < along_m[75]
    assert 0.08 < along_m[-1] < 0.6  # bones hold the distance


@pytest.mark.slow
@pytest.mark.parametrize("how", ["batch", "online"])
def test_a_real_recording_that_one_camera_goes_on_with(how: str) -> None:
    """Against what all four cameras tell. Half a second is little to learn a body from."""
    rig, observations = fgpose.files.load_recording("balance_openpose")
    reference = fgpose.smooth(observations, rig)
    first = 30
    alone = of_frames(estimated(seen_by_one(observations, 1, first), rig, how), slice(first, None))
    error_m, is_within = errors(alone, reference.positions_m[first:])
    assert np.median(error_m[-200:]) < 0.35  # it was 0.45 to 1.2 m after 1.2 s
    assert is_within.mean() > 0.95
    assert not (alone.status == Status.OBSERVED).any()


@pytest.mark.slow
@pytest.mark.parametrize("how", BOTH)
def test_of_views_that_contradict_each_other_either_may_be_right(
    how: str, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """All four detect an arm somewhere else for a second."""
    fps, first, last = 30.0, 45, 75
    truth_m = walking(90, fps, skeleton)
    scene = simulate(truth_m, skeleton, rig, fps, DetectionNoise(outlier_share=0.0), NO_OCCLUSION, seed=1)
    points2d_px, rng = scene.observations.points2d_px.copy(), np.random.default_rng(0)
    arm = [skeleton.index("left_elbow"), skeleton.index("left_wrist")]
    for joint in arm:
        points2d_px[first:last, :, joint] += rng.normal(0.0, 80.0, (4, 2)) + rng.normal(0.0, 3.0, (last - first, 4, 2))
    observations = replace(scene.observations, points2d_px=points2d_px, points3d_m=None, covariance3d_m2=None)
    trajectory = of_frames(estimated(observations, rig, how), slice(first, last))
    assert (trajectory.status[:, arm] == Status.PREDICTED).mean() > 0.9
    error_m, is_within = errors(trajectory, truth_m[first:last], arm)
    assert np.quantile(error_m, 0.9) < 0.6  # an arm is 0.5 m long
    assert is_within.mean() > 0.95


@pytest.mark.slow
def test_a_short_time_alone_is_smoothed_from_both_sides(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """From the middle of it, both ends are half a second away."""
    truth_m = walking(110, 30.0, skeleton)
    scene = simulate(truth_m, skeleton, rig, 30.0, DetectionNoise(outlier_share=0.0), NO_OCCLUSION, seed=4)
    observations, everything = seen_by_one(scene.observations, 0, 40), scene.observations
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    points2d_px[70:], confidence[70:] = everything.points2d_px[70:], everything.confidence[70:]
    trajectory = fgpose.smooth(replace(observations, points2d_px=points2d_px, confidence=confidence), rig)
    error_m, is_within = errors(of_frames(trajectory, slice(40, 70)), truth_m[40:70])
    assert np.median(error_m) < 0.1
    assert is_within.mean() > 0.95


@pytest.mark.slow
def test_an_image_that_joins_a_frame_that_was_learned_from(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    """Between two images of one time, of which one shows somebody: the filter of distances has no step to take."""
    fps, first = 15.0, 10
    scene = simulate(walking(30, fps, skeleton), skeleton, rig, fps, NOISE, NO_OCCLUSION, seed=0)
    alone = seen_by_one(scene.observations, 0, first)
    tidied, plain = (fgpose.Estimator(rig, skeleton) for _ in range(2))
    for frame in alone.frames(slice(0, first)):
        tidied.update(frame), plain.update(frame)
    for frame in alone.frames(slice(first, None)):
        time_s, points_px = float(frame.time_s[0]), frame.points2d_px[0]
        for camera in (0, 1):
            estimates = [each.update_camera(rig.names[camera], time_s, points_px[camera]) for each in (tidied, plain)]
            tidied.tidy()
        # What is learned of a frame one image sooner moves joints by less than their standard deviation.
        differ_m = estimates[0].positions_m - estimates[1].positions_m
        covariance_m2 = estimates[1].covariance_m2
        assert covariance_m2 is not None
        assert np.einsum("ji,jik,jk->j", differ_m, np.linalg.inv(covariance_m2), differ_m).max() < 1


@pytest.mark.parametrize("how", BOTH)
def test_an_arm_that_one_of_two_views_takes_for_the_other_arm(
    how: str, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
) -> None:
    """In all frames: nothing shows where it is but one view and the bones."""
    fps, pair = 30.0, rig.subset(rig.names[:2])
    truth_m = walking(75, fps, skeleton)
    scene = simulate(truth_m, skeleton, pair, fps, DetectionNoise(outlier_share=0.0), NO_OCCLUSION, seed=2)
    points2d_px, rng = scene.observations.points2d_px.copy(), np.random.default_rng(0)
    arm = [skeleton.index("left_elbow"), skeleton.index("left_wrist")]
    right = points2d_px[:, 1, skeleton.mirror[arm]]
    points2d_px[:, 1, arm] = right + rng.normal(0.0, 2.0, right.shape)
    observations = replace(scene.observations, points2d_px=points2d_px, points3d_m=None, covariance3d_m2=None)
    error_m, is_within = errors(estimated(observations, pair, how), truth_m, arm)
    assert np.quantile(error_m, 0.5) < 0.3
    assert is_within.mean() > 0.9  # it was 0 to 22 %


def sights(
    truth_m: np.ndarray, rig: fgpose.CameraRig, camera: int, sigma_m: float, n_known: int
) -> list[tuple[Sight, np.ndarray]]:
    """What one camera sees without errors, and the direction of the body; distances are known in the first frames."""
    offset_m = truth_m - rig.cameras[camera].position_m
    distance_m = np.linalg.norm(offset_m, axis=-1)
    rays, body_m = offset_m / distance_m[..., None], offset_m.mean(axis=1)
    known_m = np.where((np.arange(len(truth_m)) < n_known)[:, None], distance_m, np.nan)
    uncertain = np.full(truth_m.shape[1], sigma_m)
    directions = body_m / np.linalg.norm(body_m, axis=-1, keepdims=True)
    return [(Sight(rays[t], uncertain, known_m[t], uncertain), directions[t]) for t in range(len(truth_m))]


def test_exact_detections_tell_the_distance_of_somebody_who_walks_away(
    rig: fgpose.CameraRig, skeleton: Skeleton
) -> None:
    """The dynamics alone would stay within the first distance; its sigma after two seconds is 1 m."""
    truth_m, fps = embedded_motion("cmu_02_01_short")
    truth_m = truth_m[:: round(fps / 25.0)]
    seen = sights(truth_m, rig, 0, 0.01, 5)
    posture = Posture.of(truth_m, 1 / 25, skeleton)
    last, length_m = bone_directions(truth_m[0], skeleton)
    lengths_m = np.array([length_m[skeleton.length_of_bone.index(n)] for n in range(skeleton.n_lengths)])
    single = DistanceFilter(skeleton, lengths_m, posture, last)
    steps = [single.begin(*seen[0], about_m=1.0)]
    steps += [single.step(1 / 25, *each) for each in seen[1:]]
    true_m = np.linalg.norm(truth_m - rig.cameras[0].position_m, axis=-1)
    assert np.ptp(true_m.mean(axis=1)) > 0.5  # he does walk
    for beliefs in ([step.updated for step in steps], smoothed(steps)):
        told = [single.distances(belief) for belief in beliefs]
        off_m = np.stack([distance_m for distance_m, _ in told]) - true_m
        sigma_m = np.sqrt(np.stack([variance_m2 for _, variance_m2 in told]))
        assert np.quantile(np.abs(off_m), 0.95) < 0.35  # tilts of a few degrees and centimetres are not known
        assert np.mean(np.abs(off_m) < 2.576 * sigma_m) > 0.97
    assert np.trace(smoothed(steps)[20].covariance) < np.trace(steps[20].updated.covariance)


def test_posture_does_not_depend_on_which_way_somebody_faces(skeleton: Skeleton) -> None:
    """Nor is it known from the side what was only seen from the front."""
    rng = np.random.default_rng(0)
    truth_m = walking(60, 30.0, skeleton)
    turned = np.array([[np.cos(1.0), -np.sin(1.0), 0], [np.sin(1.0), np.cos(1.0), 0], [0, 0, 1.0]])
    ray = rng.normal(size=3)
    ray /= np.linalg.norm(ray)
    nothing = np.full((len(skeleton.bones), 3), np.nan)
    own = Posture.of(truth_m, 1 / 30, skeleton).towards(ray, nothing)
    others = Posture.of(truth_m @ turned.T, 1 / 30, skeleton).towards(ray, nothing)
    # The axis is that of the longest bones, which a body that leans has up to a degree from the vertical.
    np.testing.assert_allclose(own[0], others[0], atol=0.05)
    np.testing.assert_allclose(own[1], others[1], atol=0.05)


def test_a_bone_that_was_never_seen_may_point_anywhere(skeleton: Skeleton) -> None:
    nothing = np.full((len(skeleton.bones), 3), np.nan)
    mean, variance = Posture.none(skeleton).towards(np.array([0.0, 1.0, 0.0]), nothing)
    np.testing.assert_allclose(mean, 0.0, atol=1e-12)
    np.testing.assert_allclose(variance, 1 / 3, rtol=1e-9, atol=0.0)


def test_a_covariance_is_widened_where_another_one_is_larger() -> None:
    own, other = np.diag([1.0, 4.0, 9.0])[None], np.diag([2.0, 1.0, 0.0])[None]
    np.testing.assert_allclose(at_least(own, other)[0], np.diag([2.0, 4.0, 9.0]), rtol=1e-9, atol=1e-9)
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    both = at_least(R @ own @ R.T, R @ other @ R.T)[0]
    np.testing.assert_allclose(both, R @ np.diag([2.0, 4.0, 9.0]) @ R.T, rtol=1e-9, atol=1e-9)
    nothing = np.zeros((1, 3, 3))
    np.testing.assert_array_equal(at_least(own, nothing), own)
    assert np.isnan(at_least(np.full((1, 3, 3), np.nan), other)).all()
