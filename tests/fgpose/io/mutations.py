"""Damage to files: bytes, text, the tree of a JSON or TOML document, members of npz and parquet, words of C3D."""

from __future__ import annotations

import copy
import io
import json
import re
import struct
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

Rng = np.random.Generator

_ODD_NUMBERS = (
    *("nan", "inf", "-inf", "NaN", "Infinity", "0", "-1", "-0.0", "1e308", "-1e308", "1e400", "1e-320", "2147483648"),
    *("9" * 20, "-" + "9" * 20, "9" * 400, "9" * 5000, "0x1F", "1_000", "true", "null", '""', "[]", "{}", "1,5", ""),
)
_ODD_TEXTS = ("[" * 100_000, "{" * 50_000, '{"a":' * 50_000, "a." * 20_000, "- " * 50_000, "<a>" * 100_000, "\x00", "�")
_ODD_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1.5, 10**400, -(10**19), 1e308, float("nan"), float("inf"), "", "x", "nan", "9" * 5000),
    *([], [[]], {}, {"a": 1}, [1, "a", None], [[1, 2], [3]], [[[[1.0]]]], [[None] * 3] * 3, "\x00", "ä" * 300),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w*")
_EXTREME_WORDS = (0, 1, 2, 127, 255, 256, 32767, 32768, 65535)
_DTYPES = ("f2", "f8", ">f8", "i1", "i8", "u8", "?", "c16", "U3", "S3", "M8[s]", "m8[ms]", "O", "V4", "f4,i4")


def mutate(rng: Rng, path: Path, kind: str) -> str:
    """Damage a file in one way, sometimes in two; returns the names of the ways."""
    ways = _WAYS.get(kind, {}) if rng.random() < 0.6 else _BYTES
    ways = ways or _BYTES
    done = []
    for _ in range(1 + (rng.random() < 0.2)):
        name = str(rng.choice(sorted(ways)))
        path.write_bytes(ways[name](rng, path.read_bytes()))
        done.append(name)
        ways = _BYTES
    return "+".join(done)


def _span(rng: Rng, data: bytes, longest: int = 64) -> tuple[int, int]:
    start = int(rng.integers(0, len(data) + 1))
    return start, min(start + int(rng.integers(1, longest)), len(data))


def _flip(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 2, 8, 64)))):
        if changed:
            changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _set_word(rng: Rng, data: bytes) -> bytes:
    """16 or 32 bits become an extreme number; more often near the ends of the file, where headers are."""
    size, value = int(rng.choice((1, 2, 4, 8))), int(rng.choice((0, 1, 127, 128, 255)))
    filled = bytes([value]) * size
    place = int(rng.integers(0, max(len(data) - size, 1)))
    if rng.random() < 0.6:
        place = min(place, int(rng.integers(0, 600)))
        place = place if rng.random() < 0.5 else max(len(data) - size - place, 0)
    return data[:place] + filled + data[place + size :]


def _truncate(rng: Rng, data: bytes) -> bytes:
    return data[: int(rng.integers(0, len(data) + 1))]


def _drop(rng: Rng, data: bytes) -> bytes:
    start, stop = _span(rng, data)
    return data[:start] + data[stop:]


def _repeat(rng: Rng, data: bytes) -> bytes:
    start, stop = _span(rng, data, 600)
    return data[:stop] + data[start:stop] * int(rng.choice((1, 2, 50))) + data[stop:]


def _blank(rng: Rng, data: bytes) -> bytes:
    start, stop = _span(rng, data, 600)
    return data[:start] + bytes([int(rng.choice((0, 32, 255)))]) * (stop - start) + data[stop:]


def _noise(rng: Rng, data: bytes) -> bytes:
    start, stop = _span(rng, data)
    return data[:start] + rng.bytes(int(rng.integers(1, 64))) + data[stop:]


def _swap(rng: Rng, data: bytes) -> bytes:
    a, b = sorted(int(place) for place in rng.integers(0, len(data) + 1, 2))
    return data[:a] + data[b:] + data[a:b]


def _empty(rng: Rng, data: bytes) -> bytes:
    return bytes(int(rng.choice((0, 1, 100))))


_BYTES: dict[str, Callable[[Rng, bytes], bytes]] = {
    **{"flip": _flip, "set word": _set_word, "truncate": _truncate, "drop": _drop, "repeat": _repeat},
    **{"blank": _blank, "noise": _noise, "swap": _swap, "empty": _empty},
}


def _replaced(rng: Rng, data: bytes, pattern: re.Pattern[bytes], other: Callable[[], bytes]) -> bytes:
    places = list(pattern.finditer(data))
    if not places:
        return data
    for place in sorted(rng.choice(len(places), min(int(rng.choice((1, 1, 3))), len(places)), replace=False))[::-1]:
        match = places[int(place)]
        data = data[: match.start()] + other() + data[match.end() :]
    return data


def _odd_number(rng: Rng, data: bytes) -> bytes:
    return _replaced(rng, data, _NUMBER, lambda: str(rng.choice(_ODD_NUMBERS)).encode())


