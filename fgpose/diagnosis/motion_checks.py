"""What is suspicious of the motion itself: gaps, contradictions, speeds, turns, lives of people."""

from __future__ import annotations

from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.identity.exchange import Settled
from fgpose.association.identity.likeness import log_ratio_of_place
from fgpose.diagnosis.body.joint_names import in_words_by_part
from fgpose.diagnosis.finished import FinishedRecording, of_each_person
from fgpose.diagnosis.series import root_speed_mps, sigma_m
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import parts_of, stretches
from fgpose.trajectory import Status, Trajectory
from fgpose_factors.robust_statistics import known_quantile

# As fgpose info lists them. A gap in which the joint becomes three times as uncertain as usual is one that harms.
_GAP_S, _GAP_SIGMAS = 0.5, 3.0
_FEW_FRAMES_SHARE = 0.01
_SAME_S = 0.25  # joints that are away at the same time, to this
# Of one kind: more are in the tables.
_AT_MOST = 3
_MOST_NAMED = 6  # the others are counted
# Above the fastest run: 44.72 km/h, 12.42 m/s (U. Bolt, from 60 to 80 m, World Championships in Athletics 2009).
_MAX_SPEED_MPS = 13.0
# The fastest spin on ice skates: 342 turns a minute, 2052 degrees a second (Guinness World Records 2015). Sides that
# change places turn the body by 180 degrees in one to three frames. Less than 45 degrees in one frame may be noise of
# pairs of joints that lie above each other.
_MAX_TURN_DEG_S, _LEAST_TURN_DEG = 2100.0, 45.0
# Most joints at once, in most of at least three cameras. Occluders do that to few joints: with three of four views
# occluded, up to 35 % of the joints of a frame (benchmarks/report_checks.py).
_CONTRADICTED_SHARE, _CONTRADICTED_VIEWS = 0.5, 3
_BELIEVED = 0.5
# Who stands still sways: the centre of mass by 3 to 6 mm, root mean square, head and hands by more. Of the joints that
# move most, in so many seconds.
_STILL_M, _STILL_S, _MOVE_MOST, _OFTEN_KNOWN = 0.005, 5.0, 0.9, 0.5
# Somebody who is there for less than this in a longer recording is perhaps nobody.
_SHORT_LIFE_S = 1.0
# Who is away for longer may come back elsewhere. Of who stays for so long beside somebody, one of the two may be wrong.
_AT_ONCE_S = 1.0

_JointGap = tuple[str, float, float, float]


def gaps(recording: FinishedRecording) -> list[Finding]:
    """Joints that for long fewer than two cameras see, or are believed to see; those of the same time are one, and the
    times of the same joints."""
    together: dict[tuple[int, int, int], list[_JointGap]] = {}
    for person, trajectory in recording.people.items():
        for gap in harmful_gaps(trajectory):
            _, start_s, gap_s, _ = gap
            key = person, round(start_s / _SAME_S), round((start_s + gap_s) / _SAME_S)
            together.setdefault(key, []).append(gap)
    duration_s = float(recording.main.time_s[-1] - recording.main.time_s[0])
    of_same: dict[tuple[int, tuple[str, ...]], list[list[_JointGap]]] = {}
    for (person, *_), own in sorted(together.items(), key=lambda item: item[1][0][2], reverse=True):
        of_same.setdefault((person, tuple(joint for joint, *_ in own)), []).append(own)
    longest = list(of_same.items())[:_AT_MOST]
    return [_gap(recording, person, own[0], len(own), duration_s) for (person, _), own in longest]


