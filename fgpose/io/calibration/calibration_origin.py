"""How the cameras of a calibration became what they are: kept in its file, so that every result made with it knows."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fgpose.io.content import converted

_VERSION = 1
"""Raised when a field changes its meaning. One of another version is not read, the rig is."""


@dataclass(frozen=True)
class Reason:
    """A reason for the verdict on a calibration, see fgpose.calibration.from_people.calibrated."""

    camera: str
    """Whose it is; empty: of the whole rig."""
    grade: str
    reason: str
    remedy: str


@dataclass(frozen=True)
class MovedCamera:
    """By how much a camera was moved when the calibration was refined."""

    camera: str
    rotation_deg: float
    translation_m: float
    rotation_sigma_deg: float = 0.0
    """Standard deviation of its orientation afterwards, about each axis; 0: not known."""
    translation_sigma_m: float = 0.0
    """Of each coordinate of its position afterwards; 0: not known."""


@dataclass(frozen=True)
class CalibrationOrigin:
    """How the cameras became what they are; empty where they were taken as given.

    It is of one rig. A rig that is refined keeps the verdict and its reasons, as what happened before, and what is
    estimated anew takes the place of what was: moved is of the last refinement.
    """

    offset_sigma_s: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the time offset of each camera whose offset was estimated."""
    moved: tuple[MovedCamera, ...] = ()
    grade: str = ""
    """Of a calibration from people or with a board, with all its cameras."""
    findings: tuple[Reason, ...] = ()
    """Of the same."""
    step: str = ""
    """The command that wrote the file."""
    method: str = ""
    """How the cameras were calibrated: "from people", "with a board"; empty: not known."""
    coverage: Mapping[str, tuple[tuple[int, ...], ...]] = field(default_factory=dict)
    """Of each camera that was calibrated with a board: corners in the parts of its image, in rows from the top."""
    shift_sigma_m: float = 0.0
    """Standard deviation of each coordinate by which the last refinement may have shifted all cameras together; 0: not
    known."""

    def subset(self, cameras: Collection[str]) -> CalibrationOrigin:
        """What holds of some of the cameras; what is said of the whole rig stays."""
        return replace(
            self,
            offset_sigma_s={name: sigma_s for name, sigma_s in self.offset_sigma_s.items() if name in cameras},
            moved=tuple(each for each in self.moved if each.camera in cameras),
            findings=tuple(each for each in self.findings if not each.camera or each.camera in cameras),
            coverage={name: counts for name, counts in self.coverage.items() if name in cameras},
        )


def table_of(known: CalibrationOrigin | None, cameras: Any = None) -> dict[str, Any]:
    """As a table of TOML or JSON; empty where nothing is known.

    Args:
        known: of the rig.
        cameras: their tables, where another program may write the file anew with other cameras: it is then no longer
            of this rig.
    """
    if known is None or known == CalibrationOrigin():
        return {}
    table = {name: list(value) if isinstance(value, tuple) else value for name, value in vars(known).items()}
    table |= {name: [dataclasses.asdict(each) for each in table[name]] for name in ("moved", "findings")}
    table["offset_sigma_s"] = dict(known.offset_sigma_s)
    table["coverage"] = {name: [list(row) for row in counts] for name, counts in known.coverage.items()}
    rig = {} if cameras is None else {"rig": _digest(cameras)}
    return {"version": _VERSION} | rig | {name: value for name, value in table.items() if value}


def origin_of_table(table: Any, cameras: Any = None) -> CalibrationOrigin:
    """What table_of gave; empty if a later version of fgpose did, or if the cameras are others now.

    Raises:
        ValueError: it is damaged; the caller names the file.
    """
    try:
        if not isinstance(table, dict) or type(table.get("version")) is not int:
            raise ValueError("a table with a version is needed")
        known = {key: value for key, value in table.items() if key not in ("version", "rig")}
        if table["version"] != _VERSION or (cameras is not None and table.get("rig") != _digest(cameras)):
            return CalibrationOrigin()
        return converted(CalibrationOrigin, known, "fgpose")
    except ValueError as error:
        raise ValueError(f"what it says of its origin is damaged: {error}") from None


def _digest(cameras: Any) -> str:
    """Of what a file says of its cameras. Numbers come back from TOML as they were written."""
    return hashlib.blake2b(json.dumps(cameras, sort_keys=True, default=str).encode(), digest_size=8).hexdigest()
