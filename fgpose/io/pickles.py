"""Pickles of plain values and NumPy arrays, and the object arrays of .npy files, which are pickles, read without
running what else a pickle may contain."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, Literal

import numpy as np

from fgpose.plain_files import open_plain

# Which of them a damaged pickle raises depends on the byte that is wrong.
_DAMAGE = (
    ValueError,
    TypeError,
    LookupError,
    EOFError,
    AttributeError,
    MemoryError,
    ArithmeticError,
    RuntimeError,
    ImportError,
    SyntaxError,
    TokenError,
)
_MODULES = ("numpy.core.multiarray", "numpy.core.numeric", "numpy._core.multiarray", "numpy._core.numeric")


class _Dtype:
    """A dtype from its state in the pickle, without the flags, which say how NumPy treats the memory of its items."""

    def __init__(self, code: str, align: bool = False, copy: bool = True) -> None:
        self.dtype = np.dtype(str(code))

    def __setstate__(self, state: tuple) -> None:
        _, byte_order, sub_array, names, fields, size, *_ = state
        if sub_array is not None:
            base, shape = sub_array
            self.dtype = np.dtype((_plain(base), shape))
        elif names is not None:
            formats, offsets = [_plain(fields[name][0]) for name in names], [fields[name][1] for name in names]
            self.dtype = np.dtype({"names": list(names), "formats": formats, "offsets": offsets, "itemsize": size})
        elif byte_order in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(byte_order)


class _Array:
    """An array from its state in the pickle."""

    array: np.ndarray

    def __setstate__(self, state: tuple) -> None:
        _, shape, dtype, is_fortran, data = state
        if isinstance(data, bytes | bytearray):
            self.array = _from_bytes(data, dtype, shape, "F" if is_fortran else "C")
        else:
            # Only what np.save makes of a dictionary: one object, without a shape.
            (content,) = data
            self.array = np.empty((), dtype=object)
            self.array[()] = _resolved(content)


def _plain(dtype: _Dtype) -> np.dtype:
    if dtype.dtype.hasobject:
        raise pickle.UnpicklingError("it has an array of objects in it")
    return dtype.dtype


def _from_bytes(data: bytes | bytearray, dtype: _Dtype, shape: tuple[int, ...], order: Literal["C", "F"]) -> np.ndarray:
    return np.frombuffer(data, _plain(dtype)).reshape(shape, order=order).copy(order)


def _scalar(dtype: _Dtype, data: bytes) -> Any:
    return np.frombuffer(data, _plain(dtype))[0]


def _latin1_bytes(text: str, encoding: str) -> bytes:
    """Bytes as protocol 2 writes them."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes bytes as {encoding!r}")
    return text.encode("latin1")


def _new_array(*_: Any) -> _Array:
    return _Array()


class _NumpyUnpickler(pickle.Unpickler):
    """Reads only plain values and arrays: a pickle may call whatever find_class returns.

    It does not return NumPy's own functions either: some of them trust the sizes that a file states.
    """

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        match module_name, global_name:
            case "numpy", "dtype":
                return _Dtype
            case "numpy", "ndarray":
                return _Array
            case "_codecs", "encode":
                return _latin1_bytes
        rebuilders = {"_reconstruct": _new_array, "_frombuffer": _from_bytes, "scalar": _scalar}
        if module_name in _MODULES and global_name in rebuilders:
            return rebuilders[global_name]
        raise pickle.UnpicklingError(
            f"it wants to use {module_name}.{global_name}, which is no array and might run anything; it was not loaded"
        )


def _resolved(value: Any, known: dict[int, Any] | None = None) -> Any:
    """Plain values with the arrays in them, which are complete once everything is read.

    What is there many times is resolved once: lists of twice the same list, some dozen deep, would take for ever.
    """
    known = {} if known is None else known
    if id(value) not in known:
        match value:
            case _Array():
                return value.array
            case dict():
                found = {key: _resolved(each, known) for key, each in value.items()}
            case list():
                found = [_resolved(each, known) for each in value]
            case tuple():
                found = tuple(_resolved(each, known) for each in value)
            case _:
                return value
        known[id(value)] = found
    return known[id(value)]


def read_dictionary(path: Path) -> dict[str, Any]:
    """The dictionary that somebody saved with np.save.

    Raises:
        ValueError: the file is no .npy, is damaged, holds something else, or its pickle wants more than NumPy arrays
            and plain values. The message names the file.
        OSError: it cannot be opened.
    """
    with open_plain(path) as file:
        try:
            content = _read(file)
        except pickle.UnpicklingError as error:
            raise ValueError(f"{path}: not safe to load, or damaged: {error}") from None
        except _DAMAGE as error:
            raise ValueError(f"{path}: not a readable .npy file of a dictionary: {error}") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path}: a dictionary saved with np.save is needed, it holds {type(content).__name__}")
    return content


def unpickled(content: bytes) -> Any:
    """What a pickle holds.

    Raises:
        ValueError: it is no pickle, is damaged, or wants more than NumPy arrays and plain values.
    """
    try:
        return _resolved(_NumpyUnpickler(io.BytesIO(content)).load())
    except pickle.UnpicklingError as error:
        raise ValueError(f"not safe to load, or damaged: {error}") from None
    except _DAMAGE as error:
        raise ValueError(f"not a readable pickle: {error}") from None


def _read(file: BinaryIO) -> Any:
    version = np.lib.format.read_magic(file)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"version {version} of the format holds no dictionary")
    shape, _, dtype = read_header(file)
    if not dtype.hasobject or shape != ():
        raise ValueError(f"it holds an array of {dtype} with shape {shape}")
    content = _resolved(_NumpyUnpickler(file).load())
    return content.item() if isinstance(content, np.ndarray) and content.shape == () else content
