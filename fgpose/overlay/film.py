"""Films of the cameras with everybody drawn into them: each camera for itself, or all in a grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from fgpose.geometry.camera import Camera
from fgpose.geometry.changing_rig import held_by, pieces_of
from fgpose.io.atomic import replacing
from fgpose.monocular.clips import Clip
from fgpose.monocular.sources import Sources
from fgpose.overlay.drawing import Drawing, caption
from fgpose.overlay.moments import Moments
from fgpose.plain_files import naming
from fgpose.sampling import TimeRange
from fgpose.trajectory import Trajectory

_TICKS_HZ = 90_000  # of times in an MP4 file, as usual: exact for all usual rates
_GAP_PX = 4

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Shown:
    """One camera: its images, when they were taken, and who was there."""

    clip: Clip
    camera: Camera
    taken_s: Float[np.ndarray, " image"]
    moments: Moments

    def numbers(self, wanted: TimeRange) -> Int[np.ndarray, " wanted"]:
        """Of the images in that time. Raises ValueError: there is none; the message names the video."""
        with naming(self.clip.path):
            return np.flatnonzero(wanted.of(self.taken_s))

    def drawn(self, first: int, width_px: int, drawing: Drawing) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """The images from one on, with people and caption, scaled to a width."""
        import cv2

        pieces, piece_of = pieces_of(self.camera), held_by(self.camera, self.taken_s).argmax(axis=0)
        size_px = self.size_px(width_px)
        scale = size_px[0] / self.camera.size_px[0]
        for picture in self.clip.pictures(first):
            if picture.number >= len(self.taken_s):
                return
            image = cv2.resize(picture.image, size_px, interpolation=cv2.INTER_AREA)
            for pose in self.moments.poses(picture.number):
                drawing.add(image, pieces[piece_of[picture.number]], pose, scale)
            caption(image, f"{self.camera.name}  {self.taken_s[picture.number]:.3f} s")
            yield image

    def size_px(self, width_px: int) -> tuple[int, int]:
        """Even numbers, as the film needs."""
        width, height = self.clip.size_px
        return _even(width_px), _even(width_px * height / width)


def check_films() -> None:
    """Raise ImportError if PyAV is not installed (extra overlay)."""
    try:
        import av  # noqa: F401
    except ModuleNotFoundError:
        raise ImportError("a film needs PyAV: pip install 'fgpose[overlay]'") from None


def shown(sources: Sources, people: Mapping[int, Trajectory]) -> list[Shown]:
    """All cameras. Raises ValueError: a video cannot be read; the message names it."""
    cameras = zip(sources.clips, sources.rig.cameras, sources.taken_s(), strict=True)
    return [Shown(clip, camera, taken_s, Moments(people, taken_s)) for clip, camera, taken_s in cameras]


def film_of_each(
    cameras: list[Shown],
    paths: list[Path],
    drawing: Drawing,
    wanted: TimeRange,
    width_px: int | None,
    progress: Progress,
) -> None:
    """A film of each camera, at the times of its images, whatever their rate.

    Args:
        cameras, paths: of each film.
        drawing: how people are drawn.
        wanted: only images of this time.
        width_px: of the films; None: that of the images.
        progress: is told how many images are drawn, of how many.

    Raises:
        ValueError: no image is in that time, or one cannot be read; the message names the video.
        OSError: a film cannot be written.
    """
    numbers = [camera.numbers(wanted) for camera in cameras]
    done, total = 0, sum(map(len, numbers))
    for camera, path, its in zip(cameras, paths, numbers, strict=True):
        size_px = camera.size_px(width_px or camera.clip.size_px[0])
        with _film(path, size_px, camera.clip.fps) as add:
            first = int(its[0])
            for number, image in zip(its, camera.drawn(first, size_px[0], drawing), strict=False):
                add(image, float(camera.taken_s[number] - camera.taken_s[first]))
                done += 1
                progress(done, total)


def film_of_all(
    cameras: list[Shown], path: Path, drawing: Drawing, wanted: TimeRange, width_px: int, progress: Progress
) -> None:
    """One film of all cameras in a grid, at the rate of the fastest: of each the image that was taken last before the
    middle of the step. Arguments and errors as of film_of_each; width_px is that of the grid, and ValueError also says
    that it is too small."""
    numbers = [camera.numbers(wanted) for camera in cameras]
    fps = max(camera.clip.fps for camera in cameras)
    begin_s = min(float(camera.taken_s[its[0]]) for camera, its in zip(cameras, numbers, strict=True))
    end_s = max(float(camera.taken_s[its[-1]]) for camera, its in zip(cameras, numbers, strict=True))
    n_steps = 1 + round((end_s - begin_s) * fps)
    grid = _Grid.of(cameras, width_px)
    streams = [
        _Held(camera, int(its[0]), int(its[-1]), camera.drawn(int(its[0]), width, drawing))
        for camera, its, (width, _) in zip(cameras, numbers, grid.sizes_px, strict=True)
    ]
    with _film(path, grid.size_px, fps) as add:
        for step in range(n_steps):
            images = [stream.at(begin_s + (step + 0.5) / fps) for stream in streams]
            add(grid.put_together(images), step / fps)
            progress(step + 1, n_steps)


class _Held:
    """The images of a camera; each is shown until the next one was taken."""

    def __init__(self, camera: Shown, first: int, last: int, images: Iterator[np.ndarray]) -> None:
        self._taken_s, self._images, self._next, self._last = camera.taken_s, images, first, last
        self._image: np.ndarray | None = None

    def at(self, time_s: float) -> np.ndarray | None:
        """None: the camera has not begun, or has ended."""
        while self._next <= self._last and self._taken_s[self._next] <= time_s:
            self._image = next(self._images, None)
            self._next += 1
        return self._image


@dataclass(frozen=True)
class _Grid:
    """Where the images of several cameras are in one."""

    sizes_px: list[tuple[int, int]]
    corners_px: list[tuple[int, int]]
    size_px: tuple[int, int]

    @staticmethod
    def of(cameras: list[Shown], width_px: int) -> _Grid:
        """Raises ValueError: it is too narrow for them."""
        n_columns = _columns([camera.clip.size_px for camera in cameras])
        gaps_px = (n_columns - 1) * _GAP_PX
        each_px = (width_px - gaps_px) // n_columns
        if each_px < 2:
            side_by_side = f"{n_columns} cameras side by side" if n_columns > 1 else "a camera"
            least_px = gaps_px + 2 * n_columns
            raise ValueError(f"a film of {side_by_side} is {least_px} px wide at least (--width), got {width_px}")
        # Images are drawn as high as fits this width, which is even.
        each_px = _even(each_px)
        sizes = [camera.size_px(each_px) for camera in cameras]
        rows = [sizes[first : first + n_columns] for first in range(0, len(sizes), n_columns)]
        corners, y = [], 0
        for row in rows:
            corners += [(column * (sizes[0][0] + _GAP_PX), y) for column in range(len(row))]
            y += max(height for _, height in row) + _GAP_PX
        return _Grid(sizes, corners, (_even(n_columns * (sizes[0][0] + _GAP_PX) - _GAP_PX), _even(y - _GAP_PX)))

    def put_together(self, images: list[np.ndarray | None]) -> UInt8[np.ndarray, "height width 3"]:
        width, height = self.size_px
        whole = np.zeros((height, width, 3), dtype=np.uint8)
        for image, (x, y) in zip(images, self.corners_px, strict=True):
            if image is not None:
                whole[y : y + image.shape[0], x : x + image.shape[1]] = image
        return whole


def _columns(sizes_px: list[tuple[int, int]]) -> int:
    """So many that the whole is nearest to the shape of a screen."""
    width, height = np.mean(sizes_px, axis=0)

    def unlike(n_columns: int) -> float:
        n_rows = math.ceil(len(sizes_px) / n_columns)
        return abs(math.log(n_columns * width / (n_rows * height) / (16 / 9)))

    return min(range(1, len(sizes_px) + 1), key=unlike)


def _even(length: int | float) -> int:
    return max(2, 2 * round(length / 2))


@contextmanager
def _film(path: Path, size_px: tuple[int, int], fps: float) -> Iterator[Callable[[np.ndarray, float], None]]:
    """An MP4 file that appears when all images, each with its time in seconds, have been added."""
    import av

    with replacing(path, _check) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        container.metadata["comment"] = "made by fgpose overlay"
        # For players that know no other than 8-bit 4:2:0.
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = *size_px, "yuv420p"
        stream.options = {"crf": "20", "preset": "veryfast"}
        stream.codec_context.time_base = Fraction(1, _TICKS_HZ)

        def add(image: np.ndarray, time_s: float) -> None:
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(time_s * _TICKS_HZ), Fraction(1, _TICKS_HZ)
            container.mux(stream.encode(frame))

        yield add
        container.mux(stream.encode())


def _check(path: Path) -> None:
    """Raises ValueError or OSError: it is no film."""
    import av

    with av.open(str(path)) as container:
        if not container.streams.video:
            raise ValueError(f"{path}: there are no images in it")
