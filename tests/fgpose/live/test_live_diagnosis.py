"""The diagnosis of a running system: what it finds is said, what it has not looked at too, and it holds nobody up."""

from __future__ import annotations

import logging
import os
import re
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import made_diagnoses
import numpy as np
import pytest
from output_frames import wait_until
from test_live_tracking import scene, statuses, tracking

from fgpose.finding import Code, Severity
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.diagnosis import diagnosis_process
from fgpose.live.diagnosis.diagnosis_process import Diagnose, DiagnosisProcess
from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
from fgpose.live.diagnosis.recent import KEPT_S, Movements, RecentDetections
from fgpose.live.diagnosis.told_live import REMEDIES, doubt
from fgpose.live.frame import CameraState, CameraStatus, LiveFinding, LiveJudgement
from fgpose.live.processes.parts import Parts
from fgpose.live.tracking.live_tracking import Update
from fgpose.people_observations import Detections

START_S, RATE_HZ = 1.7e9, 10.0
NAMES = ("ring_0", "ring_1", "ring_2", "ring_3")


def image(camera: str, time_s: float, speed_px_s: float, *, is_used: bool = True) -> RecordedImage:
    """Somebody of 400 px who moves to the side, trembling by a pixel."""
    skeleton = scene().motion.skeleton
    joints_px = np.linspace((800.0, 300.0), (900.0, 700.0), skeleton.n_joints)
    joints_px[:, 0] += speed_px_s * (time_s - START_S)
    joints_px += np.random.default_rng(int(100 * (time_s - START_S))).normal(0, 1.0, joints_px.shape)
    found = Detections(camera, time_s, joints_px[None], np.ones((1, skeleton.n_joints)))
    return RecordedImage(found, time_s + 0.02, is_used=is_used)


def update(time_s: float, speed_px_s: float = 100.0) -> Update:
    return Update(tuple(image(name, time_s, speed_px_s) for name in NAMES), (), ())


def observe(diagnosis: LiveDiagnosis, begin_s: float, end_s: float, speed_px_s: float = 100.0) -> None:
    """Seconds of it, counted from START_S."""
    for time_s in np.arange(begin_s, end_s, 1 / RATE_HZ):
        diagnosis.observe(update(START_S + time_s, speed_px_s))


@pytest.fixture
def opened() -> Iterator[Callable[..., LiveDiagnosis]]:
    made: list[LiveDiagnosis] = []

    def open_it(diagnose: Diagnose, parts: Parts | None = None, *, waits: bool = True) -> LiveDiagnosis:
        now_s = partial(float, START_S + 500.0)
        rig, skeleton = scene().rig, scene().motion.skeleton
        made.append(LiveDiagnosis(rig, skeleton, diagnose, now_s=now_s, parts=parts, waits=waits))
        return made[-1]

    yield open_it
    for each in made:
        each.close()


def test_what_is_found_is_said_in_words_of_a_live_system(opened: Callable[..., LiveDiagnosis]) -> None:
    diagnosis = opened(made_diagnoses.says_mirrored)
    observe(diagnosis, 0.0, 8.0)
    assert not diagnosis.said.is_judged
    assert "10 s are needed" in diagnosis.said.waits_for
    observe(diagnosis, 8.0, 15.0)
    said = diagnosis.said
    assert (said.from_s, said.judged_s, said.waits_for) == (START_S, START_S + 500.0, "")
    assert said.to_s is not None
    # Ten seconds of motion, looked for each second.
    assert 10.0 <= said.to_s - START_S <= 12.0
    assert said.not_judged == {"lenses": "it is short"}
    assert said.is_wrong
    wrong, doubtful = said.findings
    assert (wrong.code, wrong.severity, wrong.camera) == ("mirrored-image", Severity.WRONG, "ring_1")
    assert (wrong.from_s, wrong.to_s) == (START_S + 2.0, None)
    assert (doubtful.code, doubtful.severity, doubtful.camera) == ("late-camera", Severity.DOUBTFUL, "ring_0")
    assert "NTP" in doubtful.remedy


def test_who_stands_still_is_not_judged_and_that_is_said(opened: Callable[..., LiveDiagnosis]) -> None:
    diagnosis = opened(made_diagnoses.says_mirrored)
    observe(diagnosis, 0.0, 40.0, speed_px_s=1.0)
    assert diagnosis.said == LiveJudgement(waits_for="nobody was seen to move yet")


