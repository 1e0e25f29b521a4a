"""Cameras that do not agree where people are: noticed, named, and over again."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fgpose
from fgpose.association.track import Tracked, TrackState
from fgpose.geometry.camera import CameraRig
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.frame import CameraState, CameraStatus
from fgpose.live.tracking.agreement import CameraAgreement
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.motion_lags import in_words
from fgpose.live.tracking.nobody_followed import NobodyFollowed
from fgpose.live.tracking.observed import volume_points_m
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Status
from fgpose_benchmarks.synthetic import (
    SimulatedClocks,
    SimulatedNetwork,
    WalkScene,
    film,
    positions_at,
    ring_rig,
    walkers,
)
from fgpose_benchmarks.synthetic.crowd.walkers import Behaviour
from tests.wrong_rigs import turned

NO_LATENESS = np.zeros(4)


@cache
def scene(
    n_cameras: int = 4,
    behaviour: Behaviour = "walks",
    n_people: int = 1,
    rate_hz: float = 1.0,
    start_s: float = 0.0,
    duration_s: float = 60.0,
    seed: int = 2,
) -> WalkScene:
    """People, seen by a network whose bias depends on the side from which it sees the body."""
    rig = ring_rig(n_cameras, 4.5, 2.5, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    motion = walkers((5.0, 5.0), duration_s, seed, behaviour, n_people)
    return film(motion, rig, seed, SimulatedNetwork(in_3d=False), SimulatedClocks(fps=(rate_hz,), max_start_s=start_s))


def shown(scene: WalkScene, late_s: Mapping[str, float]) -> list[tuple[Detections, np.ndarray]]:
    """All images by one clock, and who is in each; some cameras say too early a time."""
    names = scene.rig.names
    at_s = [
        scene.true_s(names.index(image.camera), np.array([image.time_s])).item() - late_s.get(image.camera, 0.0)
        for image in scene.observations.images
    ]
    images = [replace(image, time_s=time_s) for image, time_s in zip(scene.observations.images, at_s, strict=True)]
    return sorted(zip(images, scene.who, strict=True), key=lambda pair: pair[0].time_s)


def tracked(scene: WalkScene, images: list[tuple[Detections, np.ndarray]], lost: tuple[str, ...]) -> list[Tracked]:
    """Everybody where they are, and in the images where they are seen; the tracker does not find some cameras'."""
    time_s, skeleton = images[-1][0].time_s, scene.motion.skeleton
    joint, people = np.arange(skeleton.n_joints), []
    frame = int(np.clip(round(time_s * scene.motion.fps), 0, scene.motion.truth_m.shape[1] - 1))
    for person, positions_m in enumerate(scene.motion.truth_m[:, frame].copy()):
        if not np.isfinite(positions_m).all():
            continue
        seen = {
            image.camera: (np.full(len(joint), who.tolist().index(person)), joint)
            for image, who in images
            if person in who and image.camera not in lost
        }
        status = np.full(len(joint), Status.OBSERVED, dtype=np.int8)
        people.append(Tracked(person, TrackState.CONFIRMED, Estimate(skeleton, 0, time_s, positions_m, status), seen))
    return people


def look(
    agreement: CameraAgreement,
    scene: WalkScene,
    *,
    late_s: Mapping[str, float] | None = None,
    lost: tuple[str, ...] = (),
    offsets_s: np.ndarray | None = None,
    sigma_s: np.ndarray | None = None,
    after_s: float = 0.0,
) -> float:
    """All images of a scene; how many seconds it took until a camera was named, inf if none was."""
    still = np.zeros(scene.rig.n_cameras)
    noticed_s = np.inf
    for time_s, moment in itertools.groupby(shown(scene, late_s or {}), key=lambda pair: pair[0].time_s):
        moment = list(moment)
        images = [replace(image, time_s=image.time_s + after_s) for image, _ in moment]
        people = tracked(scene, moment, lost)
        agreement.add(images, [replace(person, estimate=replace(person.estimate, time_s=time_s)) for person in people])
        if agreement.is_due:
            agreement.look(still if offsets_s is None else offsets_s, still if sigma_s is None else sigma_s)
            for _ in range(scene.rig.n_cameras):
                agreement.go_on()
        noticed_s = min(noticed_s, time_s) if agreement.faults else noticed_s
    return noticed_s


