"""Which cameras a live system has, and where their images come from: the file that ``fgpose live`` is given.

For each camera of the rig it has a table ``[cameras.NAME]`` with the key ``source``, see CameraSource. The calibration
is in the same file, or in the one that ``calibration`` in the table ``[live]`` names:

    [live]
    calibration = "Calib.toml"

    [cameras.cam01]
    source = "rtsp://viewer:${FGPOSE_CAM01_PASSWORD}@192.168.0.11/stream1"

    [cameras.cam02]
    source = "/dev/video0"
    fps = 30
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fgpose.config import checked_fields, parse_toml
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import warn_far_apart
from fgpose.io.calibration import load_rig
from fgpose.live.sources import CameraSource
from fgpose.live.sources.address import kind_of, with_environment, without_password
from fgpose.plain_files import naming, read_settings


@dataclass(frozen=True)
class LiveRig:
    """Calibrated cameras and their sources."""

    rig: CameraRig
    sources: dict[str, CameraSource]
    """By the names of the cameras, in their order."""


def load_live_rig(path: str | Path) -> LiveRig:
    """Read a rig file; nothing is opened.

    Relative paths in it are relative to its folder.

    Raises:
        ValueError: it is not TOML, a camera of the rig has no source, a source has no camera, a name is there twice, or
            a key is unknown or its value of a wrong kind; the message names the file and the camera.
        OSError: a file cannot be read.

    Warns:
        UserWarning: by their time offsets cameras are far apart, see warn_far_apart.
    """
    path = Path(path)
    with naming(path):
        document = parse_toml(read_settings(path))
        tables = document.get("cameras")
        if not isinstance(tables, dict):
            raise ValueError("there are no sources; each camera needs a table [cameras.NAME] with source = ...")
        live = document.get("live", {})
        calibration = live.get("calibration") if isinstance(live, dict) else None
        if calibration is not None and not isinstance(calibration, str):
            raise ValueError(f"live.calibration must be a path, got {calibration!r}")
        sources = _sources(tables, path.parent)
    # A rig that was found from a recording has the starts of its videos.
    rig = load_rig(path if calibration is None else path.parent / calibration).after_recording()
    warn_far_apart(rig, path)
    with naming(path):
        return LiveRig(rig, _matched(sources, rig.names))


def _sources(tables: dict[str, Any], folder: Path) -> dict[str, CameraSource]:
    sources: dict[str, CameraSource] = {}
    for key, table in tables.items():
        if not isinstance(table, dict):
            raise ValueError(f"cameras.{key} is a table with source = ..., got a value")
        # caliscope numbers its cameras and calibrates them in these tables.
        name = str(table.get("name", f"cam_{key}" if key.isdecimal() else key))
        if name in sources:
            raise ValueError(f"two cameras are named {name}")
        if "matrix" in table:
            table = {key: value for key, value in table.items() if key in CameraSource.__annotations__}
        try:
            settings: dict[str, Any] = checked_fields(CameraSource, table, "")
            if not settings.get("source"):
                raise ValueError("source is missing")
            settings["source"] = _resolved(settings["source"], folder)
            sources[name] = CameraSource(**settings)
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return sources


def _resolved(source: str, folder: Path) -> str:
    """With its environment variables; paths of files are relative to the rig file."""
    source = with_environment(source)
    if kind_of(source) in ("file", "folder") and without_password(source) != source:
        raise ValueError(
            f"{without_password(source)} is no file, and an address is written rtsp://user:password@host/path"
        )
    return str(folder / source) if kind_of(source) in ("file", "folder") else source


def _matched(sources: dict[str, CameraSource], names: Iterable[str]) -> dict[str, CameraSource]:
    names = tuple(names)
    lacking = [name for name in names if name not in sources]
    unknown = [name for name in sources if name not in names]
    problems = []
    if lacking:
        problems.append(f"camera {', '.join(lacking)} of the rig has no source: a table [cameras.{lacking[0]}]")
    if unknown:
        problems.append(f"the source of {', '.join(unknown)} has no camera; the rig has {', '.join(names)}")
    if problems:
        raise ValueError("; ".join(problems))
    return {name: sources[name] for name in names}
