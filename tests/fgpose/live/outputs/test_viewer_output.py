"""A live system in the viewer, read back from its file."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from rrd_contents import (
    METRE_TOLERANCE,
    PIXEL_TOLERANCE,
    camera,
    entities,
    layout_value,
    rows,
    static_value,
    values,
    view_origins,
)

from fgpose.association.track import Tracked, TrackEvent, TrackState
from fgpose.cli import viewers
from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import NotWrittenError
from fgpose.io.live.recordings import RecordedImage
from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame, LivePerson
from fgpose.live.outputs import ViewerOutput
from fgpose.live.outputs.viewer_output import _ViewerSink
from fgpose.live.outputs.viewer_process import FrameToShow, ViewerJob, ViewerProcess, _Shower
from fgpose.live.tracking.live_tracking import Update
from fgpose.people_observations import Detections
from fgpose.trajectory import Estimate, Status
from fgpose.viewer import open_system_recording
from fgpose.viewer.rerun import palette
from tests.fgpose.full_disk import FullDisk
from tests.fgpose.live.live_frames import live_judgement
from tests.fgpose.live.output_frames import wait_until

pytest.importorskip("rerun")

# The file has no footer, which would grow in memory; Rerun's reader says so.
pytestmark = [
    pytest.mark.usefixtures("strict_and_silent"),
    pytest.mark.filterwarnings("ignore:.*no footer"),
]

SKELETON = load_skeleton("coco_17")
RIG = CameraRig((camera("cam_1", -0.5), camera("cam_2", 0.5)))
START_S = 1.75e9
# Of Unix time in double precision.
TIME_TOLERANCE_S = 1e-6
DELAY_S = 0.04
PERSON = 3
MIRRORED = replace(live_judgement("cam_1"), findings=live_judgement("cam_1").findings[:1])
LATE_FRAME = 4
"""From here on no image comes."""


def body_m() -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.3, 0.3, (SKELETON.n_joints, 3)) + np.array([0.0, 0.0, 1.0])


def update(number: int) -> Update:
    """Two cameras see somebody; cam_2 sees a poster before them. The errors are 5 px."""
    time_s = START_S + number / 10
    person_px = RIG.project(body_m())
    images, seen = [], {}
    for own, name in enumerate(RIG.names):
        points_px = np.stack([*[person_px[own] + 50.0] * own, person_px[own]])
        points_px = RIG.cameras[own].distort(points_px)
        images.append(Detections(name, time_s, points_px, np.ones(points_px.shape[:2])))
        seen[name] = np.full(SKELETON.n_joints, own), np.arange(SKELETON.n_joints)
    estimate = Estimate(
        SKELETON,
        number,
        time_s,
        body_m(),
        np.full(SKELETON.n_joints, Status.OBSERVED),
        np.tile(1e-4 * np.eye(3), (SKELETON.n_joints, 1, 1)),
        np.full((2, SKELETON.n_joints), 5.0),
    )
    events = (TrackEvent(time_s, PERSON, "confirmed", "cam_1, cam_2 agree"),) if number == 0 else ()
    people = (Tracked(PERSON, TrackState.CONFIRMED, estimate, seen),)
    return Update(tuple(RecordedImage(image, time_s, None) for image in images), people, events)


def frame(number: int, people: tuple[LivePerson, ...], second: CameraStatus | None = None) -> LiveFrame:
    """As published; after LATE_FRAME the newest image remains that of the frame before."""
    published_s = START_S + number / 10 + DELAY_S
    time_s = START_S + min(number, LATE_FRAME - 1) / 10
    cameras = CameraStatus("cam_1", CameraState.OK, n_used=1), second or CameraStatus("cam_2", CameraState.OK, n_used=1)
    return LiveFrame(number, time_s, published_s, SKELETON, people, cameras, 0.25)


def picture(brightness: int) -> np.ndarray:
    """A third of what the cameras have."""
    return np.full((160, 213, 3), brightness, dtype=np.uint8)


def publish(output: ViewerOutput, published: LiveFrame) -> None:
    n_before = output.state.n_published
    output.publish(published)
    wait_until(lambda: output.state.n_published > n_before)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames 0 to 3 with images, of which cam_2 is lost in 2; 4 to 25 without. A diagnosis speaks in 1 and 2."""
    path = tmp_path_factory.mktemp("viewer") / "live.rrd"
    output = ViewerOutput(path, RIG, SKELETON)
    for number in range(26):
        seen = update(min(number, LATE_FRAME - 1))
        person = LivePerson.of(seen.people[0])
        if number < LATE_FRAME:
            output.observe(seen if number != 2 else replace(seen, images=seen.images[:1]))
            for name in RIG.names:
                output.show_image(name, picture(50 * (number + 1)), START_S + number / 10)
        else:
            person = person.coasting((number - LATE_FRAME + 1) / 10)
        lost = CameraStatus("cam_2", CameraState.LOST, f"no image for 0.{number} s", n_used=1)
        published = frame(number, (person,), lost if number == 2 or number > LATE_FRAME else None)
        publish(output, replace(published, diagnosis=MIRRORED if number in (1, 2) else None))
    assert not path.exists()
    output.close()
    return path