def test_what_was_said_stays_while_nobody_moves(opened: Callable[..., LiveDiagnosis]) -> None:
    diagnosis = opened(made_diagnoses.says_mirrored)
    observe(diagnosis, 0.0, 13.0)
    before = diagnosis.said
    observe(diagnosis, 13.0, 40.0, speed_px_s=0.0)
    assert diagnosis.said == replace(before, waits_for="hardly anybody has moved since")


def test_the_console_says_once_what_appears_and_what_is_gone(
    opened: Callable[..., LiveDiagnosis], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="fgpose.live")
    diagnosis = opened(made_diagnoses.says_mirrored_at_first)
    observe(diagnosis, 0.0, 60.0)
    assert not diagnosis.said.findings
    said = [(record.levelname, re.sub(r"\d+ s", "N s", record.message)) for record in caplog.records]
    mirrored = "It is mirrored. Switch mirroring off, in the camera or its detector. [mirrored-image]"
    assert said[0] == ("WARNING", f"by the last N s probably wrong: {mirrored}")
    assert said[1][1].startswith("by the last N s doubtful: It is late. ")
    assert said[2:] == [
        ("INFO", "in the last N s no longer found: mirrored-image of ring_1"),
        ("INFO", "in the last N s no longer found: late-camera of ring_0"),
    ]


