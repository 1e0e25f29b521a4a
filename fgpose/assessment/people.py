"""Several tracked people measured against the true ones: detection, identity and pose, on distances in 3D."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.alignment import common_joints, same_times
from fgpose.assessment.clear_mot import TrueTrack, match_frames, tracks
from fgpose.assessment.crowd import NOBODY, Crowd, distances_m, gather
from fgpose.assessment.encounters import Encounter, encounters
from fgpose.assessment.identity import hota, identity_score, share
from fgpose.assessment.matched_pose import correct_limbs, matched_positions_m, on_another
from fgpose.assessment.metrics import joint_errors_m, mean_known
from fgpose.assessment.stays import MIN_STAY_S, Stay, false_tracks_s, matched, stays
from fgpose.association.track import TrackEvent
from fgpose.shown import Shown
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory

MATCH_M = 0.5
# The usual alpha of PCP (Belagiannis et al., 3D Pictorial Structures, 2014).
PCP_ALPHA = 0.5
# A joint this near to a neighbour's, and farther than this from its own, is the neighbour's.
WRONG_PERSON_M = 0.2
# Times of the people of one recording that differ by less are one frame.
_SAME_FRAME_S = 1e-3


@dataclass(frozen=True)
class PersonScore:
    """How one true person was found and followed. NaN: cannot be computed, as of somebody who is never there."""

    identity: int
    n_frames: int
    """Frames in which the person is there."""
    recall: float
    """Share of these in which the person is matched."""
    switches: int
    fragmentations: int
    mpjpe_mm: float
    pcp: float


@dataclass(frozen=True, repr=False)
class PeopleEvaluation(Shown):
    """How well people were found, told apart and posed; evaluate_people states the protocol.

    Shares are in [0, 1]. NaN: cannot be computed, as a recall of nobody. Quote mpjpe_mm with recall and precision:
    alone, it rewards leaving people out.
    """

    n_frames: int
    n_frames_empty: int
    """Frames in which nobody is estimated."""
    n_people: int
    """True identities that are there in at least one frame."""
    n_identities: int
    """Estimated identities that are there in at least one frame; n_people where nobody is split, merged or made up."""
    recall: float
    """Share of the true people of all frames that are matched."""
    precision: float
    """Share of the estimated people of all frames that are matched."""
    f1: float
    """Harmonic mean of recall and precision."""
    mota: float
    """1 - (misses + false people + switches) / true people of all frames: at most 1, may be negative."""
    switches: int
    """Matches of a true person to another identity than in that person's last match."""
    fragmentations: int
    """Times at which a true person is lost and matched again later."""
    idf1: float
    idp: float
    idr: float
    hota: float
    det_a: float
    ass_a: float
    mpjpe_mm: float
    """Mean over all joints of all matched people that both sides have, absolute, millimetres."""
    share_missing: float
    """Share of the true joints of matched people that the estimate lacks."""
    pcp: float
    """Share of the limbs of all true people that are correct; limbs of people or joints that are missed are not."""
    wrong_person: float
    """Share of the estimated joints of matched people that lie on another true person's joint."""
    people: tuple[PersonScore, ...]
    """One per true identity, ascending."""
    stays: tuple[Stay, ...]
    """When each true person was there, was found, and as whom."""
    encounters: tuple[Encounter, ...]
    """True people who came near one another, and what became of their identities."""
    false_tracks_s: tuple[float, ...]
    """How long each identity lives that is matched in less than half of its frames."""

    @property
    def returns(self) -> tuple[Stay, ...]:
        """The stays of those who had been away, and now stay for as long as it takes to measure bones."""
        return tuple(stay for stay in self.stays if np.isfinite(stay.away_s) and stay.duration_s >= MIN_STAY_S)

    @property
    def arrivals(self) -> tuple[Stay, ...]:
        """The stays that did not begin when the recording began, of new people too."""
        start_s = min((stay.begin_s for stay in self.stays), default=0.0)
        return tuple(stay for stay in self.stays if stay.begin_s > start_s)


def has_revisions(events: Iterable[TrackEvent]) -> bool:
    """Whether the tracker revised a number, so that revised gives others."""
    return any(event.became is not None for event in events)


def revised(people: Mapping[int, Trajectory], events: Iterable[TrackEvent]) -> dict[int, Trajectory]:
    """Everybody by the number that they have in the end: what an online tracker published under a number that it
    revised later (TrackEvent.became) is that of the person whom it meant.

    Args:
        people: as they were published.
        events: of their tracks.

    Returns:
        The same trajectories; of who was called by several numbers, times, positions and status alone, in the order of
        time. Where several numbers of one person are there at a time, the last one counts.
    """
    became = {event.person: event.became for event in events if event.became is not None}
    parts: dict[int, list[int]] = {}
    steps: dict[int, int] = {}
    for number in people:
        final, steps[number] = number, 0
        while final in became:
            final, steps[number] = became[final], steps[number] + 1
        parts.setdefault(final, []).append(number)
    newest_first = {final: sorted(own, key=steps.__getitem__) for final, own in parts.items()}
    return {
        final: people[own[0]] if len(own) == 1 else _as_one([people[number] for number in own])
        for final, own in newest_first.items()
    }


