"""The images of a camera as a folder of files."""

from __future__ import annotations

import os
from pathlib import Path

import imagesize
import numpy as np

from fgpose.io.names import frame_numbers, visible
from fgpose.monocular.network import Image
from fgpose.plain_files import MAX_IMAGE_PX, open_plain

IMAGE_SUFFIXES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"))


def image_files(folder: Path) -> tuple[Path, ...]:
    """The image files of a folder in natural order. Raises OSError if it cannot be listed."""
    return tuple(file for file in visible(folder) if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file())


def numbers_of(files: tuple[Path, ...]) -> np.ndarray:
    """The number in each name that counts, or the place in the order where these numbers do not increase."""
    names = [file.stem for file in files]
    found = frame_numbers(names, files[0].parent.name)
    numbers = np.array([np.nan if found[name] is None else float(found[name] or 0) for name in names])
    return numbers if (np.diff(numbers) > 0).all() and np.isfinite(numbers).all() else np.arange(len(files)) * 1.0


def check_headers(files: tuple[Path, ...], size_px: tuple[int, int]) -> None:
    """Make sure, without decoding all, that images have one size: that of the first, which is given.

    Raises:
        ValueError: one is empty, no image, or of another size; the message names it.
        OSError: one cannot be opened.
    """
    usual = _header(files[0])
    for file in files:
        # A header that says something else may be of another format.
        if _header(file) != usual:
            check_size(read_image(file), size_px, file)


def _header(file: Path) -> tuple[bool, tuple[int, int]]:
    """Whether there is something in the file, and the size of the image; -1 if its format is not known."""
    with open_plain(file) as stream:
        return os.fstat(stream.fileno()).st_size > 0, imagesize.get(stream)


def check_size(image: Image, size_px: tuple[int, int], where: object) -> None:
    """Raises ValueError if it is not that of the first image."""
    height, width = image.shape[:2]
    if (width, height) != size_px:
        raise ValueError(f"{where}: the image is {width} x {height}, the first is {size_px[0]} x {size_px[1]}")


def read_image(path: Path) -> Image:
    """RGB. Raises ValueError if it is no image, or OSError if it cannot be opened; the message names it."""
    import cv2

    with open_plain(path) as stream:
        content = np.frombuffer(stream.read(), np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
    except cv2.error:
        raise ValueError(f"{path}: not an image, or one of more than {MAX_IMAGE_PX} pixels") from None
    if image is None:
        raise ValueError(f"{path}: not an image, or a damaged one")
    return rgb(image)


def rgb(image: Image) -> Image:
    """From the order of OpenCV."""
    import cv2

    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
