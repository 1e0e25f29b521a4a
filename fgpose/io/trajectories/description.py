"""What a result file says of itself beside its numbers: skeleton, cameras, bone lengths, convergence, configuration."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
import typing
import warnings
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.config import Config, config_from_dict, config_to_toml, parse_toml
from fgpose.io.content import parse_json
from fgpose.io.skeletons.tables import joint_indices, joint_names, skeleton_from_json, skeleton_to_json
from fgpose.trajectory import Convergence, Status, Trajectory

LENGTHS = ("bone_lengths_m", "bone_length_sigma_m")
"""What is described of the bone lengths."""


def describe(trajectory: Trajectory) -> dict[str, str]:
    """Texts from which described() restores all of a trajectory but its arrays over time: JSON, the config as TOML."""
    texts = {
        "skeleton": skeleton_to_json(trajectory.skeleton),
        "camera_names": json.dumps(trajectory.camera_names),
    }
    for name in LENGTHS:
        lengths_m = getattr(trajectory, name)
        if lengths_m is not None:
            texts[name] = json.dumps([_or_null(length_m) for length_m in lengths_m.tolist()])
    if trajectory.convergence is not None:
        convergence = dataclasses.asdict(trajectory.convergence)
        texts["convergence"] = json.dumps({name: _or_null(value) for name, value in convergence.items()})
    if trajectory.implausible_frames:
        texts["implausible_frames"] = json.dumps(trajectory.implausible_frames)
    if trajectory.config is not None:
        texts["config"] = config_to_toml(trajectory.config)
    return texts


def described(texts: dict[str, str]) -> dict[str, Any]:
    """The arguments of Trajectory that describe() wrote. A config of another version is left out with a warning.

    Raises:
        ValueError: a text is missing or not what describe() writes; the message names it.
    """
    missing = [name for name in ("skeleton", "camera_names") if name not in texts]
    if missing:
        raise ValueError(f"its {' and '.join(missing)} are missing: it was not written by fgpose, or lost them since")
    readers = {
        "skeleton": skeleton_from_json,
        "camera_names": lambda text: joint_names(parse_json(text)),
        **dict.fromkeys(LENGTHS, _lengths_from_json),
        "convergence": _convergence_or_none,
        "implausible_frames": lambda text: joint_indices(parse_json(text)),
        "config": _config_or_none,
    }
    values = {}
    for name, read in readers.items():
        if name in texts:
            try:
                values[name] = read(texts[name])
            except ValueError as error:
                raise ValueError(f"its {name} is damaged: {error}") from None
    return values


def status_named(name: str) -> Status:
    """The status that has this name in a file. Raises ValueError if there is none."""
    try:
        return Status[name.upper()]
    except KeyError:
        raise ValueError(f"{name!r} is none of {', '.join(status.name.lower() for status in Status)}") from None


def _table(text: str) -> dict[str, Any]:
    table = parse_json(text)
    if not isinstance(table, dict):
        raise ValueError("a table is needed")
    return table


def _lengths_from_json(text: str) -> Float[np.ndarray, " length"]:
    lengths_m = parse_json(text)
    if not isinstance(lengths_m, list):
        raise ValueError("a list of numbers is needed")
    return np.array([_number(length_m) for length_m in lengths_m], dtype=float)


def _convergence_or_none(text: str) -> Convergence | None:
    """As _config_or_none: another version may say more or less of it."""
    table, kinds = _table(text), typing.get_type_hints(Convergence)
    if set(table) != set(kinds):
        _warn("the convergence", f"it has {', '.join(table)}")
        return None
    values: dict[str, Any] = {name: _number(value) if kinds[name] is float else value for name, value in table.items()}
    wrong = [name for name, value in values.items() if type(value) is not kinds[name]]
    if wrong:
        raise ValueError(f"{wrong[0]} must be a {kinds[wrong[0]].__name__}, got {values[wrong[0]]!r}")
    return Convergence(**values)


def _config_or_none(text: str) -> Config | None:
    """A result outlives the version that made it: its numbers must stay readable when a parameter has been renamed."""
    try:
        return config_from_dict(parse_toml(text))
    except ValueError as error:
        _warn("the configuration", error)
        return None


def _warn(what: str, why: object) -> None:
    warnings.warn(f"{what} of another version of fgpose is left out: {why}", UserWarning, stacklevel=4)


def _or_null(value: Any) -> Any:
    # JSON has no NaN.
    return value if math.isfinite(value) else None


def _number(value: Any) -> float:
    """A number, NaN for null."""
    if value is None:
        return math.nan
    if type(value) not in (int, float) or abs(value) > sys.float_info.max:
        raise ValueError("a number or null is needed")
    return float(value)
