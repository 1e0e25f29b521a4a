"""Of causes after which the cameras agree as well, those that leave a body whose left joints are on the left."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from fgpose.diagnosis.body.mirrored import mirrored
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.agreement import agreement
from fgpose.diagnosis.hypotheses.exchanged import side_hypotheses
from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis
from fgpose.diagnosis.hypotheses.images import mirrored_hypotheses
from fgpose.diagnosis.hypotheses.search import EXPLAINED, Explanation, State
from fgpose.finding import Code
from fgpose.sampling import spread_evenly

_FRAMES = 120


def on_the_right_sides(examined: Examined, found: Explanation) -> Explanation:
    """The explanation, or another one that the cameras cannot tell from it, if the body is mirrored with it.

    Such are left and right exchanged in the other half of the cameras; in images that are mirrored in all of them,
    exchanged or not; and where cameras stand symmetrically, mirrored images and exchanged cameras.
    """
    scene = examined.scene.frames(spread_evenly(examined.main.n_frames, _FRAMES))
    everybody = tuple(range(scene.n_cameras))

    def leaves_mirrored(causes: Iterable[Hypothesis]) -> bool:
        mended = scene
        for cause in causes:
            mended = cause.mend(mended)
        return mirrored(agreement(mended).positions_m, examined.main.skeleton)

    is_mirrored, rival = leaves_mirrored(found.causes), found.rival
    if all(cause.code is Code.EXCHANGED_SIDES for cause in found.causes):
        of_sides = {c for cause in found.causes for c in cause.cameras}
        others = tuple(cause for c in everybody if c not in of_sides for cause in side_hypotheses((c,)))
        return replace(found, causes=others if is_mirrored and others else found.causes, rival=None)
    if rival is not None and leaves_mirrored([rival]):
        same = mirrored_hypotheses(everybody) if rival.code is Code.MIRRORED_IMAGE else ()
        rival = next((other for other in same if not leaves_mirrored([other])), None)
    if not is_mirrored:
        return replace(found, rival=rival)
    for other in (*([] if rival is None else [rival]), *mirrored_hypotheses(everybody)):
        after = State(other.mend(found.before.scene))
        if not leaves_mirrored([other]) and after.cost < EXPLAINED * found.before.cost:
            return replace(found, causes=(other,), after=after, rival=None)
    return found