def _gap(recording: FinishedRecording, person: int, own: list[_JointGap], n_times: int, duration_s: float) -> Finding:
    skeleton, many = recording.main.skeleton, len(own) > 1
    joint, start_s, gap_s, _ = own[0]
    joints = [each for each, *_ in own]
    ratios = [ratio for *_, ratio in own if np.isfinite(ratio)]
    return Finding(
        Code.GAP,
        Severity.NOTE,
        f"{recording.prefix(person)}{in_words_by_part(skeleton, joints)}: fewer than two cameras see "
        f"{'them' if many else 'it'}, as far as they are believed, for {gap_s:.1f} s from {start_s:.1f} s on"
        + (f", the longest of {n_times} times" if n_times > 1 else "")
        + (f"; {'their' if many else 'its'} sigma grows to {max(ratios):.0f} times the usual" if ratios else ""),
        "What stands there is predicted: leave it out of the analysis, or add a camera that sees "
        f"{'these joints' if many else 'the joint'}.",
        min(0.4, gap_s / max(duration_s, 1e-9) + 0.05),
        person=recording.number(person),
        joint=joint,
        from_s=float(start_s),
        to_s=float(start_s + gap_s),
    )


def harmful_gaps(trajectory: Trajectory) -> list[_JointGap]:
    """Joint, start and duration in seconds, and largest sigma over the joint's median; the ratio is NaN without
    covariance."""
    sigma = sigma_m(trajectory)
    seen = _believed(trajectory) | (
        trajectory.status == Status.UNOBSERVABLE
    )  # where nothing stands nothing is predicted
    found = []
    for j, joint in enumerate(trajectory.skeleton.joints):
        for first, last in stretches(~seen[:, j]):
            duration_s = float(trajectory.time_s[last - 1] - trajectory.time_s[first])
            ratio = known_quantile(sigma[first:last, j], 1.0) / known_quantile(sigma[:, j], 0.5)
            if duration_s > _GAP_S and not ratio < _GAP_SIGMAS:
                found.append((joint, float(trajectory.time_s[first]), duration_s, ratio))
    return found


def _believed(trajectory: Trajectory) -> Bool[np.ndarray, "frame joint"]:
    """Two cameras see the joint, and it is not more probable that they hallucinate it."""
    if trajectory.visibility is None:
        return np.asarray(trajectory.observed)
    return np.asarray(trajectory.observed & ((trajectory.visibility >= _BELIEVED).sum(axis=1) >= 2))


