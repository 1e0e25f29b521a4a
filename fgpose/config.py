"""Configuration: the parameters of all parts as one, from keywords or from TOML, checked alike.

load_config reads a Config. Its sections are FusionConfig, ProjectionConfig, VisibilityConfig, DepthConfig,
SymmetryConfig, MotionConfig, SwingConfig, PriorConfig, RefinementConfig, CalibrationConfig, SolverConfig,
OnlineConfig, TrackingConfig and MonocularConfig. What may be given in place of one is a Section; of all, by name,
Sections.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
import re
import reprlib
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from fgpose.parameters import (
    CalibrationConfig,
    DepthConfig,
    FusionConfig,
    MonocularConfig,
    MotionConfig,
    OnlineConfig,
    PriorConfig,
    ProjectionConfig,
    RefinementConfig,
    SolverConfig,
    SwingConfig,
    SymmetryConfig,
    TrackingConfig,
    VisibilityConfig,
)
from fgpose.plain_files import MAX_SETTINGS_BYTES, naming, read_settings
from fgpose.shown import Shown

__all__ = [
    "CalibrationConfig",
    "Config",
    "DepthConfig",
    "FusionConfig",
    "MonocularConfig",
    "MotionConfig",
    "OnlineConfig",
    "PriorConfig",
    "ProjectionConfig",
    "RefinementConfig",
    "Section",
    "Sections",
    "SolverConfig",
    "SwingConfig",
    "SymmetryConfig",
    "TrackingConfig",
    "VisibilityConfig",
    "load_config",
]

_TOML_QUOTED = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'")
_TOML_SEPARATOR = re.compile(r"[\[\]{}=,\n]")
_MAX_KEY_PARTS = 10  # a key of fgpose has two; some ten thousand take tomllib minutes


Section = Mapping[str, Any]
"""Some fields of a section, by name."""


class Sections(TypedDict, total=False):
    """The sections as keywords, each as some of its fields or as an object of its own."""

    fusion: FusionConfig | Section
    projection: ProjectionConfig | Section
    visibility: VisibilityConfig | Section
    depth: DepthConfig | Section
    symmetry: SymmetryConfig | Section
    motion: MotionConfig | Section
    swing: SwingConfig | Section
    prior: PriorConfig | Section
    refinement: RefinementConfig | Section
    calibration: CalibrationConfig | Section
    solver: SolverConfig | Section
    online: OnlineConfig | Section
    tracking: TrackingConfig | Section
    monocular: MonocularConfig | Section


@dataclass(frozen=True, init=False, repr=False)
class Config(Shown):
    """All parameters of fgpose: ``Config(online={"lag_s": 0.2}, motion={"model": "random_walk"})``. Frozen.

    Raises:
        ValueError: an unknown section or field (the nearest known one is suggested), or a value of a wrong kind.
    """

    fusion: FusionConfig
    projection: ProjectionConfig
    visibility: VisibilityConfig
    depth: DepthConfig
    symmetry: SymmetryConfig
    motion: MotionConfig
    swing: SwingConfig
    prior: PriorConfig
    refinement: RefinementConfig
    calibration: CalibrationConfig
    solver: SolverConfig
    online: OnlineConfig
    tracking: TrackingConfig
    monocular: MonocularConfig

    def __init__(self, **sections: Unpack[Sections]) -> None:
        every_section: dict[str, Any] = {name: {} for name in _kinds(Config)}
        for name, section in checked_fields(Config, every_section | {**sections}, "").items():
            object.__setattr__(self, name, section)

    def replace(self, **sections: Unpack[Sections]) -> Config:
        """Another configuration with some fields changed: ``config.replace(online={"lag_s": 0.2})``.

        A section that is given as an object takes the place of the whole section. Raises ValueError as Config does.
        """
        own = {name: vars(section) for name, section in vars(self).items()}
        changed: dict[str, Any] = {
            name: {**own.get(name, {}), **given} if isinstance(given, Mapping) else given
            for name, given in sections.items()
        }
        return Config(**{**own, **changed})


def load_config(path: str | Path) -> Config:
    """Configuration from a TOML file; what the file does not name keeps its default.

    Raises:
        ValueError: the file is not TOML, names an unknown section or key (the nearest known one is suggested), or
            gives a value of a wrong kind.
        OSError: the file cannot be read.
    """
    with naming(path):
        return config_from_dict(parse_toml(read_settings(Path(path))))


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML document, which may be damaged. Raises ValueError if it is, or is nested too deeply, or
    larger than MAX_SETTINGS_BYTES."""
    if len(text) > MAX_SETTINGS_BYTES:
        raise ValueError(f"it has more than {MAX_SETTINGS_BYTES} bytes of TOML")
    # tomllib takes minutes and all memory for a key of some ten thousand parts.
    pieces = _TOML_SEPARATOR.split(_TOML_QUOTED.sub("", text))
    try:
        if max(piece.count(".") for piece in pieces) > _MAX_KEY_PARTS:
            raise RecursionError
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def config_from_dict(table: dict[str, Any]) -> Config:
    """Configuration from nested tables, as read from TOML. Raises ValueError as load_config does."""
    return Config(**table)


