"""True motion for synthetic scenes: a parametric walking person, and clips of motion capture."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.arrays import checked, read_arrays
from fgpose.io.skeletons import load_skeleton
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton


def walking(n_frames: int, fps: float, skeleton: Skeleton | None = None) -> Float[np.ndarray, "frame joint 3"]:
    """A person of 1.7 m who walks on a circle of 1 m radius around the origin, floor at z = 0; metres.

    Bones are rigid and mirrored ones equally long; the motion is smooth. The skeleton is h36m_17 or any other whose
    joints have these names.

    Raises:
        ValueError: the skeleton has a joint that the walker lacks.
    """
    skeleton = skeleton or load_skeleton("h36m_17")
    time_s = np.arange(n_frames) / fps
    phase = 2 * np.pi * 0.95 * time_s  # strides of 1.26 m at 1.2 m/s
    body = _walker(phase)
    unknown = [joint for joint in skeleton.joints if joint not in body]
    if unknown:
        raise ValueError(f"the walking person has no joint {', '.join(unknown)} of skeleton {skeleton.name}")
    heading = 1.2 * time_s
    on_circle = np.stack([np.sin(heading), -np.cos(heading), 0.9 + 0.015 * np.cos(2 * phase)], axis=-1)
    in_body = np.stack([body[joint] for joint in skeleton.joints], axis=1)
    return turned(in_body, heading[:, None]) + on_circle[:, None]


def _walker(phase: Float[np.ndarray, " frame"]) -> dict[str, Float[np.ndarray, "frame 3"]]:
    """Joints around the pelvis: x forward, y left, z up."""
    zero = np.zeros(phase.size)

    def at(*xyz_m: float) -> Float[np.ndarray, "frame 3"]:
        return np.tile(xyz_m, (phase.size, 1))

    def hanging(angle: Float[np.ndarray, " frame"], length_m: float) -> Float[np.ndarray, "frame 3"]:
        return length_m * np.stack([np.sin(angle), zero, -np.cos(angle)], axis=-1)

    body = {"pelvis": at(0.0, 0.0, 0.0), "spine": at(0.0, 0.0, 0.23), "thorax": at(0.01, 0.0, 0.48)}
    body |= {"neck_base": at(0.03, 0.0, 0.58), "head": at(0.04, 0.0, 0.78)}
    for side, y, step in (("left", 1.0, phase), ("right", -1.0, phase + np.pi)):
        thigh, knee = 0.45 * np.sin(step), 0.35 + 0.3 * np.cos(step)
        arm, elbow = -0.4 * np.sin(step), 0.35 - 0.15 * np.sin(step)
        body[f"{side}_hip"] = turned(at(0.0, 0.09 * y, -0.01), 0.1 * np.sin(phase))
        body[f"{side}_knee"] = body[f"{side}_hip"] + hanging(thigh, 0.43)
        body[f"{side}_ankle"] = body[f"{side}_knee"] + hanging(thigh - knee, 0.41)
        body[f"{side}_shoulder"] = body["thorax"] + turned(at(0.0, 0.17 * y, 0.02), -0.12 * np.sin(phase))
        body[f"{side}_elbow"] = body[f"{side}_shoulder"] + hanging(arm, 0.28)
        body[f"{side}_wrist"] = body[f"{side}_elbow"] + hanging(arm + elbow, 0.25)
    return body


def turned(points_m: Float[np.ndarray, "*points 3"], angle: np.ndarray) -> Float[np.ndarray, "*points 3"]:
    """Turned around the vertical (z) by angles in radians."""
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z], axis=-1)


def embedded_motion(clip: str) -> tuple[Float[np.ndarray, "frame joint 3"], float]:
    """Motion capture that comes with fgpose (skeleton h36m_17; data/mocap_cmu has a README), as motion_from_npz.

    Raises:
        OSError: there is no such clip.
    """
    with resources.as_file(resources.files("fgpose_benchmarks").joinpath("data", "mocap_cmu", f"{clip}.npz")) as path:
        return motion_from_npz(path)


def motion_from_npz(path: str | Path) -> tuple[Float[np.ndarray, "frame joint 3"], float]:
    """Joint positions in metres and frames per second of a motion clip: an npz file with positions_m and fps.

    Raises:
        ValueError: the file is not an npz, lacks one of these arrays, or positions_m is not (frames, joints, 3) of
            finite numbers.
        OSError: the file cannot be read.
    """
    with naming(path, "not a motion clip"):
        arrays = read_arrays(Path(path))
        positions_m = checked(arrays, "positions_m", "numbers", None, None, 3).astype(float)
        fps = float(checked(arrays, "fps", "numbers"))
    if not np.isfinite(positions_m).all():
        raise ValueError(f"{path}: positions_m must be finite")
    if not 0 < fps < np.inf:
        raise ValueError(f"{path}: fps must be a positive number, got {fps:g}")
    return positions_m, fps
