from __future__ import annotations

import copy
import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from crowds import crowd

import fgpose
from fgpose.assessment.people import evaluate_people
from fgpose.people_observations import Detections
from fgpose.tracking import parallel
from fgpose_benchmarks.synthetic import CrowdScene
from tests.states import state_of

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
    people: list[fgpose.people.Tracked] = []
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


def in_3d(image: Detections, rig: fgpose.CameraRig) -> Detections:
    """At distances that tell which joint of which detection it is, and hardly known."""
    (camera,) = rig.subset([image.camera]).cameras
    number = np.arange(image.confidence.size).reshape(image.confidence.shape)
    points3d_m = camera.position_m + (5.0 + 1e-3 * number)[..., None] * camera.ray(camera.undistort(image.points2d_px))
    return replace(image, points3d_m=points3d_m, covariance3d_m2=np.tile(np.eye(3), (*number.shape, 1, 1)))


@pytest.mark.parametrize("at_once", [True, False])
def test_everybody_s_estimator_gets_their_per_view_3d(
    at_once: bool, scene: CrowdScene, monkeypatch: pytest.MonkeyPatch
):
    """Of the same joints as their pixels; a camera without has none."""
    taken: list[tuple[str, list[np.ndarray]]] = []
    names = "points2d_px", "points3d_m", "covariance3d_m2"
    skeleton = scene.motion.skeleton
    estimate = fgpose.Estimate(skeleton, 0, 0.0, np.zeros((skeleton.n_joints, 3)), np.zeros(skeleton.n_joints))

    def take_arrays(_: fgpose.Estimator, time_s: np.ndarray, **arrays: np.ndarray) -> fgpose.Estimate:
        taken.extend((camera, [arrays[name][c] for name in names]) for c, camera in enumerate(scene.rig.names))
        return estimate

    def take_image(_: fgpose.Estimator, camera: str, time_s: float, **arrays: np.ndarray) -> fgpose.Estimate:
        if camera == "ring_2":
            assert set(arrays) == {"points2d_px", "confidence"}
        else:
            taken.append((camera, [arrays[name] for name in names]))
        return estimate

    monkeypatch.setattr(fgpose.Estimator, "update_arrays", take_arrays)
    monkeypatch.setattr(fgpose.Estimator, "update_camera", take_image)
    tracker = fgpose.Tracker(scene.rig, skeleton, FAST)
    given: dict[tuple[float, ...], np.ndarray] = {}
    for images in moments(scene)[:12]:
        images = [image if image.camera == "ring_2" else in_3d(image, scene.rig) for image in images]
        for image in images:
            if image.points3d_m is not None:
                pairs = zip(image.points2d_px.reshape(-1, 2).tolist(), image.points3d_m.reshape(-1, 3), strict=True)
                given |= {tuple(px): point_m for px, point_m in pairs}
        for part in [images] if at_once else [[image] for image in images]:
            tracker.update(part)
    assert {camera for camera, *_ in taken} >= {"ring_0", "ring_1", "ring_3"}
    for camera, (points2d_px, points3d_m, covariance3d_m2) in taken:
        shown = np.asarray(np.isfinite(points2d_px).all(axis=-1)) & (camera != "ring_2")
        for px, point_m in zip(points2d_px[shown].tolist(), points3d_m[shown], strict=True):
            np.testing.assert_array_equal(point_m, given[tuple(px)])
        assert np.isnan(points3d_m[~shown]).all()
        np.testing.assert_array_equal(covariance3d_m2[shown], np.tile(np.eye(3), (shown.sum(), 1, 1)))


def test_bad_per_view_3d_is_named_and_changes_nothing(scene: CrowdScene):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    first, second = (in_3d(image, scene.rig) for image in moments(scene)[0][:2])
    assert second.points3d_m is not None
    tracker.update([first])
    before = state_of(tracker)
    message = "camera ring_1, image at 0 s: points3d_m has a median coordinate of .* millimetres"
    with pytest.raises(ValueError, match=message):
        tracker.update([replace(second, points3d_m=1e5 * second.points3d_m)])
    message = "camera ring_1, image at 0 s: give a covariance3d_m2 with all points3d_m or with none"
    with pytest.raises(ValueError, match=message):
        tracker.update([replace(second, covariance3d_m2=None)])
    assert state_of(tracker) == before
    tracker.update([second])


