"""Frames in MCAP files, read back by two libraries that others use, whole and after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from fgpose.live.outputs import open_mcap_output, recover_mcap
from fgpose.live.outputs.mcap_output import LOST, McapSink
from tests.fgpose.full_disk import FullDisk
from tests.fgpose.live.output_frames import SKELETON, frame, person, wait_until

N_FRAMES = 40
_MAGIC, _CHUNK = b"\x89MCAP0\r\n", 6
_TOPICS = ("/poses", "/markers", "/people")


def write(path: Path, n_frames: int = N_FRAMES) -> Path:
    sink = McapSink(path)
    for sequence in range(n_frames):
        sink.send(frame(sequence))
    sink.close()
    return path


def read_by_mcap(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, sequence number and decoded message of each message."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (found.channel.topic, found.message.sequence, found.decoded_message)
            for found in reader.iter_decoded_messages()
        ]


def read_by_rosbags(path: Path) -> list[tuple[str, Any]]:
    with AnyReader([path]) as reader:
        return [(found.topic, reader.deserialize(body, found.msgtype)) for found, _, body in reader.messages()]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("mcap") / "people.mcap")


def nanoseconds(stamp: Any) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def check_people(message: Any, sequence: int) -> None:
    """Of a fgpose_msgs/People that either library has decoded."""
    expected = frame(sequence)
    assert (message.sequence, message.skeleton, tuple(message.joints)) == (sequence, "stick", SKELETON.joints)
    # Unix time in double precision is known to 0.24 microseconds.
    assert abs(nanoseconds(message.header.stamp) * 1e-9 - expected.time_s) < 1e-6
    assert abs(nanoseconds(message.published) * 1e-9 - expected.published_s) < 1e-6
    assert message.header.frame_id == "world"
    assert message.observed_share == 0.75
    assert [(each.person, each.state) for each in message.people] == [(4, "confirmed"), (7, "confirmed")]
    assert [(each.is_provisional, each.former) for each in message.people] == [(True, -1), (False, 2)]
    for each, true in zip(message.people, expected.people, strict=True):
        np.testing.assert_array_equal([(p.x, p.y, p.z) for p in each.positions], true.positions_m)
        upper = true.covariance_m2[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        np.testing.assert_allclose(np.reshape(each.covariance, (-1, 6)), upper, rtol=1e-7)
        np.testing.assert_array_equal(np.frombuffer(bytes(each.status), np.uint8), true.status)
        np.testing.assert_allclose(each.probability, true.probability, rtol=1e-7)
    ok, lost = message.cameras
    assert (ok.name, ok.state, ok.rate, ok.n_images, ok.n_used, ok.n_lost) == ("cam_1", "ok", 30.0, 90, 88, 1)
    assert (ok.image_age, ok.clock_offset, ok.clock_sigma) == (pytest.approx(0.04, abs=1e-6), 0.012, 0.001)
    assert np.isnan([ok.motion_offset, ok.motion_sigma]).all()
    assert (lost.state, lost.reason) == ("lost", "no image for 3 s")
    assert np.isnan([lost.image_age, lost.clock_offset, lost.clock_sigma]).all()


def test_both_libraries_read_the_people(written: Path) -> None:
    by_mcap = [message for topic, _, message in read_by_mcap(written) if topic == "/people"]
    by_rosbags = [message for topic, message in read_by_rosbags(written) if topic == "/people"]
    assert len(by_mcap) == len(by_rosbags) == N_FRAMES
    for sequence in (0, 17, N_FRAMES - 1):
        check_people(by_mcap[sequence], sequence)
        check_people(by_rosbags[sequence], sequence)


def test_poses_are_the_known_joints_of_everybody(written: Path) -> None:
    known_m = np.concatenate([each.positions_m[np.isfinite(each.positions_m[:, 0])] for each in frame(5).people])
    for messages in ([(topic, message) for topic, _, message in read_by_mcap(written)], read_by_rosbags(written)):
        poses = [message for topic, message in messages if topic == "/poses"][5]
        np.testing.assert_array_equal([(p.position.x, p.position.y, p.position.z) for p in poses.poses], known_m)
        assert {(p.orientation.x, p.orientation.w) for p in poses.poses} == {(0.0, 1.0)}
        assert poses.header.frame_id == "world"


def test_markers_are_spheres_at_joints_and_lines_along_bones(written: Path) -> None:
    for messages in ([(topic, message) for topic, _, message in read_by_mcap(written)], read_by_rosbags(written)):
        spheres, lines, *_ = markers = [m for topic, m in messages if topic == "/markers"][2].markers
        assert [(each.ns, each.id, each.type) for each in markers] == [
            ("person 4", 0, spheres.SPHERE_LIST if hasattr(spheres, "SPHERE_LIST") else 7),
            ("person 4", 1, 5),
            ("person 7", 0, 7),
            ("person 7", 1, 5),
        ]
        assert {(each.header.frame_id, each.action, each.lifetime.sec, each.lifetime.nanosec) for each in markers} == {
            ("world", 0, 0, 500_000_000)
        }
        assert all(each.scale.x > 0 and each.color.a == 1.0 for each in markers)
        positions_m = person(4, 2).positions_m
        np.testing.assert_array_equal([(p.x, p.y, p.z) for p in spheres.points], positions_m[[0, 1, 3]])
        # left_ankle is unknown, so the bone to it is not drawn.
        np.testing.assert_array_equal([(p.x, p.y, p.z) for p in lines.points], positions_m[[0, 1, 0, 3, 1, 3]])


def test_with_nobody_there_every_topic_says_so(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "empty.mcap")
    sink.send(frame(0, ()))
    sink.close()
    messages = dict(read_by_rosbags(tmp_path / "empty.mcap"))
    assert (messages["/poses"].poses, messages["/markers"].markers, messages["/people"].people) == ([], [], [])


def test_a_long_run_goes_to_several_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fgpose.live.outputs.mcap_output._MAX_FILE_S", 0.5)
    write(tmp_path / "people.mcap", 40)
    files = [tmp_path / name for name in ("people.mcap", "people_1.mcap", "people_2.mcap")]
    numbers = [[sequence for _, sequence, _ in read_by_mcap(file)] for file in files]
    # Frames of 33 ms: 16 or so to a file.
    assert [sequence for file in numbers for sequence in file] == [sequence for sequence in range(40) for _ in _TOPICS]
    assert sorted(tmp_path.iterdir()) == files


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "people.mcap").write_bytes(b"mine")
    with pytest.raises(FileExistsError, match=r"people\.mcap"):
        open_mcap_output(tmp_path / "people.mcap")
    assert (tmp_path / "people.mcap").read_bytes() == b"mine"


def test_the_output_goes_on_in_another_file_when_the_disk_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    output = open_mcap_output(tmp_path / "people.mcap", tell=told.append)
    output._retry_s = 0.01, 0.01
    output.publish(frame(0))
    wait_until(lambda: output.state.n_published == 1)
    with monkeypatch.context() as patch:
        patch.setattr("fgpose.live.outputs.ros_messages.messages", _full)
        output.publish(frame(1))
        wait_until(lambda: not output.state.is_working)
    wait_until(lambda: output._sending_since_s is None)
    output.publish(frame(2))
    wait_until(lambda: output.state.n_published == 2)
    output.close()
    assert [{n for _, n, _ in read_by_mcap(tmp_path / name)} for name in ("people.mcap", "people_1.mcap")] == [{0}, {2}]
    assert "No space left" in told[0]


def _full(frame: object) -> None:
    raise OSError(28, "No space left on device")


_WRITER = """
import sys, time
from fgpose.live.outputs.mcap_output import McapSink
from pathlib import Path
from tests.fgpose.live.output_frames import frame
sink = McapSink(Path(sys.argv[1]))
sequence = 0
while True:
    sink.send(frame(sequence))
    print(sequence, flush=True)
    sequence += 1
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """A file whose writer was killed, and the number of the last frame that it was given."""
    path = tmp_path_factory.mktemp("killed") / "people.mcap"
    command = [sys.executable, "-c", _WRITER, str(path)]
    writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    while int(writer.stdout.readline()) < 100:
        pass
    os.kill(writer.pid, signal.SIGKILL)
    numbers = [int(line) for line in writer.stdout.read().split()]
    assert writer.wait() == -signal.SIGKILL
    writer.stdout.close()
    return path, max(numbers, default=100)


