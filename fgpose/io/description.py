"""What a result file says of itself beside its numbers: skeleton, cameras, bone lengths, convergence, configuration."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
import warnings
from typing import Any

import numpy as np

from fgpose.config import Config, config_from_dict, config_to_toml
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Trajectory


def describe(trajectory: Trajectory) -> dict[str, str]:
    """Texts from which described() restores all of a trajectory but its arrays over time: JSON, the config as TOML."""
    texts = {
        "skeleton": _skeleton_to_json(trajectory.skeleton),
        "camera_names": json.dumps(trajectory.camera_names),
    }
    if trajectory.bone_lengths_m is not None:
        texts["bone_lengths_m"] = json.dumps([_or_null(length_m) for length_m in trajectory.bone_lengths_m.tolist()])
    if trajectory.convergence is not None:
        convergence = dataclasses.asdict(trajectory.convergence)
        texts["convergence"] = json.dumps({name: _or_null(value) for name, value in convergence.items()})
    if trajectory.config is not None:
        texts["config"] = config_to_toml(trajectory.config)
    return texts


def described(texts: dict[str, str]) -> dict[str, Any]:
    """The arguments of Trajectory that describe() wrote. A config of another version is left out with a warning.

    Raises:
        ValueError: a text is not what describe() writes.
        KeyError: the skeleton or the cameras are missing.
    """
    values: dict[str, Any] = {
        "skeleton": _skeleton_from_json(texts["skeleton"]),
        "camera_names": tuple(json.loads(texts["camera_names"])),
    }
    if "bone_lengths_m" in texts:
        values["bone_lengths_m"] = np.array([_or_nan(length_m) for length_m in json.loads(texts["bone_lengths_m"])])
    if "convergence" in texts:
        convergence: dict[str, Any] = json.loads(texts["convergence"])
        values["convergence"] = Convergence(**{name: _or_nan(value) for name, value in convergence.items()})
    if "config" in texts:
        values["config"] = _config_or_none(texts["config"])
    return values


def _skeleton_to_json(skeleton: Skeleton) -> str:
    return json.dumps(
        {field.name: getattr(skeleton, field.name) for field in dataclasses.fields(Skeleton) if field.init}
    )


def _skeleton_from_json(text: str) -> Skeleton:
    table = json.loads(text)
    pairs = {
        name: tuple((int(a), int(b)) for a, b in table[name]) for name in ("bones", "left_right", "limbs", "lines")
    }
    return Skeleton(table["name"], joints=tuple(table["joints"]), root=tuple(table["root"]), **pairs)


def _config_or_none(text: str) -> Config | None:
    """A result outlives the version that made it: its numbers must stay readable when a parameter has been renamed."""
    try:
        return config_from_dict(tomllib.loads(text))
    except ValueError as error:
        warnings.warn(f"the configuration of another version of fgpose is left out: {error}", UserWarning, stacklevel=2)
        return None


def _or_null(value: Any) -> Any:
    # JSON has no NaN.
    return value if math.isfinite(value) else None


def _or_nan(value: Any) -> Any:
    return math.nan if value is None else value
