"""A robot cell as a TOML file says it: links, zones, and what counts as a fault.

quantile = 0.99           # of the distance of each capsule; all keys but links or zones have defaults
max_age_s = 0.5           # older data are a fault
walking_m_s = 1.6         # a person in the age of the data; ISO 13855
hand_m_s = 2.0            # the arms; ISO 13855
surroundings_m = 1.0      # so far around each link the cameras must observe
min_observed_share = 0.9  # of these surroundings, by at least two cameras that are ok; less is a fault
missing_within_m = 2.0    # a person nearer than this whose pose lacks joints is a fault
nobodys_s = 0.5           # a detection in the surroundings that is nobody's for longer is a fault
lost_s = 60               # who is lost in the surroundings and not seen again is a fault for so long

[volume]                  # where people can be; see fgpose.live.tracking.observed.volume_points_m
low_m = [-2, -2, 0]
high_m = [2, 2, 2.2]

[radius_m]                # of some parts of the body, see fgpose.robot.body
lower_arm = 0.08

[links.forearm]           # in the frame of the link, whose pose comes from the robot
capsules = [{ from_m = [0, 0, 0], to_m = [0, 0, 0.4], radius_m = 0.08 }]
spheres = [{ centre_m = [0, 0, 0.4], radius_m = 0.1 }]

[zones.conveyor]          # in the world frame
boxes = [{ low_m = [0.5, -1, 0], high_m = [1, 1, 0.9] }]
"""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.config import parse_toml
from fgpose.io.content import read_content
from fgpose.live.tracking.observed import Volume
from fgpose.plain_files import naming
from fgpose.robot.body import RADIUS_M

_MAX_BYTES = 1_000_000  # some thousand times what a cell takes
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Capsule:
    """Everything within a radius of a segment; of a point, where both ends are the same: a sphere."""

    from_m: Vector
    to_m: Vector
    radius_m: float


@dataclass(frozen=True)
class Box:
    """A box along the axes of its frame."""

    low_m: Vector
    high_m: Vector


