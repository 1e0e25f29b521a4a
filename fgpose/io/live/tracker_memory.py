"""What a tracker knows of people and clocks, in a file from which the next one goes on: plain numbers as JSON."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from fgpose.config import Config, MonocularConfig, config_to_toml
from fgpose.geometry.camera import CameraRig
from fgpose.io.atomic import write_text
from fgpose.io.content import converted, parse_json, read_content
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

FORMAT = "fgpose tracker memory 1"
_MAX_BYTES = 64_000_000
_PARTS = {"rig": "rig", "skeleton": "skeleton", "config": "configuration"}

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class RememberedPerson:
    """Somebody who was there when it was written, or was lost not long before."""

    person: int
    begin_s: float
    """When they came, Unix time."""
    begin_m: Numbers
    """(3,) where, in the world frame."""
    end_s: float
    end_m: Numbers
    """When they were last seen, and where."""
    length_n: Numbers
    length_information: Numbers
    length_m: Numbers
    length_squares: Numbers
    """(L,) of each length of the skeleton: samples, information in 1/m^2, mean, and sum of the squared deviations over
    their variances."""
    n_length_periods: int
    """In so many periods they were measured."""
    n_looks: int
    looks: Numbers
    """In so many periods; (D,) sum of appearance vectors, empty where there are none."""
    bone_lengths_m: Numbers
    bone_length_sigma_m: Numbers
    """(L,) as the estimator has learned them, and standard deviations; both 0 where one is not known."""


@dataclass(frozen=True)
class RememberedSimilarity:
    """How alike appearance vectors are, see Samples."""

    n: int
    n_sources: int
    mean: float
    variance: float


@dataclass(frozen=True)
class TrackerMemory:
    """Who was there, and what their motion has told."""

    time_s: float
    """When the newest image was taken that was used, Unix time."""
    n_people: int
    """So many numbers were given."""
    people: tuple[RememberedPerson, ...]
    same: RememberedSimilarity
    different: RememberedSimilarity
    offset_information: tuple[Numbers, ...]
    """(C, C) 1/s^2 of the time offsets of the cameras, in the order of the rig."""
    offset_moment: Numbers
    """(C,) 1/s."""


@dataclass(frozen=True)
class _File:
    format: str
    rig: str
    skeleton: str
    config: str
    memory: TrackerMemory


def save_memory(memory: TrackerMemory, path: Path, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
    """Replace the file, whole or not at all. Raises OSError if it cannot be written; the message names it."""
    write_text(path, json.dumps(asdict(_File(FORMAT, **_made_for(rig, skeleton, config), memory=memory))))


def load_memory(path: Path, rig: CameraRig, skeleton: Skeleton, config: Config) -> TrackerMemory:
    """Read what save_memory has written for the same cameras, skeleton and parameters.

    Raises:
        ValueError: it is another file, is damaged, or was written for others; the message names the file.
        OSError: it cannot be read.
    """
    with naming(path):
        content = read_content(path, _MAX_BYTES)
        try:
            table = parse_json(content)
        except ValueError as error:
            raise ValueError(f"it is damaged, or no JSON ({error}): choose a new file, or remove this one") from None
        if not isinstance(table, dict) or table.get("format") != FORMAT:
            raise ValueError(f"it is no file of format {FORMAT!r}")
        file: _File = converted(_File, table, "memory")
        others = [_PARTS[name] for name, own in _made_for(rig, skeleton, config).items() if getattr(file, name) != own]
        if others:
            raise ValueError(f"it was written with another {' and another '.join(others)}; choose a new file")
        memory = file.memory
        _check_lengths(memory, rig.n_cameras, skeleton.n_lengths)
    return memory


def _made_for(rig: CameraRig, skeleton: Skeleton, config: Config) -> dict[str, str]:
    cameras = [(camera.name, camera.world_T_camera.tolist()) for camera in rig.cameras]
    body = [skeleton.name, *skeleton.joints, [list(bone) for bone in skeleton.bones], list(skeleton.length_of_bone)]
    # What is remembered does not depend on where networks run.
    used = config_to_toml(config.replace(monocular=MonocularConfig()))
    return {"rig": _digest(cameras), "skeleton": _digest(body), "config": _digest(used)}


def _digest(document: object) -> str:
    return hashlib.blake2b(json.dumps(document, default=int).encode(), digest_size=8).hexdigest()


def _check_lengths(memory: TrackerMemory, n_cameras: int, n_lengths: int) -> None:
    """Raises ValueError."""
    of_cameras = [memory.offset_moment, memory.offset_information, *memory.offset_information]
    if any(len(each) != n_cameras for each in of_cameras):
        raise ValueError(f"memory.offset_*: numbers of {n_cameras} cameras are needed")
    for somebody in memory.people:
        measured = somebody.length_n, somebody.length_information, somebody.length_m, somebody.length_squares
        lengths = *measured, somebody.bone_lengths_m, somebody.bone_length_sigma_m
        if any(len(each) != n_lengths for each in lengths) or len(somebody.begin_m) != 3 or len(somebody.end_m) != 3:
            raise ValueError(f"memory.people: person {somebody.person} has not {n_lengths} lengths and two places")
        bones = zip(somebody.bone_lengths_m, somebody.bone_length_sigma_m, strict=True)
        if not all((length_m > 0 and sigma_m > 0) or length_m == 0 for length_m, sigma_m in bones):
            raise ValueError(f"memory.people: person {somebody.person} has a bone length that is none")
