"""Cameras that now and then see a body far from where the others see it."""

from __future__ import annotations

import warnings
from collections.abc import Collection

import numpy as np

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity

# Of undamaged recordings, occluded or not, one frame in a hundred at most has a camera most of whose joints are so far
# from those of the others.
_FAR_M, _OFTEN = 0.3, 0.04
_LEAST_JOINTS = 4


def seen_elsewhere(examined: Examined, explained: Collection[str]) -> list[Finding]:
    """Somebody else, a reflection, a picture: in some images, where cameras agree in others.

    Args:
        examined: whose cameras agree as a rule.
        explained: cameras of which it is known already why they see people elsewhere.
    """
    geometry, names = examined.geometry, examined.rig.names
    found = geometry.state.agreement
    if geometry.explanation is not None or geometry.odd or geometry.wrong or len(names) < 3:
        return []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of images without anybody: NaN
        of_body_m = np.nanmedian(np.where(found.judged, found.distance_m, np.nan), axis=1)
    judged = found.judged.sum(axis=1) >= _LEAST_JOINTS
    far = judged & (of_body_m > _FAR_M)
    often = far.sum(axis=0) > _OFTEN * np.maximum(judged.sum(axis=0), 1)
    cameras = [c for c in np.flatnonzero(often).tolist() if names[c] not in explained]
    if not cameras:
        return []
    share, at_s = float(far[:, cameras].any(axis=1).mean()), geometry.state.scene.time_s
    when = at_s[far[:, cameras].any(axis=1)]
    who = ", ".join(names[c] for c in cameras)
    outvoted = len(cameras) == 1
    believed = (
        "the others outvote it" if outvoted else "which of them is right is not told, and what comes out is wrong then"
    )
    return [
        Finding(
            Code.DISAGREEING_CAMERA,
            Severity.DOUBTFUL if outvoted else Severity.WRONG,
            f"{who} see{'s' if len(cameras) == 1 else ''} a body {_FAR_M:.1f} m or more from where others see it in "
            f"{100 * share:.0f} % of the images: {believed}",
            "Is somebody else in its images then, a reflection, a picture? Detect everybody and use --people all, or "
            "leave such cameras out with --cameras.",
            0.8,
            camera=names[cameras[0]] if len(cameras) == 1 else "",
            from_s=float(when[0]),
            to_s=float(when[-1]),
            numbers={"share": share},
        )
    ]
