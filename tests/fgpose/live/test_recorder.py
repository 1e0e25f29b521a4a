"""A recording of a live system: all of it is there afterwards, also when the process was killed."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fgpose.association.track import TrackState
from fgpose.config import Config
from fgpose.io.calibration import load_rig
from fgpose.io.keypoints import keypoint_cameras, load_observations, load_people
from fgpose.io.live.packing import packed, unpacked
from fgpose.io.live.record_files import MAGIC, RecordFile, as_record
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.live.processes.parts import Parts
from fgpose.live.recording.live_recording import load_live_recording
from fgpose.live.recording.recorder import Recorder
from fgpose.people_observations import Detections
from fgpose.tracking import Tracker
from fgpose_benchmarks.synthetic import Scene, ring_rig
from tests.fgpose.live.output_frames import SKELETON, START_S, assert_same_frame, frame, wait_until

RIG = ring_rig()
CONFIG = Config(online={"lag_s": 0.3})


def update(number: int) -> list[RecordedImage]:
    """What two cameras see of two people at a time, and what a third saw too late."""
    rng = np.random.default_rng(number)
    images = []
    for c, name in enumerate(RIG.names[:3]):
        seen = Detections(
            name,
            START_S + number / 30 + c / 100,
            rng.uniform(0, 900, (2, SKELETON.n_joints, 2)),
            rng.uniform(0.1, 1, (2, SKELETON.n_joints)).astype(np.float32).astype(float),
            appearance=rng.normal(size=(2, 8)) if c else None,
        )
        stamp_s = None if c == 1 else seen.time_s - 7.0
        images.append(RecordedImage(seen, seen.time_s + 0.05, stamp_s, c != 2, time_sigma_s=0.01 * c))
    return images


def write(path: Path, n: int = 10) -> Path:
    with Recorder(path, RIG, SKELETON, CONFIG, now_s=lambda: START_S - 1) as recorder:
        for number in range(n):
            recorder.record(update(number))
            recorder.publish(frame(number))
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recorder") / "live.fgpose")


def assert_same_image(actual: RecordedImage, expected: RecordedImage) -> None:
    """Exactly: the same detections give the same estimates."""
    for name in ("arrived_s", "stamp_s", "is_used", "time_sigma_s"):
        assert getattr(actual, name) == getattr(expected, name)
    for name in ("camera", "time_s", "points2d_px", "confidence", "points3d_m", "covariance3d_m2", "appearance"):
        a, b = (getattr(each.detections, name) for each in (actual, expected))
        np.testing.assert_array_equal(a, b) if isinstance(b, np.ndarray) else None
        assert isinstance(b, np.ndarray) or a == b


def test_all_is_read_back_as_it_was_recorded(written: Path) -> None:
    recording = load_live_recording(written)
    assert (recording.started_s, recording.skeleton, recording.config) == (START_S - 1, SKELETON, CONFIG)
    for actual, camera in zip(recording.rig.cameras, RIG.cameras, strict=True):
        assert (actual.name, actual.size_px, actual.lens) == (camera.name, camera.size_px, camera.lens)
        for name in ("K", "world_T_camera", "distortion"):
            # An online estimate may go another way from the last bit on, and a replay with it.
            np.testing.assert_array_equal(getattr(actual, name), getattr(camera, name))
    updates = list(recording.updates())
    assert len(updates) == 10
    for number, images in enumerate(updates):
        for actual, expected in zip(images, update(number), strict=True):
            assert_same_image(actual, expected)
    for number, published in enumerate(recording.frames()):
        assert_same_frame(published, frame(number))


def test_it_is_a_recording_like_others_with_its_own_cameras(written: Path) -> None:
    rig = load_rig(written)
    assert rig.names == RIG.names == keypoint_cameras(written)
    people = load_people(written, rig, SKELETON)
    assert len(people.images) == 30
    # Late images too; times count from the beginning of the recording.
    assert people.images[0].time_s == pytest.approx(1.0, abs=1e-6)
    assert people.n_most == 2
    in_time = load_live_recording(written).observations()
    assert [image.time_s for image in in_time.images] == [image.time_s for image in people.images]


def test_an_image_that_was_recorded_twice_counts_once(tmp_path: Path) -> None:
    with Recorder(tmp_path / "twice", RIG, SKELETON) as recorder:
        for _ in range(2):
            recorder.record(update(3))
    assert len(load_live_recording(tmp_path / "twice").observations().images) == 3


def test_another_skeleton_or_other_cameras_are_refused(written: Path) -> None:
    other = replace(SKELETON, name="other", joints=("a", "b", "c", "d"))
    with pytest.raises(ValueError, match=r"live\.fgpose: its joints are not those of skeleton other"):
        load_people(written, RIG, other)
    with pytest.raises(ValueError, match=r"live\.fgpose: the calibration lacks camera"):
        load_people(written, RIG.subset(RIG.names[:2]), SKELETON)


def test_no_recording_is_overwritten(written: Path) -> None:
    before = written.read_bytes()
    with pytest.raises(FileExistsError, match=r"live\.fgpose"):
        Recorder(written, RIG, SKELETON)
    assert written.read_bytes() == before


def boundaries(path: Path) -> list[int]:
    """Where each record ends."""
    ends = [len(MAGIC)]
    for body in RecordFile(path):
        ends.append(ends[-1] + len(as_record(body)))
    assert ends[-1] == path.stat().st_size
    return ends


def test_a_recording_that_was_cut_off_is_read_up_to_the_last_whole_record(written: Path, tmp_path: Path) -> None:
    content, ends = written.read_bytes(), boundaries(written)
    path = tmp_path / "cut"
    # After the first record, in the middle of heads and bodies.
    for end in (ends[2], ends[2] + 5, ends[3] - 1, ends[7] + 12, ends[7] + 13, len(content) - 1):
        path.write_bytes(content[:end])
        n_whole = sum(boundary <= end for boundary in ends[1:]) - 1
        lost = end - max(boundary for boundary in ends if boundary <= end)
        reason = f"its last {lost} bytes are no whole record" if lost else "was not closed"
        recording = load_live_recording(path)
        with pytest.warns(UserWarning, match=reason):
            n_updates = len(list(recording.updates()))
        with pytest.warns(UserWarning, match=reason):
            n_frames = len(list(recording.frames()))
        assert n_updates + n_frames == n_whole
    path.write_bytes(content[: ends[5]] + bytes(3000))
    with pytest.warns(UserWarning, match="its last 3000 bytes"):
        list(load_live_recording(path).updates())


def test_a_recording_without_its_first_record_is_refused(written: Path, tmp_path: Path) -> None:
    content, path = written.read_bytes(), tmp_path / "cut"
    for end in (len(MAGIC), len(MAGIC) + 3, len(MAGIC) + 200):
        path.write_bytes(content[:end])
        with pytest.raises(ValueError, match="cut: it ends before anything was recorded"):
            load_live_recording(path)
        with pytest.raises(ValueError, match="cut: the recording does not begin with its cameras"):
            load_rig(path)


def test_other_damage_is_one_clear_error(written: Path, tmp_path: Path) -> None:
    content, ends, rng = written.read_bytes(), boundaries(written), np.random.default_rng(0)
    path = tmp_path / "damaged"
    for place in rng.integers(ends[1], len(content), 15):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="damaged: damaged at byte"):
            list(load_live_recording(path).updates())


def test_a_sound_record_of_wrong_content_is_one_clear_error(written: Path, tmp_path: Path) -> None:
    documents = [unpacked(body) for body in RecordFile(written)]
    image = documents[1]["images"][0]
    path = tmp_path / "wrong"

    def read(index: int, document: object) -> None:
        records = [*documents[:index], document, *documents[index + 1 :]]
        path.write_bytes(MAGIC + b"".join(as_record(packed(each)) for each in records))
        recording = load_live_recording(path)
        list(recording.frames())
        recording.observations()

    read(1, documents[1])
    wrong_images = [3, [3], [{}], [image | {"points2d_px": 3}], [image | {"time_s": "now"}], [image | {"camera": "x"}]]
    wrong = [(1, {"kind": "images", "images": each}) for each in wrong_images]
    wrong += [(1, {"kind": "images"}), (2, {"kind": "frame"}), (2, documents[2] | {"people": 3})]
    start = documents[0]
    changes = [{"version": 9}, {"rig": 3}, {"rig": {}}, {"skeleton": {}}, {"config": "x = "}, {"started_s": "now"}]
    changes += [{"config": "[online]\nlag = 3"}, {"skeleton": start["skeleton"] | {"bones": [[0, 9]]}}]
    wrong += [(0, start | change) for change in changes] + [(0, documents[1]), (0, 3)]
    for index, document in wrong:
        with pytest.raises(ValueError, match="wrong: "):
            read(index, document)


def test_damage_that_no_checksum_sees_is_an_error_that_names_the_file(written: Path, tmp_path: Path) -> None:
    bodies, rng, n_refused = [*RecordFile(written)][:3], np.random.default_rng(0), 0
    path = tmp_path / "wrong"
    for _ in range(40):
        damaged = [bytearray(body) for body in bodies]
        body = damaged[int(rng.integers(3))]
        for place in rng.integers(len(body), size=2):
            body[place] = rng.integers(256)
        path.write_bytes(MAGIC + b"".join(as_record(bytes(each)) for each in damaged))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # it has no end
                recording = load_live_recording(path)
                list(recording.frames())
                recording.observations()
        except ValueError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017 - nothing else may be raised
            n_refused += 1
    assert n_refused > 5


class FullDisk:
    """Takes some bytes of a write, then none until there is room."""

    def __init__(self, path: Path, monkeypatch: pytest.MonkeyPatch, error: int = errno.ENOSPC) -> None:
        self.is_full, self.n_refused, self.error = False, 0, error
        self.room_to_bytes: int | None = None
        """Up to this size the file can be written."""
        opened = Path.open

        def limited(self_path: Path, *args: Any, **options: Any) -> Any:
            file = opened(self_path, *args, **options)
            return _Limited(file, self) if self_path == path and args == ("xb",) else file

        monkeypatch.setattr(Path, "open", limited)


class _Limited:
    def __init__(self, file: Any, disk: FullDisk) -> None:
        self._file, self._disk = file, disk

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, content: memoryview | bytes) -> int:
        if not self._disk.is_full:
            return self._file.write(content)
        self._disk.n_refused += 1
        room = self._disk.room_to_bytes
        if room is not None and self._file.tell() + len(content) <= room:
            return self._file.write(content)
        self._file.write(content[:7])
        raise OSError(self._disk.error, os.strerror(self._disk.error))


def test_a_full_disk_is_said_once_and_the_recording_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.live.recording.recorder._FIRST_RETRY_S", 0.001)
    monkeypatch.setattr("fgpose.live.recording.recorder._LONGEST_RETRY_S", 0.002)
    monkeypatch.setattr("fgpose.live.recording.recorder._MAX_WAITING", 20)
    told: list[str] = []
    disk = FullDisk(tmp_path / "live", monkeypatch)
    with Recorder(tmp_path / "live", RIG, SKELETON, tell=told.append) as recorder:
        recorder.publish(frame(0))
        wait_until(lambda: recorder.state.n_published == 1)
        disk.is_full = True
        for number in range(1, 51):
            recorder.publish(frame(number))
        wait_until(lambda: disk.n_refused > 3)
        assert not recorder.state.is_working
        assert "No space left" in recorder.state.last_error
        assert recorder.state.n_skipped == 30
        disk.is_full = False
        wait_until(lambda: recorder.state.is_working)
        wait_until(lambda: not recorder._waiting)
        recorder.publish(frame(51))
    assert [line.partition(" (")[0] for line in told] == [
        f"the recording {tmp_path / 'live'} cannot be written",
        f"the recording {tmp_path / 'live'} goes on",
    ]
    with pytest.warns(UserWarning, match="30 records are missing"):
        numbers = [published.sequence for published in load_live_recording(tmp_path / "live").frames()]
    assert numbers == [*range(21), 51]


def test_a_thread_that_ends_is_begun_again_and_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends, append = {1: SystemExit(3), 2: MemoryError()}, Recorder._append

    def ending(recorder: Recorder, *documents: Any) -> None:
        if documents[0].get("sequence") in ends:
            raise ends.pop(documents[0]["sequence"])
        append(recorder, *documents)

    monkeypatch.setattr(Recorder, "_append", ending)
    parts = Parts()
    with Recorder(tmp_path / "live", RIG, SKELETON, parts=parts) as recorder:
        for number in range(5):
            recorder.publish(frame(number))
        wait_until(lambda: recorder.state.n_published == 4)
    # What ended the thread is written by the next; what a record has done wrong is left out and counted.
    assert [(each.part, each.reason) for each in parts.so_far()] == [("the recorder", "SystemExit: 3")]
    assert (recorder.state.n_lost, recorder.state.last_error) == (1, "a record that cannot be written: MemoryError: ")
    with pytest.warns(UserWarning, match="1 records are missing"):
        frames = list(load_live_recording(tmp_path / "live").frames())
    assert [published.sequence for published in frames] == [0, 1, 3, 4]


def test_the_disk_has_all_but_the_last_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, synced = tmp_path / "live", list[int]()
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(path.stat().st_size))
    with Recorder(path, RIG, SKELETON) as recorder:
        # A quarter of a second a frame, however long it takes.
        clock = SimpleNamespace(monotonic=lambda: recorder.state.n_published / 4)
        monkeypatch.setattr("fgpose.live.recording.recorder.time", clock)
        for number in range(20):
            recorder.publish(frame(number))
    # The first of all, then the first of which the last on the disk is more than a second old.
    assert synced == [boundaries(path)[1 + n_frames] for n_frames in (1, 6, 11, 16)]


def test_closing_ends_a_recording_also_on_a_disk_that_is_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = FullDisk(tmp_path / "live", monkeypatch, errno.EIO)
    recorder = Recorder(tmp_path / "live", RIG, SKELETON)
    recorder.publish(frame(0))
    wait_until(lambda: recorder.state.n_published == 1)
    disk.is_full = True
    recorder.publish(frame(1))
    wait_until(lambda: not recorder.state.is_working)
    recorder.close()
    recorder.close()
    recorder.publish(frame(2))
    assert not recorder._worker.is_alive
    assert recorder.state.n_lost == 1
    with pytest.warns(UserWarning, match="cut off"):
        assert [published.sequence for published in load_live_recording(tmp_path / "live").frames()] == [0]


def test_a_recording_that_ends_on_a_full_disk_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = FullDisk(tmp_path / "live", monkeypatch)
    recorder = Recorder(tmp_path / "live", RIG, SKELETON)
    for number in range(10):
        recorder.publish(frame(number))
    wait_until(lambda: recorder.state.n_published == 10)
    disk.is_full = True
    for number in range(10, 17):
        recorder.publish(frame(number))
    wait_until(lambda: not recorder.state.is_working)
    # To the byte.
    disk.room_to_bytes = (tmp_path / "live").stat().st_size
    recorder.close()
    state = recorder.state
    assert (state.n_published, state.n_skipped, state.n_lost) == (9, 8, 8)
    assert not state.is_working
    assert "No space left" in state.last_error
    with pytest.warns(UserWarning, match="8 records are missing"):
        assert [published.sequence for published in load_live_recording(tmp_path / "live").frames()] == [*range(9)]


def test_a_disk_that_hangs_is_said_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.live.recording.recorder._CLOSE_S", 0.1)
    works_again = threading.Event()
    recorder = Recorder(tmp_path / "live", RIG, SKELETON)
    recorder._append = lambda *_: works_again.wait()  # pyrefly: ignore[bad-assignment]
    for number in range(3):
        recorder.publish(frame(number))
    recorder.close()
    assert recorder.state.n_lost == 3
    assert "not taken the rest" in recorder.state.last_error
    works_again.set()
    recorder._worker.close()


_WRITER = """
import sys, time
from fgpose.live.recording.recorder import Recorder
from tests.fgpose.live.test_recorder import RIG, SKELETON, frame, update
recorder, number = Recorder(sys.argv[1], RIG, SKELETON), 0
while True:
    recorder.record(update(number))
    recorder.publish(frame(number))
    print(recorder.state.n_published, flush=True)
    number += 1
    time.sleep(0.005)
