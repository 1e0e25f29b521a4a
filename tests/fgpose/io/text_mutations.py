"""Damage to bytes, to text, and to the tree of a JSON or TOML document."""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import tomli_w

Rng = np.random.Generator

_ODD_NUMBERS = (
    *("nan", "inf", "-inf", "NaN", "Infinity", "0", "-1", "-0.0", "1e308", "-1e308", "1e400", "1e-320", "2147483648"),
    *("9" * 20, "-" + "9" * 20, "9" * 400, "9" * 5000, "0x1F", "1_000", "true", "null", '""', "[]", "{}", "1,5", ""),
)
_ODD_TEXTS = ("[" * 100_000, "{" * 50_000, '{"a":' * 50_000, "a." * 20_000, "- " * 50_000, "<a>" * 100_000, "\x00", "�")
ODD_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1.5, 10**400, -(10**19), 1e308, float("nan"), float("inf"), "", "x", "nan", "9" * 5000),
    *(
        [],
        [[]],
        {},
        {"a": 1},
        [1, "a", None],
        [[1, 2], [3]],
        [[[[1.0]]]],
        [[None] * 3] * 3,
        "\x00",
        "ä" * 300,
        "x" * 100_000,
    ),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w*")


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


BYTES: dict[str, Callable[[Rng, bytes], bytes]] = {
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


def odd_number(rng: Rng, data: bytes) -> bytes:
    return _replaced(rng, data, _NUMBER, lambda: str(rng.choice(_ODD_NUMBERS)).encode())


def other_word(rng: Rng, data: bytes) -> bytes:
    words = sorted(set(_WORD.findall(data))) or [b"x"]
    return _replaced(rng, data, _WORD, lambda: words[int(rng.integers(len(words)))])


def long_word(rng: Rng, data: bytes) -> bytes:
    return _replaced(rng, data, _WORD, lambda: b"x" * 100_000)


def nest(rng: Rng, data: bytes) -> bytes:
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


TEXT: dict[str, Callable[[Rng, bytes], bytes]] = {
    "odd number": odd_number,
    "other word": other_word,
    "long word": long_word,
    "nest": nest,
    "lines": _lines,
    "encode": _encode,
}


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
                container[key] = copy.deepcopy(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
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


def json_tree(rng: Rng, data: bytes) -> bytes:
    try:
        return json.dumps(_mutate_tree(rng, json.loads(data))).encode()
    except (ValueError, RecursionError):
        return data


def toml_tree(rng: Rng, data: bytes) -> bytes:
    try:
        return tomli_w.dumps(_mutate_tree(rng, tomllib.loads(data.decode()))).encode()
    except (ValueError, TypeError, AttributeError, RecursionError):
        return data
