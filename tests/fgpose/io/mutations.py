"""Damage to files of every kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from member_mutations import (
    c3d_header,
    c3d_parameters,
    npz_headers,
    npz_members,
    parquet_columns,
    parquet_metadata,
)
from text_mutations import BYTES, TEXT, Rng, json_tree, long_word, nest, odd_number, other_word, toml_tree

_WAYS: dict[str, dict[str, Callable[[Rng, bytes], bytes]]] = {
    "text": TEXT,
    "json": {
        "tree": json_tree,
        "odd number": odd_number,
        "nest": nest,
        "other word": other_word,
        "long word": long_word,
    },
    "toml": {**TEXT, "tree": toml_tree},
    "npz": {"members": npz_members, "headers": npz_headers},
    "parquet": {"columns": parquet_columns, "metadata": parquet_metadata},
    "c3d": {"header": c3d_header, "parameters": c3d_parameters},
}


def mutate(rng: Rng, path: Path, kind: str) -> str:
    """Damage a file in one way, sometimes in two; returns the names of the ways."""
    ways = _WAYS.get(kind, {}) if rng.random() < 0.6 else BYTES
    ways = ways or BYTES
    done = []
    for _ in range(1 + (rng.random() < 0.2)):
        name = str(rng.choice(sorted(ways)))
        path.write_bytes(ways[name](rng, path.read_bytes()))
        done.append(name)
        ways = BYTES
    return "+".join(done)