@pytest.mark.parametrize(
    ("n_cameras", "behaviour"),
    [
        (3, "walks"),
        (4, "stands"),
        pytest.param(3, "stands", marks=pytest.mark.slow),
        pytest.param(4, "walks", marks=pytest.mark.slow),
    ],
)
def test_a_camera_that_was_turned_by_a_degree_is_named(
    n_cameras: int, behaviour: Behaviour, caplog: pytest.LogCaptureFixture
) -> None:
    walk = scene(n_cameras, behaviour)
    agreement = CameraAgreement(turned(walk.rig, 1, 1.0))
    with caplog.at_level(logging.WARNING, "fgpose.live"):
        assert look(agreement, walk) < 30.0
    ((name, reason),) = agreement.faults.items()
    assert name == "ring_1"
    # 17.5 mrad; detectors are off by some more.
    assert reason.split(" mrad")[0] in {f"it sees the people {mrad}" for mrad in range(15, 21)}
    assert reason.endswith(
        "beside where the other cameras do: was it moved? fgpose calibrate --from rig.toml [moved-camera]"
    )
    assert [record.message for record in caplog.records] == [f"camera ring_1: doubtful: {reason}"]


@pytest.mark.parametrize(
    ("n_cameras", "behaviour", "n_people"),
    [
        (2, "walks", 1),
        (3, "walks", 1),
        (3, "stands", 1),
        pytest.param(4, "walks", 2, marks=pytest.mark.slow),
        pytest.param(4, "stands", 1, marks=pytest.mark.slow),
        (4, "spot", 1),
    ],
)
def test_cameras_that_are_right_are_not_blamed(n_cameras: int, behaviour: Behaviour, n_people: int) -> None:
    walk = scene(n_cameras, behaviour, n_people)
    assert look(CameraAgreement(walk.rig), walk) == np.inf


def test_two_cameras_are_blamed_together() -> None:
    walk = scene(2)
    agreement = CameraAgreement(turned(walk.rig, 1, 2.0))
    assert look(agreement, walk) < 50.0
    assert set(agreement.faults) == {"ring_0", "ring_1"}
    assert all("which is wrong is not clear" in reason for reason in agreement.faults.values())


def test_of_two_people_too() -> None:
    walk = scene(4, "walks", 2)
    agreement = CameraAgreement(turned(walk.rig, 2, 1.5))
    assert look(agreement, walk) < 30.0
    assert set(agreement.faults) == {"ring_2"}


def test_a_camera_so_far_off_that_the_tracker_does_not_follow_anybody_in_it() -> None:
    walk = scene()
    agreement = CameraAgreement(turned(walk.rig, 1, 10.0))
    assert look(agreement, walk, lost=("ring_1",)) < 40.0
    assert set(agreement.faults) == {"ring_1"}


def test_cameras_in_which_nobody_is_found_who_is_before_them() -> None:
    """As where two cameras are exchanged; over as soon as somebody is found."""
    walk = scene()
    exchanged = NobodyFollowed(walk.rig)
    moments = [list(moment) for _, moment in itertools.groupby(shown(walk, {}), key=lambda pair: pair[0].time_s)]
    noticed_s = np.inf
    for moment in moments:
        exchanged.add([image for image, _ in moment], tracked(walk, moment, ("ring_1", "ring_2")))
        noticed_s = min(noticed_s, moment[0][0].time_s) if len(exchanged.faults) == 2 else noticed_s
    assert noticed_s < 30.0
    assert set(exchanged.faults) == {"ring_1", "ring_2"}
    assert "nobody of those whom two others see" in exchanged.faults["ring_1"]
    exchanged.add([image for image, _ in moments[-1]], tracked(walk, moments[-1], ("ring_2",)))
    assert set(exchanged.faults) == {"ring_2"}


@pytest.mark.parametrize("n_cameras", [4, 6])
def test_exchanged_cameras_accuse_nobody_else(n_cameras: int) -> None:
    """They stay exchanged for longer than it takes to see that the cameras do not agree."""
    walk = scene(n_cameras)
    names = {"ring_1": "ring_2", "ring_2": "ring_1"}
    images = tuple(replace(each, camera=names.get(each.camera, each.camera)) for each in walk.observations.images)
    exchanged = replace(walk, observations=replace(walk.observations, images=images))
    agreement = CameraAgreement(walk.rig)
    assert look(agreement, exchanged, lost=("ring_1", "ring_2")) < 30.0
    assert set(agreement.faults) == {"ring_1", "ring_2"}
    assert all("keypoints those of another camera" in reason for reason in agreement.faults.values())
    look(agreement, walk, after_s=100.0)
    assert not agreement.faults