def shown(path: Path, entity: str, component: str) -> dict[int, bool]:
    """In which frames there is anything."""
    return {number: bool(value) for number, (_, value) in rows(path, entity, component).items()}


def test_people_are_where_they_are_published_to_be(file: Path) -> None:
    joints = rows(file, f"/world/person_{PERSON}/joints", "Points3D:positions")
    assert sorted(joints) == list(range(26))
    for _, positions_m in joints.values():
        np.testing.assert_allclose(positions_m, body_m(), atol=METRE_TOLERANCE)
    # Also without images time goes on.
    times_s = np.array([joints[number][0] for number in range(26)])
    np.testing.assert_allclose(times_s, START_S + np.arange(26) / 10, atol=TIME_TOLERANCE_S)
    reprojected = values(file, f"/world/camera/cam_2/image/reprojections/person_{PERSON}", "Points2D:positions")
    np.testing.assert_allclose(reprojected[0], RIG.project(body_m())[1], atol=PIXEL_TOLERANCE)
    errors_px = rows(file, f"/plots/reprojection_px/person_{PERSON}", "Scalars:scalars")
    assert {number: error for number, (_, [error]) in errors_px.items()} == dict.fromkeys(range(LATE_FRAME), 5.0)


def test_who_is_predicted_looks_so(file: Path) -> None:
    tracks = rows(file, f"/tracks/person_{PERSON}", "StateChange:state")
    assert {number: state for number, (_, [state]) in tracks.items()} == {0: "seen", LATE_FRAME: "predicted"}
    labels = rows(file, f"/world/person_{PERSON}/label", "Points3D:labels")
    texts = [text for _, (_, [text]) in sorted(labels.items())]
    assert texts == [f"{PERSON}"] * LATE_FRAME + [f"{PERSON} predicted"] * (26 - LATE_FRAME)
    radii_m = values(file, f"/world/person_{PERSON}/joints", "Points3D:radii")
    assert radii_m[LATE_FRAME].max() < 0.6 * radii_m[0].min()
    # They grow with 0.8 m/s; a metre is the most that is drawn, after 1.25 s.
    ellipsoids = shown(file, f"/world/person_{PERSON}/covariance", "Ellipsoids3D:centers")
    assert [number for number, is_there in ellipsoids.items() if not is_there] == list(range(LATE_FRAME + 12, 26))


def test_detections_have_the_colours_of_their_people(file: Path) -> None:
    ids = rows(file, "/world/camera/cam_2/image/detections", "Points2D:class_ids")
    n_joints = SKELETON.n_joints
    # Class 0 is nobody's: the poster.
    assert np.equal(ids[0][1], 0).sum() == n_joints
    assert len(set(ids[0][1])) == 2
    points_px = np.array(rows(file, "/world/camera/cam_2/image/detections", "Points2D:positions")[0][1])
    # Undistorting twice, in single precision.
    np.testing.assert_allclose(points_px[n_joints:], RIG.project(body_m())[1], atol=10 * PIXEL_TOLERANCE)
    events = rows(file, "/events", "TextLog:text")
    assert events[0][1] == [f"person {PERSON} confirmed: cam_1, cam_2 agree"]