def read_unfinished(path: Path, numbers: Counter[int]) -> None:
    """Count the messages of each number. Without its end a file has no index, and can only be read in its own order,
    from the beginning until it breaks off."""
    with path.open("rb") as file:
        for _, _, message in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False):
            numbers[message.sequence] += 1


def test_after_a_kill_at_most_the_last_second_is_missing(killed: tuple[Path, int]) -> None:
    path, last = killed
    numbers: Counter[int] = Counter()
    with pytest.raises((McapError, EOFError, ValueError)):
        read_unfinished(path, numbers)
    assert set(numbers) == set(range(max(numbers) + 1))
    assert set(numbers.values()) == {len(_TOPICS)}
    # 30 frames are a second; another may have been on its way.
    assert max(numbers) >= last - 31


def test_a_file_of_a_killed_writer_can_be_made_whole(killed: tuple[Path, int], tmp_path: Path) -> None:
    path, last = killed
    n_messages = recover_mcap(path, tmp_path / "whole.mcap")
    people = [message for topic, message in read_by_rosbags(tmp_path / "whole.mcap") if topic == "/people"]
    assert len(people) == n_messages / len(_TOPICS) >= last - 31
    check_people(people[-1], len(people) - 1)
    assert len(read_by_mcap(tmp_path / "whole.mcap")) == n_messages


