"""A body that is mirrored in all views, as a whole or from the waist on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.verdict.handedness import handedness
from fgpose.diagnosis.body.limb_sides import exchanged_limbs, twist
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.skeleton import Skeleton

# +0.53 to +1.00 of two real recordings and of five motions with the errors of real detectors, a third of the joints
# hidden or not.
_MIRRORED = -0.4
# +0.6 to +1.0 of 173 recordings by 2 to 8 cameras, and less than -0.6 with arms or legs exchanged.
_TWISTED = -0.3


def mirrored(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> bool:
    """Whether a body is clearly one whose left joints are on the right; no where the legs are not known."""
    try:
        return handedness(positions_m, skeleton) < _MIRRORED
    except ValueError:
        return False


def mirrored_body(examined: Examined) -> list[Finding]:
    """Left and right exchanged throughout."""
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