@dataclass(frozen=True)
class Link:
    """A link of a robot, or a zone: shapes that move together."""

    name: str
    capsules: tuple[Capsule, ...] = ()
    boxes: tuple[Box, ...] = ()
    is_fixed: bool = False
    """A zone: its shapes are in the world frame. Those of other links are in the frame of the link."""

    def corners_m(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Lower and upper corner of the box along the axes around all shapes."""
        low_m = [np.minimum(shape.from_m, shape.to_m) - shape.radius_m for shape in self.capsules]
        high_m = [np.maximum(shape.from_m, shape.to_m) + shape.radius_m for shape in self.capsules]
        low_m += [np.array(box.low_m) for box in self.boxes]
        high_m += [np.array(box.high_m) for box in self.boxes]
        return np.min(low_m, axis=0), np.max(high_m, axis=0)


@dataclass(frozen=True)
class Limits:
    """What is allowed for, and what counts as a fault.

    Raises:
        ValueError: a number is out of its range; the message names it.
    """

    quantile: float = 0.99
    """Probability with which each capsule of a person is at least as far away as is said."""
    max_age_s: float = 0.5
    """Older data are a fault."""
    walking_m_s: float = 1.6
    """How fast a person may come nearer in the age of the data: K of ISO 13855 for walking."""
    hand_m_s: float = 2.0
    """The same of the arms: K of ISO 13855 for hand and arm."""
    surroundings_m: float = 1.0
    """How far around each link the cameras must observe."""
    min_observed_share: float = 0.9
    """Of these surroundings, by at least two cameras that are ok; less is a fault."""
    missing_within_m: float = 2.0
    """A person whose pose lacks joints is a fault of the links that are nearer to the known joints than this: the
    surroundings, and the length of a leg or an arm."""
    nobodys_s: float = 0.5
    """A detection that may be in the surroundings of a link, and is nobody's, is a fault after so long."""
    lost_s: float = 60.0
    """Who is lost in the surroundings of a link, where nobody leaves unseen, is a fault for so long, or until somebody
    new is found near there."""

    def __post_init__(self) -> None:
        for limit in fields(self):
            value = getattr(self, limit.name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{limit.name}: a positive number is needed, got {value:g}")
        if not 0.5 <= self.quantile < 1:
            raise ValueError(f"quantile: a number from 0.5 to below 1 is needed, got {self.quantile:g}")
        if self.min_observed_share > 1:
            raise ValueError(f"min_observed_share: at most 1 is needed, got {self.min_observed_share:g}")


@dataclass(frozen=True)
class Cell:
    """Links and zones from which people are measured.

    Raises:
        ValueError: there is neither a link nor a zone, or two have one name.
    """

    links: tuple[Link, ...]
    """Zones too."""
    limits: Limits = Limits()
    volume: Volume | None = None
    """Where people can be; None: what the rig observes, see fgpose.live.tracking.observed.volume_points_m."""
    radius_m: Mapping[str, float] = field(default_factory=dict)
    """Of some parts of the body; see fgpose.robot.body."""

    def __post_init__(self) -> None:
        names = [link.name for link in self.links]
        if not names:
            raise ValueError("neither links nor zones are given")
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"{repeated[0]} is the name of two links or zones")


def load_cell(path: str | Path) -> Cell:
    """A cell from a TOML file; see the top of this module.

    Raises:
        ValueError: the file is not TOML, or a key is unknown, missing or wrong; the message names file and key.
        OSError: the file cannot be read.
    """
    with naming(path):
        return _cell(_Table("", parse_toml(read_content(Path(path), _MAX_BYTES).decode("utf-8"))))


@dataclass(frozen=True)
class _Table:
    """A table of the file with the key that leads to it, for errors."""

    key: str
    values: dict[str, Any]

    def name(self, key: str) -> str:
        return f"{self.key}.{key}" if self.key else key

    def only(self, *known: str) -> None:
        unknown = sorted(set(self.values) - set(known))
        if unknown:
            raise ValueError(f"{self.name(unknown[0])}: unknown key; known: {', '.join(known)}")

    def of(self, key: str, kind: Callable[[str, Any], Any]) -> Any:
        """A value that must be there, read by a function of its full name and itself."""
        if key not in self.values:
            raise ValueError(f"{self.name(key)} is missing")
        return kind(self.name(key), self.values[key])

    def tables(self, key: str) -> list[_Table]:
        """A list of tables, empty if it is not there."""
        rows = self.values.get(key, [])
        if not isinstance(rows, list):
            raise ValueError(f"{self.name(key)}: a list of tables is needed, got {reprlib.repr(rows)}")
        return [_table(f"{self.name(key)}[{number}]", row) for number, row in enumerate(rows)]


def _table(name: str, value: Any) -> _Table:
    if not isinstance(value, dict):
        raise ValueError(f"{name}: a table is needed, got {reprlib.repr(value)}")
    return _Table(name, value)


def _number(name: str, value: Any) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    # Whole numbers of TOML have no limit.
    if not is_number or abs(value) > sys.float_info.max or math.isnan(value):
        raise ValueError(f"{name}: a number is needed, got {reprlib.repr(value)}")
    return float(value)


def _positive(name: str, value: Any) -> float:
    if (number := _number(name, value)) <= 0:
        raise ValueError(f"{name}: a positive number is needed, got {number:g}")
    return number


def _vector(name: str, value: Any) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{name}: three numbers are needed, got {reprlib.repr(value)}")
    x, y, z = (_number(name, number) for number in value)
    return x, y, z


def _cell(table: _Table) -> Cell:
    limit_names = tuple(limit.name for limit in fields(Limits))
    table.only(*limit_names, "volume", "radius_m", "links", "zones")
    limits = Limits(**{name: table.of(name, _number) for name in limit_names if name in table.values})
    links = [
        _link(_table(f"{group}.{name}", value), name, is_fixed=group == "zones")
        for group in ("links", "zones")
        if group in table.values
        for name, value in table.of(group, _table).values.items()
    ]
    volume = _volume(table.of("volume", _table)) if "volume" in table.values else None
    radius_m = table.of("radius_m", _table) if "radius_m" in table.values else _Table("radius_m", {})
    radius_m.only(*RADIUS_M)
    return Cell(tuple(links), limits, volume, {part: radius_m.of(part, _positive) for part in radius_m.values})


def _volume(table: _Table) -> Volume:
    table.only("low_m", "high_m", "spacing_m")
    spacing = {"spacing_m": table.of("spacing_m", _positive)} if "spacing_m" in table.values else {}
    corners = table.of("low_m", _vector), table.of("high_m", _vector)
    with naming(table.key):
        return Volume(*corners, **spacing)


def _link(table: _Table, name: str, *, is_fixed: bool) -> Link:
    table.only("capsules", "spheres", "boxes")
    capsules = [_capsule(row) for row in table.tables("capsules")] + [_sphere(row) for row in table.tables("spheres")]
    boxes = [_box(row) for row in table.tables("boxes")]
    if not capsules and not boxes:
        raise ValueError(f"{table.key}: capsules, spheres or boxes are needed")
    return Link(name, tuple(capsules), tuple(boxes), is_fixed)


def _capsule(table: _Table) -> Capsule:
    table.only("from_m", "to_m", "radius_m")
    return Capsule(table.of("from_m", _vector), table.of("to_m", _vector), table.of("radius_m", _positive))


def _sphere(table: _Table) -> Capsule:
    table.only("centre_m", "radius_m")
    centre_m = table.of("centre_m", _vector)
    return Capsule(centre_m, centre_m, table.of("radius_m", _positive))


def _box(table: _Table) -> Box:
    table.only("low_m", "high_m")
    box = Box(table.of("low_m", _vector), table.of("high_m", _vector))
    if any(low >= high for low, high in zip(box.low_m, box.high_m, strict=True)):
        raise ValueError(f"{table.key}: low_m must be below high_m, got {box.low_m} and {box.high_m}")
    return box
