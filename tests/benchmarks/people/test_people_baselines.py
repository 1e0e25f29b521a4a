from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.people import PeopleEvaluation, evaluate_people
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.people.baselines.cross_view import cross_view
from fgpose_benchmarks.people.baselines.frame import Frame, NearestInTime
from fgpose_benchmarks.people.baselines.greedy import greedy
from fgpose_benchmarks.people.baselines.rapid_pose import Triangulator, rapid_pose
from fgpose_benchmarks.people.recording import PeopleRecording, Poses, trajectories
from fgpose_benchmarks.synthetic import NO_CROWD_ERRORS, CameraTimes
from tests.benchmarks.people.passing_people import changed, passing, recorded

Solve = Callable[[PeopleRecording], list[Poses]]
BASELINES = pytest.mark.parametrize("solve", [greedy, rapid_pose, cross_view])
TENTATIVE_FRAMES = 2
"""The tracker reports nobody before the third frame."""


def evaluated(recording: PeopleRecording, poses: list[Poses]) -> PeopleEvaluation:
    time_s = recording.frames.frame_time_s
    found = trajectories(recording.observations.skeleton, time_s, poses)
    return evaluate_people(found, recording.truth, time_s=time_s)


@BASELINES
@pytest.mark.parametrize(("n_people", "n_cameras"), [(2, 3), (3, 4)])
def test_exact_detections_give_exact_people(solve: Solve, n_people: int, n_cameras: int):
    recording = recorded(passing(n_people), n_cameras)
    score = evaluated(recording, solve(recording))
    tentative = TENTATIVE_FRAMES if solve is cross_view else 0
    assert score.recall == pytest.approx(1 - tentative / score.n_frames)
    assert score.precision == 1.0
    assert (score.n_identities, score.switches) == (n_people, 0)
    # All but rounding is exact.
    assert score.mpjpe_mm < 1e-3
    assert score.share_missing == 0


@BASELINES
def test_unsynchronised_cameras_are_off_by_what_people_walk(solve: Solve):
    times = CameraTimes(fps=(25.0, 30.0), random_phases=True)
    recording = recorded(passing(), 4, times=times)
    score = evaluated(recording, solve(recording))
    assert (score.n_identities, score.switches) == (3, 0)
    # Limbs of walking people move at up to 3 m/s, and images of one frame are up to 20 ms from its time.
    assert 1 < score.mpjpe_mm < 60


@BASELINES
def test_whom_only_one_camera_sees_is_nobody(solve: Solve):
    recording = recorded(passing(3), 3)
    truth_m = recording.scene.motion.truth_m[2, 0]

    def without_the_third(image: Detections) -> Detections:
        camera = recording.rig.subset([image.camera]).cameras[0]
        expected_px = camera.project(truth_m)
        is_third = np.linalg.norm(image.points2d_px - expected_px, axis=-1).max(axis=-1) < 1.0
        keep = ~is_third if image.camera != recording.rig.names[0] else np.ones(len(is_third), dtype=bool)
        return Detections(image.camera, image.time_s, image.points2d_px[keep], image.confidence[keep])

    alone = changed(recording, without_the_third)
    assert {image.n_people for image in alone.observations.images} == {2, 3}
    people = {person for of_frame in solve(alone) for person in of_frame}
    assert len(people) == 2


@BASELINES
def test_empty_images_show_nobody(solve: Solve):
    recording = recorded(passing(2, 5), 3)
    n_joints = recording.observations.skeleton.n_joints
    empty = changed(
        recording,
        lambda image: Detections(image.camera, image.time_s, np.zeros((0, n_joints, 2)), np.zeros((0, n_joints))),
    )
    assert solve(empty) == [{}] * 5


def test_a_detection_that_is_doubled_is_clustered_with_its_double():
    errors = replace(NO_CROWD_ERRORS, doubled_share=0.2)
    recording = recorded(passing(), 4, errors)
    assert max(image.n_people for image in recording.observations.images) > 3
    score = evaluated(recording, rapid_pose(recording))
    assert (score.recall, score.precision, score.n_identities) == (1.0, 1.0, 3)


def test_the_nearest_pose_in_time_is_the_same_person():
    def at(x_m: float) -> np.ndarray:
        return np.array([[x_m, 0.0, 0.0], [x_m, 0.0, 1.0]])

    identity = NearestInTime(reach_m=0.5, speed_mps=1.0, forget_s=2.0)
    assert list(identity.identified(0.0, [at(0.0), at(1.0)])) == [0, 1]
    # The nearest pair first: 1.3 is nearer to 1 than 1.6, which is out of reach of 0.
    found = identity.identified(0.1, [at(1.6), at(1.3), at(0.1)])
    assert {person: pose_m[0, 0] for person, pose_m in found.items()} == {0: 0.1, 1: 1.3, 2: 1.6}
    # After 1.9 s somebody may have gone 1.9 m farther; after more than 2 s nobody is known.
    assert list(identity.identified(2.0, [at(-2.2)])) == [0]
    assert list(identity.identified(4.1, [at(-2.2)])) == [3]


def test_pairs_are_of_different_views_and_meet_in_the_joints():
    recording = recorded(passing(2, 2), 3)
    _, images = next(recording.images())
    frame = Frame.of(images, recording.rig)
    pairs = frame.pairs()
    assert len(pairs) == 3 * 2 * 2
    joints_m, rays_m = frame.meetings(pairs)
    truth_m = recording.scene.motion.truth_m[:, 0]
    nearest_m = np.linalg.norm(joints_m[:, None] - truth_m, axis=-1).max(axis=-1).min(axis=-1)
    # Of each two cameras, two pairs are of one person.
    assert (nearest_m < 1e-9).sum() == (rays_m.max(axis=-1) < 1e-9).sum() == 6


def test_joints_of_low_confidence_are_not_used():
    recording = recorded(passing(1, 2), 3)
    _, images = next(recording.images())
    doubtful = images[0].confidence.copy()
    doubtful[0, 5] = 0.2
    images[0] = Detections(images[0].camera, images[0].time_s, images[0].points2d_px, doubtful)
    known = Frame.of(images, recording.rig).known
    assert not known[0, 0, 5]
    assert known.sum() == 3 * 17 - 1


def test_the_core_joints_must_be_there():
    with pytest.raises(ValueError, match="left_shoulder"):
        Triangulator(Skeleton("two", ("head", "hand"), ((0, 1),), (0,), ()))