@pytest.mark.parametrize("n_wrong", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_one_wrong_stamp_changes_nothing(scene: CrowdScene, n_wrong: int):
    """Whoever is tracked is tracked on, and the other cameras are heard."""
    trackers = [fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST) for _ in range(2)]
    before: list[list[fgpose.people.Tracked]] = []
    for images in moments(scene)[:12]:
        before = [tracker.update(images) for tracker in trackers]
    wrong = [replace(moments(scene)[12][0], time_s=1e6 + n) for n in range(n_wrong)]
    assert len(before[0]) == 2
    for image in wrong:
        assert [each.person for each in trackers[0].update([image])] == [each.person for each in before[0]]
    for images in moments(scene)[12:14]:
        people, others = (tracker.update(images) for tracker in trackers)
        for each, other in zip(people, others, strict=True):
            np.testing.assert_array_equal(each.estimate.positions_m, other.estimate.positions_m)


@pytest.mark.parametrize("one_by_one", [False, True])
def test_a_camera_with_another_clock_is_left_out_from_the_beginning(scene: CrowdScene, *, one_by_one: bool):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    moved = [
        [replace(each, time_s=each.time_s + 1.7e9 * (each.camera == "ring_1")) for each in images]
        for images in moments(scene)[:12]
    ]
    people, told = updated(tracker, [[each] for images in moved for each in images] if one_by_one else moved)
    assert len(people) == 2
    (message,) = told
    assert message.startswith("camera ring_1, image at 1700000000 s: more than a minute later")


def test_images_given_together_do_not_confirm_their_common_stamp(scene: CrowdScene):
    tracker, other = (fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST) for _ in range(2))
    for images in moments(scene)[:12]:
        tracker.update(images)
        other.update(images)
    tracker.update([replace(image, time_s=1.7e9) for image in moments(scene)[12]])
    for images in moments(scene)[13:15]:
        people, others = tracker.update(images), other.update(images)
        assert len(people) == 2
        for ours, theirs in zip(people, others, strict=True):
            np.testing.assert_array_equal(ours.estimate.positions_m, theirs.estimate.positions_m)


def test_after_the_clock_was_set_back_people_are_found_anew(scene: CrowdScene):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    for images in moments(scene)[:12]:
        tracker.update(images)
    tracker.events()
    back = [[replace(each, time_s=each.time_s - 3600.0) for each in images] for images in moments(scene)[12:32]]
    for images in back[:9]:
        with pytest.raises(ValueError, match="not later than the camera's image before"):
            tracker.update(images)
    people, told = updated(tracker, back[9:])
    assert sorted(each.person for each in people) == [2, 3]
    assert [message[:22] for message in told] == ["the clock was set back"]
    assert [(each.what, each.person) for each in tracker.events()][:2] == [("lost", 0), ("lost", 1)]


@pytest.mark.parametrize(("unit", "words"), [(1e3, "milliseconds"), (1e9, "nanoseconds"), (1e-3, "another unit")])
def test_times_in_another_unit_are_said(scene: CrowdScene, unit: float, words: str):
    slow = [[replace(each, time_s=unit * each.time_s) for each in images] for images in moments(scene)[:14]]
    _, told = updated(fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST), slow)
    (message,) = told
    assert "no camera films like that" in message
    assert f"are these in {words}" in message


