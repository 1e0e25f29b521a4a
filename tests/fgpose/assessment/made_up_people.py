"""People for tests of people: standing still where hand-made cases need them, or a dense crowd that moves."""

from __future__ import annotations

import numpy as np

from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory

SKELETON = Skeleton("four", ("hip", "knee", "neck", "head"), bones=((0, 1), (2, 3)), root=(0,))
# hip, knee, neck, head of somebody who stands at the origin: limbs of 0.4 and 0.2 m
STANDING_M = np.array([[0, 0, 0.9], [0, 0, 0.5], [0, 0, 1.4], [0, 0, 1.6]])
FPS = 50.0

People = dict[int, Trajectory]


def make(positions_m: np.ndarray, time_s: np.ndarray | None = None, skeleton: Skeleton = SKELETON) -> Trajectory:
    times_s = np.arange(len(positions_m)) / FPS if time_s is None else time_s
    return Trajectory(skeleton, times_s, positions_m.copy(), np.full(positions_m.shape[:2], Status.OBSERVED))


def standing(x_m: float, n_frames: int = 10) -> np.ndarray:
    return np.tile(STANDING_M + np.array([x_m, 0, 0]), (n_frames, 1, 1))


def only(positions_m: np.ndarray, frames: slice | list[int]) -> np.ndarray:
    """The same, but there in some frames only."""
    result = np.full_like(positions_m, np.nan)
    result[frames] = positions_m[frames]
    return result


def people(*positions_m: np.ndarray) -> People:
    return {identity: make(each) for identity, each in enumerate(positions_m, start=1)}


def scene(seed: int, n_people: int, n_frames: int) -> tuple[People, People]:
    """Estimate and truth of a dense crowd: people come and go, are lost, swapped, renamed and made up."""
    rng = np.random.default_rng(seed)
    walks_m = rng.uniform(0, 1.2, size=(n_people, 1, 1, 3)) + np.cumsum(
        rng.normal(scale=0.04, size=(n_people, n_frames, 1, 3)), axis=1
    )
    truth_m = walks_m + STANDING_M
    names = np.tile(np.arange(n_people)[:, None], n_frames)
    for frame in rng.integers(1, n_frames, size=n_people):
        a, b = rng.choice(n_people, size=2, replace=False)
        names[[a, b], frame:] = names[[b, a], frame:]
        names[rng.integers(n_people), frame // 2 :] = names.max() + 1
    noisy_m = truth_m + rng.normal(scale=0.15, size=(n_people, n_frames, 1, 3))
    noisy_m += rng.normal(scale=0.05, size=noisy_m.shape)
    for person in range(n_people):
        for positions_m, longest in ((truth_m, n_frames // 8), (noisy_m, n_frames // 4)):
            for begin in rng.integers(0, n_frames, size=2):
                positions_m[person, begin : begin + rng.integers(1, longest)] = np.nan
    for positions_m in (truth_m, noisy_m):
        positions_m[rng.uniform(size=positions_m.shape[:-1]) < 0.1] = np.nan
    estimate_m = {}
    for name in np.unique(names):
        estimate_m[int(name)] = np.full((n_frames, 4, 3), np.nan)
        person, frame = np.nonzero(names == name)
        estimate_m[int(name)][frame] = noisy_m[person, frame]
    ghost_m = rng.uniform(0, 1.2, size=(n_frames, 1, 3)) + STANDING_M
    estimate_m[1000] = only(ghost_m, slice(n_frames // 3, n_frames // 2))
    return {name: _cut(each) for name, each in estimate_m.items()}, {n: make(each) for n, each in enumerate(truth_m)}


def _cut(positions_m: np.ndarray) -> Trajectory:
    """A trajectory that begins and ends with its person; empty for one who is never there."""
    there = np.flatnonzero(np.isfinite(positions_m).all(axis=-1).any(axis=-1))
    frames = np.arange(there.min(initial=len(positions_m)), there.max(initial=-1) + 1)
    return make(positions_m[frames], frames / FPS)
