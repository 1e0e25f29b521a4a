"""How far joints are from the only camera that sees them: a filter over their distances along its rays.

A camera alone tells directions. What it sees of a body whose bone lengths are known tells the distance too: the farther
away, the smaller. The factor graph cannot use that. Its most probable pose is far too near to the camera, by metres
after some seconds, even with perfect detections: the smaller the body, the smaller all accelerations, and bones that
are too long may point towards the camera at no cost. Here the unknowns are the distances alone, and the bones' tilts
have the distribution that they have in the rest of the recording (fgpose.estimation.visibility.posture).

The state is the distance of the joints that no bone holds, the difference of distance along each bone, and the common
speed. Differences return to what is usual for the posture (Ornstein-Uhlenbeck processes), the speed to zero. The
squared length of a bone is quadratic in the distances, so that its mean and variance are exact (a Kalman filter of
second order, Athans, Wishner and Bertolini 1968); the variance of a tilt makes bones look shorter, as it should.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation.noise import CORRELATION_S, correlated_frames, surely_positive
from fgpose.estimation.visibility.posture import Posture
from fgpose.skeleton import Skeleton

# Of people who walk about: speed towards a camera, and time for which it lasts.
_SPEED_SIGMA_MPS, _SPEED_S = 0.7, 1.0
# How fast bones turn: their component along a ray has changed by as much as it varies (CMU walking, dancing, punching).
_TILT_S = 0.35
_WALK_DENSITY = 0.01  # of the distance of the body, m^2/s, beside its speed
_BONE_SIGMA_M = 0.005
_FEWEST_SIGMAS = 3.0  # residual from which a bone counts less: one of its detections is probably hallucinated
_FIRST_SIGMA_M = 2.0  # of a body that was not seen by several cameras yet
_UNKNOWN_LENGTH_M, _SHORTEST_M = 0.3, 0.01


@dataclass(frozen=True, eq=False)
class Sight:
    """What is known of the joints in a frame."""

    rays: Float[np.ndarray, "joint 3"]
    """Unit vectors from the camera to its detections; NaN where it does not see the joint."""
    sigma_m: Float[np.ndarray, " joint"]
    """Standard deviation of these, along each axis of the image at the joint."""
    distance_m: Float[np.ndarray, " joint"]
    """From the camera where other cameras tell it too; NaN elsewhere."""
    distance_sigma_m: Float[np.ndarray, " joint"]
    """Of the errors of distance_m, taken for independent."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Mean and covariance of the state."""

    mean: Float[np.ndarray, " state"]
    covariance: Float[np.ndarray, "state state"]


@dataclass(frozen=True, eq=False)
class Step:
    """The beliefs of a frame, and what led to it."""

    transition: Float[np.ndarray, "state state"]
    predicted: Belief
    updated: Belief