@of_each_person
def unobservable(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """Joints that nothing determines for some of the time, while others are."""
    missing = trajectory.status == Status.UNOBSERVABLE
    somebody = ~missing.all(axis=1)
    shares = missing[somebody].mean(axis=0) if somebody.any() else np.ones(missing.shape[1])
    joints = [trajectory.skeleton.joints[j] for j in np.flatnonzero(shares > _FEW_FRAMES_SHARE)]
    if not joints:
        return None
    named = in_words_by_part(trajectory.skeleton, joints, _MOST_NAMED)
    where = f"in up to {100 * shares.max():.0f} % of the frames"
    return Finding(
        Code.UNDETERMINED,
        Severity.NOTE,
        f"{recording.prefix(person)}nothing determines {named} {where}",
        "There are no numbers there. Add cameras, or a skeleton without these joints.",
        float(shares.mean()),
    )


@of_each_person
def contradicted(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """Moments at which most cameras are believed to be wrong of most joints: not they are, but the motion."""
    moments = trajectory.time_s[_contradicted_frames(trajectory)]
    if not len(moments):
        return None
    return Finding(
        Code.CONTRADICTED,
        Severity.DOUBTFUL,
        f"{recording.prefix(person)}most cameras contradict the motion of most joints in {len(moments)} frames, first "
        f"at {moments[0]:.2f} s",
        "Look at the images of that moment: another person taken for this one, or images that are not of one time? Cut "
        "the recording there.",
        0.5,
    )


def _contradicted_frames(trajectory: Trajectory) -> Bool[np.ndarray, " frame"]:
    if trajectory.visibility is None:
        return np.zeros(trajectory.n_frames, dtype=bool)
    views = np.isfinite(trajectory.visibility).sum(axis=1)
    doubted = (trajectory.visibility < _BELIEVED).sum(axis=1)
    judged = views >= _CONTRADICTED_VIEWS
    shares = ((2 * doubted > views) & judged).sum(axis=1) / np.maximum(judged.sum(axis=1), 1)
    # A few joints that are seen at all say little of the body; nor does one frame, as outliers last for one.
    found = (shares > _CONTRADICTED_SHARE) & (2 * judged.sum(axis=1) > judged.shape[1])
    before, after = np.append(False, found[:-1]), np.append(found[1:], False)
    return np.asarray(found & (before | after))


@of_each_person
def impossible_speeds(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """A body that is faster than anybody runs."""
    speed_mps = np.nan_to_num(root_speed_mps(trajectory))
    if not len(speed_mps) or speed_mps.max() <= _MAX_SPEED_MPS:
        return None
    at_s = trajectory.time_s[int(np.argmax(speed_mps))]
    return Finding(
        Code.IMPOSSIBLE_SPEED,
        Severity.WRONG,
        f"{recording.called(person) or 'the person'} is {speed_mps.max():.0f} m/s fast at {at_s:.2f} s: nobody runs "
        f"faster than {_MAX_SPEED_MPS:.0f} m/s",
        "Check the frame rate (--fps) and the scale of the calibration; is it another person from there on?",
        0.6,
    )


@of_each_person
def turns(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """A body that is turned round from one frame to the next: left and right exchanged in the result."""
    angle_deg = _turn_deg(trajectory)
    fast = (angle_deg / np.diff(trajectory.time_s) > _MAX_TURN_DEG_S) & (angle_deg > _LEAST_TURN_DEG)
    if not fast.any():
        return None
    at_s = trajectory.time_s[int(np.argmax(fast))]
    return Finding(
        Code.IMPOSSIBLE_TURN,
        Severity.DOUBTFUL,
        f"{recording.prefix(person)}left and right change places {int(fast.sum())} times, first at {at_s:.2f} s: "
        f"nobody turns faster than {_MAX_TURN_DEG_S:.0f} degrees a second",
        "Most cameras have exchanged the sides there: look at the images, leave the moment out.",
        0.6,
    )


def _turn_deg(trajectory: Trajectory) -> Float[np.ndarray, " step"]:
    """By how much the direction from right to left turns, of all pairs together; in space, as that over the floor is
    anything while somebody turns a cartwheel."""
    pairs = np.array(trajectory.skeleton.left_right, dtype=int).reshape(-1, 2)
    across_m = trajectory.positions_m[:, pairs[:, 0]] - trajectory.positions_m[:, pairs[:, 1]]
    known = np.isfinite(across_m[1:] + across_m[:-1])
    before_m, after_m = (np.where(known, each, 0.0).sum(axis=1) for each in (across_m[:-1], across_m[1:]))
    length_m2 = np.linalg.norm(before_m, axis=-1) * np.linalg.norm(after_m, axis=-1)
    cosine = np.sum(before_m * after_m, axis=-1) / np.maximum(length_m2, 1e-12)
    return np.where(length_m2 > 0, np.degrees(np.arccos(np.clip(cosine, -1, 1))), 0.0)


def motionless(recording: FinishedRecording) -> list[Finding]:
    """People who do not even sway, beside others who move: pictures of people."""
    if len(recording.people) < 2:
        return []
    moved_m = {person: _moved_m(each) for person, each in recording.people.items()}
    return [
        Finding(
            Code.MOTIONLESS,
            Severity.NOTE,
            f"person {person} does not move: joints stay where they are to {1000 * own_m:.0f} mm. Who stands still "
            "sways by about a centimetre",
            "Is it a poster, a screen or a mannequin? Then leave this person out.",
            0.1,
            person=person,
        )
        for person, own_m in moved_m.items()
        if own_m < _STILL_M and max(moved_m.values()) > _STILL_M
    ]


def _moved_m(trajectory: Trajectory) -> float:
    """How far the joints that move most are from their mean places, root mean square; inf if that is not known."""
    if trajectory.time_s[-1] - trajectory.time_s[0] < _STILL_S:
        return np.inf
    often = np.isfinite(trajectory.positions_m).all(axis=-1).mean(axis=0) > _OFTEN_KNOWN
    if not often.any():
        return np.inf
    variances_m2 = np.nanvar(trajectory.positions_m[:, often], axis=0).sum(axis=-1)
    return float(np.sqrt(np.quantile(variances_m2, _MOVE_MOST)))


def short_lives(recording: FinishedRecording) -> list[Finding]:
    """People who are there for a moment only, beside others who stay."""
    lives_s = {person: float(each.time_s[-1] - each.time_s[0]) for person, each in recording.people.items()}
    longest_s = max(lives_s.values())
    return [
        Finding(
            Code.SHORT_LIFE,
            Severity.NOTE,
            f"person {person} is there for {life_s:.1f} s only: perhaps nobody, or somebody who was not recognised",
            "See the events of this person; accept fewer false tracks (--tracking.false-tracks-per-hour).",
            0.1,
            person=person,
        )
        for person, life_s in lives_s.items()
        if life_s < _SHORT_LIFE_S < longest_s / 2
    ]


def perhaps_exchanged(recording: FinishedRecording) -> list[Finding]:
    """Two people who were so near each other that nothing tells who is who since then."""
    met = [event for event in recording.events if event.beside is not None and event.person < event.beside]
    last = {(event.person, event.beside): event for event in met}
    return [
        Finding(
            Code.PERHAPS_EXCHANGED,
            Severity.DOUBTFUL,
            f"person {one} may have changed numbers {event.reason}; bones do not tell who is who",
            "Look at the images after that: is either still who it was before? Cut the recording there if not.",
            0.5,
            person=one,
            from_s=event.time_s,
        )
        for (one, _), event in last.items()
        if event.what == Settled.PERHAPS.value
    ]


def perhaps_same(recording: FinishedRecording) -> list[Finding]:
    """People who begin where somebody else ends, rather than anywhere: perhaps the same one, who was not recognised."""
    if len(recording.people) < 2:
        return []
    places = {
        person: _places_m(each) for person, each in recording.people.items() if np.isfinite(each.positions_m).any()
    }
    everywhere_m = np.concatenate([place_m for _, place_m in places.values()]) if places else np.zeros((1, 3))
    room_m2 = float(np.prod(np.sort(np.ptp(everywhere_m, axis=0))[1:]))
    found = []
    for one, other in permutations(places, 2):
        (one_s, one_m), (other_s, other_m) = places[one], places[other]
        away_s = float(other_s[0] - one_s[-1])
        if abs(away_s) > _AT_ONCE_S or one_s[0] >= other_s[0] or one_s[-1] >= other_s[-1]:
            continue
        then_m = one_m[np.searchsorted(one_s, other_s[0], side="right") - 1]
        if log_ratio_of_place(then_m, other_m[0], max(away_s, 0.0), room_m2) < 0:
            continue
        found.append(
            Finding(
                Code.PERHAPS_SAME,
                Severity.NOTE,
                f"person {other} begins at {other_s[0]:.1f} s, {np.linalg.norm(other_m[0] - then_m):.1f} m from person "
                f"{one}, who ends at {one_s[-1]:.1f} s: perhaps they are one, whom bones and looks do not tell",
                "Look at the images of that moment: if so, take both numbers for one person.",
                0.1,
                person=other,
                from_s=float(other_s[0]),
            )
        )
    return found


def _places_m(trajectory: Trajectory) -> tuple[Float[np.ndarray, " frame"], Float[np.ndarray, "frame 3"]]:
    """When somebody is where, by the median of the joints; of one joint at least."""
    is_known = np.isfinite(trajectory.positions_m).all(axis=-1).any(axis=-1)
    known = np.flatnonzero(is_known)
    place_m = np.empty((len(known), 3))
    for part in parts_of(len(known)):  # of all at once the medians take four times as much memory as the joints
        place_m[part] = np.nanmedian(trajectory.positions_m[known[part]], axis=1)
    return trajectory.time_s[is_known], place_m
