"""Everybody who is there, live: from images as they come, and also when none comes."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import fgpose
from fgpose.association.identity.likeness import Builds
from fgpose.association.track import Tracked, TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.io.live.tracker_memory import load_memory, save_memory
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.processes.parts import Parts
from fgpose.live.recording.memory_file import MemoryFile
from fgpose.live.tracking.known import is_told_by_motion
from fgpose.live.tracking.live_tracking import LiveTracking, Update
from fgpose.live.tracking.observed import volume_points_m
from fgpose.people_observations import Detections
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

CONFIG = fgpose.Config(online={"lag_s": 0.3}, tracking={"max_processes": 1})
DELAY_S = 0.02
"""From taking an image to having its detections."""


@cache
def scene() -> CrowdScene:
    """Two people who stay, for 2 s, in four cameras."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(late_share=0.0, leaving_share=0.0, returning_share=0.0)
    motion = crowd_motion(2, 100, 50.0, walks, works, 2, plan)
    rig = ring_rig(4, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), 2)


def tracking() -> LiveTracking:
    return LiveTracking(scene().rig, scene().motion.skeleton, CONFIG, volume_points_m(scene().rig))


def statuses(state: CameraState = CameraState.OK) -> tuple[CameraStatus, ...]:
    return tuple(CameraStatus(name, state) for name in scene().rig.names)


def feed(live: LiveTracking, images: list[Detections]) -> tuple[list[Update], float]:
    """All images, each as soon as its detections are there; the time at the end."""
    updates, now_s = [], 0.0
    for image in images:
        now_s = image.time_s + DELAY_S
        updates += live.add(RecordedImage(image, now_s), now_s)
        updates += live.look(now_s, scene().rig.names)
    return updates, now_s


def errors_m(frame: LiveFrame) -> np.ndarray:
    """Mean error of each person, of the nearest true one."""
    truth = scene().truth(np.array([frame.time_s]))
    truth_m = np.stack([true.positions_m[0] for true in truth.values()])
    people_m = np.stack([person.positions_m for person in frame.people])
    return np.linalg.norm(people_m[:, None] - truth_m, axis=-1).mean(axis=-1).min(axis=1)


@pytest.fixture(scope="module")
def fed() -> tuple[LiveTracking, list[Update], float]:
    live = tracking()
    updates, now_s = feed(live, list(scene().observations.images))
    return live, updates, now_s


def test_images_of_a_moment_are_tracked_together(fed: tuple[LiveTracking, list[Update], float]):
    _, updates, _ = fed
    n_images = [len(update.images) for update in updates]
    # Only the first moment waits for nobody: it is not known yet how often images come.
    assert np.mean(np.array(n_images) == 4) > 0.95
    assert all(image.is_used for update in updates for image in update.images)
    assert sum(n_images) == len(scene().observations.images)


def test_a_frame_says_who_is_where(fed: tuple[LiveTracking, list[Update], float]):
    live, updates, now_s = fed
    frame = live.frame(now_s, statuses())
    assert {person.person for person in frame.people} == {0, 1}
    assert (errors_m(frame) < 0.1).all()
    assert frame.age_s == pytest.approx(DELAY_S)
    # The volume is what these cameras observe, all of it when all are ok.
    assert frame.observed_share == pytest.approx(1.0)
    for person in frame.people:
        assert person.covariance_m2.shape == (17, 3, 3)
        assert ((person.probability >= 0) & (person.probability <= 1)).all()
    assert [event.what for update in updates for event in update.events][:2] == ["confirmed", "confirmed"]


def test_a_frame_says_what_is_nobodys() -> None:
    """At first everybody is."""
    live, images = tracking(), list(scene().observations.images[:4])
    _, now_s = feed(live, images)
    nobodys = live.frame(now_s, statuses()).nobodys
    assert {each.camera: each.n_people for each in nobodys} == {each.camera: each.n_people for each in images}


