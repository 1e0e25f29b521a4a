"""A recording of the live system run again: whole, cut off by a kill, and with other parameters."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_frames import live_frame, live_person, standing_m
from rrd_contents import entities
from test_cli_live import free_port, receive, rig_file, send
from test_live_tracking import CONFIG, DELAY_S, scene, statuses

import fgpose
from fgpose.cli import main
from fgpose.cli.commands.live import _said
from fgpose.io.live.packing import packed, unpacked
from fgpose.io.live.record_files import MAGIC, as_record
from fgpose.io.live.recordings import RecordedImage, _number, images_document, start_document
from fgpose.live.clock import SimulatedClock
from fgpose.live.frame import CameraStatus, LiveFrame
from fgpose.live.outputs.frame_messages import frame_document
from fgpose.live.page.status_page import StatusPage
from fgpose.live.recording.live_recording import load_live_recording
from fgpose.live.recording.recorder import Recorder
from fgpose.live.recording.replay import ReplayComparison, replay
from fgpose.live.system import Feed, LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.observed import volume_points_m
from tests.fgpose.live.output_frames import wait_until

START_S = 1.7e9
# Positions are recorded in single precision: of 5 m that is 0.0005 mm.
ROUNDED_MM = 1e-3


class Recorded(Feed):
    """The cameras of the scene, one of which is silent for a while and one of which is always late."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        names = scene().rig.names
        self._coming = sorted(
            (
                (START_S + image.time_s + DELAY_S + (0.12 if image.camera == names[1] else 0.0), image)
                for image in scene().observations.images
                if not (image.camera == names[0] and 0.6 < image.time_s < 1.0) and not 1.3 < image.time_s < 1.7
            ),
            key=lambda coming: coming[0],
        )

    def take(self, timeout_s: float) -> list[RecordedImage]:
        due_s = self._clock.now_s() + timeout_s
        until_s = min(due_s, self._coming[0][0]) if self._coming else due_s
        self._clock.advance(max(until_s - self._clock.now_s(), 0.0))
        images = []
        while self._coming and self._coming[0][0] <= self._clock.now_s():
            arrived_s, image = self._coming.pop(0)
            seen = fgpose.people.Detections(image.camera, START_S + image.time_s, image.points2d_px, image.confidence)
            images.append(RecordedImage(seen, arrived_s, time_sigma_s=0.1))
        return images

    def go_on(self, camera_names: object) -> None:
        pass

    def statuses(self) -> tuple[CameraStatus, ...]:
        return statuses()


@cache
def recorded(folder: Path) -> Path:
    """Two seconds of the whole system."""
    path, clock = folder / "session.fgpose", SimulatedClock(START_S)
    rig, skeleton = scene().rig, scene().motion.skeleton
    tracking = LiveTracking(rig, skeleton, CONFIG, volume_points_m(rig))
    with Recorder(path, rig, skeleton, CONFIG, now_s=clock.now_s) as recorder:
        system = LiveSystem(
            Recorded(clock), tracking, [recorder], [lambda update: recorder.record(update.images)], clock
        )
        system.run(START_S + 2.0)
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("recorded"))


@pytest.mark.slow
def test_the_same_frames_come_again_as_far_apart_as_they_were(session: Path) -> None:
    frames: list[LiveFrame] = []
    progress: list[float] = []
    clock, published_s = SimulatedClock(5e8), list[float]()

    def take(frame: LiveFrame) -> None:
        frames.append(frame)
        published_s.append(clock.now_s())

    agreement = replay(load_live_recording(session), take, progress=progress.append, clock=clock)
    expected = list(load_live_recording(session).frames())
    assert agreement.n_frames == len(frames) == len(expected)
    assert [frame.sequence for frame in frames] == [frame.sequence for frame in expected]
    assert [(frame.time_s, frame.published_s) for frame in frames] == [
        (frame.time_s, frame.published_s) for frame in expected
    ]
    assert [[person.state for person in frame.people] for frame in frames] == [
        [person.state for person in frame.people] for frame in expected
    ]
    assert [frame.cameras for frame in frames] == [frame.cameras for frame in expected]
    assert agreement.n_others == 0
    assert agreement.n_people > 60
    assert agreement.largest_mm < ROUNDED_MM
    own_s = [frame.published_s - START_S for frame in expected]
    assert progress[-1] == pytest.approx(own_s[-1], abs=1e-6)
    assert [at_s - 5e8 for at_s in published_s] == pytest.approx(own_s, abs=1e-5)


