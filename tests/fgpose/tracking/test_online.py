from __future__ import annotations

import numpy as np
import pytest
from crowds import crowd

import fgpose
from fgpose.assessment.people import evaluate_people
from fgpose.people import Detections
from fgpose.synthetic import CrowdScene

FAST = fgpose.Config(online={"lag_s": 0.2, "covariance": False}, tracking={"max_processes": 1})


def moments(scene: CrowdScene) -> list[list[Detections]]:
    """The images of equal times."""
    by_time: dict[float, list[Detections]] = {}
    for image in scene.observations.images:
        by_time.setdefault(image.time_s, []).append(image)
    return list(by_time.values())


@pytest.fixture(scope="module")
def scene() -> CrowdScene:
    return crowd(2, 4, 4.0, 1)


@pytest.mark.slow
def test_everybody_is_tracked(scene: CrowdScene):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    estimates: dict[int, list[fgpose.Estimate]] = {}
    for images in moments(scene):
        for tracked in tracker.update(images):
            estimates.setdefault(tracked.person, []).append(tracked.estimate)
    trajectories = {person: fgpose.Trajectory.from_estimates(own) for person, own in estimates.items()}
    time_s = np.array([images[0].time_s for images in moments(scene)])
    score = evaluate_people(trajectories, scene.truth(time_s), time_s=time_s)
    # Confirmed within 0.3 s of 4 s: 93 % at least.
    assert score.recall > 0.92
    assert score.precision > 0.97
    assert score.n_identities == 2
    assert score.switches == 0
    assert score.mpjpe_mm < 50
    assert [event.what for event in tracker.events()][:2] == ["confirmed", "confirmed"]
    assert tracker.events() == []


@pytest.mark.slow
def test_images_one_by_one_are_the_same_people(scene: CrowdScene):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    people: list[fgpose.Tracked] = []
    for image in scene.observations.images[:120]:
        people = tracker.update([image])
    now_s = np.array([scene.observations.images[119].time_s])
    truth_m = np.stack([true.positions_m[0] for true in scene.truth(now_s).values()])
    assert len(people) == 2
    positions_m = np.stack([tracked.estimate.positions_m for tracked in people])
    errors_m = np.linalg.norm(positions_m[:, None] - truth_m, axis=-1).mean(axis=-1)
    # Of a person's own: people are half a metre from each other at least.
    assert (errors_m.min(axis=1) < 0.15).all()
    assert set(errors_m.argmin(axis=1)) == {0, 1}


def test_several_moments_at_once_are_taken_one_after_the_other(scene: CrowdScene):
    one_by_one, at_once = (fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST) for _ in range(2))
    first = moments(scene)[:8]
    people = [one_by_one.update(images) for images in first][-1]
    again = at_once.update([image for images in first for image in images])
    assert [tracked.person for tracked in people] == [tracked.person for tracked in again]
    for one, other in zip(people, again, strict=True):
        np.testing.assert_array_equal(one.estimate.positions_m, other.estimate.positions_m)


def test_nothing_new_is_nobody(scene: CrowdScene):
    assert fgpose.Tracker(scene.rig, scene.motion.skeleton).update([]) == []


@pytest.mark.parametrize(
    ("camera", "time_s", "n_joints", "message"),
    [
        ("door", 0.1, 17, "camera door, image at 0.1 s: the rig has no such camera, only ring_0"),
        ("ring_0", 0.1, 3, "camera ring_0, image at 0.1 s: 3 joints, skeleton h36m_17 has 17"),
        ("ring_0", 0.0, 17, "camera ring_0, image at 0 s: not later than the camera's image before, 0 s"),
        ("ring_1", -0.3, 17, "camera ring_1, image at -0.3 s: older than the newest image by more than online.lag_s"),
    ],
)
def test_bad_images_are_named_and_change_nothing(
    scene: CrowdScene, camera: str, time_s: float, n_joints: int, message: str
):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    first = moments(scene)[0]
    tracker.update([image for image in first if image.camera != "ring_1"])
    with pytest.raises(ValueError, match=message):
        tracker.update([Detections(camera, time_s, np.zeros((1, n_joints, 2)), np.ones((1, n_joints)))])
    tracker.update([image for image in first if image.camera == "ring_1"])
