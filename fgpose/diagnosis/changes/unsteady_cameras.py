"""Cameras that do not stand still, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgpose.calibration.changes.change import Change
from fgpose.calibration.changes.unsteadiness import WITHIN_S, unsteadiness_m
from fgpose.diagnosis.examined import Examined
from fgpose.estimation.evidence.image_checks.checks import without_views
from fgpose.finding import Code, Finding, Severity

# Of cameras that stand still it is 0 to 10 mm, by real networks and rigs that are a little wrong. Where all cameras
# shake by 20 mm, errors are twice as large.
_MATTERS_M, _WRONG_M = 0.015, 0.03
_SHARE = 0.6  # of that of the worst camera: the error of one is in part found in the others


def unsteady_cameras(examined: Examined, changes: Sequence[Change] = ()) -> list[Finding]:
    """Of a recording in which these changes were found, which are undone before: late clocks look alike."""
    rig, main = examined.rig, examined.main
    others = [seen for person, seen in examined.people.items() if person != examined.main_person]
    moves_m = unsteadiness_m([without_views(main, examined.gone_over), *others], rig, changes)
    worst_m = float(np.max(np.nan_to_num(moves_m)))
    if worst_m <= _MATTERS_M:
        return []
    unsteady = np.flatnonzero(moves_m > max(_MATTERS_M, _SHARE * worst_m)).tolist()
    seen = examined.info.cameras
    px = max(float(moves_m[c] * np.diag(rig.cameras[c].K)[:2].mean() / seen[c].distance_m) for c in unsteady)
    names, is_one = [rig.names[c] for c in unsteady], len(unsteady) == 1
    is_alone = is_one and rig.n_cameras > 2
    who = examined.in_words(names) if rig.n_cameras > 2 else f"{' or '.join(rig.names)}, or both,"
    reason = (
        f"{who} {'does' if is_one else 'do'} not stand still: within {WITHIN_S:g} s all joints together move by "
        f"{px:.0f} px (standard deviation), {1000 * worst_m:.0f} mm where the person is, and "
        f"{'not so in other views' if is_alone else 'otherwise in each view'}"
    )
    left_out = ", or leave it out with --cameras" if is_alone else ""
    remedy = (
        "Held in the hand, on a mast that shakes, or with electronic stabilisation? Nothing tells where a camera is "
        f"that moves all the time: fix it, switch stabilisation off, and record again{left_out}."
    )
    is_outvoted = rig.n_cameras - len(unsteady) >= 3
    severity = Severity.WRONG if worst_m > _WRONG_M and not is_outvoted else Severity.DOUBTFUL
    numbers = {"moves_m": worst_m, "moves_px": px, "cameras": float(len(unsteady))}
    camera = names[0] if is_alone else ""
    return [Finding(Code.UNSTEADY_CAMERA, severity, reason, remedy, 0.9, camera=camera, numbers=numbers)]
