"""Somebody who comes after somebody else has gone, where the recording was taken for one person's."""

from __future__ import annotations

from fgpose.association.identity import RECOGNISED
from fgpose.association.successive import Change, successive
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.people_observations import PeopleObservations

_REMEDY = "With --people all each has a result of their own, with their own bone lengths; or cut the recording there."


def somebody_else(examined: Examined) -> list[Finding]:
    """Where several were told apart, each has a result of their own, and nothing is wrong.

    With a calibration that does not fit nobody can be told from somebody else.
    """
    if examined.association is not None or examined.rig.n_cameras < 2 or examined.geometry.explanation is not None:
        return []
    found = successive(PeopleObservations.of_one(examined.main), examined.rig, examined.config.tracking)
    changes = [] if found is None else found.changes
    return [_finding(each) for each in changes if each.is_somebody_else or each.log_odds < RECOGNISED]


def _finding(change: Change) -> Finding:
    reason = str(change)
    return Finding(
        Code.SOMEBODY_ELSE,
        Severity.WRONG if change.is_somebody_else else Severity.DOUBTFUL,
        reason[0].upper() + reason[1:],
        _REMEDY,
        0.7,
        from_s=change.come_s,
        numbers={"away_m": change.away_m, "log_odds": change.log_odds},
    )
