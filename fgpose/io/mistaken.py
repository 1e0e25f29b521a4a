"""Files that are given in the place of others: keypoints, results and calibrations, told apart by their content."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from fgpose.io.arrays import array_names
from fgpose.io.content import first_bytes
from fgpose.io.tables import column_names

_CALIBRATIONS = (".toml", ".yml", ".yaml", ".xcp")


def refuse_result(path: Path) -> None:
    """Raise ValueError, which names the file, where keypoints belong and this is a result, or a calibration."""
    if _is_result(_contents(path)) or _is_trc(path):
        raise ValueError(f"{path}: this is a result, not keypoints: give the keypoints that it was made from")
    if path.suffix.lower() in _CALIBRATIONS:
        raise ValueError(
            f"{path}: a {path.suffix.lower()} file holds no keypoints; the calibration is given as rig (--rig)"
        )


def refuse_keypoints(path: Path) -> None:
    """Raise ValueError, which names the file, where a result belongs and these are keypoints."""
    if path.is_dir():
        raise ValueError(f"{path}: a folder, not the file of a result (.parquet, .npz, .trc or .c3d)")
    if _are_keypoints(_contents(path)):
        raise ValueError(f"{path}: these are keypoints, not a result: fgpose smooth makes one of them")


def refuse_recording(path: Path) -> None:
    """Raise ValueError where a calibration belongs and the file has keypoints, or a result; the caller names it."""
    contents = _contents(path)
    if _are_keypoints(contents):
        raise ValueError(
            "these are keypoints, not a calibration, which is a file of its own: fgpose calibrate makes one"
        )
    if _is_result(contents) or _is_trc(path):
        raise ValueError("this is a result, not a calibration: give the rig that it was made with")


def refuse_folder_of_keypoints(folder: Path) -> None:
    """Raise ValueError where a calibration belongs and the folder has keypoints; the caller names it."""
    if any((folder / f"{name}.yml").is_file() for name in ("intri", "extri")):
        return
    if any(folder.glob("*.json")) or any(folder.glob("*/*.json")):
        raise ValueError(
            "a folder with keypoints, not a calibration: were the two exchanged? First come the keypoints, the "
            "calibration is rig (--rig)"
        )


def _is_result(contents: set[str]) -> bool:
    return {"positions_m", "status"} <= contents or {"x_m", "status"} <= contents


def _are_keypoints(contents: set[str]) -> bool:
    return "points2d_px" in contents or {"camera", "x_px"} <= contents


def _contents(path: Path) -> set[str]:
    """The names of the arrays or columns; none of a damaged file, of which its reader says more."""
    start = first_bytes(path, 4)
    with suppress(ValueError):
        if start == b"PAR1":
            return column_names(path)
        if start.startswith(b"PK"):
            return array_names(path)
    return set()


def _is_trc(path: Path) -> bool:
    return first_bytes(path, 16).removeprefix(b"\xef\xbb\xbf").startswith(b"PathFileType")
