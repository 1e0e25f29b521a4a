from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from crowds import crowd

import fgpose
from fgpose.assessment.people import evaluate_people
from fgpose.tracking.batch import SmoothedPeople
from fgpose_benchmarks.synthetic import CameraTimes, CrowdScene

FAST = fgpose.Config(solver={"covariance": False})


@cache
def everybody(
    n_people: int, n_cameras: int, times: CameraTimes | None
) -> tuple[CrowdScene, SmoothedPeople, list[tuple[int, int]]]:
    """A crowd, what is made of it, and the progress that was told."""
    scene, told = crowd(n_people, n_cameras, 6.0, 1, times), list[tuple[int, int]]()
    people = fgpose.smooth_people(scene.observations, scene.rig, FAST, lambda done, of: told.append((done, of)))
    return scene, people, told


@pytest.mark.parametrize(
    ("n_people", "n_cameras", "times"),
    [
        (3, 4, None),
        pytest.param(4, 5, None, marks=pytest.mark.slow),
        pytest.param(3, 4, CameraTimes(fps=(25.0, 30.0), random_phases=True), marks=pytest.mark.slow),
    ],
)
def test_everybody_is_told_apart_and_smoothed(n_people: int, n_cameras: int, times: CameraTimes | None):
    scene, people, told = everybody(n_people, n_cameras, times)
    time_s = people.association.frames.frame_time_s
    score = evaluate_people(people.trajectories, scene.truth(time_s), time_s=time_s)
    # Who enters or leaves is missed for some frames; the issue of this project asks for 98, 99 and 98 %.
    assert score.recall > 0.97
    assert score.precision > 0.97
    assert score.idf1 > 0.97
    assert score.n_identities == n_people
    # The detections are as noisy as those of one person in the other tests, whose error is 15 to 25 mm.
    assert score.mpjpe_mm < 40
    assert told[-1][0] == told[-1][1]


def test_each_has_the_frames_that_show_them():
    _, people, _ = everybody(3, 4, None)
    for person, trajectory in people.trajectories.items():
        own = people.association.of(person)
        np.testing.assert_array_equal(trajectory.time_s, own.frame_time_s)
        all_s = people.association.observations.frame_time_s
        np.testing.assert_allclose(all_s[trajectory.frame_numbers], trajectory.time_s, atol=1e-9)
        assert own.seen[0].any()
        assert own.seen[-1].any()


@pytest.mark.parametrize(("unseen_s", "is_away"), [(2.0, True), (0.4, False)])
def test_somebody_who_is_away_has_no_pose_meanwhile(unseen_s: float, is_away: bool):
    scene = crowd(1, 4, 5.0, 2)

    def emptied(image: fgpose.people.Detections) -> fgpose.people.Detections:
        return replace(image, points2d_px=image.points2d_px[:0], confidence=image.confidence[:0], points3d_m=None)

    images = [emptied(image) if 2.0 < image.time_s < 2.0 + unseen_s else image for image in scene.observations.images]
    observations = replace(scene.observations, images=tuple(images))
    people = fgpose.smooth_people(observations, scene.rig, FAST)
    (trajectory,) = people.trajectories.values()
    (truth,) = scene.truth(trajectory.time_s).values()
    missing = np.asarray(np.isnan(trajectory.positions_m).all(axis=(1, 2)))
    unseen = (trajectory.time_s > 2.0) & (trajectory.time_s < 2.0 + unseen_s)
    assert not missing[~unseen].any()
    assert missing[unseen].all() == is_away
    assert (trajectory.status[missing] == fgpose.Status.UNOBSERVABLE).all()
    # As where nobody is away: the error of one person in four cameras is 15 to 25 mm in the other tests.
    error_m = np.linalg.norm(trajectory.positions_m - truth.positions_m, axis=-1)[~unseen]
    assert error_m.mean() < 0.03


def test_every_detection_belongs_to_at_most_one_person():
    scene, smoothed, _ = everybody(3, 4, None)
    people = smoothed.association
    used: set[tuple[int, int, int, int]] = set()
    for seen in people.people.values():
        for t, c, j in np.argwhere(seen.detection != -1).tolist():
            one = (seen.first_frame + t, c, int(seen.detection[t, c, j]), int(seen.joint[t, c, j]))
            assert one not in used
            used.add(one)
    n_detections = sum(image.n_people for image in scene.observations.images)
    assert 0 <= people.n_unused < 0.1 * n_detections


def test_a_camera_that_the_rig_lacks_is_named():
    scene = crowd(1, 3, 1.0, 0)
    with pytest.raises(ValueError, match="no camera ring_2"):
        fgpose.smooth_people(scene.observations, scene.rig.subset(["ring_0", "ring_1"]))
