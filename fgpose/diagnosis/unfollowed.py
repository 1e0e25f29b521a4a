"""Cameras in which nobody is followed among several people, although they show somebody: what is wrong of them.

What does not fit anybody belongs to nobody, and no other check sees it.
"""

from __future__ import annotations

from collections.abc import Iterator

from fgpose.association.chosen_person import with_unfollowed
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.finding import Code, Finding
from fgpose.observations import Observations


def causes_of_unfollowed(examined: Examined) -> list[Finding]:
    """The cause that makes cameras agree, with one of those whom each of those cameras sees most taken for the main
    person; none where there is no such cause: they may show somebody else."""
    found: list[Finding] = []
    for seen in _with_unfollowed(examined):
        with_them = Examined(examined.rig, {examined.main_person: seen}, examined.config)
        causes = disagreements(with_them) if with_them.geometry.explanation is not None else []
        if causes and not any(each.code is Code.OTHER_PERSON for each in causes):
            return causes
        found = found or causes
    return found


def _with_unfollowed(examined: Examined) -> Iterator[Observations]:
    association = examined.association
    if association is None:
        yield from () if examined.with_unfollowed is None else (examined.with_unfollowed,)
        return
    main = association.people[examined.main_person].in_frames(len(association.frames.image))
    for seen in with_unfollowed(association, main):
        yield association.observations.of_person(seen)
