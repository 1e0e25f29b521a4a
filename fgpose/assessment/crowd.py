"""Several people in the same frames: who is there, and how far an estimated person is from a true one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.alignment import same_times
from fgpose.assessment.metrics import mean_known
from fgpose.trajectory import Trajectory

NOBODY = -1


@dataclass(frozen=True, eq=False)
class Crowd:
    """The people of each frame, in slots: the memory grows with the people there at once, not with the identities.

    T frames, S slots (the most people in any frame), J joints.
    """

    identities: tuple[int, ...]
    """In ascending order; also those who are in none of the frames."""
    person: Int[np.ndarray, "frame slot"]
    """Index into identities, ascending in each frame; NOBODY: the slot is empty."""
    positions_m: Float[np.ndarray, "frame slot joint 3"]
    """World frame, metres; NaN = missing."""

    @property
    def n_there(self) -> int:
        """How many people there are in all frames together."""
        return int((self.person != NOBODY).sum())

    @property
    def n_frames_there(self) -> Int[np.ndarray, " identity"]:
        """In how many frames each identity is there."""
        return np.bincount(self.person[self.person != NOBODY], minlength=len(self.identities))


def gather(
    people: Mapping[int, Trajectory],
    joints: Sequence[int],
    instants_s: Float[np.ndarray, " frame"],
    offset_s: float = 0.0,
) -> Crowd:
    """Bring trajectories to common frames. Somebody is there where at least one joint is known.

    Args:
        people: trajectories by identity.
        joints: which of those that every trajectory has.
        instants_s: increasing, seconds; a trajectory's frame is taken as the instant's where same_times pairs them.
        offset_s: added to the times of the trajectories.
    """
    identities = tuple(sorted(people))
    known = [_known(people[identity], joints, instants_s, offset_s) for identity in identities]
    n_frames = len(instants_s)
    n_there = sum((np.bincount(frames, minlength=n_frames) for frames, _ in known), np.zeros(n_frames, dtype=int))
    n_slots = int(n_there.max(initial=0))
    person = np.full((n_frames, n_slots), NOBODY)
    positions_m = np.full((n_frames, n_slots, len(joints), 3), np.nan)
    filled = np.zeros(n_frames, dtype=int)
    for index, (frames, known_m) in enumerate(known):
        person[frames, filled[frames]] = index
        positions_m[frames, filled[frames]] = known_m
        filled[frames] += 1
    return Crowd(identities, person, positions_m)


def _known(
    trajectory: Trajectory, joints: Sequence[int], instants_s: Float[np.ndarray, " instant"], offset_s: float
) -> tuple[Int[np.ndarray, " frame"], Float[np.ndarray, "frame joint 3"]]:
    """Indices of the instants at which the person is there, and the positions."""
    own, instants = same_times(trajectory.time_s + offset_s, instants_s)
    positions_m = trajectory.positions_m[own][:, list(joints)]
    there = np.isfinite(positions_m).all(axis=-1).any(axis=-1)
    return instants[there], positions_m[there]


def distances_m(truth: Crowd, estimate: Crowd) -> Float[np.ndarray, "frame truth estimate"]:
    """Mean distance over the joints that both have (MPJPE), metres, for the slots of each frame; NaN: no such joint."""
    result = np.full((*truth.person.shape, estimate.person.shape[1]), np.nan)
    for slot in range(truth.person.shape[1]):
        errors_m = np.linalg.norm(estimate.positions_m - truth.positions_m[:, slot, None], axis=-1)
        result[:, slot] = mean_known(errors_m, axis=-1)
    return result
