"""Cameras in which nobody is followed among several people, although they show somebody: what is wrong of them.

What does not fit anybody belongs to nobody, and no other check sees it.
"""

from __future__ import annotations

from fgpose.association.chosen_person import with_unfollowed
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.finding import Finding
from fgpose.observations import Observations


def causes_of_unfollowed(examined: Examined) -> list[Finding]:
    """The cause that makes cameras agree, with the one whom each of those cameras sees most taken for the main person;
    none where there is no such cause: they may show somebody else."""
    seen = _with_unfollowed(examined)
    if seen is None:
        return []
    with_them = Examined(examined.rig, {examined.main_person: seen}, examined.config)
    return disagreements(with_them) if with_them.geometry.explanation is not None else []


def _with_unfollowed(examined: Examined) -> Observations | None:
    association = examined.association
    if association is None:
        return examined.with_unfollowed
    main = association.people[examined.main_person].in_frames(len(association.frames.image))
    seen = with_unfollowed(association, main)
    return None if seen is None else association.observations.of_person(seen)
