"""Whole bodies: moving hands and a speaking face on a motion of the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.noise import DetectionNoise
from fgpose_benchmarks.synthetic.occlusion import NO_OCCLUSION, Occlusion
from fgpose_benchmarks.synthetic.scene import Scene, simulate

# Where each finger begins, from the wrist, and its bones, metres: along the forearm, across the palm.
_FINGERS = {
    "thumb": ((0.025, 0.03), (0.040, 0.032, 0.026)),
    "index": ((0.088, 0.025), (0.042, 0.025, 0.020)),
    "middle": ((0.090, 0.005), (0.046, 0.029, 0.021)),
    "ring": ((0.084, -0.015), (0.042, 0.027, 0.021)),
    "pinky": ((0.076, -0.033), (0.034, 0.020, 0.018)),
}
_JOINTS = {"thumb": ("cmc", "mcp", "ip", "tip")}
_OF_FINGERS = ("mcp", "pip", "dip", "tip")
# Of the head: forward, to the left, up; metres from the ends of the neck.
_HEAD = {
    "nose": (0.11, 0.0, 0.02),
    "left_eye": (0.09, 0.032, 0.06),
    "right_eye": (0.09, -0.032, 0.06),
    "left_ear": (0.0, 0.075, 0.04),
    "right_ear": (0.0, -0.075, 0.04),
}
# Of a foot, from the ankle: forward, to its outer side, up.
_FOOT = {"big_toe": (0.16, -0.02, -0.07), "small_toe": (0.13, 0.04, -0.07), "heel": (-0.05, 0.0, -0.07)}
# Points on the surface, metres from the joint that holds them, in the world.
_BESIDE = {
    "acromion": ("shoulder", (0.0, 0.0, 0.03)),
    "olecranon": ("elbow", (0.0, 0.02, 0.0)),
    "cubital_fossa": ("elbow", (0.0, -0.02, 0.0)),
}
_SPEECH_M, _SPEECH_HZ = 0.006, 2.5  # how far and how often the lips open


def whole_body_of(
    motion_m: Float[np.ndarray, "frame joint 3"], fps: float, skeleton: Skeleton
) -> Float[np.ndarray, "frame joint 3"]:
    """A motion of h36m_17 with hands that grasp and a face that speaks, as the joints of this skeleton.

    Bones of the hands and all of the head but the lips are rigid.

    Raises:
        ValueError: the skeleton has a joint that is not known.
    """
    given, time_s = load_skeleton("h36m_17"), np.arange(len(motion_m)) / fps
    at = {joint: motion_m[:, given.index(joint)] for joint in given.joints}
    at["neck"] = at["neck_base"]
    axes = _head_axes(at)
    for joint, place in (_HEAD | _face()).items():
        lips_m = np.zeros((len(time_s), 3))
        if "lower_lip" in joint:
            lips_m[:, 2] = -_SPEECH_M * (1 - np.cos(2 * np.pi * _SPEECH_HZ * time_s)) / 2
        at[joint] = at["neck_base"] + 0.1 * axes[:, 2] + np.einsum("tia,ti->ta", axes, lips_m + np.array(place))
    for side, outwards in (("left", 1.0), ("right", -1.0)):
        at |= _hand(side, outwards, at, time_s)
        forward = np.cross(_unit(at["left_hip"] - at["right_hip"]), (0.0, 0.0, 1.0))
        for part, (ahead_m, outer_m, up_m) in _FOOT.items():
            across = outwards * outer_m * np.cross((0.0, 0.0, 1.0), forward)
            at[f"{side}_{part}"] = at[f"{side}_ankle"] + ahead_m * forward + across + np.array([0.0, 0.0, up_m])
        at |= {f"{side}_{finger}": at[f"{side}_{finger}_mcp"] for finger in ("pinky", "index", "thumb")}
        at |= {f"{side}_foot_index": at[f"{side}_big_toe"], f"{side}_mouth": at[f"{side}_mouth_corner"]}
        for joint, (holder, offset_m) in _BESIDE.items():
            at[f"{side}_{joint}"] = at[f"{side}_{holder}"] + np.array(offset_m)
    unknown = [joint for joint in skeleton.joints if joint not in at]
    if unknown:
        raise ValueError(f"the whole body has no joint {', '.join(unknown)} of skeleton {skeleton.name}")
    return np.stack([at[joint] for joint in skeleton.joints], axis=1)


def simulate_whole_body(
    truth_m: Float[np.ndarray, "frame joint 3"],
    skeleton: Skeleton,
    rig: CameraRig,
    fps: float,
    noise: DetectionNoise,
    occlusion: Occlusion = NO_OCCLUSION,
    seed: int = 0,
) -> Scene:
    """As simulate; the errors of a part are smaller than those of the body by its relative_sigma. The occluders of a
    part are its own."""
    of_body = simulate(truth_m[:, skeleton.body], skeleton.of_joints(skeleton.body), rig, fps, noise, occlusion, seed)
    scenes = [(list(skeleton.body), of_body)]
    for number, part in enumerate(skeleton.parts):
        share = part.relative_sigma
        exact = replace(noise, sigma_px=share * noise.sigma_px, correlated_px=share * noise.correlated_px)
        hides = replace(occlusion, hallucination_px=share * occlusion.hallucination_px)
        own = skeleton.of_joints(part.joints, part.name)
        joints = list(part.joints)
        scenes.append((joints, simulate(truth_m[:, joints], own, rig, fps, exact, hides, seed + 1 + number)))
    first = scenes[0][1].observations
    shape = *first.points2d_px.shape[:2], skeleton.n_joints
    points2d_px, confidence, occluded = np.full((*shape, 2), np.nan), np.zeros(shape), np.zeros(shape, dtype=bool)
    for joints, scene in scenes:
        points2d_px[:, :, joints] = scene.observations.points2d_px
        confidence[:, :, joints] = scene.observations.confidence
        occluded[:, :, joints] = scene.occluded
    observations = replace(
        first,
        skeleton=skeleton,
        points2d_px=points2d_px,
        confidence=confidence,
        points3d_m=None,
        covariance3d_m2=None,
    )
    return Scene(truth_m, observations, occluded, rig)


def _head_axes(at: dict[str, np.ndarray]) -> Float[np.ndarray, "frame axis 3"]:
    """Forward, left and up of the head."""
    up = _unit(at["head"] - at["neck_base"])
    left = at["left_shoulder"] - at["right_shoulder"]
    left = _unit(left - np.sum(left * up, axis=-1, keepdims=True) * up)
    return np.stack([np.cross(left, up), left, up], axis=1)


def _hand(
    side: str, outwards: float, at: dict[str, np.ndarray], time_s: Float[np.ndarray, " frame"]
) -> dict[str, Float[np.ndarray, "frame 3"]]:
    """The hand goes on as the forearm does; each finger bends and stretches in its own time."""
    wrist_m = at[f"{side}_wrist"]
    along = _unit(wrist_m - at[f"{side}_elbow"])
    body = _unit(at["left_shoulder"] - at["right_shoulder"])
    palm = _unit(body - np.sum(body * along, axis=-1, keepdims=True) * along) * -outwards
    across = np.cross(palm, along) * -outwards
    hand = {f"{side}_hand_root": wrist_m}
    for number, (finger, ((ahead_m, beside_m), bones_m)) in enumerate(_FINGERS.items()):
        names = _JOINTS.get(finger, _OF_FINGERS)
        point_m = wrist_m + ahead_m * along + beside_m * across
        hand[f"{side}_{finger}_{names[0]}"] = point_m
        bend = 0.15 + 0.45 * (1 - np.cos(2 * np.pi * (0.4 + 0.15 * number) * time_s + number + outwards)) / 2
        for bone, (name, length_m) in enumerate(zip(names[1:], bones_m, strict=True), start=1):
            angle = (bone * bend)[:, None]
            point_m = point_m + length_m * (np.cos(angle) * along + np.sin(angle) * palm)
            hand[f"{side}_{finger}_{name}"] = point_m
    return hand


def _face() -> dict[str, tuple[float, float, float]]:
    """The 68 points of iBUG and the pupils: forward, left, up, metres; mirror images of each other."""
    points: dict[str, tuple[float, float, float]] = {
        "chin": (0.085, 0.0, -0.075),
        "nose_base": (0.10, 0.0, 0.0),
        "nose_tip": (0.11, 0.0, 0.02),
        "upper_lip": (0.1, 0.0, -0.02),
        "inner_upper_lip": (0.098, 0.0, -0.025),
        "inner_lower_lip": (0.098, 0.0, -0.028),
        "lower_lip": (0.097, 0.0, -0.036),
    }
    points |= {f"nose_bridge_{n}": (0.09 + 0.007 * n, 0.0, 0.068 - 0.012 * n) for n in range(1, 4)}
    half: dict[str, tuple[float, float, float]] = {}
    for n in range(1, 9):
        angle = (n - 1) / 8 * np.pi / 2
        half[f"jaw_{n}"] = (0.085 * np.sin(angle), 0.072 * np.cos(angle), 0.045 - 0.12 * np.sin(angle))
    for n in range(1, 6):
        half[f"brow_{n}"] = (0.08 + 0.004 * n, 0.058 - 0.009 * n, 0.08 + 0.004 * np.sin(n))
    half |= {"nostril_1": (0.1, 0.006, 0.003), "nostril_2": (0.095, 0.013, 0.005)}
    half |= {"eye_outer": (0.08, 0.045, 0.058), "eye_inner": (0.088, 0.018, 0.058), "pupil": (0.09, 0.032, 0.06)}
    half |= {"eye_upper_1": (0.086, 0.037, 0.064), "eye_upper_2": (0.088, 0.027, 0.064)}
    half |= {"eye_lower_1": (0.086, 0.037, 0.054), "eye_lower_2": (0.088, 0.027, 0.054)}
    half |= {"mouth_corner": (0.088, 0.025, -0.026), "inner_mouth_corner": (0.09, 0.02, -0.026)}
    half |= {"upper_lip_1": (0.094, 0.016, -0.021), "upper_lip_2": (0.099, 0.007, -0.018)}
    half |= {"lower_lip_1": (0.093, 0.016, -0.032), "lower_lip_2": (0.096, 0.007, -0.035)}
    half |= {"inner_upper_lip": (0.096, 0.009, -0.025), "inner_lower_lip": (0.096, 0.009, -0.028)}
    for joint, (ahead_m, left_m, up_m) in half.items():
        points |= {f"left_{joint}": (ahead_m, left_m, up_m), f"right_{joint}": (ahead_m, -left_m, up_m)}
    return points


def _unit(vectors: Float[np.ndarray, "frame 3"]) -> Float[np.ndarray, "frame 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