def test_cameras_that_show_nobody_or_in_which_somebody_is_found_are_right() -> None:
    walk = scene()
    watched = NobodyFollowed(walk.rig)
    for _, moment in itertools.groupby(shown(walk, {}), key=lambda pair: pair[0].time_s):
        found = list(moment)
        empty = [
            replace(image, points2d_px=image.points2d_px[:0], confidence=image.confidence[:0])
            if image.camera == "ring_1"
            else image
            for image, _ in found
        ]
        watched.add(empty, tracked(walk, found, ("ring_1",)))
    assert watched.faults == {}


def test_it_is_over_when_the_camera_is_back_and_not_before(caplog: pytest.LogCaptureFixture) -> None:
    walk = scene()
    bumped = turned(walk.rig, 1, 1.0)
    agreement = CameraAgreement(bumped)
    look(agreement, walk)
    # Nobody is there for ten minutes: it is as it was.
    agreement.add([Detections("ring_0", 660.0, np.zeros((0, 17, 2)), np.zeros((0, 17)))], [])
    agreement.look(NO_LATENESS, NO_LATENESS)
    agreement.go_on()
    assert set(agreement.faults) == {"ring_1"}
    put_back = replace(walk, observations=replace(walk.observations, images=_seen_by(walk, bumped)))
    with caplog.at_level(logging.INFO, "fgpose.live"):
        look(agreement, put_back, after_s=700.0)
    assert not agreement.faults
    assert caplog.records[-1].message == "camera ring_1: it sees the people where the others do again"


def _seen_by(scene: WalkScene, rig: CameraRig) -> tuple[Detections, ...]:
    """The images as cameras that stand where this rig says would have taken them, without errors."""
    images, times_s = [], np.array([image.time_s for image in scene.observations.images])
    positions_m = positions_at(scene.motion, times_s)
    for n, (image, who) in enumerate(zip(scene.observations.images, scene.who, strict=True)):
        camera = rig.cameras[rig.names.index(image.camera)]
        people_m = positions_m[who, n]
        images.append(replace(image, points2d_px=camera.distort(camera.project(people_m))))
    return tuple(images)


def test_nobody_tells_nothing() -> None:
    walk = scene()
    agreement = CameraAgreement(turned(walk.rig, 1, 5.0))
    for time_s in np.arange(0.0, 60.0, 0.5).tolist():
        agreement.add([Detections("ring_0", time_s, np.zeros((0, 17, 2)), np.zeros((0, 17)))], [])
        agreement.look(NO_LATENESS, NO_LATENESS)
        agreement.go_on()
    assert not agreement.faults


@pytest.mark.slow
def test_cameras_that_take_their_images_at_different_moments() -> None:
    """A walker is 35 mrad farther after an eighth of a second."""
    walk = scene(rate_hz=8.0, start_s=1.0, duration_s=30.0)
    assert look(CameraAgreement(walk.rig), walk) == np.inf
    agreement = CameraAgreement(turned(walk.rig, 1, 1.0))
    assert look(agreement, walk) < 30.0
    assert set(agreement.faults) == {"ring_1"}


@pytest.mark.slow
def test_a_camera_that_is_late_was_not_moved() -> None:
    """A walker is 60 mrad farther after a fifth of a second: too much, unless the motion has told it."""
    walk = scene(rate_hz=8.0, start_s=1.0, duration_s=30.0)
    late = {"ring_2": 0.2}
    # What somebody sees who knows nothing of it: the test can fail.
    assert look(CameraAgreement(walk.rig), walk, late_s=late) < np.inf
    unknown = np.array([0.0, 0.0, 0.1, 0.0])
    assert look(CameraAgreement(walk.rig), walk, late_s=late, sigma_s=unknown) == np.inf
    known, agreement = np.array([0.0, 0.0, 0.2, 0.0]), CameraAgreement(turned(walk.rig, 2, 1.0))
    assert look(CameraAgreement(walk.rig), walk, late_s=late, offsets_s=known, sigma_s=0.02 * unknown) == np.inf
    assert look(agreement, walk, late_s=late, offsets_s=known, sigma_s=0.02 * unknown) < 30.0
    assert set(agreement.faults) == {"ring_2"}


