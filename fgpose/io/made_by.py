"""Which command wrote a file, so that another does not replace it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from fgpose.io.arrays import array_names, read_arrays, text
from fgpose.io.calibration import load_calibration_origin
from fgpose.io.content import first_bytes
from fgpose.io.tables import column_names
from fgpose.io.trajectories import load_origin

# The header of a TRC, the parameters of a C3D and, behind its layout, the name of a recording in Rerun are in these.
_HEAD_BYTES = 4 << 20
_SAID = re.compile(rb"made by fgpose ([a-z]+)")
_DETECT = "detect"


def made_by(path: Path) -> str:
    """The command, without fgpose; empty where the file does not say it, is damaged, or is of another program."""
    try:
        match path.suffix.lower():
            case ".parquet":
                return _of_table(path)
            case ".npz":
                return _of_archive(path)
            case ".toml":
                return load_calibration_origin(path).step
    except (ValueError, OSError):
        return ""
    found = _SAID.search(first_bytes(path, _HEAD_BYTES))
    return found[1].decode() if found else ""


def _of_table(path: Path) -> str:
    origin = load_origin(path)
    if origin is not None:
        # Before there was a step, there was the command.
        return origin.step or (re.findall(r"^fgpose ([a-z]+)", origin.command) or [""])[0]
    return _DETECT if {"camera", "joint", "x_px"} <= column_names(path) else ""


def _of_archive(path: Path) -> str:
    names = array_names(path)
    if "made_by" in names:
        return text(read_arrays(path, {"made_by"}), "made_by")
    return _DETECT if "points2d_px" in names else load_calibration_origin(path).step


def refuse_others(paths: Iterable[Path], step: str, source: Path | None = None, remedy: str = "") -> None:
    """Raise ValueError, before any work, if a file that will be written is there and is not of this step, or of
    another recording. A file that says nothing counts as the others that will be written do.

    Args:
        paths: what will be written.
        step: the command, without fgpose.
        source: what it is made from.
        remedy: how another name is given.
    """
    there = {path: made_by(path) for path in paths if path.is_file()}
    known = [maker for maker in there.values() if maker]
    for path, own in there.items():
        maker = own or (known[0] if known else "")
        what = f"fgpose {maker} made it" if maker else "it does not say what made it"
        if maker != step:
            raise ValueError(f"{path} is there already, and {what}: fgpose {step} does not replace it; {remedy}")
        other = None if source is None or path.suffix != ".parquet" else _other_source(path, source)
        if other:
            raise ValueError(f"{path} is there already, made from another recording, {other}; {remedy}")


def _other_source(path: Path, source: Path) -> str:
    """The recording that a result is from, if that is another."""
    try:
        origin = load_origin(path)
    except (ValueError, OSError):
        return ""
    files = [] if origin is None else [origin.input_file(what) for what in ("Keypoints", "Videos")]
    paths = [file.path for file in files if file is not None]
    same = not paths or any(os.path.realpath(each) == os.path.realpath(source) for each in paths)
    return "" if same else paths[0]
