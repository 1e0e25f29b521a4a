"""A body that is mirrored in all views."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.handedness import handedness
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.skeleton import Skeleton

# +0.53 to +1.00 of two real recordings and of five motions with the errors of real detectors, a third of the joints
# hidden or not.
_MIRRORED = -0.4


def mirrored(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> bool:
    """Whether a body is clearly one whose left joints are on the right; no where the legs are not known."""
    try:
        return handedness(positions_m, skeleton) < _MIRRORED
    except ValueError:
        return False


def mirrored_body(examined: Examined) -> list[Finding]:
    """Left and right exchanged throughout."""
    if not mirrored(examined.body_m, examined.main.skeleton):
        return []
    return [
        Finding(
            Code.EXCHANGED_SIDES,
            Severity.WRONG,
            "The body is mirrored in all views: knees and feet point backwards if its left joints are on the left",
            "Left and right are exchanged in the keypoints (another order of joints, mirrored images in all cameras), "
            "or the world of the calibration is left-handed. Exchange the joints, or convert the calibration.",
            1.0,
        )
    ]
