"""The images of one camera over time: a video file, or a folder of image files. Checked at once, decoded on demand."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.monocular.edit_list import shown_share
from fgpose.monocular.image_files import check_headers, check_size, image_files, numbers_of, read_image, rgb
from fgpose.monocular.network import Image
from fgpose.monocular.stamps import repaired
from fgpose.plain_files import check_plain

if TYPE_CHECKING:
    import cv2

VIDEO_SUFFIXES = frozenset((".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".wmv"))

# Cameras are decoded in parallel; more threads for each would only wait for each other.
_DECODER_THREADS = 1
# What OpenCV calls the format of packets that it is not to decode.
_AS_STORED = -1
# Containers without a frame rate state the rate of their clock instead.
_MAX_FPS = 2000.0
# Numbers with larger gaps than this between the images are not frame numbers.
_MAX_FRAMES_PER_IMAGE = 1000
_HASHED_BYTES = 1 << 16  # of head, middle and tail: at once even for large videos


class ClipImage(NamedTuple):
    """One image of a clip."""

    number: int
    """From 0."""
    stamp_s: float
    """The time that its file gives it; NaN for the file of a single image."""
    image: Image


@dataclass(frozen=True)
class Clip:
    """What one camera recorded. Made by open_clip."""

    name: str
    """Of the camera, as the file or folder is called."""
    path: Path
    size_px: tuple[int, int]
    """Width and height."""
    n_images: int
    """As the file says, without what its edit list cuts; a damaged video holds fewer. Where the file states how long it
    lasts only, as MKV does, it is what its rate would give."""
    fps: float
    """Images per second."""
    given_fps: float | None = None
    """Given by the user; overrides what the file says."""
    files: tuple[Path, ...] = ()
    """Of a folder of images, in natural order; empty for a video."""
    own_fps: float = float("nan")
    """As the file of a video says."""
    begin_s: float = 0.0
    """Added to all times: when it begins by the clock of the rig, where cameras began at different moments."""

    @property
    def end_s(self) -> float:
        """When the last image ends."""
        last_s = self.times_s(np.full(self.n_images, np.nan))[-1]
        return float(last_s) + 1 / self.fps

    def pictures(self, start: int = 0) -> Iterator[ClipImage]:
        """The images from one on, decoded as they are asked for.

        A video that cannot be decoded to its end simply ends there.

        Raises:
            ValueError: an image cannot be read, or its size is not that of the first; the message names the file.
        """
        images = self._of_files(start) if self.files else self._of_video(start)
        for picture in images:
            where = self.files[picture.number] if self.files else f"{self.path}, frame {picture.number}"
            check_size(picture.image, self.size_px, where)
            yield picture

    def images_at(self, numbers: Sequence[int]) -> dict[int, Image]:
        """Those of images_one_by_one, at once."""
        return dict(self.images_one_by_one(numbers))

    def images_one_by_one(self, numbers: Sequence[int]) -> Iterator[tuple[int, Image]]:
        """Some of the images by number, of those that there are, in one pass. Numbers increase.

        Raises:
            ValueError: an image cannot be read; the message names the file.
        """
        if self.files:
            yield from ((number, read_image(self.files[number])) for number in numbers if number < len(self.files))
            return
        video = _open_video(self.path)
        try:
            position = -1
            for number in numbers:
                # Grabbed, not sought, as in _of_video; only what is wanted is converted.
                while position < number and video.grab():
                    position += 1
                if position < number:
                    break
                read, image = video.retrieve()
                if read:
                    yield number, rgb(image)
        finally:
            video.release()

    def stamps_s(self) -> Float[np.ndarray, " image"]:
        """Of all images, as pictures() gives them, read without decoding an image; NaN where files hold none.

        Raises:
            ValueError: it is no video any more; the message names the file.
        """
        import cv2

        if self.files:
            return np.full(len(self.files), np.nan)
        stamps_ms = list[float]()
        video = _open_video(self.path, [cv2.CAP_PROP_FORMAT, _AS_STORED])
        try:
            while video.grab():
                stamps_ms.append(video.get(cv2.CAP_PROP_POS_MSEC))
        finally:
            video.release()
        if not stamps_ms:  # Of a container that OpenCV reads no packets from.
            return np.full(self.n_images, np.nan)
        # Where images are predicted from later ones, they are not stored in the order of time.
        return np.sort(np.array(stamps_ms, dtype=float)) / 1000

    def taken_s(self) -> Float[np.ndarray, " image"]:
        """Time of each image, from its file; see stamps_s and times_s. Raises ValueError as stamps_s."""
        return self.times_s(self.stamps_s()[: self.n_images])

    def times_s(self, stamps_s: Float[np.ndarray, " image"]) -> Float[np.ndarray, " image"]:
        """Time of each of the first images, given the stamps that they were read with.

        An image of a video has the time of its stamp; where a few do not increase, these are interpolated. If the user
        gave fps, or if most do not increase, image n has the time n / fps. For image files n is the number in the name;
        if these numbers do not increase, it is the position of the file in the order. All are moved by begin_s.

        Warns:
            UserWarning: some stamps do not increase.
        """
        return self.begin_s + self._own_times_s(stamps_s)

    def _own_times_s(self, stamps_s: Float[np.ndarray, " image"]) -> Float[np.ndarray, " image"]:
        index = np.arange(len(stamps_s))
        if self.files:
            assert self.given_fps is not None
            return numbers_of(self.files)[: len(index)] / self.given_fps
        if self.given_fps is not None or np.isnan(stamps_s).all():
            return index / self.fps
        times_s, bad = repaired(stamps_s, 1 / self.fps)
        if len(bad):
            taken = "they are interpolated" if times_s is not None else f"all are taken at {self.fps:g} images a second"
            warnings.warn(
                f"{self.path}: {len(bad)} of {len(index)} time stamps do not increase, first that of image {bad[0]}; "
                f"{taken}",
                stacklevel=3,
            )
        return index / self.fps if times_s is None else times_s

    def first(self, n_images: int) -> Clip:
        """The same without the images after so many."""
        return replace(self, n_images=min(n_images, self.n_images), files=self.files[:n_images])

    def fingerprint(self) -> str:
        """Changes with the content: of a video size, head, middle and tail; of image files names, sizes and times."""
        digest = hashlib.sha256()
        for file in self.files:
            status = file.stat()
            digest.update(f"{file.name}/{status.st_size}/{status.st_mtime_ns}/".encode())
        if not self.files:
            size = self.path.stat().st_size
            digest.update(str(size).encode())
            with self.path.open("rb") as stream:
                for offset in (0, size // 2, max(0, size - _HASHED_BYTES)):
                    stream.seek(offset)
                    digest.update(stream.read(_HASHED_BYTES))
        return digest.hexdigest()

    def _of_files(self, start: int) -> Iterator[ClipImage]:
        for index in range(start, len(self.files)):
            yield ClipImage(index, float("nan"), read_image(self.files[index]))

    def _of_video(self, start: int) -> Iterator[ClipImage]:
        import cv2

        video = _open_video(self.path)
        try:
            # The images before the start are decoded, not skipped by seeking: where a seek ends depends on the
            # container.
            for _ in range(start):
                if not video.grab():
                    return
            index = start
            while video.grab():
                stamp_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1000
                read, image = video.retrieve()
                if not read:
                    return
                yield ClipImage(index, stamp_s, rgb(image))
                index += 1
        finally:
            video.release()


def open_clip(name: str, path: Path, fps: float | None = None) -> Clip:
    """Probe a video or a folder of images: size, number and rate of its images. The first one is decoded, of image
    files the header of each is read.

    Args:
        name: of the camera.
        path: a file that FFmpeg can decode, or a folder of image files (PNG, JPEG, BMP, TIFF, WebP).
        fps: images per second; needed for a folder, overrides what a video says.

    Raises:
        ValueError: the video is empty, damaged or no video, an image cannot be read, or fps is missing or not positive;
            the message names the file.
        OSError: it cannot be opened.
    """
    if fps is not None and not 0 < fps <= _MAX_FPS:
        raise ValueError(f"fps must be a positive number up to {_MAX_FPS:g}, got {fps:g}")
    return _open_folder(name, path, fps) if path.is_dir() else _open_file(name, path, fps)


def _open_folder(name: str, path: Path, fps: float | None) -> Clip:
    files = image_files(path)
    if not files:
        raise ValueError(f"{path}: no images")
    if fps is None:
        raise ValueError(f"{path}: images have no times; give the frames per second (fps, or --fps)")
    height, width = read_image(files[0]).shape[:2]
    check_headers(files, (width, height))
    numbers = numbers_of(files)
    step = float(np.median(np.diff(numbers))) if len(files) > 1 else 1.0
    if step > _MAX_FRAMES_PER_IMAGE:
        raise ValueError(
            f"{path}: the numbers of the images are not frame numbers: "
            f"{len(files)} images from {numbers[0]} to {numbers[-1]}"
        )
    return Clip(name, path, (width, height), len(files), fps / step, fps, files)


def _open_file(name: str, path: Path, fps: float | None) -> Clip:
    import cv2

    # FFmpeg calls every file that it cannot open invalid; the message of the system is clearer.
    with path.open("rb") as stream:
        if not stream.read(1):
            raise ValueError(f"{path}: the video is empty")
    video = _open_video(path)
    try:
        read, image = video.read()
        if not read:
            raise ValueError(f"{path}: no image of the video can be decoded; it is empty or damaged")
        own_fps, n_images = video.get(cv2.CAP_PROP_FPS), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        if fps is None and not 0 < own_fps <= _MAX_FPS:
            raise ValueError(f"{path}: the video does not say its frame rate; give it (fps, or --fps)")
        if n_images <= 0:
            n_images = 1 + sum(1 for _ in iter(video.grab, False))
    finally:
        video.release()
    height, width = image.shape[:2]
    n_images = max(1, round(n_images * shown_share(path)))
    return Clip(name, path, (width, height), n_images, fps or own_fps, fps, own_fps=own_fps)


def _open_video(path: Path, options: Sequence[int] = ()) -> cv2.VideoCapture:
    """With options of OpenCV: numbers of properties, each with its value."""
    import cv2

    check_plain(path)
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, _DECODER_THREADS, *options])
    if not video.isOpened():
        raise ValueError(f"{path}: not a video, or a damaged or truncated one")
    return video