def _as_one(parts: list[Trajectory]) -> Trajectory:
    """Of one person; of the frames of one time the first counts."""
    there = [np.isfinite(part.positions_m).all(axis=-1).any(axis=-1) for part in parts]
    time_s, positions_m, status = (
        np.concatenate([getattr(part, name)[known] for part, known in zip(parts, there, strict=True)])
        for name in ("time_s", "positions_m", "status")
    )
    time_s, first = np.unique(time_s, return_index=True)
    return Trajectory(parts[0].skeleton, time_s, positions_m[first], status[first])


def evaluate_people(
    estimate: Mapping[int, Trajectory],
    truth: Mapping[int, Trajectory],
    *,
    time_s: Float[np.ndarray, " frame"] | None = None,
    truth_offset_s: float = 0.0,
    match_m: float = MATCH_M,
) -> PeopleEvaluation:
    """Measure tracked people against true ones. Both are trajectories by identity, which may cover different frames.

    Frames and joints: somebody is there in a frame where at least one joint is known. Joints are the same when their
    names mean the same, frames when their times are (alignment.same_times, for each person); nothing is interpolated.
    All frames of the truth count, those in which nothing is estimated too; estimates at other times do not.

    Distance of an estimated and a true person in a frame: mean over the joints that both have.

    Matches: per frame, one to one, at a distance below match_m, by the protocol of CLEAR-MOT (clear_mot.match_frames).
    Recall, precision, F1, MOTA, switches, fragmentations, MPJPE, missing joints, PCP and wrong_person rest on these.
    IDF1 pairs whole identities, with the same threshold. HOTA has its own matches (identity.hota).

    PCP: a limb (a bone of the truth's skeleton) is correct if the mean error of its two ends is at most half its true
    length (Belagiannis et al., 3D Pictorial Structures for Multiple Human Pose Estimation, 2014).

    wrong_person: a joint lies on another's if it is farther than 0.2 m from the same joint of the person's own truth
    and at most 0.2 m from that of another true person; joints whose own truth is missing are not judged.

    Args:
        estimate: by identity; none at all: everybody is missed.
        truth: by identity. For a room in which nobody is, one trajectory of NaN.
        time_s: the instants that count, increasing, in the estimate's clock; None: all times of the truth. To be given
            where the rates differ, or where the truth has no frames while nobody is there.
        truth_offset_s: added to the truth's times, for a truth with a clock of its own.
        match_m: metres.

    Raises:
        ValueError: there is no truth, the people of one side have different skeletons, no joint or no frame is in
            common, or match_m or time_s is not as described.
    """
    if not 0 < match_m < np.inf:
        raise ValueError(f"match_m must be positive and finite, got {match_m}")
    skeleton = _skeleton(truth, "truth")
    of_truth = of_estimate = tuple(range(skeleton.n_joints))
    if estimate:
        common = common_joints(_skeleton(estimate, "estimate"), skeleton)
        of_truth, of_estimate = common.reference, common.estimate
    instants_s = _instants_s(truth, truth_offset_s) if time_s is None else time_s
    _check_times(estimate, truth, instants_s, truth_offset_s)
    found, real = gather(estimate, of_estimate, instants_s), gather(truth, of_truth, instants_s, truth_offset_s)
    return _evaluation(found, real, instants_s, _bones(skeleton, of_truth), match_m)