def crafted(path: Path, **changes: dict[str, Any]) -> Path:
    """A recording of a frame and an image, with changes of a record of each kind."""
    rig, skeleton, image = scene().rig, scene().motion.skeleton, scene().observations.images[0]
    seen = fgpose.people.Detections(image.camera, START_S, image.points2d_px, image.confidence)
    people = [live_person(standing_m(skeleton))]
    frame = live_frame(skeleton, people, START_S, cameras=rig.names)
    documents = {
        "start": start_document(rig, skeleton, CONFIG, START_S),
        "images": images_document([RecordedImage(seen, START_S)]),
        "frame": {"kind": "frame", **frame_document(frame)},
        "lost": {"kind": "lost", "n": 1},
        "end": {"kind": "end"},
    }
    bodies = []
    for kind, document in documents.items():
        document = unpacked(packed(document))
        table = document["images"][0] if kind == "images" else document
        table |= changes.get(kind, {})
        bodies.append(as_record(packed(document)))
    path.write_bytes(MAGIC + b"".join(bodies))
    return path


CRAFTED: list[tuple[str, str, object, str]] = [
    *(("start", "started_s", value, "started_s is|no Unix time") for value in (1e300, -1.0, np.nan, "now", None)),
    ("start", "started_s", 0, "a frame was published|it arrived"),
    ("start", "rig", {"camera_names": ["a"], "K": 3}, "K of the rig"),
    ("start", "skeleton", np.zeros(2), "a damaged first record"),
    *(("frame", "published_s", value, "published_s is") for value in (np.nan, "now", None, [], np.zeros(2))),
    *(("frame", "published_s", value, "a frame was published") for value in (START_S + 1e9, 1e300)),
    ("frame", "people", [{"person": []}], "damaged message.*people"),
    ("frame", "cameras", [{"name": "ring_0", "state": "ok", "n_lost": "many"}], "damaged message.*n_lost"),
    ("frame", "cameras", [{"name": "door", "state": "ok"}], "cameras that its rig has not: door"),
    ("frame", "joints", 3, "joints of the message"),
    ("frame", "restarts", [{"part": 3}], "damaged message.*restarts"),
    *(("images", "time_s", value, "time_s is|it arrived|it was taken") for value in (1e300, np.nan, "now", 0, None)),
    *(("images", "arrived_s", value, "arrived_s is|it arrived") for value in (1e300, np.nan, "now", START_S + 1e9)),
    ("images", "stamp_s", "now", "stamp_s is"),
    ("images", "camera", "door", "no such camera"),
    ("images", "confidence", "high", "damaged images"),
    ("lost", "n", [], "n is"),
]


@pytest.mark.parametrize("value", [10**400, -(10**400), 2**1024, np.nan, np.inf, True, "3", None])
def test_what_is_no_finite_number_is_refused(value: object) -> None:
    """Whoever unpacked it: some know integers of any length."""
    with pytest.raises(ValueError, match=r"n is .{1,60}, not a finite number"):
        _number({"n": value}, "n")


@pytest.mark.filterwarnings("ignore:.*records are missing")
@pytest.mark.parametrize(("kind", "key", "value", "reason"), CRAFTED)
def test_a_crafted_recording_is_refused_by_name(
    tmp_path: Path, kind: str, key: str, value: object, reason: str
) -> None:
    path = crafted(tmp_path / "bad.fgpose", **{kind: {key: value}})
    with pytest.raises(ValueError, match=reason) as error:
        replay(load_live_recording(path), lambda frame: None, clock=SimulatedClock(START_S))
    assert str(path) in str(error.value)


@pytest.mark.filterwarnings("ignore:.*records are missing")
def test_nobody_waits_for_hours_that_were_not_recorded(tmp_path: Path) -> None:
    clock = SimulatedClock(5e8)
    path = crafted(tmp_path / "a.fgpose", frame={"published_s": START_S + 3600.0})
    assert replay(load_live_recording(path), lambda frame: None, clock=clock).n_frames == 1
    assert clock.now_s() == pytest.approx(5e8 + 10.0)


