"""Stretches of time that begin and end within a recording."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.calibration.changes.clock_changes import MIN_BLOCKS


class Stretch(NamedTuple):
    """The blocks between two in which a change makes most better."""

    gain: float
    """-inf if there is no room for one."""
    held: Bool[np.ndarray, " block"]


def stretches(told: Bool[np.ndarray, " block"]) -> tuple[Int[np.ndarray, " stretch"], Int[np.ndarray, " stretch"]]:
    """The first block of each, and the one after it: blocks enough are in it, before it and after it."""
    number = np.concatenate([[0], np.cumsum(told)])
    first, end = _pairs(len(told))
    there = (number[first] >= MIN_BLOCKS) & (number[end] - number[first] >= MIN_BLOCKS)
    there &= number[-1] - number[end] >= MIN_BLOCKS
    return first[there], end[there]


@cache
def _pairs(n_blocks: int) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
    first, end = np.triu_indices(n_blocks + 1, MIN_BLOCKS)
    return first, end


def best_stretch(
    gain: Float[np.ndarray, " stretch"],
    first: Int[np.ndarray, " stretch"],
    end: Int[np.ndarray, " stretch"],
    n_blocks: int,
) -> Stretch:
    """That of the largest gain."""
    if not len(gain):
        return Stretch(-np.inf, np.zeros(n_blocks, dtype=bool))
    best, block = int(np.argmax(gain)), np.arange(n_blocks)
    return Stretch(float(gain[best]), (block >= first[best]) & (block < end[best]))


def better_stretch(gain: Float[np.ndarray, " block"], told: Bool[np.ndarray, " block"]) -> Stretch:
    """That in which all blocks together gain most."""
    first, end = stretches(told)
    total = np.concatenate([[0.0], np.cumsum(gain)])
    return best_stretch(total[end] - total[first], first, end, len(told))
