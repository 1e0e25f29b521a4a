"""Files of what a monocular network has found: one for each image, or one for a camera."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from fgpose.io.keypoints.detections import CameraDetections, Provenance
from fgpose.io.keypoints.networks.documents import is_document_of_network, read_document
from fgpose.io.keypoints.networks.people import MARKS, USED_KEYS, image_of, images_of, is_of_one_image, joints_in
from fgpose.io.names import camera_name, frame_numbers, not_hidden
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

_BINARY = (".npz", ".npy", ".pkl", ".pickle", ".pt", ".pth")
# Of a file for each person of an image.
_PERSON = re.compile(r"(?<![^\W\d_])(?:person|people|pid)[_-]?\d+", re.IGNORECASE)


def is_of_network(source: Path) -> bool:
    """Whether the source of a camera is such a file, or a folder with one for each image, by the largest of them.

    Raises:
        ValueError: an npz is damaged; the message names it.
        OSError: it cannot be read.
    """
    largest = _largest(source)
    if largest is None:
        return False
    with naming(largest):
        return is_document_of_network(largest, MARKS)


def joints_of(source: Path) -> tuple[str, int]:
    """The name of the network and the number of its joints, by the largest file of the source of a camera; 0: it shows
    nobody. Raises as read."""
    largest = _largest(source)
    return ("", 0) if largest is None else joints_in(_document(Provenance(largest, camera_name(source.stem))))


def _largest(source: Path) -> Path | None:
    """The file that most likely shows somebody."""
    return max(_files(source), key=lambda path: path.stat().st_size, default=None)


def is_binary(path: Path) -> bool:
    """Whether a path may be such a file and is no JSON, by its name."""
    return path.suffix.lower() in _BINARY and path.is_file()


def _files(source: Path) -> list[Path]:
    if not source.is_dir():
        return [source]
    return not_hidden(source.glob("*.json")) or list(filter(is_binary, not_hidden(source.iterdir())))


def read(source: Path, camera: str, skeleton: Skeleton) -> tuple[CameraDetections, str | None]:
    """The images of one camera by frame number, and the name of the network.

    In a folder each file is an image, whose number is in its name, or where names have person_000 and the like one
    person in it. A single file holds all images, see people.images_of.

    Raises:
        ValueError: a file is damaged, wants to run something, is of no known network, or does not fit the skeleton. The
            message names file, camera, frame and joint.
        OSError: a file cannot be read.
    """
    paths = _files(source)
    if len(paths) > 1:
        frames = _of_images(paths, camera, skeleton)
    else:
        frames = _of_file(paths[0], camera, skeleton, is_alone=source.is_dir())
    names = {image.of_network.network for image in frames.values() if image.of_network is not None}
    return frames, " and ".join(sorted(names)) or None


def _document(source: Provenance) -> Any:
    with naming(source):
        return read_document(source.path, USED_KEYS)


def _of_file(path: Path, camera: str, skeleton: Skeleton, *, is_alone: bool) -> CameraDetections:
    source = Provenance(path, camera)
    document = _document(source)
    if not is_of_one_image(document):
        return images_of(document, source, skeleton)
    if is_alone:
        return _of_images([path], camera, skeleton)
    raise ValueError(
        f"{source}: a single image, where files of a whole camera are expected. Each camera needs a folder of its own; "
        f"if {path.parent} is that of one camera, give the folder above it, {path.absolute().parent.parent}"
    )


def _of_images(paths: list[Path], camera: str, skeleton: Skeleton) -> CameraDetections:
    name = {path: _PERSON.sub("", path.stem) for path in paths}
    number = frame_numbers(list(dict.fromkeys(name.values())), camera_name(paths[0].parent.name))
    of_frame: dict[int, list[Path]] = {}
    for path in paths:
        if (frame := number[name[path]]) is None:
            raise ValueError(f"{Provenance(path, camera)}: no frame number in the name {path.stem!r}")
        of_frame.setdefault(frame, []).append(path)
    frames: CameraDetections = {}
    for frame, files in sorted(of_frame.items()):
        sources = [Provenance(path, camera, frame) for path in files]
        if len(files) > 1 and not all(_PERSON.search(path.stem) for path in files):
            raise ValueError(f"{sources[1]}: another file has the same frame number")
        documents = [_document(source) for source in sources]
        frames[frame] = image_of(documents if len(documents) > 1 else documents[0], sources[0], skeleton)
    return frames
