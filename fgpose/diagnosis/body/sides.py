"""Left and right on the wrong sides: of the whole body or of arms or legs, in all views or in one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.from_people.verdict.handedness import handedness
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.consistency import consistency
from fgpose.diagnosis.hypotheses.geometry import Geometry
from fgpose.diagnosis.hypotheses.hypothesis import with_sides_exchanged
from fgpose.diagnosis.hypotheses.scene import SynchronousViews
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import spread_evenly
from fgpose.skeleton import Skeleton

LIMBS = {"arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle")}
_FRAMES = 60
# Share of the cost (consistency.cost) that is left with them exchanged: more than 1.3 in 114 recordings by 2 to 8
# cameras, so less than 0.77 where they are exchanged, 0.2 as a rule.
_LESS_COST = 0.7
# +0.53 to +1.00 of two real recordings and of five motions with the errors of real detectors, a third of the joints
# hidden or not.
_MIRRORED = -0.4
# +0.6 to +1.0 of 173 recordings by 2 to 8 cameras, and less than -0.6 with arms or legs exchanged.
_TWISTED = -0.3


def twist(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> float:
    """Whether hips and shoulders face the same way: +1 if so in all frames, -1 if never; NaN if that is not known."""
    across_m = [
        positions_m[:, skeleton.index(f"left_{joint}")] - positions_m[:, skeleton.index(f"right_{joint}")]
        for joint in ("hip", "shoulder")
        if {f"left_{joint}", f"right_{joint}"} <= set(skeleton.joints)
    ]
    if len(across_m) < 2:
        return np.nan
    along = np.sum(across_m[0] * across_m[1], axis=-1)
    along = along[np.isfinite(along)]
    total = float(np.abs(along).sum())
    return float(along.sum()) / total if total > 0 else np.nan


def exchanged_limbs(examined: Examined) -> list[Finding]:
    """Cameras that agree with the others only if left and right arms, or legs, are exchanged in them; not both."""
    if examined.rig.n_cameras < 2 or not _may_exchange(examined.geometry):
        return []
    scene, skeleton = examined.scene(spread_evenly(examined.main.n_frames, _FRAMES)), examined.main.skeleton
    found: dict[str, int] = {}
    for limbs, joints in LIMBS.items():
        both = [f"{side}_{name}" for name in joints for side in ("left", "right")]
        own = [skeleton.index(joint) for joint in both if joint in skeleton.joints]
        camera = _exchanging(scene, np.array(own), skeleton) if own else None
        if camera is not None:
            found[limbs] = camera
    if len(found) > 1 and (scene.n_cameras == 2 or len(set(found.values())) == 1):
        return []  # of a whole view the explanation tells
    return [_exchanged(examined.rig.names[camera], limbs) for limbs, camera in found.items()]


def _may_exchange(geometry: Geometry) -> bool:
    """Whether a body is seen, or would be but for exchanged sides: two cameras may nearly agree all the same."""
    if geometry.explanation is None:
        return geometry.usable
    return all(cause.code is Code.EXCHANGED_SIDES for cause in geometry.explanation.causes)


def _exchanging(scene: SynchronousViews, joints: Int[np.ndarray, " joint"], skeleton: Skeleton) -> int | None:
    """The camera in which these joints are exchanged; None: in none. Two cameras agree whichever of them is mended, but
    a body whose arms are on the right sides is not twisted."""
    part, cameras = scene.joints(joints), range(scene.n_cameras)
    before = consistency(part).cost
    costs = [consistency(with_sides_exchanged(part, (c,))).cost for c in cameras]
    able = [c for c in cameras if costs[c] < _LESS_COST * before]
    if not able or len(cameras) > 2:
        return min(able, key=lambda c: costs[c], default=None)
    order = np.arange(skeleton.n_joints)
    order[joints] = skeleton.mirror[joints]
    mended = [scene.with_views({c: scene.views[c].joints(order)}) for c in able]
    return max(zip(able, mended, strict=True), key=lambda each: twist(consistency(each[1]).positions_m, skeleton))[0]


def _exchanged(camera: str, limbs: str) -> Finding:
    return Finding(
        Code.EXCHANGED_SIDES,
        Severity.WRONG,
        f"Left and right {limbs} are exchanged in {camera} throughout: exchanged back, they agree with those of the "
        "other cameras, and with the rest of the body",
        f"Exchange left and right {limbs} in its keypoints; does another network, or another order of joints, make "
        "them?",
        1.0,
        camera=camera,
        joint=limbs,
    )


def mirrored(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> bool:
    """Whether a body is clearly one whose left joints are on the right; no where the legs are not known."""
    try:
        return handedness(positions_m, skeleton) < _MIRRORED
    except ValueError:
        return False


def mirrored_body(examined: Examined) -> list[Finding]:
    """Left and right exchanged throughout."""
    examined.refuse_side_by_side()
    positions_m, skeleton = examined.body_m, examined.main.skeleton
    if twist(positions_m, skeleton) < _TWISTED:
        return exchanged_limbs(examined) or [_twisted_body(positions_m, skeleton)]
    if not mirrored(positions_m, skeleton):
        return []
    return [
        Finding(
            Code.EXCHANGED_SIDES,
            Severity.WRONG,
            "The body is mirrored in all views: knees and feet point backwards if its left joints are on the left",
            "Left and right are exchanged in the keypoints (another order of joints, mirrored images in all cameras), "
            "or the world of the calibration is left-handed: the recording does not tell which. Exchange the joints or "
            "convert the calibration.",
            1.0,
        )
    ]


def _twisted_body(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> Finding:
    """Knees and feet tell whether it is the arms or the legs."""
    order = np.arange(skeleton.n_joints)
    shoulders = [skeleton.index(f"{side}_shoulder") for side in ("left", "right")]
    order[shoulders] = shoulders[::-1]
    if mirrored(positions_m[:, order], skeleton):
        limbs, why = "legs", ": knees and feet point backwards if the left leg is on the left"
    elif mirrored(positions_m, skeleton):
        limbs, why = "arms", ": knees and feet point to where the hips do"
    else:
        limbs, why = "arms or legs", ""
    return Finding(
        Code.EXCHANGED_SIDES,
        Severity.WRONG,
        f"Hips and shoulders face opposite ways in all views, so left and right {limbs} are exchanged{why}",
        f"Exchange left and right {limbs} in the keypoints, or write a skeleton file with the joints in their order "
        "(--skeleton my.toml).",
        1.0,
    )
