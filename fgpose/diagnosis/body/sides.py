"""A body that is mirrored in all views."""

from __future__ import annotations

from fgpose.calibration.from_people.handedness import handedness
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity

# +0.53 to +1.00 of two real recordings and of five motions with the errors of real detectors, a third of the joints
# hidden or not.
_MIRRORED = -0.4


def mirrored_body(examined: Examined) -> list[Finding]:
    """Left and right exchanged throughout."""
    skeleton = examined.main.skeleton
    try:
        side = handedness(examined.body_m, skeleton)
    except ValueError:  # no legs
        return []
    if side > _MIRRORED:
        return []
    return [
        Finding(
            Code.EXCHANGED_SIDES,
            Severity.WRONG,
            "The body is mirrored in all views: knees and feet point backwards if its left joints are on the left",
            "Left and right are exchanged in the keypoints (another order of joints, mirrored images in all cameras), "
            "or the world of the calibration is left-handed. Exchange the joints, or convert the calibration.",
            1.0,
            numbers={"handedness": side},
        )
    ]
