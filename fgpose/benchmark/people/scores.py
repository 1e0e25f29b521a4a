"""From a result of several people to numbers: one score for every recording and method."""

from __future__ import annotations

from dataclasses import dataclass

from fgpose.assessment.people import evaluate_people
from fgpose.benchmark.people.recording import PeopleMethod, PeopleRecording, PeopleResult
from fgpose.benchmark.scores import Scored


@dataclass(frozen=True)
class PeopleScore(Scored):
    """How good one method was on one recording, by the protocol of fgpose.assessment.people; shares in [0, 1], NaN
    where a number does not exist."""

    recall: float
    precision: float
    f1: float
    mota: float
    idf1: float
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


def score_people(recording: PeopleRecording, result: PeopleResult, method: PeopleMethod) -> PeopleScore:
    """How good a method's result is at the times of the recording's frames.

    Raises:
        ValueError: the result has none of these times, or another skeleton.
    """
    time_s = recording.frames.frame_time_s
    found = evaluate_people(result.people, recording.truth, time_s=time_s)
    minutes = sum(person.n_frames for person in found.people) * (time_s[-1] - time_s[0]) / (len(time_s) - 1) / 60
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
        hota=found.hota,
        switches=float(found.switches / minutes),
        fragmentations=float(found.fragmentations / minutes),
        mpjpe_mm=found.mpjpe_mm,
        pcp=found.pcp,
        wrong_person=found.wrong_person,
        missing=found.share_missing,
        n_identities=found.n_identities,
        n_people=found.n_people,
        ms_per_frame=1000 * result.cpu_s / len(time_s),
    )
