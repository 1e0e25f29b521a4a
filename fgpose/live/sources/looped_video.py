"""Videos for cameras that are played: there is nothing at their ends that a camera would not show."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

# As cameras send it: key frames a second apart, and no frame that refers to a later one.
_CODEC, _OPTIONS = "libx264", {"preset": "ultrafast", "bf": "0", "crf": "20"}


def write_looped_video(
    video: Path, path: Path, *, every: int = 1, shrink: int = 1
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Write a video that goes forwards and then backwards, so that nobody jumps when it begins anew.

    Args:
        video: any that FFmpeg reads.
        path: the new one, H.264.
        every: use every so manieth image; the rate is so many times lower.
        shrink: make it so many times smaller.

    Returns:
        Width and height of its images as they were, and as they are.

    Raises:
        OSError: a file cannot be read or written.
        ImportError: PyAV is not installed.
    """
    try:
        import av
    except ImportError:
        raise ImportError('playing videos needs PyAV: pip install "fgpose[live]"') from None
    with av.open(str(video)) as container:
        source = container.streams.video[0]
        source.thread_type = "AUTO"
        # H.264 has even sizes.
        width, height = (2 * (side // (2 * shrink)) for side in (source.width, source.height))
        rate = Fraction(source.average_rate or 30) / every
        frames = [
            frame.reformat(width, height, "yuv420p", interpolation="AREA").to_ndarray()
            for number, frame in enumerate(container.decode(video=0))
            if number % every == 0
        ]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(_CODEC, rate=rate, options=_OPTIONS | {"g": str(round(rate))})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for frame in frames + frames[-2:0:-1]:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="yuv420p")))
        container.mux(stream.encode(None))
    return (source.width, source.height), (width, height)