def test_a_camera_that_is_lost_shows_nothing(file: Path) -> None:
    for entity, component in (("detections", "Points2D:positions"), ("picture", "EncodedImage:blob")):
        found = shown(file, f"/world/camera/cam_2/image/{entity}", component)
        assert found == {0: True, 1: True, 2: False, 3: True, LATE_FRAME + 1: False}, entity
        assert all(shown(file, f"/world/camera/cam_1/image/{entity}", component).values())
    states = rows(file, "/cameras/cam_2", "StateChange:state")
    changes = {0: "ok", 2: "lost", 3: "ok", LATE_FRAME + 1: "lost"}
    assert {number: state for number, (_, [state]) in states.items()} == changes
    # Once for each change, although the reason counts the seconds.
    said = {number: text for number, (_, [text]) in rows(file, "/events/cameras", "TextLog:text").items()}
    reasons = {2: "no image for 0.2 s", LATE_FRAME + 1: f"no image for 0.{LATE_FRAME + 1} s"}
    assert said == {3: "camera cam_2 ok"} | {number: f"camera cam_2 lost: {why}" for number, why in reasons.items()}


def test_what_is_wrong_is_among_the_events_when_it_appears_and_when_it_is_gone(file: Path) -> None:
    said = {number: texts for number, (_, texts) in rows(file, "/events/diagnosis", "TextLog:text").items()}
    assert said == {1: [MIRRORED.findings[0].text], 3: ["no longer found: mirrored-image of cam_1"]}


def test_small_pictures_fill_the_image(file: Path) -> None:
    scale = static_value(file, "/world/camera/cam_1/image/picture", "Transform3D:scale")
    np.testing.assert_allclose(scale, [640 / 213, 480 / 160, 1.0], rtol=1e-6)


def test_delay_and_observed_share_are_plotted(file: Path) -> None:
    delays_ms = rows(file, "/plots/delay_ms", "Scalars:scalars")
    # Without new images there is no new delay.
    assert sorted(delays_ms) == list(range(LATE_FRAME))
    np.testing.assert_allclose(
        [delay for _, (delay,) in delays_ms.values()], 1e3 * DELAY_S, atol=1e3 * TIME_TOLERANCE_S
    )
    assert np.concatenate(values(file, "/plots/observed", "Scalars:scalars")).tolist() == [25.0] * 26


def test_the_layout_shows_the_system(file: Path) -> None:
    origins = view_origins(file)
    assert origins["StateTimeline"] == {"/tracks", "/cameras", "/status"}
    assert {"/plots/delay_ms", "/plots/observed"} < origins["TimeSeries"]
    shown_entities = entities(file) | {"/legend/cameras"}
    for where in set().union(*origins.values()):
        assert any(entity == where or entity.startswith(f"{where}/") for entity in shown_entities), where


def test_it_opens_on_what_was_seen_last(file: Path) -> None:
    from rerun.blueprint.components import PlayState

    # At the beginning nobody is there.
    assert layout_value(file, "TimePanelBlueprint:play_state") == PlayState.Following.value


def test_every_state_of_a_camera_has_a_colour() -> None:
    assert set(palette.CAMERA_STATES) == {state.value for state in CameraState}


RATE_HZ, WALK_MPS = 30.0, 1.5


def walking_update(number: int) -> tuple[Update, LivePerson | None]:
    """Somebody who walks past both cameras, is seen 0.05 s after the images were taken, and goes after 2 s."""
    time_s = START_S + number / RATE_HZ
    if number > 60:
        return Update(update(0).images[:0], (), ()), None
    joints_m = body_m() + np.array([WALK_MPS * (number / RATE_HZ - 1.0), 0.0, 2.0])
    known, seen = update(0), {}
    images = []
    for own, name in enumerate(RIG.names):
        points_px = RIG.cameras[own].distort(RIG.project(joints_m)[own])[None]
        images.append(RecordedImage(Detections(name, time_s, points_px, np.ones(points_px.shape[:2])), time_s, None))
        seen[name] = np.zeros(SKELETON.n_joints, dtype=int), np.arange(SKELETON.n_joints)
    estimate = replace(known.people[0].estimate, frame=number, time_s=time_s, positions_m=joints_m)
    tracked = Tracked(PERSON, TrackState.CONFIRMED, estimate, seen)
    return Update(tuple(images), (tracked,), ()), LivePerson.of(tracked)