def test_without_images_people_may_be_anywhere_and_nothing_is_observed(fed: tuple[LiveTracking, list[Update], float]):
    live, _, now_s = fed
    seen, silent = live.frame(now_s, statuses()), live.frame(now_s + 1.0, statuses(CameraState.LOST))
    assert silent.sequence == seen.sequence + 1
    assert silent.observed_share == 0.0
    assert silent.age_s == pytest.approx(1.0 + DELAY_S)
    for before, after in zip(seen.people, silent.people, strict=True):
        assert after.state is TrackState.COASTING
        known = np.isfinite(before.positions_m).all(axis=-1)
        # 0.8 m in every direction after a second: somebody who walks at 1.6 m/s is within two standard deviations. And
        # along their way as far as they would have gone.
        assert before.velocity_mps is not None
        grown_m2 = np.linalg.eigvalsh(after.covariance_m2[known] - before.covariance_m2[known])
        squares = np.array([0.0, 0.0, np.sum(before.velocity_mps**2)]) + 0.8**2
        np.testing.assert_allclose(grown_m2, np.tile((1.0 + DELAY_S) ** 2 * squares, (known.sum(), 1)), rtol=1e-6)
        assert not after.probability.any()


def test_whose_images_always_come_late_is_seen_until_they_stay_away(caplog: pytest.LogCaptureFixture) -> None:
    live, late_s, seen, now_s = tracking(), 0.25, 0, 0.0
    for image in scene().observations.images[: 4 * 75]:  # 1.5 s
        now_s = image.time_s + late_s
        live.add(RecordedImage(image, now_s), now_s)
        if live.look(now_s, scene().rig.names):
            for person in live.frame(now_s, statuses()).people:
                seen += 1
                assert person.state is TrackState.CONFIRMED
                assert (person.status == fgpose.Status.OBSERVED).mean() > 0.5
                # Of when the images were taken, not of now: 0.8 m/s for the delay would be 0.2 m and more.
                assert np.sqrt(np.nanmedian(np.diagonal(person.covariance_m2, axis1=1, axis2=2))) < 0.1
    assert seen > 100  # two people in most of 75 moments
    assert [record.message[:37] for record in caplog.records] == ["frames come 0.25 s after their images"]
    for unseen_s, state in ((0.04, TrackState.CONFIRMED), (0.2, TrackState.COASTING)):  # two and ten intervals
        people = live.frame_without_news(now_s + unseen_s, statuses()).people
        assert [person.state for person in people] == [state, state]
    assert not people[0].probability.any()


def test_no_more_images_are_used_than_have_come(fed: tuple[LiveTracking, list[Update], float]):
    """Cameras are asked less often than the tracker."""
    live, _, now_s = fed
    asked = tuple(CameraStatus(name, CameraState.OK, n_images=50, n_lost=2) for name in scene().rig.names)
    for camera in live.frame(now_s, asked).cameras:
        assert (camera.n_images, camera.n_used, camera.n_lost) == (62, 60, 2)


def test_nobody_is_said_too():
    frame = tracking().frame(5.0, statuses())
    assert (frame.people, frame.sequence) == ((), 0)
    assert np.isnan([frame.time_s, frame.age_s]).all()
    assert frame.observed_share > 0.9


@pytest.mark.slow
def test_a_late_image_is_used_within_the_lag_and_counted_beyond():
    live, images = tracking(), list(scene().observations.images)
    held = [image for image in images if image.camera == "ring_0"]
    others = [image for image in images[: 4 * 45] if image.camera != "ring_0"]
    _, now_s = feed(live, others)
    live.look(now_s + 1.0, ())
    newest_s = max(image.time_s for image in others)
    within = next(image for image in held if image.time_s > newest_s - 0.2)
    beyond = next(image for image in held if image.time_s < newest_s - 0.5)
    for image, is_used in ((within, True), (beyond, False)):
        updates = live.add(RecordedImage(image, now_s), now_s) + live.look(now_s + 1.0, ())
        assert [each.is_used for update in updates for each in update.images] == [is_used]


