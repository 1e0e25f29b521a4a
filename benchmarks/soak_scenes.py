"""Random scenes that are hard on an estimator: everything that a rig, a network or a clock does wrong, drawn by a seed.

Made in parts of bounded length, so that a run may be as long as it likes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import fgpose
import fgpose_benchmarks
from fgpose.config import config_from_dict
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, motion_from_npz, ring_rig, simulate

_CLIPS = Path(fgpose_benchmarks.__file__).parent / "data" / "mocap_cmu"
_PART_FRAMES = 1000
_UNIX_TIME_S = 1.7e9  # doubles are then 0.2 us apart
_AWAY_M = 3.0
_MOST_POINTS = 600  # joints of all frames in the window: more can take a second an update
TROUBLES = (
    "missing detections",
    "lost cameras",
    "bursts of 200 px",
    "joints at one point",
    "clock jumps",
    "frames within microseconds",
    "person returns 3 m away",
    "repeated and old frames",
)


@dataclass(frozen=True, eq=False)
class SoakConditions:
    """The conditions of one run."""

    seed: int
    rig: fgpose.CameraRig
    skeleton: fgpose.Skeleton
    config: fgpose.Config
    clip_m: Float[np.ndarray, "frame joint 3"]
    clip_fps: float
    fps: float
    missing_share: float
    """Share of all detections that is missing, in intervals."""
    with_3d: bool
    starts_s: float
    troubles: frozenset[str]

    @property
    def conditions(self) -> list[str]:
        """What this run has in common with others, as the rows of a table."""
        return [
            f"{self.rig.n_cameras} cameras",
            "with per-view 3D" if self.with_3d else "2D only",
            f"motion {self.config.motion.model}",
            f"symmetry {self.config.symmetry.form}",
            f"solver {self.config.online.solver}",
            "up to 10 joints" if self.skeleton.n_joints <= 10 else "more than 10 joints",
            "up to 50 Hz" if self.fps <= 50 else "more than 50 Hz",
            "lag up to 0.5 s" if self.config.online.lag_s <= 0.5 else "lag above 0.5 s",
            *sorted(self.troubles),
        ]


def draw(seed: int) -> SoakConditions:
    """The conditions of a seed; half of the troubles each."""
    rng = np.random.default_rng(seed)
    clips = sorted(_CLIPS.glob("*.npz"))
    clip_m, clip_fps = motion_from_npz(clips[rng.integers(len(clips))])
    skeleton, clip_m = _body(int(rng.integers(3, 34)), clip_m)
    fps = float(rng.uniform(15, 120))
    lag_s = np.clip(rng.uniform(0.1, 1.0), 0.1, max(0.1, _MOST_POINTS / (skeleton.n_joints * fps)))
    troubles = frozenset(trouble for trouble in TROUBLES if rng.random() < 0.5)
    return SoakConditions(
        seed=seed,
        rig=ring_rig(int(rng.integers(1, 6))),
        skeleton=skeleton,
        config=_config(rng, float(lag_s)),
        clip_m=clip_m,
        clip_fps=clip_fps,
        fps=fps,
        missing_share=float(rng.uniform(0, 0.7)),
        with_3d=bool(rng.random() < 0.5),
        starts_s=float(rng.choice([0.0, _UNIX_TIME_S])),
        troubles=troubles,
    )


def _config(rng: np.random.Generator, lag_s: float) -> fgpose.Config:
    def one_of(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    return config_from_dict(
        {
            "motion": {
                "model": one_of("constant_velocity", "constant_velocity", "random_walk", "none"),
                "adaptive": one_of(True, True, False),
                "max_unseen_s": one_of(3.0, 3.0, 0.2, 1e4),
            },
            "symmetry": {"form": one_of("shared_length", "shared_length", "frame", "none")},
            "projection": {
                "kernel": one_of("cauchy", "cauchy", "none", "huber", "geman_mcclure", "tukey"),
                "weighting": one_of("fusion", "fusion", "confidence", "uniform"),
            },
            "depth": {"use": one_of("few_views", "never", "always")},
            "online": {
                "lag_s": lag_s,
                "relinearize_m": one_of(0.03, 0.03, 0.01),
                "covariance": one_of(True, True, False),
                "estimate_time_offsets": one_of(False, False, True),
                "solver": one_of("isam2", "window"),
            },
        }
    )


def _body(n_joints: int, clip_m: np.ndarray) -> tuple[fgpose.Skeleton, np.ndarray]:
    """A connected part of the body, or the body with markers that its joints carry."""
    whole = load_skeleton("h36m_17")
    kept = list(whole.root)
    while len(kept) < min(n_joints, whole.n_joints):
        kept.append(next(b for a, b in whole.bones if a in kept and b not in kept))
    number = {joint: index for index, joint in enumerate(kept)}
    n_markers = n_joints - len(kept)

    def among(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((number[a], number[b]) for a, b in pairs if a in number and b in number)

    skeleton = fgpose.Skeleton(
        name=f"soak_{n_joints}",
        joints=(*(whole.joints[joint] for joint in kept), *(f"marker_{marker}" for marker in range(n_markers))),
        bones=among(whole.bones) + tuple((marker, len(kept) + marker) for marker in range(n_markers)),
        root=(0,),
        left_right=among(whole.left_right),
        limbs=among(tuple(limb for limb in whole.limbs if number.keys() >= set(whole.mirrored(limb)))),
    )
    markers_m = clip_m[:, kept[:n_markers]] + np.array([0.05, 0.05, 0.05])
    return skeleton, np.concatenate([clip_m[:, kept], markers_m], axis=1)


def parts(soak: SoakConditions, n_frames: int) -> Iterator[fgpose.Observations]:
    """The recording of a run, time after time."""
    time_s = soak.starts_s
    for number, first in enumerate(range(0, n_frames, _PART_FRAMES)):
        part = _part(soak, np.random.default_rng([soak.seed, number]), first, min(_PART_FRAMES, n_frames - first))
        moved_s = time_s + part.frame_time_s
        # Two frames at one time are refused at the door; that is tried on purpose elsewhere.
        while (stuck := np.flatnonzero(np.diff(moved_s) <= 0)).size:
            moved_s[stuck + 1] = np.nextafter(moved_s[stuck], np.inf)
        yield replace(part, time_s=moved_s)
        time_s = moved_s[-1] + 1 / soak.fps


def _part(soak: SoakConditions, rng: np.random.Generator, first: int, n_frames: int) -> fgpose.Observations:
    truth_m = _swinging(soak, first, n_frames)
    hidden = np.zeros((n_frames, soak.rig.n_cameras), dtype=bool)
    if "person returns 3 m away" in soak.troubles:
        for leaves in rng.integers(0, n_frames, 1 + n_frames // 200):
            returns = min(leaves + int(rng.uniform(0.2, 4.0) * soak.fps), n_frames - 1)
            hidden[leaves:returns] = True
            angle = rng.uniform(0, 2 * np.pi)
            truth_m[returns:] += _AWAY_M * np.array([np.cos(angle), np.sin(angle), 0.0])
            truth_m[returns:] -= np.round(truth_m[returns:].mean(axis=(0, 1)) / _AWAY_M) * [_AWAY_M, _AWAY_M, 0.0]
    occlusion = Occlusion(n_views=int(rng.integers(0, soak.rig.n_cameras + 1)))
    seed = int(rng.integers(2**31))
    seen = simulate(truth_m, soak.skeleton, soak.rig, soak.fps, DetectionNoise(), occlusion, seed).observations
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    if "lost cameras" in soak.troubles:
        hidden |= _stretches(rng, hidden.shape, 0.3, (0.2 * soak.fps, 4.0 * soak.fps))
    points2d_px[hidden] = np.nan
    if "missing detections" in soak.troubles:
        points2d_px[_stretches(rng, points2d_px.shape[:3], soak.missing_share, (1, 40))] = np.nan
    if "bursts of 200 px" in soak.troubles:
        wild = _stretches(rng, points2d_px.shape[:3], 0.05, (1, 15))
        points2d_px[wild] += rng.uniform(-200, 200, (*wild.shape, 2))[wild]
    if "joints at one point" in soak.troubles:
        _put_at_one_point(rng, soak, points2d_px, confidence)
    return replace(
        seen,
        points2d_px=points2d_px,
        confidence=confidence,
        points3d_m=_known(seen.points3d_m, points2d_px) if soak.with_3d else None,
        covariance3d_m2=seen.covariance3d_m2 if soak.with_3d else None,
        time_s=_times_s(rng, soak, n_frames),
    )


def _swinging(soak: SoakConditions, first: int, n_frames: int) -> np.ndarray:
    """The motion through the clip and back, at the run's frame rate."""
    last = len(soak.clip_m) - 1
    at = np.arange(first, first + n_frames) / soak.fps * soak.clip_fps
    at = last - np.abs(last - at % (2 * last))
    below = np.minimum(at.astype(int), last - 1)
    share = (at - below)[:, None, None]
    return (1 - share) * soak.clip_m[below] + share * soak.clip_m[below + 1]


