"""Whole sessions with the diagnosis of recordings: what is wrong is named in the frames, and nothing else is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from fgpose.cli import main
from fgpose.finding import Code
from fgpose.live.clock import SimulatedClock
from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
from fgpose.live.diagnosis.told_live import told_live
from fgpose.live.frame import CameraState, LiveFrame
from fgpose.live.recording.live_recording import load_live_recording
from fgpose.live.recording.recorder import Recorder
from fgpose.live.recording.replay import replay
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.observed import volume_points_m
from fgpose.pipeline import load_source
from fgpose.pipeline.diagnosed import Subject, diagnose_people
from live_diagnosis import CONFIG, DAMAGES, START_S, Damage, Session
from simulated_cameras import SimulatedCameras

pytestmark = pytest.mark.slow
# The first diagnosis comes after ten seconds of motion.
SESSION = Session(rate_hz=15.0, duration_s=20.0)
MIRRORED = next(damage for damage in DAMAGES if damage.codes == (Code.MIRRORED_IMAGE,))
UNDAMAGED = Damage("nothing", ())


@cache
def session(damage: Damage, path: Path) -> list[LiveFrame]:
    """The frames of a system, which is recorded."""
    clock, frames = SimulatedClock(START_S), list[LiveFrame]()
    images, rig = damage.to_images(SESSION.images(), SESSION.rig), damage.to_rig(SESSION.rig)
    skeleton = SESSION.motion().skeleton
    feed = SimulatedCameras(rig, clock, lambda name, n: images[name][n], SESSION.rate_hz, 0.3, 1)

    class Frames:
        def publish(self, frame: LiveFrame) -> None:
            frames.append(frame)

    tracking = LiveTracking(rig, skeleton, CONFIG, volume_points_m(rig))
    diagnosis = LiveDiagnosis(rig, skeleton, diagnose_people, now_s=clock.now_s, waits=True)
    with Recorder(path, rig, skeleton, CONFIG, now_s=clock.now_s) as recorder:
        observers = [lambda update: recorder.record(update.images)]
        system = LiveSystem(feed, tracking, [Frames(), recorder], observers, clock, diagnosis=diagnosis)
        system.run(START_S + SESSION.duration_s)
    return frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sessions")


def test_of_a_healthy_session_it_says_that_it_has_looked(folder: Path) -> None:
    frames = session(UNDAMAGED, folder / "healthy.fgpose")
    first, last = frames[0].diagnosis, frames[-1].diagnosis
    assert first is not None
    assert not first.is_judged
    assert first.waits_for
    assert last is not None
    assert last.is_judged
    assert last.findings == ()
    states = {camera.state for frame in frames for camera in frame.cameras}
    assert CameraState.DOUBTFUL not in states


def test_a_mirrored_camera_is_named_in_every_frame_from_then_on(folder: Path) -> None:
    name = SESSION.rig.names[1]
    frames = session(MIRRORED, folder / "mirrored.fgpose")
    judged = [frame for frame in frames if frame.diagnosis is not None and frame.diagnosis.is_judged]
    assert judged
    assert judged[0].published_s < START_S + 19.0
    for frame in judged:
        assert frame.diagnosis is not None
        (finding,) = frame.diagnosis.findings
        assert (finding.code, finding.camera) == (Code.MIRRORED_IMAGE, name)
        camera = next(camera for camera in frame.cameras if camera.name == name)
        assert camera.state is CameraState.DOUBTFUL
        assert finding.reason in camera.reason


def test_it_finds_what_info_finds_in_the_recording(folder: Path) -> None:
    path = folder / "mirrored.fgpose"
    live = session(MIRRORED, path)[-1].diagnosis
    assert live is not None
    info = Subject.of(load_source(path, path)).diagnosis()
    # The recording has the seconds after the diagnosis too, so that numbers differ.
    assert [(each.code, each.camera) for each in told_live(info.findings, 0.0)] == [
        (each.code, each.camera) for each in live.findings
    ]


def test_run_again_it_is_diagnosed_again_and_says_the_same(folder: Path) -> None:
    path = folder / "mirrored.fgpose"
    recorded, frames = session(MIRRORED, path), list[LiveFrame]()
    recording = load_live_recording(path)
    diagnosis = LiveDiagnosis(recording.rig, recording.skeleton, diagnose_people, now_s=lambda: START_S, waits=True)
    replay(recording, frames.append, diagnosis=diagnosis)
    assert len(frames) == len(recorded)
    again, before = frames[-1].diagnosis, recorded[-1].diagnosis
    assert again is not None
    assert before is not None
    assert again == replace(before, judged_s=START_S)
    # What cameras said is there once.
    assert [camera.reason for camera in frames[-1].cameras] == [camera.reason for camera in recorded[-1].cameras]


def test_a_healthy_recording_run_again_with_a_wrong_rig_has_no_camera_that_is_ok(folder: Path) -> None:
    path = folder / "healthy.fgpose"
    session(UNDAMAGED, path)
    recording, frames = load_live_recording(path), list[LiveFrame]()
    recording.rig = next(damage for damage in DAMAGES if damage.codes == (Code.UNIT,)).to_rig(recording.rig)
    diagnosis = LiveDiagnosis(recording.rig, recording.skeleton, diagnose_people, waits=True)
    replay(recording, frames.append, diagnosis=diagnosis)
    last = frames[-1].diagnosis
    assert last is not None
    assert [each.code for each in last.findings] == [Code.UNIT]
    assert {camera.state for camera in frames[-1].cameras} == {CameraState.DOUBTFUL}
    assert frames[-1].observed_share == 0.0


@pytest.mark.parametrize("is_off", [False, True])
def test_the_command_says_it_unless_it_is_switched_off(
    folder: Path, caplog: pytest.LogCaptureFixture, *, is_off: bool
) -> None:
    path = folder / "mirrored.fgpose"
    session(MIRRORED, path)
    caplog.clear()  # of what was said when it was recorded
    assert main(["live", "--replay", str(path), "--fast", *(["--no-diagnose"] if is_off else [])]) == 0
    said = [record.message for record in caplog.records if f"[{Code.MIRRORED_IMAGE}]" in record.message]
    assert [" probably wrong: " in line for line in said] == ([] if is_off else [True])