@pytest.mark.parametrize(
    ("n_cameras", "late_s"),
    [(3, 0.6), (4, -0.6), pytest.param(3, -0.6, marks=pytest.mark.slow), pytest.param(4, 0.6, marks=pytest.mark.slow)],
)
def test_a_clock_that_is_grossly_wrong_is_noticed_at_once(n_cameras: int, late_s: float) -> None:
    """The tracker does not find the person in it. Its clock is not known to a tenth of a second, as that of any camera
    without a measured latency."""
    walk = scene(n_cameras, rate_hz=8.0, duration_s=8.0)
    unknown = np.where(np.arange(n_cameras) == 1, 0.1, 0.02)
    agreement = CameraAgreement(walk.rig)
    assert look(agreement, walk, late_s={"ring_1": late_s}, lost=("ring_1",), sigma_s=unknown) <= 2.0
    ((name, reason),) = agreement.faults.items()
    assert name == "ring_1"
    assert reason.startswith("it sees people where they " + ("will be in 0." if late_s > 0 else "were 0."))
    assert float(reason.removeprefix("it sees people where they ").split(" s")[0].split()[-1]) == pytest.approx(
        0.6, abs=0.15
    )
    assert look(CameraAgreement(walk.rig), walk, sigma_s=unknown) == np.inf


def said_when_wrong(walk: WalkScene, wrong_s: float) -> dict[str, tuple[float, str]]:
    """What is said of which camera, and how much later, if the clock of ring_1 jumps by 0.6 s; with the tracker, which
    for a while believes the wrong camera and loses one that is right."""
    rig = walk.rig
    live = LiveTracking(rig, walk.motion.skeleton, fgpose.Config(tracking={"max_processes": 1}), volume_points_m(rig))
    ok = [CameraStatus(name, CameraState.OK) for name in rig.names]
    late = [
        replace(image, time_s=image.time_s + 0.6) if image.camera == "ring_1" and image.time_s > wrong_s else image
        for image in walk.observations.images
    ]
    said: dict[str, tuple[float, str]] = {}
    in_order = sorted(late, key=lambda image: image.time_s)
    for instant, images in itertools.groupby(in_order, key=lambda image: int(12.0 * image.time_s)):
        live.track([RecordedImage(image, image.time_s, time_sigma_s=0.02) for image in images])
        for _ in range(8):
            live.tidy()
        for camera in live.frame(instant / 12.0, ok).cameras:
            if camera.state is not CameraState.OK:
                said.setdefault(camera.name, (instant / 12.0 - wrong_s, camera.reason))
    live.close()
    return said


@pytest.mark.parametrize("n_cameras", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_clock_that_becomes_wrong_accuses_nobody_else(n_cameras: int) -> None:
    said = said_when_wrong(scene(n_cameras, rate_hz=12.0, duration_s=6.0), 3.0)
    assert said.keys() == {"ring_1"}
    after_s, reason = said["ring_1"]
    assert after_s <= 2.0
    assert "it sees people where they were 0." in reason


@pytest.mark.slow
def test_it_takes_longer_where_the_third_camera_agrees_with_either() -> None:
    """For two seconds the person walks so."""
    said = said_when_wrong(scene(3, rate_hz=12.0, duration_s=10.0, seed=4), 5.0)
    assert said.keys() == {"ring_1"}
    assert said["ring_1"][0] <= 3.5


def test_who_may_be_the_one_is_named_too_where_it_cannot_be_told() -> None:
    assert "were 0.6 s ago (or it is ring_1 or ring_2: it cannot be told which)" in in_words(-0.6, ["ring_1", "ring_2"])
    assert "told" not in in_words(-0.6, [])


@pytest.mark.slow
def test_the_status_of_the_camera_says_it() -> None:
    """With the tracker, which takes less and less of what such a camera sees."""
    walk = scene(rate_hz=5.0, duration_s=30.0)
    rig = turned(walk.rig, 1, 3.0)
    live = LiveTracking(rig, walk.motion.skeleton, fgpose.Config(tracking={"max_processes": 1}), volume_points_m(rig))
    ok = [CameraStatus(name, CameraState.OK) for name in rig.names]
    share = live.frame(0.0, ok).observed_share
    for time_s, images in itertools.groupby(walk.observations.images, key=lambda image: image.time_s):
        live.track([RecordedImage(image, time_s) for image in images])
        live.tidy()
    frame = live.frame(30.0, ok)
    live.close()
    assert [camera.state for camera in frame.cameras] == [
        CameraState.DOUBTFUL if name == "ring_1" else CameraState.OK for name in rig.names
    ]
    assert "beside where the other cameras do" in frame.cameras[1].reason
    assert frame.observed_share < share
    late = replace(ok[1], state=CameraState.LATE, reason="images come 0.9 s after they were taken")
    lost = replace(ok[1], state=CameraState.LOST, reason="no image comes")
    said = [live.frame(30.0, [ok[0], status, *ok[2:]]).cameras[1] for status in (late, lost)]
    assert [status.state for status in said] == [CameraState.DOUBTFUL, CameraState.LOST]
    assert said[0].reason.endswith(f"; {late.reason}")
    assert said[1].reason.startswith(f"{lost.reason}; ")