@pytest.mark.filterwarnings("ignore:camera ring_1. its clock was set:UserWarning")
@pytest.mark.parametrize("by_s", [0.3, pytest.param(-0.25, marks=pytest.mark.slow)])
def test_a_clock_that_is_set_drives_nobody(by_s: float) -> None:
    """Its images made the newest frames, a moment ahead of all others and seen by nobody else."""
    live, frame = tracking(), None
    for at_s, images in itertools.groupby(scene().observations.images, key=lambda image: image.time_s):
        is_set = at_s >= 1.0
        moment = [replace(each, time_s=at_s + by_s * (is_set and each.camera == "ring_1")) for each in images]
        for image in moment:
            now_s = at_s + DELAY_S
            live.add(RecordedImage(image, now_s), now_s)
            live.look(now_s, scene().rig.names)
        frame = live.frame(at_s + DELAY_S, statuses())
        assert frame.time_s <= at_s
        # Detections of three cameras err by some centimetres, and the moment may wait for another one.
        assert not is_set or (errors_m(frame) < 0.1).all()
    assert frame is not None
    assert len(frame.people) == 2
    set_clock, *others = sorted(frame.cameras, key=lambda camera: camera.name != "ring_1")
    assert set_clock.state is CameraState.DOUBTFUL
    assert set_clock.reason.startswith("its clock was set")
    assert set_clock.reason.endswith("[late-camera]")
    assert {camera.state for camera in others} == {CameraState.OK}
    assert set_clock.n_used == 30
    assert {camera.n_used for camera in others} == {60}


@pytest.mark.parametrize("gap_s", [0.2, pytest.param(0.3, marks=pytest.mark.slow)])
def test_a_computer_that_is_too_slow_sets_no_clock(gap_s: float) -> None:
    """It leaves images out, then finds two of each camera: the first of them was given before the others of its moment,
    again and again, and its camera was far ahead of them. Nothing is warned of: warnings are errors."""
    live, taken_s = tracking(), np.array(sorted({image.time_s for image in scene().observations.images}))
    burst_s = np.arange(taken_s[0], taken_s[-1], gap_s)
    pairs = {at_s: taken_s[taken_s <= at_s + 1e-9][-2:] for at_s in burst_s[1:].tolist()}
    for at_s, pair_s in pairs.items():
        for image in (image for image in scene().observations.images if image.time_s in pair_s):
            live.add(RecordedImage(image, at_s + DELAY_S), at_s + DELAY_S)
        live.look(at_s + DELAY_S, scene().rig.names)
    frame = live.frame(burst_s[-1] + DELAY_S, statuses())
    assert {(camera.state, camera.n_used) for camera in frame.cameras} == {(CameraState.OK, 2 * len(pairs))}


@pytest.mark.slow
def test_the_motion_tells_how_late_a_camera_is():
    """Where that is not known; it changes nothing where the times are those of this computer."""
    late_s, live, held = {"ring_1": 0.03}, tracking(), tracking()
    moments = itertools.groupby(scene().observations.images, key=lambda image: image.time_s)
    for at_s, images in moments:
        images = [replace(image, time_s=image.time_s - late_s.get(image.camera, 0.0)) for image in images]
        live.track([RecordedImage(image, image.time_s, time_sigma_s=0.1) for image in images])
        live.tidy()
        if at_s < 1.0:
            held.track([RecordedImage(image, image.time_s) for image in images])
            held.tidy()
    told, silent = live.frame(3.0, statuses()), held.frame(1.0, statuses())
    assert {camera.motion_offset_s for camera in silent.cameras} == {None}
    offset_s = np.array([camera.motion_offset_s for camera in told.cameras])
    # Relative to the mean of four. Three seconds of two people who hardly walk tell it to some milliseconds.
    np.testing.assert_allclose(offset_s, [-0.0075, 0.0225, -0.0075, -0.0075], atol=0.01)
    assert all(camera.motion_sigma_s is not None and 0 < camera.motion_sigma_s < 0.02 for camera in told.cameras)


def test_motion_proves_a_clock_beside_one_that_is_proven() -> None:
    """It tells how late images come, beside a camera of which that is known; without one it does not."""
    late = CameraStatus("late", CameraState.OK, unproven_s=0.6)
    proven = CameraStatus("other", CameraState.OK, unproven_s=0.0)
    lost = replace(proven, state=CameraState.LOST)
    assert is_told_by_motion("late", 0.01, [late, proven])
    for sigma_s, other in ((0.05, proven), (0.01, replace(late, name="other")), (0.01, lost)):
        assert not is_told_by_motion("late", sigma_s, [late, other])
    assert not is_told_by_motion("other", 0.01, [proven])