@pytest.mark.filterwarnings("ignore:.*records are missing")
def test_the_page_of_a_replay_has_the_time_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[dict[str, Any]] = []
    close = StatusPage.close

    def look_and_close(page: StatusPage) -> None:
        shown.append(json.loads(page._content("/state.json")))
        close(page)

    monkeypatch.setattr(StatusPage, "close", look_and_close)
    path = crafted(tmp_path / "session.fgpose")
    assert main(["live", "--replay", str(path), "--fast", "--page", "0"]) == 0
    (state,) = shown
    assert state["replay"] == "session.fgpose"
    # It was published a moment ago, years after it was recorded.
    assert 0.0 <= state["now_s"] - state["frame"]["published_s"] < 60.0
    assert abs(state["now_s"] - START_S) < 60.0


@pytest.mark.parametrize(
    ("largest_mm", "is_same", "is_explained"), [(490.9, True, True), (490.9, False, False), (1e-4, True, False)]
)
def test_people_elsewhere_by_the_same_detections_are_explained(
    largest_mm: float, *, is_same: bool, is_explained: bool
) -> None:
    said = _said(ReplayComparison(n_frames=9, n_people=9, largest_mm=largest_mm), is_same=is_same)
    assert said.startswith(f"9 frames again; people within {largest_mm:.4f} mm of those recorded")
    assert ("another way from the last bit on" in said) == is_explained


@pytest.mark.slow
def test_other_parameters_give_other_people(session: Path) -> None:
    other = fgpose.Config(online={"lag_s": 0.3}, motion={"model": "none"}, tracking={"max_processes": 1})
    agreement = replay(load_live_recording(session), lambda frame: None, config=other)
    assert agreement.largest_mm > 1.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*no footer")
def test_the_command_records_it_again(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    again, rrd = tmp_path / "again.fgpose", tmp_path / "again.rrd"
    assert main(["live", "--replay", str(session), "--fast", "--record", str(again), "--rrd", str(rrd)]) == 0
    said = capsys.readouterr().out
    n_frames = len(list(load_live_recording(session).frames()))
    assert f"{n_frames} frames again; people within 0.000" in said
    assert len(list(load_live_recording(again).updates())) == len(list(load_live_recording(session).updates()))
    assert rrd.stat().st_size > 10_000
    # People, and the detections of the updates.
    for entity in ("/world/person_0/joints", *(f"/world/camera/{name}/image/detections" for name in scene().rig.names)):
        assert entity in entities(rrd)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--replay", "a.fgpose", "rig.toml", "--model", "blazepose-full"], "leave out RIG.toml, --model"),
        (["rig.toml", "--fast"], "--fast needs --replay"),
        ([], "give a rig file, RIG.toml, or --replay FILE.fgpose"),
        (["--replay", "nothing.fgpose"], "nothing.fgpose"),
    ],
)
def test_wrong_options_of_replay(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", *arguments]) != 0
    assert message in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
@pytest.mark.filterwarnings("always:.*was (not closed|cut off)")
def test_after_kill_9_what_was_recorded_is_there_and_comes_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port, frames_port, record = free_port(), free_port(), tmp_path / "session.fgpose"
    options = ["--skeleton", "h36m_17", "--keypoints-port", str(port), "--record", str(record)]
    options += ["--zmq", str(frames_port)]
    command = [sys.executable, "-m", "fgpose", "live", str(rig_file(tmp_path)), *options]
    frames, published, enough, stop = list[LiveFrame](), threading.Event(), threading.Event(), threading.Event()
    threads = [
        threading.Thread(target=send, args=(port, published, enough)),
        threading.Thread(target=receive, args=(frames_port, frames, published, stop)),
    ]
    system = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    for thread in threads:
        thread.start()
    try:
        # Starting it takes the better part of a minute where other programs want every core.
        wait_until(lambda: sum(bool(frame.people) for frame in frames) > 30 or system.poll() is not None)
        assert system.poll() is None
    finally:
        os.kill(system.pid, signal.SIGKILL)
        system.wait()
        for event in (published, enough, stop):
            event.set()
        for thread in threads:
            thread.join()
    with pytest.warns(UserWarning, match="was not closed|was cut off"):
        recorded = list(load_live_recording(record).frames())
    assert any(frame.people for frame in recorded)

    assert main(["live", "--replay", str(record), "--fast"]) == 0
    said = capsys.readouterr()
    assert f"{len(recorded)} frames again; people within 0.000" in said.out
    assert said.err.count("the recording was not closed") + said.err.count("the recording was cut off") == 1
    smoothed = ["smooth", str(record), "--rig", str(record), "--skeleton", "h36m_17", "-o", str(tmp_path / "batch")]
    assert main(smoothed) == 0
    assert list((tmp_path / "batch").glob("*.parquet"))