@pytest.mark.parametrize(
    ("diagnose", "reason"),
    [
        (made_diagnoses.raises_at_first, "ValueError: nothing can be told"),
        (made_diagnoses.dies_at_first, "its process ended with status 3"),
        (made_diagnoses.hangs_at_first, "does not answer"),
    ],
)
def test_a_child_that_fails_is_said_and_begun_again(
    diagnose: Diagnose,
    reason: str,
    opened: Callable[..., LiveDiagnosis],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if diagnose is made_diagnoses.hangs_at_first:
        # Time that others have does not count: others take that long to start it.
        monkeypatch.setattr(diagnosis_process, "_ANSWERS_WITHIN_S", 10.0)
    notes: list[str] = []
    parts = Parts(lambda: START_S, notes.append)
    diagnosis = opened(diagnose, parts)
    observe(diagnosis, 0.0, 15.0)
    assert reason in diagnosis.said.waits_for
    assert "is tried again" in diagnosis.said.waits_for
    (restarts,) = parts.so_far()
    assert (restarts.part, restarts.n) == ("the diagnosis", 1)
    assert reason in restarts.reason
    assert notes[0].endswith("and is begun again in 5 s; 1 times so far")
    # It comes again after five seconds, and when that fails too after ten.
    observe(diagnosis, 15.0, 31.0)
    assert diagnosis.said.is_judged
    assert diagnosis.said.waits_for == ""


def test_live_it_waits_for_nothing_and_ends_its_process(
    opened: Callable[..., LiveDiagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[DiagnosisProcess] = []

    class Noted(DiagnosisProcess):
        def __init__(self) -> None:
            super().__init__()
            started.append(self)

    monkeypatch.setattr("fgpose.live.diagnosis.live_diagnosis.DiagnosisProcess", Noted)
    monkeypatch.setattr("fgpose.live.diagnosis.live_diagnosis._LOOKS_S", 0.05)
    diagnosis = opened(made_diagnoses.hangs_at_first, waits=False)
    observe(diagnosis, 0.0, 15.0)
    wait_until(lambda: started)
    # It hangs, and what comes is taken all the same.
    observe(diagnosis, 15.0, 16.0)
    assert not diagnosis.said.is_judged
    diagnosis.close()
    with pytest.raises(ProcessLookupError):
        os.kill(started[0].process_id, 0)


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="priorities of threads are those of Linux")
def test_the_child_gives_way_to_everybody(
    opened: Callable[..., LiveDiagnosis], monkeypatch: pytest.MonkeyPatch
) -> None:
    nice: list[int] = []
    answer = DiagnosisProcess.answer

    def answered(process: DiagnosisProcess, *arguments: object) -> object:
        try:
            return answer(process, *arguments)  # pyrefly: ignore[bad-argument-type]
        finally:
            nice.append(os.getpriority(os.PRIO_PROCESS, process.process_id))
            os.kill(process.process_id, signal.SIGKILL)

    monkeypatch.setattr(DiagnosisProcess, "answer", answered)
    diagnosis = opened(made_diagnoses.says_mirrored)
    observe(diagnosis, 0.0, 15.0)
    assert nice == [19]


def test_memory_is_that_of_a_minute() -> None:
    recent, movements = RecentDetections(), Movements(len(NAMES))
    for time_s in np.arange(0.0, 300.0, 0.5):
        recent.add(update(START_S + time_s).images)
        movements.add(recent.images(recent.newest_s))
    images = recent.images()
    assert len(images) == len(NAMES) * (2 * KEPT_S + 1)
    assert min(each.time_s for each in images) == recent.newest_s - KEPT_S
    movements.forget(recent.newest_s - KEPT_S)
    assert movements.duration_s(0.0) == pytest.approx(KEPT_S, abs=1.0)


def test_pictures_with_a_fault_are_not_looked_at_but_repetitions_are() -> None:
    recent = RecentDetections()
    first = image(NAMES[0], START_S, 100.0)
    again = replace(first, detections=first.detections.at(START_S + 0.1), is_used=False)
    recent.add([first, again, image(NAMES[0], START_S + 0.2, 100.0, is_used=False)])
    assert [each.time_s - START_S for each in recent.images()] == pytest.approx([0.0, 0.1])


def test_of_several_cameras_one_that_sees_somebody_move_is_not_enough() -> None:
    of_two, of_one = Movements(2), Movements(1)
    for time_s in START_S + np.arange(0.0, 20.0, 0.1):
        moving, still = image(NAMES[0], time_s, 100.0).detections, image(NAMES[1], time_s, 0.0).detections
        of_two.add([moving, still])
        of_one.add([moving])
    assert of_two.duration_s(0.0) == 0.0
    assert of_one.duration_s(0.0) == pytest.approx(20.0, abs=1.0)


def test_the_clocks_are_looked_at_as_the_tracker_knows_them(opened: Callable[..., LiveDiagnosis]) -> None:
    diagnosis = opened(made_diagnoses.says_mirrored)
    cameras = [CameraStatus(name, CameraState.OK) for name in NAMES]
    cameras[1] = replace(cameras[1], motion_offset_s=0.08, motion_sigma_s=0.004)
    cameras[2] = replace(cameras[2], motion_offset_s=0.5, motion_sigma_s=0.3)  # it has hardly told anything
    diagnosis.publish(replace(tracking().frame(START_S, statuses()), cameras=tuple(cameras)))
    np.testing.assert_allclose(diagnosis._rig_now().time_offsets_s, [0.0, 0.08, 0.0, 0.0])


def test_every_code_has_words_of_a_live_system_or_none() -> None:
    assert set(REMEDIES) == set(Code)
    # There is no recording to which these could be given.
    others = re.compile(r"--(?!from|skeleton)|fgpose (smooth|track|refine|synchronise)|[Cc]ut the recording")
    assert not [code for code, remedy in REMEDIES.items() if remedy and others.search(remedy)]


def finding(code: Code, camera: str = "", severity: Severity = Severity.WRONG) -> LiveJudgement:
    return LiveJudgement((LiveFinding(code, severity, "why", "what to do", camera),), START_S, START_S, START_S)


@pytest.mark.parametrize(
    ("said", "doubtful"),
    [
        (finding(Code.MIRRORED_IMAGE, "ring_1"), (False, True, False, False)),
        # Either may be the one.
        (finding(Code.EXCHANGED_CAMERAS, "ring_1"), (True, True, True, True)),
        (finding(Code.UNIT), (True, True, True, True)),
        (finding(Code.UNIT, severity=Severity.DOUBTFUL), (False, False, False, False)),
        (finding(Code.LATE_CAMERA, "ring_1", Severity.DOUBTFUL), (False, False, False, False)),
        # Of the people, and of no place.
        (finding(Code.WRONG_SKELETON), (False, False, False, False)),
        (LiveJudgement(), (False, False, False, False)),
        (None, (False, False, False, False)),
    ],
)
def test_cameras_that_are_wrong_are_doubtful_in_frames(said: LiveJudgement | None, doubtful: tuple[bool, ...]) -> None:
    live = tracking()
    frame = live.frame(START_S, statuses(), diagnosis=said)
    assert frame.diagnosis == said
    assert tuple(camera.state is CameraState.DOUBTFUL for camera in frame.cameras) == doubtful
    for camera, is_doubtful in zip(frame.cameras, doubtful, strict=True):
        assert camera.reason == (doubt(said, camera.name) if is_doubtful else "")
        assert ("why [" in camera.reason) == is_doubtful
    n_ok = 4 - sum(doubtful)
    assert frame.observed_share == pytest.approx(live.observed_share(frame.cameras))
    assert (frame.observed_share == 0.0) == (n_ok < 2)