def _stretches(
    rng: np.random.Generator, shape: tuple[int, ...], share: float, frames: tuple[float, float]
) -> np.ndarray:
    """True for about this share of the frames (first axis), in intervals, independently along the other axes."""
    chosen = np.zeros(shape, dtype=bool).reshape(shape[0], -1)
    for column in chosen.T:
        start = 0
        while start < shape[0]:
            length = max(1, round(rng.uniform(*frames)))
            column[start : start + length] = rng.random() < share
            start += length
    return chosen.reshape(shape)


def _put_at_one_point(
    rng: np.random.Generator, soak: SoakConditions, points2d_px: np.ndarray, confidence: np.ndarray
) -> None:
    """Two joints of a bone, or any number of joints, at one pixel in every view; here and there from the start."""
    n_frames = len(points2d_px)
    for start in [0, *rng.integers(0, n_frames, 1 + n_frames // 100)]:
        frames = slice(start, start + int(rng.integers(1, 30)))
        joints = list(soak.skeleton.bones[rng.integers(len(soak.skeleton.bones))])
        if rng.random() < 0.3:
            joints = rng.permutation(soak.skeleton.n_joints)[: rng.integers(2, soak.skeleton.n_joints + 1)].tolist()
        for joint in joints:
            points2d_px[frames, :, joint] = points2d_px[frames, :, joints[0]]
            confidence[frames, :, joint] = confidence[frames, :, joints[0]]


def _known(points3d_m: np.ndarray | None, points2d_px: np.ndarray) -> np.ndarray | None:
    """The per-view 3D of what is detected."""
    return (
        None if points3d_m is None else np.where(np.isnan(points2d_px).any(axis=-1, keepdims=True), np.nan, points3d_m)
    )


def _times_s(rng: np.random.Generator, soak: SoakConditions, n_frames: int) -> np.ndarray:
    steps_s = np.full(n_frames, 1 / soak.fps)
    if "clock jumps" in soak.troubles:
        jumps = rng.integers(0, n_frames, 1 + n_frames // 200)
        steps_s[jumps] += rng.choice([0.1, 1.0, 10.0, 3600.0, 1e6], jumps.size)
    if "frames within microseconds" in soak.troubles:
        steps_s[_stretches(rng, (n_frames,), 0.1, (1, 40))] = rng.choice([1e-4, 1e-6, 1e-9])
    return np.cumsum(steps_s)
