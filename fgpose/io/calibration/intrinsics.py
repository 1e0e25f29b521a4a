"""Intrinsics for cameras whose poses are not known, from any file that has some."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.config import parse_toml
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.fitted_camera import fitted_camera
from fgpose.geometry.intrinsics import is_of_another_size
from fgpose.geometry.lens import without_unused
from fgpose.io.arrays import array_names, read_arrays
from fgpose.io.calibration import (
    biocv,
    documents,
    live_format,
    npz_format,
    opencap,
    opencv_yaml,
    toml_formats,
    xml_formats,
)
from fgpose.io.calibration.calibrated_view import CalibratedView, Intrinsics, check_focal
from fgpose.io.content import read_content
from fgpose.io.names import named_cameras, visible
from fgpose.plain_files import MAX_CALIBRATION_BYTES, naming

Size = tuple[int, int]

_SUFFIXES = (".yml", ".yaml", ".json", ".toml", ".npz")


def load_intrinsics(
    path: str | Path, camera_names: Sequence[str], sizes_px: Sequence[Size | None] | None = None
) -> CameraRig:
    """Cameras with the intrinsics of a file and without poses: each is the origin of its own frame.

    - A calibration of any format that load_rig reads; its poses and time offsets are left out. A camera that has no
      pose yet is fine: caliscope's, and Pose2Sim's ``int_cam01_img``.
    - What a calibration with a board leaves, of one camera or of several: YAML, JSON, TOML or npz with
      ``camera_matrix`` and ``distortion_coefficients`` (OpenCV, ROS; ``mtx`` and ``dist``), or EasyMocap's
      ``intri.yml`` alone.
    - A folder with one such file per camera, by its name (``cam01.yml``).

    Names are compared as match_cameras does. The intrinsics of a file with one camera are shared by all.

    Args:
        path: the file or folder.
        camera_names: of the cameras wanted.
        sizes_px: width and height of the images of each; the intrinsics are fitted to them (fitted_camera). None: as
            the file says.

    Warns:
        UserWarning: images have another size than the intrinsics, or the file says nothing of a distortion; it says
            what was assumed.

    Raises:
        ValueError: the file is damaged, has no intrinsics or lacks a camera, or a size does not fit; the message names
            the file and the camera.
        OSError: the file cannot be read.
    """
    path = Path(path)
    with naming(path):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            known = _lenses(path)
        for warning in caught:
            warnings.warn(f"{path}: {warning.message}", stacklevel=2)
        if len(known) == 1:
            of_camera = dict.fromkeys(camera_names, known[0])
        else:
            by_name = {lens.name: lens for lens in known}
            of_camera = {name: by_name[own] for name, own in named_cameras(camera_names, by_name).items()}
        cameras = [_camera(name, of_camera[name], size) for name, size in _sized(camera_names, sizes_px)]
    pairs = zip(cameras, _sized(camera_names, sizes_px), strict=True)
    return CameraRig(tuple(fitted_camera(camera, size or camera.size_px, path) for camera, (_, size) in pairs))


def _sized(names: Sequence[str], sizes_px: Sequence[Size | None] | None) -> list[tuple[str, Size | None]]:
    return list(zip(names, sizes_px or [None] * len(names), strict=True))


def _camera(name: str, lens: Intrinsics, size_px: Size | None) -> Camera:
    """As the file says; where it does not say for which images, for these."""
    size_px = lens.size_px or size_px
    if size_px is None:
        raise ValueError(f"camera {lens.name}: it does not say for images of which size it is; give it (--size)")
    check_focal(lens.name, lens.K, size_px)
    camera = Camera(name, size_px, lens.K, np.eye(4), without_unused(lens.distortion), lens.lens)
    if lens.size_px is None and is_of_another_size(camera):
        x, y = camera.K[:2, 2]
        raise ValueError(
            f"camera {lens.name}: the principal point ({x:.0f}, {y:.0f}) is far from the middle of an image of "
            f"{size_px[0]} x {size_px[1]}: these intrinsics are for images of another size"
        )
    return camera


def _lenses(path: Path) -> list[Intrinsics]:
    """All cameras of a file or folder."""
    if not path.is_dir():
        return _of_file(path)
    if (path / "intri.yml").is_file():
        return _of_file(path / "intri.yml")
    for format_of_folder in (opencap, biocv):
        if format_of_folder.files_in(path):
            return _without_poses(format_of_folder.read(path))
    files = [file for file in visible(path) if file.suffix.lower() in _SUFFIXES]
    if not files:
        raise ValueError(
            f"no intrinsics in this folder: it should have a file for each camera ({', '.join(_SUFFIXES)})"
        )
    return [_only_lens(file) for file in files]


def _only_lens(file: Path) -> Intrinsics:
    with naming(file.name):
        found = _of_file(file)
    if len(found) > 1:
        raise ValueError(f"{file.name}: in a folder, a file has one camera, this one has {len(found)}")
    return replace(found[0], name=file.stem)


def _of_file(path: Path) -> list[Intrinsics]:
    if live_format.is_live(path):
        return _without_poses(live_format.read(path))
    content = read_content(path, MAX_CALIBRATION_BYTES)
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start:
        raise ValueError("the file is empty")
    if content.startswith(b"PK"):
        is_rig = "world_T_camera" in array_names(path)
        return _without_poses(npz_format.read(path)) if is_rig else documents.lenses(read_arrays(path), path.stem)
    if xml_formats.is_xml(content):
        return _without_poses(xml_formats.read(content))
    if opencap.is_pickle(content):
        return _without_poses(opencap.read(path))
    if path.suffix.lower() == biocv.EXTENSION:
        return _without_poses(biocv.read(path))
    if start.startswith((b"{", b"[{", b"[\n", b"[ ", b"[\r")):
        return documents.lenses(documents.json_document(start), path.stem)
    if start.startswith(b"%YAML") or path.suffix.lower() in (".yml", ".yaml"):
        document = opencv_yaml.yaml_document(path)
        return opencv_yaml.intrinsics(document) or documents.lenses(document, path.stem)
    return _of_toml(start, path.stem)


def _of_toml(content: bytes, name: str) -> list[Intrinsics]:
    try:
        text = content.decode("utf-8")
        document = parse_toml(text)
    except ValueError as error:
        raise ValueError(f"no intrinsics, or a damaged file: {error}") from None
    if toml_formats.has_cameras(document):
        return _without_poses(toml_formats.read(text, poses=False)[0])
    return documents.lenses(document, name)


def _without_poses(views: list[CalibratedView]) -> list[Intrinsics]:
    return [Intrinsics(view.name, view.K, view.distortion, view.size_px, view.lens) for view in views]