def config_to_toml(config: Config) -> str:
    """The whole configuration as TOML, as load_config reads it."""
    import tomli_w

    return tomli_w.dumps(dataclasses.asdict(config))


@cache
def _kinds(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def checked_fields(cls: type, table: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """The values of a table, checked against the fields of a dataclass."""
    known = _kinds(cls)
    for name in table:
        if name not in known:
            nearest = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
            raise ValueError(f"unknown key {prefix}{name}; did you mean {prefix}{nearest}?")
    return {name: _convert(known[name], value, f"{prefix}{name}") for name, value in table.items()}


def _convert(kind: Any, value: Any, name: str) -> Any:
    if dataclasses.is_dataclass(kind):
        table = vars(value) if isinstance(value, typing.cast(type, kind)) else value
        if not isinstance(table, Mapping):
            raise ValueError(f"{name} is a section, got {reprlib.repr(value)}")
        return typing.cast(type, kind)(**checked_fields(typing.cast(type, kind), table, f"{name}."))
    if typing.get_origin(kind) is Literal:
        choices = typing.get_args(kind)
        if value not in choices:
            raise ValueError(f"{name} must be one of {', '.join(map(str, choices))}, got {reprlib.repr(value)}")
        return value
    if typing.get_origin(kind) in (types.UnionType, typing.Union):  # the latter of a Literal and None
        (kind,) = (each for each in typing.get_args(kind) if each is not type(None))
        return None if value is None else _convert(kind, value, name)
    if typing.get_origin(kind) is tuple:
        return _several(typing.get_args(kind)[0], value, name)
    if kind in (int, float):
        return _number(kind, value, name)
    if type(value) is not kind:
        raise ValueError(f"{name} must be a {kind.__name__}, got {reprlib.repr(value)}")
    return value


def _several(kind: Any, value: Any, name: str) -> tuple[Any, ...]:
    """A list of values; one alone may stand for a list of it."""
    values = value if isinstance(value, list | tuple) else [value]
    return tuple(_convert(kind, each, name) for each in values)


# Of a number of the configuration. No scale, duration or count is as large, or as small as one over it, and what is
# computed with them, weights as the inverse squares of sigmas among it, has a solution in double precision.
_LARGEST = 1e12


def _number(kind: type[int] | type[float], value: Any, name: str) -> int | float:
    """Every number but a least confidence is a scale, a duration or a count: zero or less has no meaning."""
    of_kind = numbers.Integral if kind is int else numbers.Real
    if not isinstance(value, of_kind) or isinstance(value, bool):
        raise ValueError(f"{name} must be a {kind.__name__}, got {reprlib.repr(value)}")
    try:
        size = float(value)
    except OverflowError:
        size = math.inf
    may_be = {"online.lag_s": math.inf, "data.min_confidence": 0.0}
    if not 1 / _LARGEST < size < _LARGEST and size != may_be.get(name):
        raise ValueError(f"{name} must be a positive number, got {reprlib.repr(value)}")
    return kind(size)
