"""Damage to the members of npz and parquet files, and to the header and parameters of C3D."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from text_mutations import BYTES, ODD_VALUES, Rng, json_tree

_DTYPES = ("f2", "f8", ">f8", "i1", "i8", "u8", "?", "c16", "U3", "S3", "M8[s]", "m8[ms]", "O", "V4", "f4,i4")
_EXTREME_WORDS = (0, 1, 2, 127, 255, 256, 32767, 32768, 65535)


def _mutate_array(rng: Rng, array: np.ndarray) -> np.ndarray:
    match int(rng.integers(9)):
        case 0 | 1:
            return _retyped(array, str(rng.choice(_DTYPES)))
        case 2:
            return array.ravel()
        case 3:
            return array[None]
        case 4:
            return array[..., None]
        case 5:
            return array[:0] if array.ndim else np.array([])
        case 6:
            return array[1:] if array.ndim else array.ravel()[0:1]
        case 7:
            return array.T if array.ndim > 1 else np.array(None, dtype=float)
        case _:
            return _odd_entries(rng, array)


def _retyped(array: np.ndarray, dtype: str) -> np.ndarray:
    try:
        return array.astype(dtype)
    except (TypeError, ValueError):
        return np.zeros(array.shape, dtype)


def _odd_entries(rng: Rng, array: np.ndarray) -> np.ndarray:
    array = np.array(array)
    flat = array.reshape(-1)
    if array.dtype.kind == "f" and flat.size:
        flat[rng.integers(flat.size, size=3)] = rng.choice((np.nan, np.inf, -np.inf, -1.0, 1e300), 3)
    elif array.dtype.kind in "iu" and flat.size:
        flat[rng.integers(flat.size)] = int(rng.choice((0, 5, 100)))
    elif array.dtype.kind == "U" and array.ndim == 0:
        return np.array(json_tree(rng, str(array).encode()).decode())
    elif array.dtype.kind == "U" and flat.size:
        flat[rng.integers(flat.size)] = str(rng.choice(("", "x", "x" * 100_000, "\x00a", flat[0])))
    return array


def npz_members(rng: Rng, data: bytes) -> bytes:
    try:
        arrays = dict(np.load(io.BytesIO(data)))
    except Exception:  # an earlier mutation broke it
        return data
    names = sorted(arrays)
    name, other = (names[int(i)] for i in rng.integers(0, len(names), 2))
    match int(rng.integers(6)):
        case 0:
            del arrays[name]
        case 1:
            arrays[f"{name}_"] = arrays.pop(name)
        case 2:
            arrays[name], arrays[other] = arrays[other], arrays[name]
        case _:
            arrays[name] = _mutate_array(rng, arrays[name])
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def npz_headers(rng: Rng, data: bytes) -> bytes:
    """What a member says of itself is changed; the archive around it is sound."""
    stream = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(stream, "w") as target:
            chosen = int(rng.integers(len(source.namelist())))
            for index, name in enumerate(source.namelist()):
                content = source.read(name)
                if index == chosen:
                    content = _lying(rng, content)
                target.writestr(name, content, int(rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))))
    except Exception:  # an earlier mutation broke it
        return data
    return stream.getvalue()


def _lying(rng: Rng, content: bytes) -> bytes:
    shapes = (b"(-1,)", b"(10000000000, 1000000)", b"(0, 1000000000000)", b"(3, 3, 3)", b"()", b"((((", b"(1e9,)")
    types = (b"'<f8'", b"'|O'", b"'<U999999999'", b"'<U0'", b"[('a', '<f8')]", b"'nonsense'", b"1", b"'<f16'")
    match int(rng.integers(4)):
        case 0:
            return re.sub(rb"\([\d, ]*\)", shapes[int(rng.integers(len(shapes)))], content, count=1)
        case 1:
            return re.sub(rb"'[<|>][a-zA-Z]\d+'", types[int(rng.integers(len(types)))], content, count=1)
        case 2:
            return content[:128] if rng.random() < 0.5 else content + b"\x00" * 8
        case _:
            header = bytearray(content)
            header[int(rng.integers(min(len(header), 128)))] = int(rng.integers(256))
            return bytes(header)


def parquet_columns(rng: Rng, data: bytes) -> bytes:
    try:
        table = pq.read_table(io.BytesIO(data))
        table = _mutate_table(rng, table)
    except (pa.ArrowException, OSError, KeyError):
        return data
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def _mutate_table(rng: Rng, table: pa.Table) -> pa.Table:
    index = int(rng.integers(table.num_columns))
    name = table.column_names[index]
    match int(rng.integers(8)):
        case 0:
            return table.drop_columns([name])
        case 1:
            return table.rename_columns([f"{each}_" if each == name else each for each in table.column_names])
        case 2:
            other = int(rng.integers(table.num_columns))
            return table.set_column(index, name, table.column(other))
        case 3:
            return table.slice(int(rng.integers(3)), int(rng.integers(table.num_rows + 1)))
        case 4:
            return table.append_column(name, table.column(index))
        case 5:
            return pa.concat_tables([table, table.slice(0, int(rng.integers(table.num_rows)))])
        case _:
            return table.set_column(index, name, _odd_column(rng, table.num_rows))


def _odd_column(rng: Rng, n_rows: int) -> pa.Array:
    columns = (
        pa.nulls(n_rows),
        pa.array(["x"] * n_rows),
        pa.array([b"\xff"] * n_rows),
        pa.array([[1.0, 2.0]] * n_rows),
        pa.array([{"a": 1}] * n_rows),
        pa.array([True] * n_rows),
        pa.array(np.arange(n_rows), pa.timestamp("us")),
        pa.array([float("inf"), *[None] * (n_rows - 1)], pa.float64()),
        pa.array([2**63 - 1] * n_rows),
        pa.array([None, *["nose"] * (n_rows - 1)]).dictionary_encode(),
    )
    return columns[int(rng.integers(len(columns)))]


def parquet_metadata(rng: Rng, data: bytes) -> bytes:
    try:
        table = pq.read_table(io.BytesIO(data))
    except (pa.ArrowException, OSError):
        return data
    metadata = dict(table.schema.metadata or {})
    keys = sorted(metadata) or [b"fgpose.skeleton"]
    key = keys[int(rng.integers(len(keys)))]
    text = metadata.pop(key, b"")
    match int(rng.integers(4)):
        case 0:
            metadata[key] = json_tree(rng, text)
        case 1:
            metadata[key] = json.dumps(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]).encode()
        case 2:
            metadata[key] = BYTES[str(rng.choice(sorted(BYTES)))](rng, text) if text else b"\xff"
    stream = io.BytesIO()
    pq.write_table(table.replace_schema_metadata(metadata), stream)
    return stream.getvalue()


def c3d_header(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 2, 4)))):
        word = int(rng.integers(0, 12))
        if len(changed) >= 24:
            struct.pack_into("<H", changed, 2 * word, int(rng.choice(_EXTREME_WORDS)))
    return bytes(changed)


def c3d_parameters(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 2, 8)))):
        place = 512 + int(rng.integers(0, 1500))
        if place < len(changed):
            changed[place] = int(rng.choice((0, 1, 2, 127, 128, 254, 255)))
    return bytes(changed)
