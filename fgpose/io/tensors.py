"""Tensors of torch, from their storages; torch itself is not needed."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

_BFLOAT16 = "bfloat16"
ELEMENT_TYPES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "BFloat16Storage": _BFLOAT16,
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "<i1",
    "ByteStorage": "<u1",
    "BoolStorage": "?",
}
"""Of the storages by their names in torch: NumPy's code of an element."""
# A number that is expanded to a tensor takes no memory in the file.
_MAX_EXPANDED = 1_000_000


@dataclass
class Storage:
    """The numbers that tensors share, one after the other."""

    code: str
    """Of ELEMENT_TYPES."""
    n_elements: int
    content: bytes | None = None
    """None until it is read."""

    def fill(self, content: bytes) -> None:
        """Take its elements from the beginning of these bytes. Raises pickle.UnpicklingError if they are too few."""
        n_bytes = self.n_bytes
        if not 0 <= n_bytes <= len(content):
            raise pickle.UnpicklingError(f"of the {self.n_elements} numbers of a tensor there are {len(content)} bytes")
        self.content = content[:n_bytes]

    @property
    def n_bytes(self) -> int:
        return self.n_elements * (2 if self.code == _BFLOAT16 else np.dtype(self.code).itemsize)

    @cached_property
    def numbers(self) -> np.ndarray:
        if self.content is None:
            raise pickle.UnpicklingError("the numbers of a tensor are missing")
        if self.code != _BFLOAT16:
            return np.frombuffer(self.content, self.code)
        upper_half = np.frombuffer(self.content, "<u2").astype(np.uint32)
        return (upper_half << 16).view(np.float32)


StorageOf = Callable[[Any], Storage]
"""The storage that a pickle of torch refers to. Raises pickle.UnpicklingError for anything else."""


def stated_storage(pid: Any) -> tuple[str, Storage]:
    """The name of a storage that a pickle of torch refers to, and what it says of it. Raises as StorageOf."""
    match pid:
        case ("storage", str(code), str(key), _, int(n_elements), *_) if code in ELEMENT_TYPES.values():
            return key, Storage(code, n_elements)
    raise pickle.UnpicklingError("it refers to something that is no storage of a tensor")


class Tensor:
    """A view of a storage, as torch's pickles say it."""

    def __init__(self, storage: Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> None:
        self._storage, self._offset, self._size, self._stride = storage, offset, tuple(size), tuple(stride)

    @cached_property
    def array(self) -> np.ndarray:
        """Its numbers, not to be changed. Raises pickle.UnpicklingError unless they are all in the storage."""
        if not isinstance(self._storage, Storage):
            raise pickle.UnpicklingError("a tensor without a storage")
        given, n = self._storage.numbers, math.prod(self._size)
        if min((self._offset, *self._size, *self._stride)) < 0 or len(self._size) != len(self._stride):
            raise pickle.UnpicklingError(f"a tensor of size {self._size} with steps of {self._stride}")
        if n == 0:
            return np.empty(self._size, given.dtype)
        last = self._offset + sum((m - 1) * step for m, step in zip(self._size, self._stride, strict=True))
        if last >= len(given) or n > max(len(given), _MAX_EXPANDED):
            raise pickle.UnpicklingError(f"a tensor of size {self._size} of {len(given)} numbers")
        steps = [step * given.itemsize for step in self._stride]
        return np.lib.stride_tricks.as_strided(given[self._offset :], self._size, steps, writeable=False)


def parameter(tensor: Tensor, *_: Any) -> Tensor:
    """What torch pickles a parameter of a network as."""
    return tensor


def plain_size(size: Any = ()) -> tuple[int, ...]:
    """What torch pickles a size as."""
    return tuple(size)
