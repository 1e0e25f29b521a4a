"""The clocks of all cameras from the shifts between pairs of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_ROUNDS = 20
# Of a whitened disagreement (Huber): beyond two standard deviations pairs count less.
_HUBER = 2.0
# Two cameras never know their shift better: numbers as 0.1 ms come from a few lucky blocks.
_MIN_SIGMA_S, _MIN_SIGMA_RATE = 5e-4, 1e-5


@dataclass(frozen=True, eq=False)
class ClockShift:
    """Of two clocks: time of the first = time of the second + shift_s + rate * (time of the second - middle_s)."""

    shift_s: float
    rate: float
    middle_s: float
    """By the second clock, of what both cameras show."""
    covariance: Float[np.ndarray, "2 2"]
    """Of shift_s and rate."""

    @property
    def sigma_s(self) -> float:
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def rate_sigma(self) -> float:
        return float(np.sqrt(self.covariance[1, 1]))


@dataclass(frozen=True, eq=False)
class Clocks:
    """Common time = own time * (1 + rate) + offset_s."""

    offsets_s: Float[np.ndarray, " camera"]
    rates: Float[np.ndarray, " camera"]
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation of the common time in the middle of what a camera shows of the walker."""
    rate_sigma: Float[np.ndarray, " camera"]
    disagreement_s: Float[np.ndarray, " camera"]
    """Median over the pairs of a camera of how far their shift is from that of these clocks."""


def solve_clocks(shifts: Mapping[tuple[int, int], ClockShift], n_cameras: int, reference: int) -> Clocks:
    """The clocks that suit all pairs together: weighted least squares, iterated with a Huber kernel.

    Every pair gives two equations, for the shift in the middle of what it shows and for the rate. What a camera itself
    gets wrong is the same in all its pairs: standard deviations are those of one pair, not less with more of them.

    Args:
        shifts: of pairs (first, second) that connect all cameras that occur, also with the reference.
        reference: the camera whose clock is the common one.

    Returns:
        NaN for cameras that do not occur.
    """
    known = [reference, *sorted({camera for pair in shifts for camera in pair} - {reference})]
    column = {camera: 2 * n for n, camera in enumerate(known)}
    rows, right = _equations(shifts, column)
    weight, solution = np.ones(len(rows)), np.zeros(2 * len(known))
    covariance = np.zeros((2 * len(known), 2 * len(known)))
    for _ in range(_ROUNDS if len(rows) else 0):
        # The first two unknowns are those of the reference: zero.
        own = rows[:, 2:] * weight[:, None]
        solution[2:] = np.linalg.lstsq(own, right * weight, rcond=1e-15)[0]
        covariance[2:, 2:] = np.linalg.pinv(own.T @ own, rcond=1e-15, hermitian=True)
        apart = np.linalg.norm((right - rows @ solution).reshape(-1, 2), axis=1)
        weight = np.repeat(np.sqrt(np.minimum(1.0, _HUBER / np.maximum(apart, 1e-9))), 2)
    return _clocks(solution, covariance, shifts, column, n_cameras)


def _equations(
    shifts: Mapping[tuple[int, int], ClockShift], column: Mapping[int, int]
) -> tuple[Float[np.ndarray, "row unknown"], Float[np.ndarray, " row"]]:
    """Two rows for each pair, in standard deviations; unknowns: offset and rate of each camera."""
    rows, right = np.zeros((2 * len(shifts), 2 * len(column))), np.zeros(2 * len(shifts))
    for n, ((first, second), shift) in enumerate(shifts.items()):
        a, b, pair = column[first], column[second], slice(2 * n, 2 * n + 2)
        # What the second clock calls middle_s, the first calls middle_s + shift_s.
        equation = np.zeros((2, rows.shape[1]))
        equation[0, [b, b + 1]] = 1.0, shift.middle_s
        equation[0, [a, a + 1]] = -1.0, -(shift.middle_s + shift.shift_s)
        equation[1, [b + 1, a + 1]] = 1.0, -1.0
        covariance = shift.covariance + np.diag([_MIN_SIGMA_S**2, _MIN_SIGMA_RATE**2])
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        rows[pair], right[pair] = whitening @ equation, whitening @ (shift.shift_s, shift.rate)
    return rows, right


def _clocks(
    solution: Float[np.ndarray, " unknown"],
    covariance: Float[np.ndarray, "unknown unknown"],
    shifts: Mapping[tuple[int, int], ClockShift],
    column: Mapping[int, int],
    n_cameras: int,
) -> Clocks:
    offsets_s, rates, sigma_s, rate_sigma, apart_s = np.full((5, n_cameras), np.nan)
    for camera, at in column.items():
        offsets_s[camera], rates[camera] = solution[at : at + 2]
    for camera, at in column.items():
        own = {pair: shift for pair, shift in shifts.items() if camera in pair}
        middle_s = float(np.mean([_middle_s(camera, pair, shift) for pair, shift in own.items()])) if own else 0.0
        by = np.array([1.0, middle_s])
        # As many pairs as each camera has confirm each other only in part.
        alone = max(len(own) / 2, 1.0)
        sigma_s[camera] = np.sqrt(max(by @ covariance[at : at + 2, at : at + 2] @ by, 0.0) * alone)
        rate_sigma[camera] = np.sqrt(max(covariance[at + 1, at + 1], 0.0) * alone)
        apart_s[camera] = np.median([abs(_apart_s(offsets_s, rates, *each)) for each in own.items()]) if own else 0.0
    return Clocks(offsets_s, rates, sigma_s, rate_sigma, apart_s)


def _middle_s(camera: int, pair: tuple[int, int], shift: ClockShift) -> float:
    return shift.middle_s + (shift.shift_s if camera == pair[0] else 0.0)


def _apart_s(
    offsets_s: Float[np.ndarray, " camera"],
    rates: Float[np.ndarray, " camera"],
    pair: tuple[int, int],
    shift: ClockShift,
) -> float:
    """Common time of the second clock less that of the first, at the moment that the pair takes for the same."""
    (first, second), middle_s = pair, shift.middle_s
    of_first_s = (middle_s + shift.shift_s) * (1 + rates[first]) + offsets_s[first]
    return float(middle_s * (1 + rates[second]) + offsets_s[second] - of_first_s)
