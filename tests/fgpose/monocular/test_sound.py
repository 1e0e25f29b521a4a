"""Starts of videos by their sound: real encoders, rooms and noise of two kinds."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from fgpose.monocular.clips import Clip, open_clip
from fgpose.monocular.sound import starts_by_sound

AUDIO_HZ = 16000


def steps_and_claps(duration_s: float, seed: int) -> np.ndarray:
    """Of somebody who walks: bursts of noise at uneven moments, of uneven loudness."""
    rng = np.random.default_rng(seed)
    sound = np.zeros(int(duration_s * AUDIO_HZ))
    for at_s in np.cumsum(rng.uniform(0.3, 1.2, int(duration_s))):
        begin = int(at_s * AUDIO_HZ)
        burst = rng.standard_normal(800) * np.exp(-np.arange(800) / 200) * rng.uniform(0.1, 0.6)
        end = min(begin + 800, len(sound))
        sound[begin:end] += burst[: max(end - begin, 0)]
    return sound


def heard(sound: np.ndarray, start_s: float, duration_s: float, seed: int) -> np.ndarray:
    """By a microphone that begins later, in a room with an echo, with a noise of its own."""
    rng = np.random.default_rng(seed)
    begin = int(start_s * AUDIO_HZ)
    own = 0.5 * sound[begin : begin + int(duration_s * AUDIO_HZ)]
    own[1600:] += 0.3 * own[:-1600]
    return own + 0.003 * rng.standard_normal(len(own))


def filmed(path: Path, samples: np.ndarray | None, duration_s: float) -> Clip:
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", 10)
        video.width = video.height = 32
        audio = None if samples is None else container.add_stream("aac", AUDIO_HZ, layout="mono")
        for _ in range(int(10 * duration_s)):
            container.mux(video.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8))))
        container.mux(video.encode())
        if audio is not None and samples is not None:
            for begin in range(0, len(samples) - 1023, 1024):
                piece = samples[None, begin : begin + 1024].astype(np.float32)
                frame = av.AudioFrame.from_ndarray(piece, "fltp", "mono")
                frame.sample_rate, frame.pts = AUDIO_HZ, begin
                container.mux(audio.encode(frame))
            container.mux(audio.encode())
    return open_clip(path.stem, path)


def test_videos_that_begin_seconds_apart(tmp_path: Path) -> None:
    sound, starts_s = steps_and_claps(40.0, 0), [4.0, 0.0, 7.31]
    clips = [
        filmed(tmp_path / f"cam{c}.mp4", heard(sound, start_s, 25.0, c), 25.0) for c, start_s in enumerate(starts_s)
    ]
    found = starts_by_sound(clips)
    offsets_s = np.array([found[clip.name].offset_s for clip in clips])
    # A frame of the encoder is 64 ms, and its delay is compensated by the stamps; steps are 5 ms.
    np.testing.assert_allclose(offsets_s - offsets_s[0], np.array(starts_s) - starts_s[0], atol=0.01)


def test_what_is_not_heard_has_no_start(tmp_path: Path) -> None:
    sound = steps_and_claps(30.0, 0)
    clips = [
        filmed(tmp_path / "cam0.mp4", heard(sound, 0.0, 20.0, 0), 20.0),
        filmed(tmp_path / "cam1.mp4", heard(sound, 3.0, 20.0, 1), 20.0),
        filmed(tmp_path / "cam2.mp4", heard(steps_and_claps(30.0, 5), 0.0, 20.0, 2), 20.0),  # another room
        filmed(tmp_path / "cam3.mp4", None, 20.0),
        filmed(tmp_path / "cam4.mp4", np.zeros(20 * AUDIO_HZ), 20.0),
    ]
    assert set(starts_by_sound(clips)) == {"cam0", "cam1"}


@pytest.mark.parametrize("n", [0, 1])
def test_one_video_has_nothing_to_be_compared_with(tmp_path: Path, n: int) -> None:
    clips = [filmed(tmp_path / f"cam{c}.mp4", heard(steps_and_claps(10.0, 0), 0.0, 8.0, c), 8.0) for c in range(n)]
    assert starts_by_sound(clips) == {}