def updated(tracker: fgpose.Tracker, given: list[list[Detections]]) -> tuple[list[fgpose.people.Tracked], list[str]]:
    """Who is there at the end, and what was warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        people = [tracker.update(images) for images in given]
    return people[-1], [str(each.message) for each in told]


def test_after_a_pause_all_are_heard_again(scene: CrowdScene):
    """One by one too: the second camera confirms the time of the first."""
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    people: list[fgpose.people.Tracked] = []
    for images in moments(scene)[:2]:
        tracker.update(images)
    for images in moments(scene)[2:12]:
        for image in images:
            people = tracker.update([replace(image, time_s=image.time_s + 1000.0)])
    assert len(people) == 2


@pytest.mark.parametrize(
    ("camera", "time_s", "n_joints", "message"),
    [
        ("door", 0.1, 17, "camera door, image at 0.1 s: the rig has no such camera, only ring_0"),
        ("ring_0", 0.1, 3, "camera ring_0, image at 0.1 s: 3 joints, skeleton h36m_17 has 17"),
        ("ring_0", 0.0, 17, "camera ring_0, image at 0 s: not later than the camera's image before, 0 s"),
        (
            "ring_1",
            -0.3,
            17,
            "camera ring_1, image at -0.3 s: older than the newest image, of ring_0 at 0 s, by more than",
        ),
    ],
)
def test_bad_images_are_named_and_change_nothing(
    scene: CrowdScene, camera: str, time_s: float, n_joints: int, message: str
):
    tracker = fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST)
    first = moments(scene)[0]
    tracker.update([image for image in first if image.camera != "ring_1"])
    before = state_of(tracker)
    with pytest.raises(ValueError, match=message):
        tracker.update([Detections(camera, time_s, np.zeros((1, n_joints, 2)), np.ones((1, n_joints)))])
    assert state_of(tracker) == before
    tracker.update([image for image in first if image.camera == "ring_1"])


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda tracker: pickle.loads(pickle.dumps(tracker))])
def test_a_copy_goes_on_by_itself(scene: CrowdScene, again):
    config = FAST.replace(online={"solver": "window"})
    images = moments(scene)[:14]
    with fgpose.Tracker(scene.rig, scene.motion.skeleton, config) as tracker:
        for each in images[:-2]:
            tracker.update(each)
        before, other = state_of(tracker), again(tracker)
        of_other = [other.update(each) for each in images[-2:]]
        other.close()
        assert state_of(tracker) == before
        for each, one in zip(of_other, [tracker.update(each) for each in images[-2:]], strict=True):
            assert len(each) == len(one) > 0
            for a, b in zip(each, one, strict=True):
                np.testing.assert_array_equal(a.estimate.positions_m, b.estimate.positions_m)


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_tracker_with_other_processes_says_why_it_is_not_copied(scene: CrowdScene, monkeypatch, again):
    monkeypatch.setattr(parallel, "n_cores", lambda: 2)
    config = FAST.replace(tracking={"max_processes": 2})
    with (
        fgpose.Tracker(scene.rig, scene.motion.skeleton, config) as tracker,
        pytest.raises(TypeError, match=r"this Tracker cannot be saved or copied.*tracking\.max_processes = 1"),
    ):
        again(tracker)


def test_what_is_nobodys_is_told(scene: CrowdScene):
    """First everybody, until they are confirmed; then what one camera alone shows."""
    images = moments(scene)[:40]
    with fgpose.Tracker(scene.rig, scene.motion.skeleton, FAST) as tracker:
        tracker.update(images[0])
        assert {name: each.n_people for name, each in tracker.nobodys.items()} == {
            each.camera: each.n_people for each in images[0]
        }
        for each in images[1:-1]:
            tracker.update(each)
        assert len(tracker.update([])) == 0
        first, *others = images[-1]
        # The same person once more, beside everybody.
        points_px = np.concatenate([first.points2d_px, first.points2d_px[:1] + np.array([0.0, 3000.0])])
        alone = Detections(first.camera, first.time_s, points_px, np.concatenate([first.confidence, np.ones((1, 17))]))
        assert len(tracker.update([alone, *others])) == 2
        (point_px,) = tracker.nobodys[first.camera].points2d_px
        np.testing.assert_array_equal(point_px, points_px[-1])
        assert [tracker.nobodys[each.camera].n_people for each in others] == [0, 0, 0]
