"""Files of what a network has found, as plain values and arrays: npz, JSON, pickles, files of torch. Nothing in them is
run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.arrays import array_names, opened_archive, read_arrays
from fgpose.io.content import first_bytes, parse_json, read_content
from fgpose.io.pickles import unpickled, unpickled_npy
from fgpose.io.torch_files import read_torch
from fgpose.plain_files import check_expansion, max_file_bytes

_PICKLES, _TORCH = (".pkl", ".pickle"), (".pt", ".pth")
# How names of other programs end, beside keypoints: OpenCap's cameras, what DeepLabCut leaves beside its tables.
_OTHER_PICKLES = ("cameraIntrinsicsExtrinsics.pickle", "_meta.pickle", "_full.pickle", "_assemblies.pickle")
_HEADER_BYTES = 128
_OBJECTS = b"'descr': '|O'"
# What only a member of an npz or a key of a document says: of these programs, in a world of their own.
_IN_OWN_WORLDS = {
    "GVHMR": ("smpl_params_global", "smpl_params_incam"),
    "WHAM": ("trans_world", "pose_world"),
    "TRAM": ("pred_rotmat", "pred_trans"),
}
_MARKS_OF_WORLDS = tuple(mark for marks in _IN_OWN_WORLDS.values() for mark in marks)
_DEEPEST = 2  # people by number in an array of objects
_JOBLIB = b"joblib.numpy_pickle"


def is_document_of_network(path: Path, of_arrays: Sequence[str]) -> bool:
    """Whether a file may hold what a network has found: of JSON and npz by the names in it.

    Raises:
        ValueError: an npz is damaged; the caller names it.
        OSError: it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        names = array_names(path)
        return not names.isdisjoint(of_arrays) or _world_of(names) is not None or bool(_objects(path))
    if suffix == ".json":
        content = read_content(path)
        return any(f'"{name}"'.encode() in content for name in (*of_arrays, *_MARKS_OF_WORLDS))
    if suffix == ".npy":
        return _OBJECTS in first_bytes(path, _HEADER_BYTES)
    return suffix in _TORCH or (suffix in _PICKLES and not path.name.endswith(_OTHER_PICKLES))


def read_document(path: Path, of_arrays: Sequence[str]) -> Any:
    """What a file holds, of an npz the arrays of these names, or the objects that it has in place of arrays.

    Raises:
        ValueError: it is damaged, wants to run something, or is of a network whose people stand in a world of its own;
            the caller names it.
        OSError: it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        refuse_own_world(dict.fromkeys(array_names(path)))
        arrays = read_arrays(path, of_arrays)
        return arrays if arrays else _read_objects(path)
    if suffix == ".json":
        return parse_json(read_content(path))
    content = read_content(path, max_file_bytes())
    world = _world_of(name for name in _MARKS_OF_WORLDS if name.encode() in content)
    if world:
        raise ValueError(_refusal(world))
    if suffix == ".npy":
        return unpickled_npy(content)
    if suffix in _TORCH:
        return read_torch(path)
    if _JOBLIB in content:
        raise ValueError("written by joblib; save it with pickle.dump, or the arrays with np.savez")
    return unpickled(content)


def refuse_own_world(document: Any) -> None:
    """Raise ValueError if a document is of a network that puts people into a world of its own."""
    if world := _world_in(document, _DEEPEST):
        raise ValueError(_refusal(world))


def _world_in(document: Any, deepest: int) -> str | None:
    parts = document.values() if isinstance(document, Mapping) else document if isinstance(document, list) else ()
    found = _world_of(document) if isinstance(document, Mapping) else None
    if found or not deepest:
        return found
    return next((each for part in parts if (each := _world_in(part, deepest - 1))), None)


def _world_of(names: Any) -> str | None:
    given = set(names)
    return next((world for world, marks in _IN_OWN_WORLDS.items() if given.issuperset(marks)), None)


def _refusal(world: str) -> str:
    return (
        f"of {world}, which gives a body model in a world of its own: it has no joints that one calibrated camera sees "
        "by itself. Give what SAM 3D Body, NLF or MeTRAbs found in the images"
    )


def _objects(path: Path) -> list[str]:
    """Members of an npz that are no plain arrays."""
    with opened_archive(path) as archive:
        members = [member.filename for member in archive.infolist() if member.filename.endswith(".npy")]
        return [name for name in members if _OBJECTS in archive.open(name).read(_HEADER_BYTES)]


def _read_objects(path: Path) -> Any:
    names, of_bytes = _objects(path), path.stat().st_size
    with opened_archive(path) as archive:
        check_expansion(sum(archive.getinfo(name).file_size for name in names), of_bytes)
        contents = {name.removesuffix(".npy"): archive.read(name) for name in names}
    return {name: unpickled_npy(content) for name, content in contents.items()}


def as_array(value: Any) -> np.ndarray | None:
    """An array of numbers; None for anything else, also for lists of unequal length."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        return None
    if array.dtype.kind == "O" and array.size:
        try:
            return array.astype(float)  # lists with null are objects
        except (ValueError, TypeError, OverflowError):
            return None
    return array if array.dtype.kind in "fiu" else None