def _evaluation(
    found: Crowd, real: Crowd, time_s: Float[np.ndarray, " frame"], bones: list[tuple[int, int]], match_m: float
) -> PeopleEvaluation:
    gaps_m = distances_m(real, found)
    partner = match_frames(gaps_m, real, found, match_m)
    followed, named = tracks(partner, real, found), matched(partner, real, found)
    matched_m = matched_positions_m(partner, found)
    errors_m = joint_errors_m(matched_m, real.positions_m)
    limbs = correct_limbs(errors_m, real.positions_m, bones, PCP_ALPHA)
    ours = identity_score(gaps_m, real, found, match_m)
    higher_order = hota(gaps_m, real, found)
    n_true, n_found = real.n_there, found.n_there
    n_matched, n_switches = sum(track.n_matched for track in followed), sum(track.n_switches for track in followed)
    return PeopleEvaluation(
        n_frames=len(real.person),
        n_frames_empty=int((found.person == NOBODY).all(axis=1).sum()),
        n_people=int((real.n_frames_there > 0).sum()),
        n_identities=int((found.n_frames_there > 0).sum()),
        recall=share(n_matched, n_true),
        precision=share(n_matched, n_found),
        f1=share(2 * n_matched, n_true + n_found),
        mota=1 - share(n_true + n_found - 2 * n_matched + n_switches, n_true),
        switches=n_switches,
        fragmentations=sum(track.n_fragmentations for track in followed),
        idf1=ours.idf1,
        idp=ours.idp,
        idr=ours.idr,
        hota=higher_order.hota,
        det_a=higher_order.det_a,
        ass_a=higher_order.ass_a,
        mpjpe_mm=1000 * float(mean_known(errors_m)),
        share_missing=_share_missing(errors_m, real.positions_m, partner),
        pcp=float(mean_known(limbs)),
        wrong_person=float(mean_known(on_another(matched_m, errors_m, real.positions_m, WRONG_PERSON_M))),
        people=_person_scores(followed, errors_m, limbs, real),
        stays=stays(named, real, found, time_s),
        encounters=encounters(named, real, found, time_s),
        false_tracks_s=false_tracks_s(partner, found, time_s),
    )


def _person_scores(
    followed: tuple[TrueTrack, ...],
    errors_m: Float[np.ndarray, "frame slot joint"],
    limbs: Float[np.ndarray, "frame slot bone"],
    real: Crowd,
) -> tuple[PersonScore, ...]:
    return tuple(
        PersonScore(
            identity=identity,
            n_frames=track.n_frames,
            recall=share(track.n_matched, track.n_frames),
            switches=track.n_switches,
            fragmentations=track.n_fragmentations,
            mpjpe_mm=1000 * float(mean_known(errors_m[real.person == index])),
            pcp=float(mean_known(limbs[real.person == index])),
        )
        for index, (identity, track) in enumerate(zip(real.identities, followed, strict=True))
    )


def _share_missing(
    errors_m: Float[np.ndarray, "frame slot joint"],
    truth_m: Float[np.ndarray, "frame slot joint 3"],
    partner: Int[np.ndarray, "frame slot"],
) -> float:
    known = np.asarray(np.isfinite(truth_m).all(axis=-1)) & (partner != NOBODY)[..., None]
    return share(int((known & np.isnan(errors_m)).sum()), int(known.sum()))


def _skeleton(people: Mapping[int, Trajectory], side: str) -> Skeleton:
    """The skeleton of all people of one side."""
    skeletons = list({trajectory.skeleton: None for trajectory in people.values()})
    if not skeletons:
        raise ValueError(f"the {side} has no trajectory; a room without people is a trajectory of NaN")
    if len(skeletons) > 1:
        names = ", ".join(skeleton.name for skeleton in skeletons)
        raise ValueError(f"the people of the {side} must have one skeleton, got {names}")
    return skeletons[0]


def _bones(skeleton: Skeleton, joints: tuple[int, ...]) -> list[tuple[int, int]]:
    """The bones between some of a skeleton's joints, as indices into these."""
    return [(joints.index(a), joints.index(b)) for a, b in skeleton.bones if a in joints and b in joints]


def _instants_s(people: Mapping[int, Trajectory], offset_s: float) -> Float[np.ndarray, " frame"]:
    """All times of some people, increasing, seconds."""
    times_s = np.unique(np.concatenate([trajectory.time_s for trajectory in people.values()])) + offset_s
    return times_s[np.diff(times_s, prepend=-np.inf) > _SAME_FRAME_S]


def _check_times(
    estimate: Mapping[int, Trajectory],
    truth: Mapping[int, Trajectory],
    instants_s: Float[np.ndarray, " frame"],
    truth_offset_s: float,
) -> None:
    """Raise ValueError if the instants do not increase or one of the sides has frames, but none at any of them."""
    if (np.diff(instants_s) <= 0).any():
        raise ValueError("time_s must increase")
    for side, people, offset_s in (("estimate", estimate, 0.0), ("truth", truth, truth_offset_s)):
        times_s = [trajectory.time_s + offset_s for trajectory in people.values() if trajectory.n_frames]
        if times_s and not any(len(same_times(own_s, instants_s)[0]) for own_s in times_s):
            first_s, last_s = min(own_s[0] for own_s in times_s), max(own_s[-1] for own_s in times_s)
            counted = f"from {instants_s[0]:.6g} to {instants_s[-1]:.6g} s" if len(instants_s) else "none"
            raise ValueError(
                f"no frame in common: the {side} lasts from {first_s:.6g} to {last_s:.6g} s, "
                f"the frames that count are {counted}"
            )
