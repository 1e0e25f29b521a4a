"""Which way is up, by the body and by the cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.finding import Code, Finding, Severity
from fgpose.skeleton import Skeleton

# Somebody who exercises on the floor does not lie in one direction all of the time: length of the mean of the trunk's
# directions.
_STEADY = 0.7
_LEAST_FRAMES = 10
# Further from up than anybody works; a trunk of somebody who sits or bends is nearer.
_LIES_DEG = 60.0
_ALIKE_DEG, _OTHERWISE_DEG = 50.0, 45.0
# Of a body that stands straight: leaning cancels where people turn, and is 10 degrees where they do not.
_TILTED_DEG, _STRAIGHT_DEG = 20.0, 15.0
_OFF_AXIS_DEG = 10.0
_NAMES, _DIRECTIONS = ("+x", "+y", "+z", "-x", "-y", "-z"), np.concatenate([np.eye(3), -np.eye(3)])
_AXES = dict(zip(_NAMES, _DIRECTIONS, strict=True))


def wrong_up(examined: Examined) -> list[Finding]:
    """A body that lies, stands on its head or leans throughout, where the cameras say that it does not."""
    body, steady = _direction(examined.body_m, examined.main.skeleton, "hip", "shoulder")
    if body is None:
        raise NotJudgedError("shoulders and hips are not seen")
    given = examined.world_up if examined.world_up[0] in "+-" else f"+{examined.world_up}"
    up, of_cameras = _AXES[given], _cameras_up(examined)
    if steady < _STEADY:
        return []
    away_deg = _angle_deg(body, up)
    cameras_agree = of_cameras is not None and _angle_deg(of_cameras, body) < _ALIKE_DEG
    if away_deg > _LIES_DEG:
        if of_cameras is not None and _angle_deg(of_cameras, up) < _OTHERWISE_DEG:
            return []  # who lies does so
        severity = Severity.WRONG if cameras_agree else Severity.DOUBTFUL
        return [_finding(body, of_cameras if cameras_agree else None, given, away_deg, severity)]
    if away_deg > _TILTED_DEG and cameras_agree and _stands_straight(examined, body):
        assert of_cameras is not None
        if _angle_deg(of_cameras, body) < _STRAIGHT_DEG:
            return [_tilted(given, away_deg)]
    return []


def _direction(
    positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton, low: str, high: str
) -> tuple[Float[np.ndarray, 3] | None, float]:
    """Mean of the directions from one pair of joints to another, and how alike they are: 1 if all are the same."""
    ends = []
    for name in (low, high):
        pair = [f"{side}_{name}" for side in ("left", "right")]
        if not set(pair) <= set(skeleton.joints):
            return None, 0.0
        ends.append(positions_m[:, [skeleton.index(joint) for joint in pair]].mean(axis=1))
    axis = ends[1] - ends[0]
    axis = axis[np.isfinite(axis).all(axis=-1)]
    if len(axis) < _LEAST_FRAMES:
        return None, 0.0
    mean = (axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)).mean(axis=0)
    return mean / max(float(np.linalg.norm(mean)), 1e-12), float(np.linalg.norm(mean))


def _cameras_up(examined: Examined) -> Float[np.ndarray, 3] | None:
    """Where the upper borders of the images point: cameras are mostly level. None where that is all over."""
    mean = np.mean([-camera.world_T_camera[:3, 1] for camera in examined.rig.cameras], axis=0)
    length = float(np.linalg.norm(mean))
    return mean / length if length > _STEADY / 2 else None


def _angle_deg(a: Float[np.ndarray, 3], b: Float[np.ndarray, 3]) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1, 1))))


def _stands_straight(examined: Examined, body: Float[np.ndarray, 3]) -> bool:
    legs, steady = _direction(examined.body_m, examined.main.skeleton, "ankle", "hip")
    return legs is not None and steady > _STEADY and _angle_deg(legs, body) < _STRAIGHT_DEG


def _finding(
    body: Float[np.ndarray, 3], cameras: Float[np.ndarray, 3] | None, given: str, away_deg: float, severity: Severity
) -> Finding:
    up = body if cameras is None else (body + cameras) / np.linalg.norm(body + cameras)
    name = max(_AXES, key=lambda each: float(_AXES[each] @ up))
    level = _angle_deg(up, _AXES[name])
    posture = "stands on the head" if away_deg > 180 - _LIES_DEG else "lies"
    witness = "and the upper borders of the images point the same way" if cameras is not None else ""
    if level > _OFF_AXIS_DEG:
        cause = f"up is probably near {name} ({level:.0f} degrees from it)"
        remedy = "Give --world-up auto, which levels the world by the people in it."
    else:
        cause = f"up is probably {name}"
        remedy = f"Give --world-up {name}."
    return Finding(
        Code.WORLD_UP,
        severity,
        f"The person {posture} throughout, if {given} of the world is up: heads are towards {name} of hips"
        f"{', ' + witness if witness else ''}. So {cause}",
        remedy,
        0.8,
        numbers={"angle_deg": away_deg},
    )


def _tilted(given: str, away_deg: float) -> Finding:
    return Finding(
        Code.WORLD_UP,
        Severity.DOUBTFUL,
        f"The world is tilted: a person who stands straight leans by {away_deg:.0f} degrees from {given} throughout, "
        "and the images lean alike",
        "Give --world-up auto, which levels the world by the people in it.",
        0.6,
        numbers={"angle_deg": away_deg},
    )
