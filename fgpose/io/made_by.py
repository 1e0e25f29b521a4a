"""Which command wrote a file, so that another does not replace it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from fgpose.io.arrays import array_names, read_arrays, text
from fgpose.io.atomic import check_replaceable
from fgpose.io.calibration import load_calibration_origin
from fgpose.io.content import first_bytes, last_bytes
from fgpose.io.tables import column_names
from fgpose.io.trajectories import load_origin

# The header of a TRC, the parameters of a C3D, what a PDF and an SVG say of themselves and, behind its layout, the name
# of a recording in Rerun are in these.
_HEAD_BYTES = 4 << 20
# The tags of an MP4 are its end.
_END_BYTES = 4096
_PAGE_HEAD_BYTES = 4096
_PAGE = b'<meta name="generator" content="fgpose '
_SAID = re.compile(rb'made by fgpose ([a-z]+)(?: from "([^"]+)")?')
_ANGLES = "angles"
_DETECT = "detect"
_REPORT = "report"


def made_by(path: Path) -> str:
    """The command, without fgpose; empty where the file does not say it, is damaged, or is of another program."""
    return _maker(path)[0]


def _maker(path: Path) -> tuple[str, str]:
    """The command and, if that is known, the path of the recording."""
    try:
        match path.suffix.lower():
            case ".parquet":
                return _of_table(path)
            case ".npz":
                return _of_archive(path)
            case ".toml":
                return load_calibration_origin(path).step, ""
            case ".mp4":
                return _said(last_bytes(path, _END_BYTES), path)
    except (ValueError, OSError):
        return "", ""
    # A page may be named anything, and names other commands: those that made what it is about.
    if _PAGE in first_bytes(path, _PAGE_HEAD_BYTES):
        return _REPORT, ""
    return _said(first_bytes(path, _HEAD_BYTES), path)


def _said(content: bytes, path: Path) -> tuple[str, str]:
    found = _SAID.search(content)
    if found is None:
        return "", ""
    recording = (found[2] or b"").decode(errors="replace")
    return found[1].decode(), os.path.normpath(path.parent / recording) if recording else ""


def _of_table(path: Path) -> tuple[str, str]:
    if {"camera", "joint", "x_px"} <= column_names(path):
        return _DETECT, ""
    origin = load_origin(path)
    if origin is not None:
        # Before there was a step, there was the command.
        step = origin.step or (re.findall(r"^fgpose ([a-z]+)", origin.command) or [""])[0]
        return step, origin.recording
    # Tables of older versions say what is in them alone.
    return (_ANGLES, "") if {"kind", "name", "value", "unit"} <= column_names(path) else ("", "")


def _of_archive(path: Path) -> tuple[str, str]:
    names = array_names(path)
    if "made_by" in names:
        return _said(b"made by fgpose " + text(read_arrays(path, {"made_by"}), "made_by").encode(), path)
    return _DETECT if "points2d_px" in names else load_calibration_origin(path).step, ""


def check_result(
    path: Path,
    step: str,
    inputs: Iterable[Path | None] = (),
    remedy: str = "choose another with --output, or remove it",
) -> None:
    """Make sure, before any work is done, that a command can write its only file; its folder is made if it is absent.

    Args:
        path: the file.
        step: the command, without fgpose.
        inputs: what it is made from.
        remedy: how another name is given.

    Raises:
        ValueError: it is an input, or there already and not of this command; the message names it.
        OSError: its folder cannot be written into, or what has its name is no plain file.
    """
    refuse_inputs([path], inputs)
    refuse_others([path], step, remedy=remedy)
    check_replaceable(path)


def refuse_inputs(
    paths: Iterable[Path], inputs: Iterable[Path | None], remedy: str = "choose another with --output"
) -> None:
    """Raise ValueError, which says how another name is given, if what will be written is what it is made from, also by
    another name. None: an input that was not given."""
    known = {os.path.realpath(path) for path in inputs if path is not None}
    for path in paths:
        if os.path.realpath(path) in known:
            raise ValueError(f"the result {path} would replace an input; {remedy}")


def refuse_others(paths: Iterable[Path], step: str, source: Path | None = None, remedy: str = "") -> None:
    """Raise ValueError, before any work, if a file that will be written is there and is not of this step, or of
    another recording. A file that says nothing counts as the others that will be written do.

    Args:
        paths: what will be written.
        step: the command, without fgpose.
        source: what it is made from.
        remedy: how another name is given.
    """
    paths = list(paths)
    there = {path: _maker(path) for path in paths if path.is_file()}
    known = [maker for maker, _ in there.values() if maker]
    for path, (own, recording) in there.items():
        maker = own or (known[0] if known else "")
        what = f"fgpose {maker} made it" if maker else "it does not say what made it"
        if maker != step:
            raise ValueError(f"{path} is there already, and {what}: fgpose {step} does not replace it; {remedy}")
        _refuse_another(path, recording, source, remedy)
    # One name in one folder is of one recording.
    for table in {path.with_suffix(".parquet") for path in paths} - there.keys():
        maker, recording = _maker(table) if table.is_file() else ("", "")
        _refuse_another(table, recording if maker == step else "", source, remedy)


def _refuse_another(path: Path, recording: str, source: Path | None, remedy: str) -> None:
    if source is not None and recording and os.path.realpath(recording) != os.path.realpath(source):
        raise ValueError(f"{path} is there already, made from another recording, {recording}; {remedy}")