def _other_word(rng: Rng, data: bytes) -> bytes:
    words = sorted(set(_WORD.findall(data))) or [b"x"]
    return _replaced(rng, data, _WORD, lambda: words[int(rng.integers(len(words)))])


def _nest(rng: Rng, data: bytes) -> bytes:
    places = [match.start() for match in _NUMBER.finditer(data)] or [0]
    place = int(rng.choice(places)) if rng.random() < 0.8 else 0
    return data[:place] + _ODD_TEXTS[int(rng.integers(len(_ODD_TEXTS)))].encode() + data[place:]


def _lines(rng: Rng, data: bytes) -> bytes:
    lines = data.split(b"\n")
    a, b = (int(i) for i in rng.integers(0, len(lines), 2))
    match int(rng.integers(3)):
        case 0:
            del lines[a]
        case 1:
            lines.insert(a, lines[b])
        case _:
            lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _encode(rng: Rng, data: bytes) -> bytes:
    return data.decode("utf-8", "replace").encode(
        str(rng.choice(("utf-16", "utf-8-sig", "utf-32", "cp037"))), "replace"
    )


_TEXT = {"odd number": _odd_number, "other word": _other_word, "nest": _nest, "lines": _lines, "encode": _encode}


def _places(node: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) of a document."""
    found, waiting = [], [node]
    while waiting:
        node = waiting.pop()
        children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, child in children:
            found.append((node, key))
            waiting.append(child)
    return found


def _mutate_tree(rng: Rng, document: Any) -> Any:
    root = {"root": document}
    # Few places of a recording are keys; the numbers would hide them.
    places = [place for place in _places(root) if isinstance(place[0], dict) or rng.random() < 0.1]
    for _ in range(int(rng.choice((1, 1, 2)))):
        container, key = places[int(rng.integers(len(places)))]
        if isinstance(container, dict) and key not in container:
            continue
        value = container[key]
        match int(rng.integers(6)):
            case 0 | 1:
                container[key] = copy.deepcopy(_ODD_VALUES[int(rng.integers(len(_ODD_VALUES)))])
            case 2:
                container[key] = [value]
            case 3:
                container[key] = value * 2 if isinstance(value, list | str) else [value, value]
            case 4:
                container[key] = value[:-1] if isinstance(value, list | str) else str(value)
            case _:
                if isinstance(container, dict) and container is not root:
                    del container[key]
                else:
                    container[key] = None
    return root.get("root")


def _json_tree(rng: Rng, data: bytes) -> bytes:
    try:
        return json.dumps(_mutate_tree(rng, json.loads(data))).encode()
    except (ValueError, RecursionError):
        return data


def _toml_tree(rng: Rng, data: bytes) -> bytes:
    try:
        return tomli_w.dumps(_mutate_tree(rng, tomllib.loads(data.decode()))).encode()
    except (ValueError, TypeError, AttributeError, RecursionError):
        return data


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
        return np.array(_json_tree(rng, str(array).encode()).decode())
    elif array.dtype.kind == "U" and flat.size:
        flat[rng.integers(flat.size)] = str(rng.choice(("", "x", "\x00a", flat[0])))
    return array


def _npz_members(rng: Rng, data: bytes) -> bytes:
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


def _npz_headers(rng: Rng, data: bytes) -> bytes:
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


def _parquet_columns(rng: Rng, data: bytes) -> bytes:
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


def _parquet_metadata(rng: Rng, data: bytes) -> bytes:
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
            metadata[key] = _json_tree(rng, text)
        case 1:
            metadata[key] = json.dumps(_ODD_VALUES[int(rng.integers(len(_ODD_VALUES)))]).encode()
        case 2:
            metadata[key] = _BYTES[str(rng.choice(sorted(_BYTES)))](rng, text) if text else b"\xff"
    stream = io.BytesIO()
    pq.write_table(table.replace_schema_metadata(metadata), stream)
    return stream.getvalue()


def _c3d_header(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 2, 4)))):
        word = int(rng.integers(0, 12))
        if len(changed) >= 24:
            struct.pack_into("<H", changed, 2 * word, int(rng.choice(_EXTREME_WORDS)))
    return bytes(changed)


def _c3d_parameters(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 2, 8)))):
        place = 512 + int(rng.integers(0, 1500))
        if place < len(changed):
            changed[place] = int(rng.choice((0, 1, 2, 127, 128, 254, 255)))
    return bytes(changed)


_WAYS: dict[str, dict[str, Callable[[Rng, bytes], bytes]]] = {
    "text": _TEXT,
    "json": {"tree": _json_tree, "odd number": _odd_number, "nest": _nest, "other word": _other_word},
    "toml": {**_TEXT, "tree": _toml_tree},
    "npz": {"members": _npz_members, "headers": _npz_headers},
    "parquet": {"columns": _parquet_columns, "metadata": _parquet_metadata},
    "c3d": {"header": _c3d_header, "parameters": _c3d_parameters},
}