class DistanceFilter:
    """The distances of the joints from one camera, frame after frame.

    Args:
        skeleton: of the person.
        lengths_m: shared bone lengths; NaN where one is not known.
        posture: how the bones usually point.
        last: directions of the bones when several cameras saw them last; NaN if they never did.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        lengths_m: Float[np.ndarray, " length"],
        posture: Posture,
        last: Float[np.ndarray, "bone 3"],
    ) -> None:
        self._posture, self._last = posture, last
        self._bone_ends = skeleton.bone_ends
        self._length_m = lengths_m[np.array(skeleton.length_of_bone, dtype=int)]
        chains, self._bone_of_joint = _chains(skeleton)
        self._held = self._bone_of_joint >= 0
        n = skeleton.n_joints
        own_length_m = self._length_m[self._bone_of_joint] if skeleton.bones else np.full(n, np.nan)
        own_length_m = np.where(np.isnan(own_length_m), _UNKNOWN_LENGTH_M, np.maximum(own_length_m, _SHORTEST_M))
        self._scale_m = np.where(self._held, own_length_m, 0.0)
        self._rows = np.hstack([chains, np.zeros((n, 1))])  # make distances from a state
        self.belief = Belief(np.zeros(n + 1), np.eye(n + 1))

    def begin(
        self,
        sight: Sight,
        ray: Float[np.ndarray, " 3"],
        about_m: float,
        speed_mps: float = 0.0,
        speed_sigma_mps: float = _SPEED_SIGMA_MPS,
    ) -> Step:
        """With what is known in a frame.

        Args:
            sight: of the frame.
            ray: to the body.
            about_m: distance of the body if no joint tells any.
            speed_mps, speed_sigma_mps: of the body away from the camera.
        """
        tilt_m, tilt_m2 = self._usual(ray)
        known = np.isfinite(sight.distance_m)
        about_m = float(np.mean(sight.distance_m[known])) if known.any() else about_m
        mean = np.append(np.where(self._held, tilt_m, about_m), speed_mps)
        variance = np.append(np.where(self._held, tilt_m2, _FIRST_SIGMA_M**2), speed_sigma_mps**2)
        self.belief = Belief(mean, np.diag(variance))
        self._take_distances(sight)
        return Step(np.eye(len(mean)), self.belief, self.belief)

    def step(self, step_s: float, sight: Sight, ray: Float[np.ndarray, " 3"]) -> Step:
        """The next frame, this time later."""
        transition = self._predict(step_s, ray)
        predicted = self.belief
        self._take_distances(sight)
        self._take_bones(sight, step_s)
        return Step(transition, predicted, self.belief)

    def distances(self, belief: Belief) -> tuple[Float[np.ndarray, " joint"], Float[np.ndarray, " joint"]]:
        """Distance of every joint and its variance."""
        return self._rows @ belief.mean, np.einsum("js,st,jt->j", self._rows, belief.covariance, self._rows)

    def _usual(self, ray: Float[np.ndarray, " 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of what a joint is farther away than the one that holds it, after a long time."""
        mean, variance = self._posture.towards(ray, self._last)
        if not len(mean):
            return np.zeros(len(self._held)), np.zeros(len(self._held))
        return self._scale_m * mean[self._bone_of_joint], self._scale_m**2 * variance[self._bone_of_joint]

    def _predict(self, step_s: float, ray: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "state state"]:
        tilt_m, tilt_m2 = self._usual(ray)
        keep, keep_speed = np.exp(-step_s / _TILT_S), np.exp(-step_s / _SPEED_S)
        transition = np.diag(np.append(np.where(self._held, keep, 1.0), keep_speed))
        transition[:-1, -1] = np.where(self._held, 0.0, step_s)
        offset = np.append(np.where(self._held, (1 - keep) * tilt_m, 0.0), 0.0)
        noise = np.append(
            np.where(self._held, (1 - keep**2) * tilt_m2, _WALK_DENSITY * step_s),
            (1 - keep_speed**2) * _SPEED_SIGMA_MPS**2,
        )
        belief = self.belief
        covariance = transition @ belief.covariance @ transition.T + np.diag(noise)
        self.belief = Belief(transition @ belief.mean + offset, covariance)
        return transition

    def _take_distances(self, sight: Sight) -> None:
        known = np.isfinite(sight.distance_m)
        if known.any():
            rows = self._rows[known]
            missing_m = sight.distance_m[known] - rows @ self.belief.mean
            self._take(rows, missing_m, sight.distance_sigma_m[known] ** 2, np.zeros(len(rows)))

    def _take_bones(self, sight: Sight, step_s: float) -> None:
        """The squared lengths of all bones that the camera sees as a whole."""
        start, end = self._bone_ends
        known = np.asarray(np.isfinite(sight.rays).all(axis=-1))
        seen = known[start] & known[end] & np.isfinite(self._length_m)
        start, end, length_m = start[seen], end[seen], self._length_m[seen]
        if not len(start):
            return
        rows = np.stack([self._rows[start], self._rows[end]], axis=1)
        along_m = rows @ self.belief.mean
        cosine = np.einsum("bi,bi->b", sight.rays[start], sight.rays[end])
        hessian = np.empty((len(start), 2, 2))
        hessian[:, [0, 1], [0, 1]], hessian[:, [0, 1], [1, 0]] = 2.0, -2 * cosine[:, None]
        gradient = np.einsum("bij,bj->bi", hessian, along_m)
        of_ends = np.einsum("bis,st,bjt->bij", rows, self.belief.covariance, rows)
        curved = np.einsum("bij,bjk->bik", hessian, of_ends)
        error_m2 = sight.sigma_m[start] ** 2 + sight.sigma_m[end] ** 2
        mean_m2 = np.einsum("bi,bi->b", gradient, along_m) / 2 + np.trace(curved, axis1=1, axis2=2) / 2
        across_m2 = np.maximum(1 - cosine**2, 0.0) * along_m.prod(axis=1)
        # Twice the time, because a part of the errors stays for longer. With half of it distances of synthetic walkers
        # are too small by 3 cm more, and 2 % fewer are within their 99 %.
        as_one = correlated_frames(step_s, 2 * CORRELATION_S)
        noise_m4 = (4 * across_m2 * error_m2 + 4 * error_m2**2) * as_one
        noise_m4 = noise_m4 + (2 * length_m * _BONE_SIGMA_M) ** 2 + np.einsum("bij,bji->b", curved, curved) / 2
        # Errors across the bone make it look longer.
        missing_m2 = length_m**2 - (mean_m2 - 2 * error_m2)
        slopes = np.einsum("bi,bis->bs", gradient, rows)
        self._take(slopes, missing_m2, noise_m4, np.full(len(slopes), _FEWEST_SIGMAS**2))

    def _take(
        self,
        rows: Float[np.ndarray, "row state"],
        missing: Float[np.ndarray, " row"],
        noise: Float[np.ndarray, " row"],
        gate: Float[np.ndarray, " row"],
    ) -> None:
        """Kalman's update; noise grows with residuals above the gate, if there is one."""
        covariance = self.belief.covariance
        by_row = covariance @ rows.T
        expected = rows @ by_row
        total = np.diag(expected) + noise
        excess = np.where(gate > 0, missing**2 / (np.maximum(gate, 1e-12) * total), 0.0)
        noise = noise + np.maximum(excess - 1, 0.0) * total
        gain = np.linalg.solve(surely_positive(expected + np.diag(noise)), by_row.T).T
        covariance = covariance - gain @ by_row.T
        self.belief = Belief(self.belief.mean + gain @ missing, (covariance + covariance.T) / 2)