@pytest.mark.slow
def test_a_picture_and_its_points_are_of_one_moment(tmp_path: Path) -> None:
    path, every, late = tmp_path / "live.rrd", 10, 2
    output = ViewerOutput(path, RIG, SKELETON)
    for number in range(165):
        # It is there before its people are; its brightness says which one it is.
        for name in RIG.names if number % every == 5 and number < 70 else ():
            output.show_image(name, picture(number), START_S + number / RATE_HZ)
        of = number - late
        if of < 0:
            continue
        seen, person = walking_update(of)
        output.observe(seen)
        time_s = START_S + of / RATE_HZ
        cameras = tuple(CameraStatus(name, CameraState.OK, n_used=1) for name in RIG.names)
        people = () if person is None else (person,)
        publish(output, LiveFrame(of, time_s, time_s + 0.05, SKELETON, people, cameras, 1.0))
    output.close()
    pictures = rows(path, "/world/camera/cam_2/image/picture", "EncodedImage:blob")
    # None has come for three seconds: the last one is taken away.
    assert [number for number, (_, value) in pictures.items() if not value] == [65 + round(3 * RATE_HZ)]
    pictures = {number: row for number, row in pictures.items() if row[1]}
    assert len(pictures) == 7
    detected = rows(path, "/world/camera/cam_2/image/detections", "Points2D:positions")
    reprojected = rows(path, f"/world/camera/cam_2/image/reprojections/person_{PERSON}", "Points2D:positions")
    for frame_number, (time_s, [blob]) in pictures.items():
        image = np.asarray(cv2.imdecode(np.frombuffer(bytes(blob), np.uint8), cv2.IMREAD_COLOR))
        taken = round(float(np.median(image)))
        assert taken % every == 5
        assert frame_number == taken
        assert time_s == pytest.approx(START_S + taken / RATE_HZ, abs=TIME_TOLERANCE_S)
        # Undistorting twice, in single precision.
        expected_px = RIG.project(body_m() + np.array([WALK_MPS * (taken / RATE_HZ - 1.0), 0.0, 2.0]))[1]
        if taken <= 60:
            np.testing.assert_allclose(detected[taken][1], expected_px, atol=10 * PIXEL_TOLERANCE)
            np.testing.assert_allclose(reprojected[taken][1], expected_px, atol=10 * PIXEL_TOLERANCE)
    # Between pictures the points stay as the picture does; who goes is taken out at once.
    first, last = min(pictures), max(pictures)
    assert [n for n in detected if first <= n < last] == [n for n in pictures if n < last]
    shown_points = {number: bool(value) for number, (_, value) in reprojected.items() if number >= first}
    assert [number for number, is_there in shown_points.items() if is_there] == [n for n in pictures if n <= 60]
    assert not shown_points[61]
    # The scene has all frames.
    assert set(rows(path, f"/world/person_{PERSON}/joints", "Points3D:positions")) >= set(range(61))


class Blocked(ViewerProcess):
    """Shows frames when it is let."""

    def __init__(self, error: Exception | None = None) -> None:
        self.shown: list[FrameToShow] = []
        self.free, self.error, self.n_closed, self.viewer_url = threading.Event(), error, 0, None

    def send(self, shown: FrameToShow) -> None:
        self.free.wait()
        if self.error is not None:
            raise self.error
        self.shown.append(shown)

    def close(self) -> None:
        self.n_closed += 1


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Any]]:
    """Has these opened in place of processes; the paths of their files."""

    def put(*processes: Blocked) -> list[Any]:
        paths: list[Any] = []

        def open_it(job: ViewerJob) -> Blocked:
            paths.append(job.path)
            return processes[len(paths) - 1]

        monkeypatch.setattr("fgpose.live.outputs.viewer_output.ViewerProcess", open_it)
        return paths

    return put


def test_what_a_viewer_that_hangs_missed_is_bounded(opened: Callable[..., list[Any]]) -> None:
    process = Blocked()
    opened(process)
    output = ViewerOutput(None, RIG, SKELETON)
    output.publish(frame(0, ()))
    wait_until(lambda: not output._waiting)
    for number in range(1000):
        event = TrackEvent(0.0, number, "confirmed", "")
        output.observe(replace(update(number), events=(event,)))
        output.show_image("cam_1", picture(number % 256), START_S + number / 10)
        output.publish(replace(frame(number, ()), time_s=START_S + number / 10))
    process.free.set()
    wait_until(lambda: output.state.n_published == 2)
    output.close()
    last = process.shown[-1]
    assert [image.time_s for image in last.images] == [START_S + 99.9] * 2
    assert last.pictures["cam_1"].picture.image_rgb[0, 0, 0] == 999 % 256
    assert [event.person for event in last.events] == list(range(800, 1000))


