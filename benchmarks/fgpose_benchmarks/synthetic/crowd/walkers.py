"""People who walk through a room so that cameras can be calibrated from them, and those who do what does not help."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.body_motion import ANKLE_M
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion, crowd_motion, motion_on
from fgpose_benchmarks.synthetic.crowd.routes import CrowdPlan, Route
from fgpose_benchmarks.synthetic.motion import embedded_motion

Behaviour = Literal["walks", "line", "spot", "stands"]
"""All over the floor, with short stops; to and fro on one line; works on one spot; stands still."""
Clips = Literal["tuning", "test"]

FPS = 50.0
"""Of the true motion."""
_WALK = "cmu_02_01_short"
_WORKS = {"tuning": ("cmu_02_05",), "test": ("cmu_02_07_a", "cmu_02_10")}
"""What people do at their stops; the same clips as in the benchmark of several people."""
_LINE_S = 3.2  # one way; 1.1 m/s on 2.8 m
_TURN_S = 0.8
_MARGIN_M = 0.6  # of a line from the walls


def walkers(
    floor_m: tuple[float, float],
    duration_s: float,
    seed: int,
    behaviour: Behaviour = "walks",
    n_people: int = 1,
    clips: Clips = "tuning",
) -> CrowdMotion:
    """The true motion; the first person is always there, the others come and go.

    Args:
        floor_m: of a room around the world's origin.
        n_people: of whom all but the first walk; more than one only with "walks".
        clips: defaults may be chosen on "tuning", results are stated on "test".

    Raises:
        ValueError: there are several people of another behaviour, or they find no way around each other.
    """
    gait, works = embedded_motion(_WALK), [embedded_motion(name) for name in _WORKS[clips]]
    n_frames = int(duration_s * FPS) + 1
    if behaviour == "walks":
        plan = CrowdPlan(
            *floor_m,
            late_share=0.0 if n_people == 1 else CrowdPlan.late_share,
            leaving_share=0.0,
            returning_share=0.0,
            working_share=0.3,
            min_stop_s=0.3,
            max_stop_s=1.5,
        )
        return crowd_motion(n_people, n_frames, FPS, [gait], works, seed, plan)
    if n_people != 1:
        raise ValueError(f"only one person can be asked for who {behaviour}, not {n_people}")
    ground_m = _line_m(n_frames, floor_m[0]) if behaviour == "line" else np.full((n_frames, 2), 0.2)
    work = np.full(n_frames, 0 if behaviour == "spot" else -1)
    route = Route(ground_m, work, np.zeros(n_frames, dtype=bool))
    return motion_on(route, FPS, gait, works[seed % len(works)], seed)


def _line_m(n_frames: int, length_m: float) -> Float[np.ndarray, "frame 2"]:
    """To and fro along x, a little aside of the origin; whoever turns round stands for a moment."""
    time_s = np.arange(n_frames) / FPS
    leg, since_s = np.divmod(time_s, _LINE_S + _TURN_S)
    share = np.clip(since_s / _LINE_S, 0.0, 1.0)
    share = 0.5 - 0.5 * np.cos(np.pi * share)
    along = np.where(leg % 2 == 0, share, 1.0 - share) - 0.5
    return np.stack([(length_m - 2 * _MARGIN_M) * along, np.full(n_frames, 0.3)], axis=-1)


def stature_m(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """How tall the person of a synthetic motion is who stands straight, without shoes.

    The head of the bodies is about the top of the skull (data/mocap_cmu). Their spine is slightly bent when they
    stand: the lengths of its bones would add up to too much.
    """
    known = positions_m[np.isfinite(positions_m).all(axis=(1, 2))]
    lengths_m = skeleton.bone_lengths(known[:1])[0]

    def between(a: str, b: str) -> float:
        return float(lengths_m[skeleton.bones.index((skeleton.index(a), skeleton.index(b)))])

    leg_m = ANKLE_M + between("left_hip", "left_knee") + between("left_knee", "left_ankle")
    trunk_m = np.linalg.norm(known[:, skeleton.index("head")] - known[:, skeleton.index("pelvis")], axis=-1)
    return leg_m + float(np.quantile(trunk_m, 0.95))