def smoothed(steps: list[Step]) -> list[Belief]:
    """The beliefs of all frames given all frames (Rauch, Tung and Striebel)."""
    later = steps[-1].updated
    beliefs = [later]
    for step, following in zip(reversed(steps[:-1]), reversed(steps[1:]), strict=True):
        own, predicted = step.updated, following.predicted
        gain = np.linalg.solve(surely_positive(predicted.covariance), following.transition @ own.covariance).T
        mean = own.mean + gain @ (later.mean - predicted.mean)
        covariance = own.covariance + gain @ (later.covariance - predicted.covariance) @ gain.T
        later = Belief(mean, (covariance + covariance.T) / 2)
        beliefs.append(later)
    return beliefs[::-1]


@lru_cache(maxsize=16)
def _chains(skeleton: Skeleton) -> tuple[Float[np.ndarray, "joint joint"], Int[np.ndarray, " joint"]]:
    """Which differences along bones make the distance of each joint (ones and zeros), and the bone that holds each
    joint; -1 if none does."""
    n = skeleton.n_joints
    chains, bone_of_joint = np.eye(n), np.full(n, -1)
    placed = {joint for joint in range(n) if joint not in {end for _, end in skeleton.bones}}
    while len(placed) < n:
        reached = [
            (number, start, end)
            for number, (start, end) in enumerate(skeleton.bones)
            if start in placed and end not in placed
        ]
        if not reached:  # bones that form a ring: cut it anywhere
            placed.add(next(joint for joint in range(n) if joint not in placed))
            continue
        number, start, end = reached[0]
        chains[end] += chains[start]
        bone_of_joint[end] = number
        placed.add(end)
    return chains, bone_of_joint
