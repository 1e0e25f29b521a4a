"""Decoding with less work where the computer does not keep up."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from made_videos import SMOOTHED, pictures, write_video

from fgpose.live.sources import frame_dropping
from fgpose.live.sources.frame_dropping import Dropping, Lateness
from fgpose.live.sources.packets import PacketDecoder

av = pytest.importorskip("av")
N_IMAGES, KEY = 75, 30


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a key frame in every 30."""
    return write_video(tmp_path_factory.mktemp("videos") / "a.mp4", pictures(N_IMAGES), 30, options=SMOOTHED)


def decoded(video: Path, late_s: float) -> list[tuple[int, np.ndarray]]:
    """Number and brightness of all frames, each of which comes so late."""
    container = av.open(str(video))
    stream = container.streams.video[0]
    packets = PacketDecoder("cam01", stream, is_live=True)
    frames = []
    for packet in container.demux(stream):
        for frame in packets.decode(packet):
            frames.append((round(30 * frame.time), frame.to_ndarray(format="gray")))
            packets.hurry(late_s)
    return frames


def test_a_network_that_holds_images_back_is_no_reason_to_hurry() -> None:
    times_s = iter([0.0, 0.2, 0.4, 0.41, 10.0, 10.4])
    lateness = Lateness(lambda: next(times_s))
    assert [lateness.dropping(late_s) for late_s in (1.0, 0.8, 0.5, 0.1, 1.0, 1.0)] == [Dropping.NONE] * 6


def test_a_computer_that_stays_behind_hurries_until_it_is_in_time() -> None:
    times_s = iter([0.0, 0.6, 1.9, 2.1, 2.2, 2.3])
    lateness = Lateness(lambda: next(times_s))
    expected = [Dropping.NONE, Dropping.SOME, Dropping.SOME, Dropping.MOST, Dropping.NONE, Dropping.NONE]
    assert [lateness.dropping(late_s) for late_s in (1.0, 1.0, 1.0, 1.0, 0.2, 0.5)] == expected


def test_in_time_everything_is_decoded_as_it_is(video: Path) -> None:
    frames = decoded(video, 0.0)
    expected = [frame.to_ndarray(format="gray") for frame in av.open(str(video)).decode(video=0)]
    assert [number for number, _ in frames] == list(range(N_IMAGES))
    for (_, ours), theirs in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_too_late_all_frames_come_with_rougher_edges_from_the_next_key_frame_on(
    video: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(frame_dropping, "_STAYS_S", -1.0)
    with caplog.at_level(logging.WARNING, "fgpose.live"):
        frames = decoded(video, 1.0)
    assert [record.getMessage() for record in caplog.records] == [
        "camera cam01: the computer is too slow to decode it with full quality"
    ]
    assert [number for number, _ in frames] == list(range(N_IMAGES))  # of this video all depend on each other
    apart = [
        np.abs(ours.astype(float) - theirs).mean()
        for (_, ours), (_, theirs) in zip(frames, decoded(video, 0.0), strict=True)
    ]
    assert max(apart[:KEY]) == 0
    assert 0 < max(apart[KEY:]) < 5  # grey levels; noise has 3


def test_far_too_late_only_key_frames_come(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_dropping, "_STAYS_S", -1.0)
    monkeypatch.setattr(frame_dropping, "_STAYS_FAR_S", -1.0)
    assert [number for number, _ in decoded(video, 1.0)] == [0, 30, 60]
