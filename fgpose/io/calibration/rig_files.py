"""Reading and writing of calibration files of any format."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from fgpose.geometry.camera import CameraRig
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
from fgpose.io.calibration.calibrated_view import CalibratedView, Unit, UnitOfFormat, metres_per_unit, rig_in_metres
from fgpose.io.calibration.calibration_origin import CalibrationOrigin
from fgpose.io.content import read_content
from fgpose.io.formats import RigFormat as AddedFormat
from fgpose.io.formats import recognised
from fgpose.io.mistaken import refuse_folder_of_keypoints, refuse_recording
from fgpose.plain_files import MAX_CALIBRATION_BYTES, naming
from fgpose.shown.wrong_types import check_type

RigFormat = Literal["auto", "npz", "pose2sim", "aniposelib", "caliscope", "easymocap"]
_Writer = Callable[[CameraRig, Path, CalibrationOrigin | None], None]

_JSON = (b"{", b"[{", b"[\n", b"[ ", b"[\r")  # a TOML file may begin with [table]
# Files of caliscope also hold all points that it saw.
_FORMATS = (
    "Pose2Sim, aniposelib or caliscope TOML, Qualisys .qca.txt, Vicon .xcp, intri.yml with extri.yml, OpenCap's "
    "pickles, bioCV's .calib, JSON or YAML with K, dist, R, t and size, or npz of fgpose"
)


def load_rig(path: str | Path, unit: Unit = "auto") -> CameraRig:
    """The cameras of a calibration file; the format is recognised by its content.

    Pose2Sim, aniposelib and caliscope TOML, Qualisys ``.qca.txt``, Vicon ``.xcp``, EasyMocap / OpenCV FileStorage YAML
    (the folder with ``intri.yml`` and ``extri.yml``, or either file), OpenCap's ``cameraIntrinsicsExtrinsics.pickle``
    (one, or the folder of all), bioCV's ``.calib``, JSON or YAML with K, dist, R, t and the image size of each camera,
    the npz of save_rig, and the recording of a live system. All but the last two store world to camera. Other packages
    may add formats (fgpose.io.formats).

    Args:
        path: the file, or the folder of the files of all cameras.
        unit: unit of the lengths in the file: m, dm, cm, mm, inch, ft, or how many metres a unit is, as the side of the
            squares of a board (0.054). auto takes what the format prescribes, or the file says (``"unit": "cm"``);
            where neither does, as in files of aniposelib, the size of the rig tells.

    Warns:
        UserWarning: a camera is left out, or something of the file may be meant otherwise.

    Raises:
        ValueError: the file is empty, damaged or no calibration; a camera is incomplete or impossible (its rotation is
            no rotation, K is singular); the unit is ambiguous or the rig implausibly large. The message names the file
            and the camera.
        OSError: the file cannot be read.
    """
    path = Path(path)
    metres_per_unit(unit)
    with naming(path):
        if (other := recognised(AddedFormat, path)) is not None:
            return other.read(path)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            views, unit_of_format = _read(path)
        for warning in caught:
            warnings.warn(f"{path}: {warning.message}", stacklevel=2)
        return rig_in_metres(views, unit_of_format, unit)


def _read(path: Path) -> tuple[list[CalibratedView], UnitOfFormat]:
    if path.is_dir():
        return _read_folder(path)
    if live_format.is_live(path):
        return live_format.read(path), "m"
    content = read_content(path, MAX_CALIBRATION_BYTES)
    start = content.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not start:
        raise ValueError("the file is empty")
    refuse_recording(path)
    if content.startswith(b"PK"):
        return npz_format.read(path), "m"
    if xml_formats.is_xml(content):
        return xml_formats.read(content), "mm"
    if opencap.is_pickle(content):
        return opencap.read(path), "mm"
    if path.suffix.lower() == biocv.EXTENSION:
        return biocv.read(path), "mm"
    if start.startswith(_JSON):
        return documents.read(documents.json_document(start))
    if start.startswith(b"%YAML") or path.suffix.lower() in (".yml", ".yaml"):
        return _read_yaml(path)
    try:
        return toml_formats.read(start.decode("utf-8"))
    except UnicodeDecodeError:
        raise ValueError(f"not a calibration, or not UTF-8; it should be {_FORMATS}") from None


def _read_yaml(path: Path) -> tuple[list[CalibratedView], UnitOfFormat]:
    """EasyMocap's, or tables as in JSON."""
    if path.stem in ("intri", "extri") or (path.parent / "intri.yml").is_file():
        return opencv_yaml.read(path.parent), "m"
    return documents.read(opencv_yaml.yaml_document(path))