def test_after_a_failure_another_file_is_begun(opened: Callable[..., list[Any]], tmp_path: Path) -> None:
    full, next_one, said = Blocked(OSError("the disk is full")), Blocked(), []
    full.free.set()
    next_one.free.set()
    paths = opened(full, next_one)
    output = ViewerOutput(tmp_path / "live.rrd", RIG, SKELETON, tell=said.append)
    for number in range(2):
        output.publish(frame(number, ()))
        wait_until(lambda n=number: output.state.n_skipped + output.state.n_published > n)
    output.close()
    assert paths == [tmp_path / "live.rrd", tmp_path / "live_1.rrd"]
    assert (full.n_closed, len(next_one.shown)) == (1, 1)
    assert "the disk is full" in said[0]


@pytest.mark.parametrize("has_display", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_viewer_connects_to_the_system(
    has_display: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(viewers, "has_display", lambda: has_display)
    monkeypatch.setattr(viewers, "_start", started.append)
    output = viewers.open_viewer(None, RIG, SKELETON, True, lambda line: None)
    try:
        assert output.viewer_url is not None
        # Wherever there is no window to be opened, it is said how to look.
        assert output.viewer_url in capsys.readouterr().err
        if has_display:
            ((_, *options),) = started
            assert options[:2] == ["--connect", output.viewer_url]
            assert "--memory-limit" in options
        else:
            assert not started
    finally:
        output.close()


def test_what_is_wrong_from_the_start_is_raised(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("no folder")
    with pytest.raises(OSError, match="taken"):
        ViewerOutput(tmp_path / "taken" / "live.rrd", RIG, SKELETON)


@pytest.mark.parametrize("is_showing", [False, True])
def test_the_file_is_whole_when_the_system_is_killed(
    is_showing: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    output = ViewerOutput(path := tmp_path / "live.rrd", RIG, SKELETON)
    output.observe(seen := update(0))
    publish(output, frame(0, (LivePerson.of(seen.people[0]),)))
    sink = output._sink
    assert isinstance(sink, _ViewerSink)
    child = sink._process._process
    # As when this process ends: nothing is heard and nothing is said any more.
    child._stdout.close()
    if is_showing:
        child.write(FrameToShow(frame(1, ()), {}, [], {}, []))
    child._stdin.close()
    child._process.wait()
    assert path.exists()
    assert capfd.readouterr().err == ""
    assert f"/world/person_{PERSON}/joints" in entities(path)
    output.close()


def test_what_a_full_disk_has_taken_is_kept_under_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The first moment is flushed, the others when it is asked for.
    monkeypatch.setattr("fgpose.live.outputs.viewer_process.time", SimpleNamespace(monotonic=lambda: 0.0))
    disk, earlier = FullDisk(tmp_path, monkeypatch), tmp_path / "live.rrd"
    earlier.write_text("the recording of the day before")
    recording = open_system_recording(earlier, RIG, SKELETON)
    shower = _Shower(recording)
    assert shower.show(FrameToShow(frame(0, ()), {}, [], {}, [])) == 0
    assert shower.show(FrameToShow(frame(1, ()), {}, [], {}, [])) == 1
    recording.flush()
    # What is flushed may still be in the pipe to the thread that writes.
    wait_until(lambda: any(path.stat().st_size for path in tmp_path.iterdir() if path != earlier))
    disk.is_full = True
    shower.show(FrameToShow(frame(2, ()), {}, [], {}, []))
    with suppress(NotWrittenError):
        recording.flush()
    wait_until(lambda: disk.n_refused)
    with pytest.raises(NotWrittenError, match=f"cannot write {earlier}: No space left"):
        recording.flush()
    with pytest.raises(NotWrittenError, match="No space left"):
        shower.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["live.rrd", "live_incomplete.rrd"]
    assert earlier.read_text() == "the recording of the day before"
    assert (tmp_path / "live_incomplete.rrd").read_bytes().startswith(b"RRF2")


def test_a_recording_says_what_is_missing_before_it(tmp_path: Path) -> None:
    shower = _Shower(open_system_recording(tmp_path / "live.rrd", RIG, SKELETON))
    shower.show(FrameToShow(frame(0, ()), {}, [], {}, [], note="7 frames before are missing"))
    shower.close()
    said = rows(tmp_path / "live.rrd", "/events/recording", "TextLog:text")
    assert [text for _, text in said.values()] == [["7 frames before are missing"]]
