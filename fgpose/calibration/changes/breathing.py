"""Lenses whose focal length changes to and fro while a recording lasts, as an autofocus does that hunts.

The focal length of a camera is a process that returns to its mean within seconds (Ornstein-Uhlenbeck); how far it
strays is learned from the recording. It is found by the arms and judged by the legs, and the other way round: what a
network errs by in one view is not a zoom that both agree on, and a camera that turns is told by turns.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.clock_changes import MIN_BLOCKS
from fgpose.calibration.changes.comparison import Comparison
from fgpose.calibration.changes.credible import is_better_by_each, is_of_several_seconds
from fgpose.calibration.changes.lag_costs import BLOCK_S, angle, independent, reweighted, wide_enough
from fgpose.geometry.vectors import cross

_MOMENT_S, _LEAST_SAMPLES = 0.5, 2
_RETURNS_S = 2.0
_AT_FIRST, _CONSTANT = 0.02, 0.05  # standard deviations of what changes, and of what is off all the time
_LEARNED = 8
_STEP = 0.01  # for derivatives
# Root mean square: 3 cm two metres from the middle of the room, as usual detections err. Of right lenses 0.1 to 0.5 %.
_MATTERS = 0.015


@dataclass(frozen=True, eq=False)
class Breathing:
    """A lens of which the focal length changes."""

    camera: int
    share: float
    """Standard deviation of its logarithm over time."""


class _Way(Enum):
    """What a camera does, by so many numbers."""

    ZOOM = 1
    TURN = 2


class _System(NamedTuple):
    """Information and gradient of what the cameras do, for each half of the joints."""

    information: Float[np.ndarray, "half moment n n"]
    gradient: Float[np.ndarray, "half moment n"]
    time_s: Float[np.ndarray, " moment"]
    n_each: int

    def of_camera(self, c: int) -> _System:
        own = slice(self.n_each * c, self.n_each * (c + 1))
        return self._replace(information=self.information[..., own, own], gradient=self.gradient[..., own])

    def beside(self, c: int, value: Float[np.ndarray, " moment"]) -> _System:
        """With a camera that is known to do this."""
        return self._replace(gradient=self.gradient + self.information[..., c] * value[None, :, None])


class _Fit(NamedTuple):
    """What one camera does over time."""

    changing: Float[np.ndarray, "moment n"]
    constant: Float[np.ndarray, "moment n"]


def breathing_lenses(compared: Comparison) -> tuple[Breathing, ...]:
    """The clearest first, each beside those before it; none of recordings that do not tell.

    Args:
        compared: on top of all changes and other lenses that were found.
    """
    if compared.blocks.n_blocks < 2 * MIN_BLOCKS:
        return ()
    scale = compared.scale()
    zoom, turn = (_system(compared, way, scale) for way in _Way)
    turns = dict.fromkeys(range(compared.rig.n_cameras), 0.0)
    found: list[Breathing] = []
    total = 0.0
    while left := [c for c in turns if c not in {each.camera for each in found}]:
        gains = {c: _gain(zoom.of_camera(c)) for c in left}
        credible = [c for c in left if _is_credible(gains[c], zoom.time_s)]
        if credible and not found:
            turns = {c: float(_gain(turn.of_camera(c)).sum()) for c in turns}
            credible = [c for c in credible if gains[c].sum() > turns[c]]
        c = max(credible, key=lambda c: float(gains[c].sum()), default=None)
        if c is None:
            break
        fit = _learned(zoom.of_camera(c), slice(None))
        share = float(np.std(fit.changing))
        if share < _MATTERS:
            break
        found.append(Breathing(c, share))
        total += float(gains[c].sum())
        zoom = zoom.beside(c, (fit.changing + fit.constant)[:, 0])
    # A camera that turns makes others look as if their lenses changed.
    return tuple(found) if total > max(turns.values()) else ()


def _is_credible(gain: Float[np.ndarray, "half moment"], time_s: Float[np.ndarray, " moment"]) -> bool:
    return is_better_by_each(gain) and is_of_several_seconds(_by_second(gain.sum(axis=0), time_s))


def _by_second(
    gain: Float[np.ndarray, " moment"], time_s: Float[np.ndarray, " moment"]
) -> Float[np.ndarray, " second"]:
    length_s = max(BLOCK_S, float(np.min(np.diff(time_s))))
    return np.bincount(((time_s - time_s[0]) / length_s).astype(int), gain)


def _gain(system: _System) -> Float[np.ndarray, "half moment"]:
    """By how much each half of the joints agrees better with what the other half says of every moment than with what
    it says of all moments alike."""
    gain = np.zeros(system.gradient.shape[:2])
    for judge, own in enumerate(gain):
        fit = _learned(system, slice(1 - judge, 2 - judge))
        still = _still(system, slice(1 - judge, 2 - judge))
        with_fit, with_still = (_cost(system, judge, each) for each in (fit.changing + fit.constant, still))
        own[:] = with_still - with_fit
    return gain


def _cost(system: _System, half: int, value: Float[np.ndarray, "moment n"]) -> Float[np.ndarray, " moment"]:
    quadratic = np.einsum("mi,mij,mj->m", value, system.information[half], value)
    return np.einsum("mi,mi->m", system.gradient[half], value) + 0.5 * quadratic


def _still(system: _System, halves: slice) -> Float[np.ndarray, "moment n"]:
    """What suits all moments."""
    information, gradient = (each[halves].sum(axis=(0, 1)) for each in (system.information, system.gradient))
    value = -np.linalg.solve(information + np.eye(len(gradient)) / _CONSTANT**2, gradient)
    return np.broadcast_to(value, (len(system.time_s), len(value)))


def _learned(system: _System, halves: slice) -> _Fit:
    """With the variance that is most probable (expectation and maximisation)."""
    information, gradient = system.information[halves].sum(axis=0), system.gradient[halves].sum(axis=0)
    n = gradient.shape[1]
    variance = np.full(n, _AT_FIRST**2)
    mean, covariance = _smoothed(information, gradient, system.time_s, variance)
    for _ in range(_LEARNED):
        squares = mean[:, :n] ** 2 + np.einsum("mii->mi", covariance)[:, :n]
        variance = np.maximum(squares.mean(axis=0), 1e-10)
        mean, covariance = _smoothed(information, gradient, system.time_s, variance)
    return _Fit(mean[:, :n], mean[:, n:])


def _smoothed(
    information: Float[np.ndarray, "moment n n"],
    gradient: Float[np.ndarray, "moment n"],
    time_s: Float[np.ndarray, " moment"],
    variance: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "moment state"], Float[np.ndarray, "moment state state"]]:
    """Of what changes and what is constant, by a Kalman filter and a smoother (Rauch, Tung, Striebel)."""
    n = gradient.shape[1]
    both = np.hstack([np.eye(n), np.eye(n)])
    mean, covariance = np.zeros(2 * n), np.diag([*variance, *[_CONSTANT**2] * n])
    stays = np.exp(-np.diff(time_s, prepend=time_s[0]) / _RETURNS_S)
    before, after = [], []
    for k, stay in enumerate(stays):
        step = np.array([*[stay] * n, *[1.0] * n])
        mean, covariance = step * mean, step[:, None] * covariance * step
        covariance[:n, :n] += np.diag(variance * (1 - stay**2)) if k else 0.0
        before.append((mean, covariance, step))
        own = both.T @ information[k] @ both
        covariance = np.linalg.solve(np.eye(2 * n) + covariance @ own, covariance)
        covariance = 0.5 * (covariance + covariance.T)
        mean = mean - covariance @ (both.T @ gradient[k] + own @ mean)
        after.append((mean, covariance))
    means, covariances = [mean], [covariance]
    for (own_mean, own), (next_mean, following, step) in zip(after[-2::-1], before[:0:-1], strict=True):
        back = own * step @ np.linalg.inv(following + 1e-12 * np.eye(2 * n))
        mean = own_mean + back @ (mean - next_mean)
        covariance = own + back @ (covariance - following) @ back.T
        means.append(mean)
        covariances.append(covariance)
    return np.array(means[::-1]), np.array(covariances[::-1])


def _system(compared: Comparison, way: _Way, scale: dict[tuple[int, int], float]) -> _System:
    rays, seconds = compared.rays, compared.blocks
    index, n = seconds.index, way.value
    taken_s = rays.time_s[index]
    length_s = max(_MOMENT_S, _LEAST_SAMPLES * seconds.n_blocks * seconds.length_s / len(index))
    numbers, moment = np.unique(((taken_s - taken_s.min()) / length_s).astype(int), return_inverse=True)
    n_joints, n_unknowns = rays.direction.shape[2], n * rays.n_cameras
    # Skeletons have arms and legs one after the other.
    half = np.arange(n_joints) >= n_joints / 2
    information = np.zeros((2, len(numbers), n_unknowns, n_unknowns))
    gradient = np.zeros((2, len(numbers), n_unknowns))
    changed = [_changed(compared, c, way) for c in range(rays.n_cameras)]
    for (a, b), sigma in scale.items():
        baseline_m = (rays.centre_m[b, index] - rays.centre_m[a, index])[:, None]
        one, other = rays.direction[a, index], rays.direction[b, index]
        still = angle(one, other, baseline_m) / sigma
        weight = independent(seconds) * np.minimum(rays.weight[a, index], rays.weight[b, index])
        weight = reweighted(still, weight, wide_enough(still, weight))
        with_change = [angle(each, other, baseline_m) for each in changed[a]]
        with_change += [angle(one, each, baseline_m) for each in changed[b]]
        slopes = np.stack([(each / sigma - still) / _STEP for each in with_change], axis=-1)
        slopes, still = np.where(weight[..., None] > 0, np.nan_to_num(slopes), 0.0), np.nan_to_num(still)
        columns = [n * c + k for c in (a, b) for k in range(n)]
        for number in range(2):
            counted = weight * (half == number)
            of_pair = np.zeros((len(numbers), 2 * n, 2 * n)), np.zeros((len(numbers), 2 * n))
            np.add.at(of_pair[0], moment, np.einsum("sj,sja,sjb->sab", counted, slopes, slopes))
            np.add.at(of_pair[1], moment, np.einsum("sj,sj,sja->sa", counted, still, slopes))
            information[np.ix_([number], range(len(numbers)), columns, columns)] += of_pair[0]
            gradient[np.ix_([number], range(len(numbers)), columns)] += of_pair[1]
    return _System(information, gradient, taken_s.min() + (numbers + 0.5) * length_s, n)


def _changed(compared: Comparison, c: int, way: _Way) -> list[Float[np.ndarray, "sample joint 3"]]:
    """The rays of a camera, by one step of each number."""
    index = compared.blocks.index
    world_R_camera = compared.rays.world_R_camera[c, index]
    own = np.einsum("sji,skj->ski", world_R_camera, compared.rays.direction[c, index])
    if way is _Way.ZOOM:
        changed = [own * np.exp([-_STEP, -_STEP, 0.0])]
    else:
        changed = [own + _STEP * cross(np.broadcast_to(axis, own.shape), own) for axis in np.eye(3)[:2]]
    changed = [each / np.linalg.norm(each, axis=-1, keepdims=True) for each in changed]
    return [np.einsum("sij,skj->ski", world_R_camera, each) for each in changed]
