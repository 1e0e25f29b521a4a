"""From a result of several people to numbers: one score for every recording and method."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fgpose.assessment.encounters import Encounter
from fgpose.assessment.people import PeopleEvaluation, evaluate_people, has_revisions, revised
from fgpose.assessment.stays import Stay, confirmation_delays_s
from fgpose_benchmarks.comparison.scores import Scored
from fgpose_benchmarks.people.recording import PeopleMethod, PeopleRecording, PeopleResult
from fgpose_benchmarks.people.truth import seen_by

SHORT_AWAY_S = 5.0
"""Returns after a shorter and after a longer absence are counted apart."""
CLOSE_M = 0.5
"""As are switches of people who come nearer to each other, and of those who do not."""


@dataclass(frozen=True)
class PeopleScore(Scored):
    """How good one method was on one recording, by the protocol of fgpose.assessment.people; shares in [0, 1], NaN
    where a number does not exist."""

    recall: float
    precision: float
    f1: float
    mota: float
    idf1: float
    idf1_revised: float
    """By the numbers that people have in the end."""
    hota: float
    switches: float
    """Per true person and minute."""
    fragmentations: float
    """Per true person and minute."""
    mpjpe_mm: float
    """Absolute, of matched people."""
    pcp: float
    wrong_person: float
    missing: float
    """Share of the joints of matched people that the method does not give."""
    n_identities: int
    n_people: int
    ms_per_frame: float
    """Processor time for the images of all cameras of about one time."""
    minutes: float
    """Length of the recording."""
    person_minutes: float
    """For how long true people are there, of all people together."""
    n_short_returns: int
    """Stays of people who had been away for SHORT_AWAY_S or less; see assessment.stays."""
    n_short_recognised: int
    """Of these, in how many cases the identity of before goes on."""
    n_long_returns: int
    n_long_recognised: int
    n_arrivals: int
    """All returns, and new people who come after the start."""
    n_mistaken: int
    """Of these, how many are taken for somebody else who is or was there."""
    n_passes: int
    """Encounters in which two people come nearer than 1 m, but not than CLOSE_M; see assessment.encounters."""
    pass_switches: int
    """Identity switches at these."""
    n_close_passes: int
    """Nearer than CLOSE_M."""
    close_switches: int
    confirmed_s: tuple[float, ...]
    """For each stay of a person the time from being detected by two cameras to being there in the result."""
    n_unconfirmed: int
    """Stays in which people are detected by two cameras, but never there in the result."""
    false_tracks_s: tuple[float, ...]
    """How long false tracks live."""


def score_people(recording: PeopleRecording, result: PeopleResult, method: PeopleMethod) -> PeopleScore:
    """How good a method's result is at the times of the recording's frames.

    Raises:
        ValueError: the result has none of these times, or another skeleton.
    """
    time_s = recording.frames.frame_time_s
    found = final = evaluate_people(result.people, recording.truth, time_s=time_s)
    if has_revisions(result.events):
        final = evaluate_people(revised(result.people, result.events), recording.truth, time_s=time_s)
    frame_min = float(time_s[-1] - time_s[0]) / (len(time_s) - 1) / 60
    person_minutes = sum(person.n_frames for person in found.people) * frame_min
    delays_s = confirmation_delays_s(found.stays, seen_by(2, recording), time_s)
    short = [stay for stay in found.returns if stay.away_s <= SHORT_AWAY_S]
    long = [stay for stay in found.returns if stay.away_s > SHORT_AWAY_S]
    close, far = _by_distance(found)
    return PeopleScore(
        variant=recording.variant,
        clip=recording.clip,
        method=method.name,
        group=method.group,
        recall=found.recall,
        precision=found.precision,
        f1=found.f1,
        mota=found.mota,
        idf1=found.idf1,
        idf1_revised=final.idf1,
        hota=found.hota,
        switches=found.switches / person_minutes,
        fragmentations=found.fragmentations / person_minutes,
        mpjpe_mm=found.mpjpe_mm,
        pcp=found.pcp,
        wrong_person=found.wrong_person,
        missing=found.share_missing,
        n_identities=found.n_identities,
        n_people=found.n_people,
        ms_per_frame=1000 * result.cpu_s / len(time_s),
        minutes=len(time_s) * frame_min,
        person_minutes=person_minutes,
        n_short_returns=len(short),
        n_short_recognised=_n_recognised(short),
        n_long_returns=len(long),
        n_long_recognised=_n_recognised(long),
        n_arrivals=len(found.arrivals),
        n_mistaken=sum(stay.is_mistaken for stay in found.arrivals),
        n_passes=len(far),
        pass_switches=sum(each.n_switches for each in far),
        n_close_passes=len(close),
        close_switches=sum(each.n_switches for each in close),
        confirmed_s=tuple(delay_s for delay_s in delays_s if np.isfinite(delay_s)),
        n_unconfirmed=int(np.isinf(delays_s).sum()),
        false_tracks_s=found.false_tracks_s,
    )


def _n_recognised(stays: Iterable[Stay]) -> int:
    return sum(stay.is_recognised for stay in stays)


def _by_distance(found: PeopleEvaluation) -> tuple[list[Encounter], list[Encounter]]:
    """Encounters nearer than CLOSE_M, and the others."""
    close = [each for each in found.encounters if each.distance_m < CLOSE_M]
    return close, [each for each in found.encounters if each.distance_m >= CLOSE_M]
