"""What is wrong with a recording and its rig before anything is estimated."""

from __future__ import annotations

from fgpose.diagnosis.body.limb_sides import exchanged_limbs
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity

# Higher, cameras are named that only have the person partly hidden; lower, some of little use are not.
_FEW_SEEN = 0.5
# Hallucinations under occluders look like an exchange of one pair in up to 7 % (camera_checks); the estimator leaves
# them out.
_OFTEN_EXCHANGED = 0.1


def repaired(examined: Examined) -> list[Finding]:
    """What readers of files had to repair or to leave out."""
    return [
        Finding(Code.READ_WITH_REPAIRS, Severity.NOTE, remark, "Nothing is to be done if that is what you expect.", 0.0)
        for remark in examined.remarks
    ]


def exchanged_sides(examined: Examined) -> list[Finding]:
    """Cameras that exchange left and right, of arms or legs throughout, or in some frames."""
    throughout = exchanged_limbs(examined)
    if throughout:
        return throughout
    info = examined.info
    return [
        Finding(
            Code.EXCHANGED_SIDES,
            Severity.DOUBTFUL if camera.share_swapped > _OFTEN_EXCHANGED else Severity.NOTE,
            f"{camera.name} exchanges left and right in {100 * camera.share_swapped:.0f} % of the pairs that can be "
            "judged",
            "Whole poses that are turned are corrected; if errors stay, use another network.",
            0.5 * camera.share_swapped,
            camera=camera.name,
            numbers={"share": camera.share_swapped},
        )
        for camera in info.cameras
        if camera.name in info.suspected_swaps
    ]


def blind(examined: Examined) -> list[Finding]:
    """Cameras that see little."""
    shares = examined.seen.mean(axis=(0, 2))
    return [
        Finding(
            Code.BLIND_CAMERA,
            Severity.NOTE,
            f"{name} sees only {100 * share:.0f} % of the joints",
            "Look at its images: is the person in them, and not hidden?",
            0.2 * float(1 - share),
            camera=name,
            numbers={"share": float(share)},
        )
        for name, share in zip(examined.rig.names, shares.tolist(), strict=True)
        if share < _FEW_SEEN
    ]


def never_seen(examined: Examined) -> list[Finding]:
    """Joints that two cameras never see at once."""
    joints = examined.info.never_seen
    if not joints:
        return []
    return [
        Finding(
            Code.NEVER_SEEN,
            Severity.NOTE,
            f"Never seen by two cameras at once, so not estimated: {', '.join(joints)}",
            "Add a camera that sees them, or use a skeleton without them.",
            0.1,
        )
    ]
