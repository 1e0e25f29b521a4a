"""Views in which a network has exchanged left and right, image by image: the model of flips, forward in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.image_checks.flip_model import (
    disagreement,
    log_change,
    log_prior,
    metres_per_px,
    of_states,
    possible_states,
)
from fgpose.estimation.evidence.image_checks.flips import SURE, TWO, confirmed, suspicious_sides
from fgpose.estimation.evidence.image_checks.sides import (
    Limbs,
    Sides,
    can_tell,
    exchanged,
    exchanged_joints,
    limb_joints,
    sides_of,
)
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton

_TOGETHER_S = 0.1  # images that are farther apart do not show limbs in one place
_SETTLED = 1e-3  # probability that any view is flipped, at which none is


@dataclass(frozen=True, eq=False)
class RunningFlips:
    """What the next images are compared with."""

    _of_sides: tuple[_OfSides, ...]

    @staticmethod
    def none(n_cameras: int, skeleton: Skeleton) -> RunningFlips:
        """Before the first image."""
        return RunningFlips(tuple(_OfSides.none(n_cameras, sides) for sides in sides_of(skeleton)))

    def after(
        self, images: Observations, of_limbs: Limbs, expected_m: Float[np.ndarray, "joint 3"], rig: CameraRig
    ) -> tuple[Bool[np.ndarray, "camera joint"], RunningFlips]:
        """Which joints of the next images are exchanged with those of the other side, and what those after them are
        compared with.

        Args:
            images: of one frame.
            of_limbs: what they show of the limbs; see limbs.
            expected_m: where the joints are expected; NaN where that is not known.
            rig: the cameras.
        """
        if not can_tell(images.skeleton, rig, TWO):
            return np.zeros((rig.n_cameras, images.skeleton.n_joints), dtype=bool), self
        flipped = np.zeros((rig.n_cameras, len(self._of_sides)), dtype=bool)
        time_s, of_sides = float(images.frame_time_s[0]), list[_OfSides]()
        points_px, weights = (array.copy() for array in of_limbs)
        limbs_m = expected_m[limb_joints(images.skeleton)]
        (of_cameras,) = suspicious_sides(points_px, limbs_m[None], rig, sides_of(images.skeleton))
        suspicious = np.asarray(of_cameras.any(axis=0))
        suspicious |= not np.isfinite(limbs_m).any()
        for number, each in enumerate(self._of_sides):
            own = each.sides.pairs
            seen = points_px[0][:, own], weights[0][:, own]
            found, after = each.after(*seen, time_s, rig, is_suspicious=bool(suspicious[number]))
            of_sides.append(after)
            flipped[:, number] = found
            if found.any():
                points_px[:, :, own] = exchanged(points_px[:, :, own], found[None])
                weights[:, :, own] = exchanged(weights[:, :, own], found[None])
        return exchanged_joints(flipped, images.skeleton), RunningFlips(tuple(of_sides))


@dataclass(frozen=True, eq=False)
class _OfSides:
    """The same of joints that are exchanged together, where those of the whole body are as they should be."""

    sides: Sides
    log_belief: Float[np.ndarray, " state"]
    """Log probability of each of possible_states, by all images so far."""
    before_px: Float[np.ndarray, "camera pair side 2"]
    """Where each joint was seen last, undistorted and not corrected."""
    before_weights: Float[np.ndarray, "camera pair side"]
    """Zero where it was never seen."""
    before_s: Float[np.ndarray, "camera pair side"]
    """When it was."""
    time_s: float
    """Of the newest image."""

    @staticmethod
    def none(n_cameras: int, sides: Sides) -> _OfSides:
        """Before the first image."""
        zero = np.zeros((n_cameras, len(sides.pairs), 2))
        prior = log_prior(possible_states(n_cameras))
        return _OfSides(sides, prior, np.full((*zero.shape, 2), np.nan), zero, zero - np.inf, -np.inf)

    def after(
        self,
        points_px: Float[np.ndarray, "camera pair side 2"],
        weights: Float[np.ndarray, "camera pair side"],
        time_s: float,
        rig: CameraRig,
        *,
        is_suspicious: bool,
    ) -> tuple[Bool[np.ndarray, " camera"], _OfSides]:
        """In which of the next images they are exchanged."""
        seen, shows = weights > 0, weights.any(axis=(1, 2))
        belief, flipped = self.log_belief, np.zeros(rig.n_cameras, dtype=bool)
        if is_suspicious or -np.expm1(self.log_belief[0]) >= _SETTLED:
            belief, flipped = self._judged(points_px, weights, time_s, rig)
        before_px = np.where(seen[..., None], points_px, self.before_px)
        before_weights = np.where(seen, weights, self.before_weights)
        before_s, newest_s = np.where(seen, time_s, self.before_s), max(time_s, self.time_s)
        return flipped & shows, _OfSides(self.sides, belief, before_px, before_weights, before_s, newest_s)

    def _judged(
        self,
        points_px: Float[np.ndarray, "camera pair side 2"],
        weights: Float[np.ndarray, "camera pair side"],
        time_s: float,
        rig: CameraRig,
    ) -> tuple[Float[np.ndarray, " state"], Bool[np.ndarray, " camera"]]:
        """The belief with these images, and which views are flipped by it. The other views count with what they have
        just shown."""
        states, seen = possible_states(rig.n_cameras), weights > 0
        shows = np.asarray(seen.any(axis=(1, 2)))[:, None, None]
        just_seen = ~shows & (time_s - self.before_s < _TOGETHER_S)
        now_px = np.where(just_seen[..., None], self.before_px, points_px)[None]
        now = np.where(just_seen, self.before_weights, weights)[None]
        scale = metres_per_px(now_px, now, rig)
        cost = disagreement(now_px, now, scale, rig, states)[0]
        if just_seen.any():  # what they tell of each other has been counted
            cost = cost - disagreement(now_px, np.where(just_seen, now, 0.0), scale, rig, states)[0]
        if np.isfinite(self.time_s):
            before = self.before_px[None], self.before_weights[None], (time_s - self.before_s)[None]
            step_s = np.array([[max(time_s - self.time_s, 0.0)]])
            change = log_change(points_px[None], weights[None], *before, step_s, scale)[0]
            belief = np.logaddexp.reduce(self.log_belief[:, None] + of_states(change, states), axis=0) - cost
        else:
            belief = self.log_belief - cost
        belief = belief - np.logaddexp.reduce(belief)
        found = np.exp(belief) @ states > SURE
        return belief, confirmed(now_px, now, found[None], rig)[0] if found.any() else found
