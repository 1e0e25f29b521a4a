"""Recordings without a fault, whose truth is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    real_errors,
    simulate,
)
from fgpose_benchmarks.synthetic.rig import look_at

FPS = 30.0
SECONDS = 16.0
_GAIT = "cmu_02_01_short"
# One person each, who walks about and works: the seed draws the route and the body.
CLIPS: tuple[tuple[str, str, int], ...] = (
    ("walk and punch", "cmu_02_05", 101),
    ("walk and bend", "cmu_02_07_a", 102),
    ("walk and wash", "cmu_02_10", 103),
    ("walk and climb", "cmu_01_04_a", 104),
    ("walk and work", "cmu_03_03_a", 105),
)
RIGS: Mapping[str, tuple[int, ...]] = {"2 cameras": (0, 1), "3 cameras": (0, 1, 2), "4 cameras": (0, 1, 2, 3)}
"""Which cameras of the room are used. They stand as in no ring: one that is turned or mirrored looks like itself."""
_N_CONTROLS, _OCCLUDER = 6, Occlusion(n_views=1, n_occluders=1)
# Of a detector that misses people now and then, by decimetres: these may be said to be seen elsewhere, as a note.
_N_MISSED, _MISSING = 2, "blazepose_full"
_PLACES_M = ((4.6, 1.2, 2.4), (0.9, 4.9, 1.7), (-5.2, -0.6, 2.9), (-1.1, -4.3, 2.1))
_FOCAL_PX, _SIZE_PX, _TARGET_M = 900.0, (1600, 1200), (0.0, 0.0, 0.9)


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
    is_control: bool = field(default=False, kw_only=True)
    """Whether it is never damaged: one of many in which nothing may be found."""

    @property
    def name(self) -> str:
        return f"{self.clip}, {self.rig_name}"

    @property
    def is_real(self) -> bool:
        """Whether a network detected the body in real images; its truth is an estimate then."""
        return False

    @property
    def truth_covariance_m2(self) -> Float[np.ndarray, "frame joint 3 3"] | None:
        """Of the truth, where it is an estimate."""
        return None

    def film(self, rig: CameraRig, truth_m: Float[np.ndarray, "frame joint 3"] | None = None) -> Observations:
        """The same motion, or another one, with these cameras, the same errors of detection and no occluders."""
        return _filmed(self.truth_m if truth_m is None else truth_m, rig, self.seed)


def takes(clips: Sequence[tuple[str, str, int]] = CLIPS, seconds: float = SECONDS) -> Iterator[Take]:
    """Every clip with every rig."""
    for clip, work, seed in clips:
        yield from _by_each_rig(clip, motion(work, seed, seconds), seed)


def controls(clips: Sequence[tuple[str, str, int]] = CLIPS) -> Iterator[Take]:
    """Other people on other routes, every other one with an occluder before some camera at any time; the last ones seen
    by a worse detector."""
    for clip, work, seed in clips:
        for k in range(1, _N_CONTROLS + _N_MISSED + 1):
            other, occlusion = seed + 1000 * k, NO_OCCLUSION if k % 2 else _OCCLUDER
            source, truth_m = _MISSING if k > _N_CONTROLS else None, motion(work, other, SECONDS)
            yield from _by_each_rig(f"{clip}, control {k}", truth_m, other, occlusion, is_control=True, source=source)


def _by_each_rig(
    clip: str,
    truth_m: Float[np.ndarray, "frame joint 3"],
    seed: int,
    occlusion: Occlusion = NO_OCCLUSION,
    *,
    is_control: bool = False,
    source: str | None = None,
) -> Iterator[Take]:
    for rig_name, used in RIGS.items():
        rig = CameraRig(tuple(_camera(c) for c in used))
        seen = _filmed(truth_m, rig, seed, occlusion, source)
        yield Take(clip, rig_name, rig, seen, truth_m, seed, is_control=is_control)


def _camera(number: int) -> Camera:
    K = np.array([[_FOCAL_PX, 0.0, _SIZE_PX[0] / 2], [0.0, _FOCAL_PX, _SIZE_PX[1] / 2], [0.0, 0.0, 1.0]])
    pose = look_at(np.array(_PLACES_M[number]), np.array(_TARGET_M))
    return Camera(f"cam{number + 1}", _SIZE_PX, K, pose, np.zeros(0))


def motion(work: str, seed: int, seconds: float) -> Float[np.ndarray, "frame joint 3"]:
    """Of one person who is there all the time (h36m_17)."""
    n_frames = int(seconds * FPS)
    every = crowd_motion(1, n_frames, FPS, [embedded_motion(_GAIT)], [embedded_motion(work)], seed=seed)
    truth_m = every.truth_m[0]
    known = np.flatnonzero(np.isfinite(truth_m).all(axis=(1, 2)))
    return truth_m[known[0] : known[-1] + 1]


def _filmed(
    truth_m: Float[np.ndarray, "frame joint 3"],
    rig: CameraRig,
    seed: int,
    occlusion: Occlusion = NO_OCCLUSION,
    source: str | None = None,
) -> Observations:
    """With the errors of a real network (None: one of two), which every camera has at other times."""
    skeleton = load_skeleton("h36m_17")
    source = source or ("openpose", "blazepose_heavy")[seed % 2]
    errors = real_errors(np.random.default_rng(seed), len(truth_m), rig.n_cameras, skeleton, FPS, (source,))
    return simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), occlusion, seed, None, errors).observations