def test_an_image_that_was_there_before_is_not_used_again():
    live, images = tracking(), list(scene().observations.images[:8])
    _, now_s = feed(live, images)
    (update,) = live.add(RecordedImage(images[0], now_s), now_s)
    assert [image.is_used for image in update.images] == [False]


def test_an_image_with_the_time_of_one_that_waits_is_not_used():
    live, image = tracking(), scene().observations.images[0]
    assert live.add(RecordedImage(image, image.time_s), image.time_s) == []
    (update,) = live.add(RecordedImage(image, image.time_s), image.time_s)
    assert [image.is_used for image in update.images] == [False]
    (update,) = live.look(image.time_s + 1.0, ())
    assert [image.is_used for image in update.images] == [True]


def test_a_tracker_that_fails_is_replaced(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    live, images = tracking(), list(scene().observations.images)
    _, now_s = feed(live, images[:60])

    def fail(_: object) -> None:
        raise RuntimeError("indeterminate")

    monkeypatch.setattr(live._tracker, "update", fail)
    (update,) = [update for image in images[60:64] for update in feed(live, [image])[0]]
    assert (update.people, live.n_failures) == ((), 1)
    assert "the tracker ended (RuntimeError: indeterminate) and is begun again" in caplog.text
    # Nobody is not nobody there: a system that has just begun knows nothing, and says so from the first frame on.
    begun_s, failed = images[0].time_s, live.frame(now_s, statuses())
    assert failed.people == ()
    assert np.isnan(failed.tracking_since_s)
    _, now_s = feed(live, images[64:140])
    assert begun_s < update.images[0].detections.time_s <= live.frame(now_s, statuses()).tracking_since_s < now_s
    assert len(live.frame(now_s, statuses()).people) == 2


def test_a_new_start_says_that_it_has_found_nobody_yet() -> None:
    """Whatever has failed: who is there is not nobody."""
    live, images = tracking(), list(scene().observations.images)
    _, now_s = feed(live, images[:60])
    assert np.isfinite(live.frame(now_s, statuses()).tracking_since_s)
    live.restart()
    assert np.isnan(live.frame(now_s, statuses()).tracking_since_s)


def test_an_image_that_shows_the_same_again_does_not_make_people_newer() -> None:
    """All cameras stand still, with new stamps: people are not where they were."""
    live, images = tracking(), list(scene().observations.images)
    _, now_s = feed(live, images[:60])
    newest_s, last = live.newest_s, {image.camera: image for image in images[:60]}
    again = [replace(image, time_s=image.time_s + 0.1 * k) for k in range(1, 6) for image in last.values()]
    updates, now_s = feed(live, again)
    assert all(not image.is_used for update in updates for image in update.images)
    assert live.newest_s == newest_s
    assert live.frame(now_s, statuses()).age_s > 0.5 - 0.1


def test_after_a_time_without_images_people_may_not_be_found_yet() -> None:
    live, images = tracking(), list(scene().observations.images)
    _, now_s = feed(live, images[:60])
    before_s = live.frame(now_s, statuses()).tracking_since_s
    gap = [replace(image, time_s=image.time_s + 0.6) for image in images[60:80]]
    _, now_s = feed(live, gap)
    since_s = live.frame(now_s, statuses()).tracking_since_s
    assert since_s > before_s
    assert since_s == pytest.approx(gap[0].time_s, abs=0.05)  # its moment


def test_processes_are_looked_at_while_no_image_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    live, looked = tracking(), []
    monkeypatch.setattr(live._tracker, "look", lambda: looked.append(1))
    for k in range(10):
        assert live.look(0.05 * k, ()) == []
    assert 4 <= len(looked) <= 5  # every 0.1 s
    monkeypatch.setattr(live._tracker, "look", Mock(side_effect=OSError("no memory")))
    live.look(1.0, ())
    assert live.n_failures == 1


def test_each_failure_of_gtsam_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    parts, images = Parts(), list(scene().observations.images)
    live = LiveTracking(scene().rig, scene().motion.skeleton, CONFIG, volume_points_m(scene().rig), parts)
    feed(live, images[:60])
    assert parts.so_far() == ()
    update = live._tracker.update

    def failing(given: list[Detections]) -> list[Tracked]:
        return [replace(each, estimate=replace(each.estimate, n_repairs=2)) for each in update(given)]

    monkeypatch.setattr(live._tracker, "update", failing)
    feed(live, images[60:80])
    (restarts,) = parts.so_far()
    assert (restarts.part, restarts.reason) == ("the graph of an estimator", "GTSAM has failed")
    assert restarts.n == 2 * len(live.frame(0.0, statuses()).people) > 0


def test_the_next_system_knows_people_and_clocks(fed: tuple[LiveTracking, list[Update], float], tmp_path: Path) -> None:
    live, _, now_s = fed
    path, made_for = tmp_path / "people.json", (scene().rig, scene().motion.skeleton, CONFIG)
    MemoryFile(path, live, scene().rig, CONFIG).close()
    memory = load_memory(path, *made_for)
    assert memory == live.memory()
    # Numbers that a new tracker would not give, and what nothing here tells.
    others = tuple(replace(each, person=each.person + 5) for each in memory.people)
    told = tuple(map(tuple, (1e4 * np.eye(4)).tolist()))
    memory = replace(memory, n_people=7, people=others, offset_information=told)
    after = LiveTracking(*made_for, volume_points_m(scene().rig), memory=memory)
    # Everybody goes back the way they came.
    images = [replace(image, time_s=2 * now_s - image.time_s) for image in scene().observations.images]
    _, later_s = feed(after, sorted(images, key=lambda image: image.time_s)[:100])
    middles_m = [
        {person.person: np.nanmedian(person.positions_m, axis=0) for person in frame.people}
        for frame in (live.frame(now_s, statuses()), after.frame(later_s, statuses()))
    ]
    assert middles_m[1].keys() == {person + 5 for person in middles_m[0]}
    for person, middle_m in middles_m[0].items():
        # They walk at 1.5 m/s at most.
        assert np.linalg.norm(middles_m[1][person + 5] - middle_m) < 1.5 * (later_s - now_s)
    known = after.memory()
    assert known is not None
    assert known.n_people >= 7
    assert known.offset_information == told
    # Bones too: they are known better than after 0.4 s, and than those of somebody who may have changed meanwhile.
    bones_of = {each.person: each for each in known.people}
    for each in memory.people:
        then_m, now_m = np.array(each.bone_lengths_m), np.array(bones_of[each.person].bone_lengths_m)
        sigma_m = np.hypot(each.bone_length_sigma_m, Builds().between_stays_m)
        assert (np.abs(now_m - then_m) < 3 * sigma_m).all()
        assert (np.array(bones_of[each.person].bone_length_sigma_m) < sigma_m).all()


def test_a_memory_that_does_not_fit_is_refused(fed: tuple[LiveTracking, list[Update], float], tmp_path: Path) -> None:
    made_for = rig, skeleton, config = scene().rig, scene().motion.skeleton, CONFIG
    memory, path = fed[0].memory(), tmp_path / "people.json"
    assert memory is not None
    save_memory(memory, path, *made_for)
    others = CameraRig(rig.cameras[:3]), skeleton, config.replace(online={"lag_s": 0.2})
    with pytest.raises(ValueError, match=r"people\.json: it was written with another rig and another configuration"):
        load_memory(path, *others)
    document = json.loads(path.read_text())
    document["memory"]["people"][0]["length_m"].pop()
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=r"people\.json: memory\.people: person 0 has not"):
        load_memory(path, *made_for)
    save_memory(memory, path, *made_for)
    document = json.loads(path.read_text())
    document["memory"]["people"][0]["bone_lengths_m"][0] = -0.1
    path.write_text(json.dumps(document))
    with pytest.raises(ValueError, match=r"people\.json: memory\.people: person 0 has a bone length that is none"):
        load_memory(path, *made_for)
    save_memory(memory, path, *made_for)
    path.write_text(path.read_text()[:300])
    with pytest.raises(ValueError, match=r"people\.json: it is damaged, .*: choose a new file, or remove this one"):
        load_memory(path, *made_for)
    path.write_text('{"format": "of somebody else"}')
    with pytest.raises(ValueError, match=r"people\.json: it is no file of format"):
        load_memory(path, *made_for)