def test_wherever_a_file_is_cut_all_whole_chunks_are_recovered(tmp_path: Path) -> None:
    path = tmp_path / "people.mcap"
    sink = McapSink(path)
    for sequence in range(0, 90, 15):
        sink.send(frame(sequence))  # half a second later: each frame has a chunk of its own
    sink.close()
    content = path.read_bytes()
    ends, at = [], len(_MAGIC)
    while at < len(content) - len(_MAGIC):
        kind, at = content[at], at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        ends += [at] if kind == _CHUNK else []
    assert len(ends) == 6
    for number, cut in enumerate(sorted({*range(ends[0], len(content), 501), *ends, *(end - 1 for end in ends[1:])})):
        path.write_bytes(content[:cut])
        n_messages = recover_mcap(path, tmp_path / f"whole_{number}.mcap")
        assert n_messages == len(_TOPICS) * sum(end <= cut for end in ends), cut


def test_only_what_has_messages_can_be_made_whole(tmp_path: Path) -> None:
    (tmp_path / "other.mcap").write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"other\.mcap: no messages"):
        recover_mcap(tmp_path / "other.mcap", tmp_path / "whole.mcap")


def test_a_full_disk_leaves_no_empty_files_and_all_that_is_missing_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = open_mcap_output(tmp_path / "people.mcap")
    output._retry_s = 0.001, 0.001
    disk = FullDisk(tmp_path, monkeypatch)
    output.publish(frame(0))
    wait_until(lambda: output.state.n_published == 1)
    output._sink.close()  # pyrefly: ignore[missing-attribute]
    for sequence in range(1, 20):
        output.publish(frame(sequence))
    wait_until(lambda: output.state.n_published == 20)
    disk.is_full = True
    for sequence in range(20, 60):
        output.publish(frame(sequence))
    wait_until(lambda: output.state.n_published + output.state.n_lost == 60 and output._sink is None)
    n_published = output.state.n_published
    assert sorted(file.name for file in tmp_path.iterdir()) == ["people.mcap", "people_1.mcap"]
    disk.is_full = False
    output.publish(frame(60))
    wait_until(lambda: output.state.is_working)
    output.close()
    state = output.state
    assert state.n_published == n_published + 1
    assert state.n_published + state.n_lost == 61
    with (tmp_path / "people_2.mcap").open("rb") as file:
        (lost,) = make_reader(file).iter_metadata()
    assert (lost.name, lost.metadata) == (LOST, {"n_frames": str(state.n_lost)})
    n_messages = recover_mcap(tmp_path / "people_1.mcap", tmp_path / "recovered.mcap")
    assert n_messages == (n_published - 1) * len(_TOPICS)