def _read_folder(folder: Path) -> tuple[list[CalibratedView], UnitOfFormat]:
    if opencap.files_in(folder):
        return opencap.read(folder), "mm"
    if biocv.files_in(folder):
        return biocv.read(folder), "mm"
    refuse_folder_of_keypoints(folder)
    return opencv_yaml.read(folder), "m"


def load_calibration_origin(path: str | Path) -> CalibrationOrigin:
    """How the cameras of a calibration file became what they are, as save_rig was told; empty where the file does not
    say, as those of other programs, or where its cameras were changed since.

    Raises:
        ValueError: what the file says of it is damaged; the message names the file. load_rig still reads the cameras.
        OSError: the file cannot be read.
    """
    path = Path(path)
    with naming(path):
        if path.is_dir() or live_format.is_live(path):
            return CalibrationOrigin()
        content = read_content(path, MAX_CALIBRATION_BYTES)
        if content.startswith(b"PK"):
            return npz_format.read_origin(path)
        return toml_formats.read_origin(content.decode("utf-8", errors="replace").removeprefix("\ufeff"))


def load_quarter_turns(path: str | Path) -> dict[str, int]:
    """By how many quarter turns, clockwise, the images of a camera are turned before anything is detected in them, as a
    file of caliscope says; those that are turned only. The calibration is that of the images as recorded.

    Raises:
        OSError: the file cannot be read.
    """
    path = Path(path)
    if path.is_dir() or live_format.is_live(path):
        return {}
    try:
        return toml_formats.quarter_turns(
            read_content(path, MAX_CALIBRATION_BYTES).decode("utf-8").removeprefix("\ufeff")
        )
    except ValueError:
        # It is not TOML.
        return {}


def save_rig(
    rig: CameraRig, path: str | Path, file_format: RigFormat = "auto", origin: CalibrationOrigin | None = None
) -> None:
    """Write a rig, in metres, world to camera.

    - npz: exact, of fgpose.
    - pose2sim: TOML of Pose2Sim.
    - aniposelib: TOML of aniposelib, as anipose, caliscope's export and Pose2Sim read it.
    - caliscope: caliscope's own camera_array.toml.
    - easymocap: a folder with intri.yml and extri.yml, OpenCV's YAML.

    All keep time offsets but easymocap, and load_rig reads them all. A file appears under its name only when it is
    complete.

    Args:
        rig: the cameras.
        path: the file; of easymocap the folder, which is made if it is absent.
        file_format: auto takes npz for .npz and pose2sim for .toml.
        origin: how the cameras became what they are. npz, pose2sim and aniposelib keep it, as ``[metadata.fgpose]`` of
            the TOML; where it is empty the file is as without.

    Warns:
        UserWarning: there are time offsets, and the format has none.

    Raises:
        TypeError: it is no rig.
        ValueError: the extension does not fit the format, or the format cannot hold a camera (a fisheye lens, a name).
        OSError: the file cannot be written.
    """
    check_type("save_rig", "rig", rig, CameraRig)
    path = Path(path)
    writer = _WRITERS[check_format(path, file_format)]
    with naming(path):
        writer(rig, path, origin)


def check_format(path: str | Path, file_format: RigFormat = "auto") -> RigFormat:
    """The format that save_rig will write. Raises ValueError as it does, before any work is done."""
    path = Path(path)
    if file_format == "auto":
        by_extension: dict[str, RigFormat] = {".npz": "npz", ".toml": "pose2sim"}
        if path.suffix not in by_extension:
            raise ValueError(
                f"{path}: a rig is written as .npz or .toml; for other formats name it ({', '.join(_WRITERS)})"
            )
        return by_extension[path.suffix]
    if file_format not in _WRITERS:
        raise ValueError(f"{path}: a rig is written as {', '.join(_WRITERS)}, got {file_format!r}")
    extension = {"npz": ".npz", "easymocap": ""}.get(file_format, ".toml")
    if path.suffix != extension:
        wanted = f"a {extension} file" if extension else "a folder with two files"
        raise ValueError(f"{path}: {file_format} is written into {wanted}")
    return file_format


def _without_origin(write: Callable[[CameraRig, Path], None]) -> _Writer:
    return lambda rig, path, origin: write(rig, path)


_WRITERS: dict[RigFormat, _Writer] = {
    "npz": npz_format.write,
    "pose2sim": toml_formats.write_pose2sim,
    "aniposelib": toml_formats.write_aniposelib,
    "caliscope": _without_origin(toml_formats.write_caliscope),
    "easymocap": _without_origin(opencv_yaml.write),
}