"""


@pytest.mark.slow
def test_after_a_kill_all_that_was_written_is_there(tmp_path: Path) -> None:
    path = tmp_path / "killed"
    with subprocess.Popen([sys.executable, "-c", _WRITER, path], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        while int(writer.stdout.readline()) < 60:
            pass
        writer.send_signal(signal.SIGKILL)
        last = max([60, *map(int, writer.stdout.read().split())])
    recording = load_live_recording(path)
    with pytest.warns(UserWarning, match="not closed|cut off"):
        updates = list(recording.updates())
    with pytest.warns(UserWarning, match="not closed|cut off"):
        frames = list(recording.frames())
    assert len(updates) >= last
    assert len(frames) >= last
    for number, published in enumerate(frames):
        assert_same_frame(published, frame(number))


def images_of(scene: Scene, t: int) -> list[Detections]:
    """The one person of a scene at Unix time, as live cameras show them."""
    seen = scene.observations
    return [
        Detections(name, START_S + seen.time_s[t], seen.points2d_px[t, c, None], seen.confidence[t, c, None])
        for c, name in enumerate(scene.rig.names)
    ]


def test_the_smoother_gets_what_was_seen(walking_scene: Scene, tmp_path: Path) -> None:
    seen, path = walking_scene.observations, tmp_path / "walk"
    with Recorder(path, walking_scene.rig, seen.skeleton, now_s=lambda: START_S) as recorder:
        for t in range(seen.n_frames):
            recorder.record([RecordedImage(image, image.time_s + 0.03) for image in images_of(walking_scene, t)])
    read = load_observations(path, load_rig(path), seen.skeleton)
    np.testing.assert_array_equal(read.points2d_px, seen.points2d_px)
    np.testing.assert_array_equal(read.confidence, seen.confidence)
    # Unix time in double precision is known to 0.24 microseconds.
    np.testing.assert_allclose(read.time_s, seen.time_s, atol=1e-6)


@pytest.mark.slow
def test_the_tracker_gives_the_same_estimates_again(walking_scene: Scene, tmp_path: Path) -> None:
    scene, published = walking_scene, list[LiveFrame]()
    seen = scene.observations

    def followed(tracker: Tracker, images: list[Detections], number: int) -> LiveFrame:
        people = tuple(
            LivePerson(
                each.person,
                TrackState(each.state),
                each.estimate.positions_m,
                np.asarray(each.estimate.covariance_m2),
                each.estimate.status,
                np.ones(seen.skeleton.n_joints),
            )
            for each in tracker.update(images)
        )
        return LiveFrame(number, images[0].time_s, images[0].time_s, seen.skeleton, people, (), 1.0)

    config = Config(tracking={"max_processes": 1})
    rig, path = scene.rig, tmp_path / "walk"
    with Tracker(rig, seen.skeleton, config) as tracker, Recorder(path, rig, seen.skeleton, config) as recorder:
        for t in range(20):
            images = images_of(scene, t)
            recorder.record([RecordedImage(image, image.time_s + 0.03) for image in images])
            published.append(followed(tracker, images, t))
            recorder.publish(published[-1])
    recording = load_live_recording(path)
    assert any(each.people for each in published)
    with Tracker(recording.rig, recording.skeleton, recording.config) as tracker:
        again = [
            followed(tracker, [image.detections for image in images], t) for t, images in enumerate(recording.updates())
        ]
    for first, second, recorded in zip(published, again, recording.frames(), strict=True):
        assert_same_frame(recorded, first)
        assert [each.person for each in second.people] == [each.person for each in first.people]
        for a, b in zip(first.people, second.people, strict=True):
            # GTSAM's threads sum in an order of their own: 1e-15 m in one frame.
            np.testing.assert_allclose(a.positions_m, b.positions_m, atol=1e-9)
