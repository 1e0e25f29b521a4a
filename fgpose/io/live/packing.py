"""Documents with arrays as MessagePack: an array is a map of its shape, its type and its bytes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fgpose.io.content import damage

_ARRAY_KEYS = {"shape", "dtype", "data"}
_DTYPES = ("<f4", "<f8", "<i8", "|u1")


def packed(document: Any) -> bytes:
    """A document of maps, lists, texts, numbers and arrays. An array of numbers that single precision holds exactly
    takes four bytes for each, any other eight.

    Raises:
        ImportError: MessagePack is not installed.
    """
    return _msgpack().packb(document, default=_array_as_map)


def unpacked(body: bytes | memoryview) -> Any:
    """The document; its arrays cannot be written to.

    Raises:
        ValueError: the bytes are no such document.
        ImportError: MessagePack is not installed.
    """
    msgpack = _msgpack()
    with damage("not a MessagePack document"):
        return msgpack.unpackb(body, object_hook=_map_as_array)


def _msgpack() -> Any:
    try:
        import msgpack
    except ImportError:
        raise ImportError("messages and live recordings need msgpack: pip install 'fgpose[live]'") from None
    return msgpack


def _array_as_map(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if not isinstance(value, np.ndarray):
        raise TypeError(f"a {type(value).__name__} cannot be packed")
    array = _smallest(value)
    return {"shape": array.shape, "dtype": array.dtype.str, "data": array.tobytes()}


def _smallest(array: np.ndarray) -> np.ndarray:
    """Of the types that a document may have, the smallest that holds every number exactly."""
    if array.dtype.str in ("<f4", "|u1"):
        return array
    if array.dtype.kind in "iub":
        return array.astype("<i8")
    with np.errstate(over="ignore"):
        single = array.astype("<f4")
    return single if ((single == array) | np.isnan(array)).all() else array.astype("<f8")


def _map_as_array(document: dict[str, Any]) -> Any:
    if document.keys() != _ARRAY_KEYS:
        return document
    shape, dtype, data = (document[key] for key in ("shape", "dtype", "data"))
    if dtype not in _DTYPES:
        raise ValueError(f"an array of type {dtype!r:.40}; possible are {', '.join(_DTYPES)}")
    if not isinstance(shape, list) or not all(isinstance(length, int) and length >= 0 for length in shape):
        raise ValueError("the shape of an array must be a list of lengths")
    if not isinstance(data, bytes) or math.prod(shape) * np.dtype(dtype).itemsize != len(data):
        raise ValueError(f"an array of shape {tuple(shape)} and type {dtype} has another number of bytes")
    return np.frombuffer(data, dtype).reshape(shape)
