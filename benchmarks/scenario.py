"""What every benchmark runs on: 17 joints, 4 cameras, 50 Hz, real motion, synthetic detections, one seed."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose import Config, load_rig, load_skeleton
from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.sources import Sources, open_sources
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    motion_from_npz,
    ring_rig,
    simulate,
)

# Punching on the spot: the person stays in all four images, so that every detection there can be is there.
_CLIP = Path(__file__).parent / "fgpose_benchmarks" / "data" / "mocap_cmu" / "cmu_02_05.npz"
_CLIP_FRAMES = 400  # as in the measurements so far: longer runs swing through the same eight seconds
_SEED = 0
_HELD_BY = {"pinky": "wrist", "index": "wrist", "thumb": "wrist", "heel": "ankle", "foot_index": "ankle"}
POSITIONS_ONLY = Config(solver={"covariance": False})
"""What aniposelib gives too; what the covariances cost is measured by itself."""


def scene(n_frames: int, occlusion: Occlusion = NO_OCCLUSION) -> Scene:
    """The start of the clip or, beyond its end, the clip back and forth."""
    clip_m, fps = motion_from_npz(_CLIP)
    clip_m = clip_m[:_CLIP_FRAMES]
    truth_m = clip_m[:n_frames] if n_frames <= len(clip_m) else _back_and_forth(clip_m, n_frames)
    return simulate(truth_m, load_skeleton("h36m_17"), ring_rig(), fps, DetectionNoise(), occlusion, _SEED)


def scene_of_33_joints(n_frames: int) -> Scene:
    """The same motion at 60 Hz with the joints of BlazePose: hands, feet and face keep their place beside wrist, ankle
    and head."""
    body, skeleton = scene(n_frames), load_skeleton("blazepose_33")
    named = body.observations.skeleton
    rng = np.random.default_rng(_SEED)

    def place_m(joint: str) -> Float[np.ndarray, "frame 3"]:
        if joint in named.joints:
            return body.truth_m[:, named.index(joint)]
        side, _, part = joint.partition("_")
        holder = f"{side}_{_HELD_BY[part]}" if part in _HELD_BY else "head"
        return body.truth_m[:, named.index(holder)] + rng.uniform(-0.08, 0.08, 3)

    truth_m = np.stack([place_m(joint) for joint in skeleton.joints], axis=1)
    return simulate(truth_m, skeleton, ring_rig(), 60.0, DetectionNoise(), NO_OCCLUSION, _SEED)


def _back_and_forth(clip_m: Float[np.ndarray, "clip joint 3"], n_frames: int) -> Float[np.ndarray, "frame joint 3"]:
    """The clip swings to its end and back: it slows down where it turns and is nowhere faster than recorded."""
    from scipy.interpolate import CubicSpline

    half = (len(clip_m) - 1) / 2
    at = half * (1.0 - np.cos(np.arange(n_frames) / half))
    return np.asarray(CubicSpline(np.arange(len(clip_m)), clip_m)(at))


def demo_sources() -> Sources:
    """The four demonstration videos of one person and their cameras, fetched at the first use."""
    folder = fetch_demo_videos()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two of the videos are 8 px narrower than their calibration
        return open_sources(folder / "videos", load_rig(folder / "calibration" / "Calib.qca.txt"))
