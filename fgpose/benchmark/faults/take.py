"""Recordings without a fault, whose truth is known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    crowd_motion,
    embedded_motion,
    real_errors,
    ring_rig,
    simulate,
)

FPS = 30.0
SECONDS = 24.0
_GAIT = "cmu_02_01_short"
# One person each, who walks about and works: the seed draws the route and the body.
CLIPS: tuple[tuple[str, str, int], ...] = (
    ("walk and punch", "cmu_02_05", 101),
    ("walk and bend", "cmu_02_07_a", 102),
    ("walk and wash", "cmu_02_10", 103),
    ("walk and climb", "cmu_01_04_a", 104),
    ("walk and work", "cmu_03_03_a", 105),
)
RIGS: tuple[tuple[str, int, tuple[int, ...]], ...] = (
    ("2 cameras", 4, (0, 1)),
    ("3 cameras", 4, (0, 1, 2)),
    ("4 cameras", 4, (0, 1, 2, 3)),
)
"""Name, cameras of the ring, and which of them are used."""


@dataclass(frozen=True, eq=False)
class Take:
    """One person in a room, seen by calibrated cameras."""

    clip: str
    rig_name: str
    rig: CameraRig
    """As it is; its file may say something else after a damage."""
    observations: Observations
    truth_m: Float[np.ndarray, "frame joint 3"]
    """World frame, metres."""
    seed: int

    @property
    def name(self) -> str:
        return f"{self.clip}, {self.rig_name}"

    def film(self, rig: CameraRig, truth_m: Float[np.ndarray, "frame joint 3"] | None = None) -> Observations:
        """The same motion, or another one, with these cameras and the same errors of detection."""
        return _filmed(self.truth_m if truth_m is None else truth_m, rig, self.seed)


def takes(clips: Sequence[tuple[str, str, int]] = CLIPS, seconds: float = SECONDS) -> Iterator[Take]:
    """Every clip with every rig."""
    for clip, work, seed in clips:
        truth_m = motion(work, seed, seconds)
        for rig_name, n_ring, used in RIGS:
            ring = ring_rig(n_ring, 5.0, 2.5, (0.0, 0.0, 0.9), focal_px=900.0, size_px=(1600, 1200))
            rig = ring.subset(ring.names[c] for c in used)
            yield Take(clip, rig_name, rig, _filmed(truth_m, rig, seed), truth_m, seed)


def motion(work: str, seed: int, seconds: float) -> Float[np.ndarray, "frame joint 3"]:
    """Of one person who is there all the time (h36m_17)."""
    n_frames = int(seconds * FPS)
    every = crowd_motion(1, n_frames, FPS, [embedded_motion(_GAIT)], [embedded_motion(work)], seed=seed)
    truth_m = every.truth_m[0]
    known = np.flatnonzero(np.isfinite(truth_m).all(axis=(1, 2)))
    return truth_m[known[0] : known[-1] + 1]


def _filmed(truth_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig, seed: int) -> Observations:
    """With the errors of a real network, which every camera has at other times."""
    skeleton = load_skeleton("h36m_17")
    source = ("openpose", "blazepose_heavy")[seed % 2]
    errors = real_errors(np.random.default_rng(seed), len(truth_m), rig.n_cameras, skeleton, FPS, (source,))
    return simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed, None, errors).observations
