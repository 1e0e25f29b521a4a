"""What a result was made from, and with: kept in its file as JSON, so that it can be judged without anything else."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fgpose.association.track import TrackEvent
from fgpose.finding import Code, Finding
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration.calibrated_view import rig_in_metres
from fgpose.io.calibration.calibration_origin import CalibrationOrigin as CalibrationOrigin
from fgpose.io.calibration.calibration_origin import MovedCamera as MovedCamera
from fgpose.io.calibration.calibration_origin import Reason as Reason
from fgpose.io.calibration.toml_formats import pose2sim_text, read
from fgpose.io.content import converted, parse_json
from fgpose.io.names import files_below

_VERSION = 1
"""Raised when a field changes its meaning. One of another version is not read, the result is."""
_LONGEST_PATH = 200  # a parameter of a C3D has 255 characters


@dataclass(frozen=True)
class InputFile:
    """A file, or a folder, that a result was made from."""

    what: str
    """Keypoints, Calibration or Videos; Video of a single one; the Result that angles are of; or what a step of a study
    began from."""
    path: str
    """In a file relative to the folder of the result, in memory absolute."""
    size_bytes: int
    """Of all files together: another size is another recording."""
    camera: str = ""
    """Whose video it is."""
    image_px: tuple[int, ...] = ()
    """Width and height of its images."""
    rate_hz: float | None = None
    """Of its images."""

    @property
    def is_there(self) -> bool:
        """Whether there still is such a file, of the same size."""
        try:
            return size_bytes(Path(self.path)) == self.size_bytes
        except OSError:
            return False


@dataclass(frozen=True, eq=False)
class Origin:
    """What a result was made from, and with. The settings are those of its trajectories."""

    inputs: tuple[InputFile, ...] = ()
    rig: CameraRig | None = None
    """As it was used, its time offsets by the clocks of the inputs."""
    calibration: CalibrationOrigin = field(default_factory=CalibrationOrigin)
    estimated: tuple[str, ...] = ()
    """What of the cameras was estimated on this recording before the result was: poses, clocks."""
    findings: tuple[Finding, ...] = ()
    """What is probably wrong with the recording and the result."""
    events: tuple[TrackEvent, ...] = ()
    """Of the tracks of several people."""
    chosen: str = ""
    """Of how many people this is one, and why this one; nothing where there was nobody else."""
    fps: float | None = None
    """That the keypoints or images were read with, where that was given."""
    command: str = ""
    step: str = ""
    """The command that made the result, without what it was called with."""
    remarks: tuple[str, ...] = ()
    """What was changed or left out when the inputs were read."""
    fgpose: str = ""
    """Version."""

    def with_inputs(self, *inputs: InputFile) -> Origin:
        return replace(self, inputs=(*self.inputs, *inputs))

    def input_file(self, what: str) -> InputFile | None:
        """The first of a kind."""
        return next((each for each in self.inputs if each.what == what), None)

    @property
    def recording(self) -> str:
        """Path of the keypoints, or else the videos, or the result; empty if there are none."""
        seen = self.input_file("Keypoints") or self.input_file("Videos") or self.input_file("Result")
        return "" if seen is None else seen.path

    def maker(self, folder: Path) -> str:
        """For files in this folder that hold a line alone: the command and the recording, as far as they are known."""
        path = _relative(self.recording, folder) if self.recording else ""
        is_short = 0 < len(path) <= _LONGEST_PATH and path.isprintable() and '"' not in path
        return f'{self.step} from "{path}"' if self.step and is_short else self.step


def input_file(what: str, path: Path) -> InputFile:
    """A file or folder as it is now. Raises OSError if it cannot be seen."""
    return InputFile(what, os.path.abspath(path), size_bytes(path))


def size_bytes(path: Path) -> int:
    """Of a file, or of all files in a folder that are not hidden. Raises OSError if it cannot be seen."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.stat().st_size for file in files_below(path))


def origin_to_json(origin: Origin, folder: Path) -> str:
    """As it is kept in the file of a result in this folder: nothing in it depends on where the folder is, as long as
    the inputs keep their places beside it."""
    table = {each.name: getattr(origin, each.name) for each in dataclasses.fields(Origin) if each.name != "rig"}
    table |= {name: [dataclasses.asdict(each) for each in table[name]] for name in ("inputs", "findings", "events")}
    table["calibration"] = dataclasses.asdict(origin.calibration)
    for each in table["inputs"]:
        each["path"] = _relative(each["path"], folder)
    rig = {} if origin.rig is None else {"rig": pose2sim_text(origin.rig)}
    return json.dumps({"version": _VERSION} | table | rig, allow_nan=False)


def _relative(path: str, folder: Path) -> str:
    own, base = os.path.realpath(path), os.path.realpath(folder)
    # What shares nothing with the result does not move with it.
    return own if os.path.commonpath((own, base)) == os.sep else Path(os.path.relpath(own, base)).as_posix()


def origin_from_json(text: str, folder: Path) -> Origin | None:
    """What origin_to_json wrote; None if a later version of fgpose did.

    Raises:
        ValueError: it is damaged; the caller names the file.
    """
    try:
        table = parse_json(text)
        if not isinstance(table, dict) or type(table.get("version")) is not int:
            raise ValueError("a table with a version is needed")
        if table.pop("version") != _VERSION:
            return None
        rig = _rig(table.pop("rig")) if "rig" in table else None
        # A later version may know more kinds of findings: the result is as readable without them.
        table["findings"] = [each for each in table.get("findings", []) if _is_known(each)]
        origin = replace(converted(Origin, table, "origin"), rig=rig)
    except RecursionError:
        raise ValueError("its origin is damaged: it is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"its origin is damaged: {error}") from None
    inputs = (replace(each, path=os.path.normpath(os.path.join(os.path.abspath(folder), each.path)))
              for each in origin.inputs)  # fmt: skip
    return replace(origin, inputs=tuple(inputs))


def _is_known(finding: Any) -> bool:
    return not isinstance(finding, dict) or finding.get("code") in list(Code)


def _rig(text: Any) -> CameraRig:
    if not isinstance(text, str):
        raise ValueError("rig: a text is needed")
    views, unit = read(text)
    return rig_in_metres(views, unit, "m")
