"""Pickles of plain values, NumPy arrays and tensors of torch, and the object arrays of .npy files, which are pickles,
read without running what else a pickle may contain."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tokenize import TokenError
from typing import Any, Literal

import numpy as np

from fgpose.io.tensors import ELEMENT_TYPES, Storage, StorageOf, Tensor, parameter, plain_size, stated_storage
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
            # What np.save makes of a dictionary, or of a list of them.
            objects = np.empty(len(data), dtype=object)
            for place, each in enumerate(data):
                objects[place] = _resolved(each)
            self.array = objects.reshape(shape, order="F" if is_fortran else "C")


def _plain(dtype: _Dtype) -> np.dtype:
    if dtype.dtype.hasobject:
        raise pickle.UnpicklingError("it has an array of objects in it")
    return dtype.dtype


def _from_bytes(data: bytes | bytearray, dtype: _Dtype, shape: tuple[int, ...], order: Literal["C", "F"]) -> np.ndarray:
    # Not copied: a pickle of some bytes can name them many times.
    return np.frombuffer(data, _plain(dtype)).reshape(shape, order=order)


def _scalar(dtype: _Dtype, data: bytes) -> Any:
    return np.frombuffer(data, _plain(dtype))[0]


def _latin1_bytes(text: str, encoding: str) -> bytes:
    """Bytes as protocol 2 writes them."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes bytes as {encoding!r}")
    return text.encode("latin1")


def _new_array(*_: Any) -> _Array:
    return _Array()


_TORCH_MAGIC_NUMBER = 0x1950A86A20F9469CFC6C
_COUNT_BYTES = 8  # a number of elements stands before those of each storage


def _torch_stream(content: bytes) -> Any:
    """What torch wrote before version 1.6, and writes into pickles of tensors: pickles one after the other (a magic
    number, a version, the system, the content, the names of the storages), then the numbers of the storages."""
    file, storages = io.BytesIO(content), {}

    def storage(pid: Any) -> Storage:
        key, stated = stated_storage(pid)
        return storages.setdefault(key, stated)

    if _Unpickler(file).load() != _TORCH_MAGIC_NUMBER:
        raise pickle.UnpicklingError("it is no file of torch")
    for _ in ("version", "system"):
        _Unpickler(file).load()
    found = _Unpickler(file, storage).load()
    for key in _Unpickler(file).load():
        file.read(_COUNT_BYTES)
        storages[key].fill(file.read(max(storages[key].n_bytes, 0)))
    return found


_OF_TORCH = {
    ("torch", "Size"): plain_size,
    ("torch._utils", "_rebuild_tensor"): Tensor,
    ("torch._utils", "_rebuild_tensor_v2"): Tensor,
    ("torch._utils", "_rebuild_parameter"): parameter,
    ("torch.storage", "_load_from_bytes"): _torch_stream,
}


class _Unpickler(pickle.Unpickler):
    """Reads only plain values, arrays and tensors: a pickle may call whatever find_class returns.

    It does not return NumPy's and torch's own functions either: some of them trust the sizes that a file states.
    """

    def __init__(self, file: io.BufferedIOBase, storage: StorageOf | None = None) -> None:
        super().__init__(file)
        self._storage = storage

    def persistent_load(self, pid: Any) -> Any:
        if self._storage is None:
            raise pickle.UnpicklingError("it refers to something outside")
        return self._storage(pid)

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        match module_name, global_name:
            case "numpy", "dtype":
                return _Dtype
            case "numpy", "ndarray":
                return _Array
            case "_codecs", "encode":
                return _latin1_bytes
            case "collections", "OrderedDict":
                return dict
            case "torch", _ if global_name in ELEMENT_TYPES:
                return ELEMENT_TYPES[global_name]
        if (module_name, global_name) in _OF_TORCH:
            return _OF_TORCH[module_name, global_name]
        rebuilders = {"_reconstruct": _new_array, "_frombuffer": _from_bytes, "scalar": _scalar}
        if module_name in _MODULES and global_name in rebuilders:
            return rebuilders[global_name]
        raise pickle.UnpicklingError(
            f"it wants to use {module_name}.{global_name}, which is no array or tensor and might run anything; it was "
            "not loaded"
        )


def _resolved(value: Any, known: dict[int, Any] | None = None) -> Any:
    """Plain values with the arrays in them, which are complete once everything is read.

    What is there many times is resolved once: lists of twice the same list, some dozen deep, would take for ever.
    """
    known = {} if known is None else known
    if id(value) not in known:
        match value:
            case _Array() | Tensor():
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
    with open_plain(path) as file, _damage("a readable .npy file of a dictionary", f"{path}: "):
        content = _read(file)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: a dictionary saved with np.save is needed, it holds {type(content).__name__}")
    return content


def unpickled(content: bytes, storage: StorageOf | None = None) -> Any:
    """What a pickle holds: plain values and arrays, which must not be changed; tensors of torch as arrays.

    Args:
        content: the pickle.
        storage: gives the numbers of the tensors of a file of torch, which are not in its pickle.

    Raises:
        ValueError: it is no pickle, is damaged, or wants more than arrays, tensors and plain values.
    """
    with _damage("a readable pickle"):
        return _resolved(_Unpickler(io.BytesIO(content), storage).load())


def unpickled_stream(content: bytes) -> Any:
    """What a file holds that torch wrote before version 1.6; as unpickled."""
    with _damage("a readable file of torch"):
        return _resolved(_torch_stream(content))


def unpickled_npy(content: bytes) -> Any:
    """What np.save made of a dictionary or a list of them, alone or in an npz: plain values and arrays. Raises as
    unpickled."""
    with _damage("a readable array of objects"):
        return _read(io.BytesIO(content), any_shape=True)


@contextmanager
def _damage(instead_of: str, file: str = "") -> Iterator[None]:
    """Unpickling: what is refused or damaged is a ValueError, after the name of the file if it is given."""
    try:
        yield
    except pickle.UnpicklingError as error:
        raise ValueError(f"{file}not safe to load, or damaged: {error}") from None
    except _DAMAGE as error:
        raise ValueError(f"{file}not {instead_of}: {error}") from None


def _read(file: io.BufferedIOBase, any_shape: bool = False) -> Any:
    version = np.lib.format.read_magic(file)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"version {version} of the format holds no dictionary")
    shape, _, dtype = read_header(file)
    if not dtype.hasobject or (shape != () and not any_shape):
        raise ValueError(f"it holds an array of {dtype} with shape {shape}")
    content = _resolved(_Unpickler(file).load())
    is_of_objects = isinstance(content, np.ndarray) and content.dtype == object
    return content.tolist() if is_of_objects else content
