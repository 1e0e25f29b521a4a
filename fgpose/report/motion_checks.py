"""What is suspicious of the motion itself: gaps, jumps, bones, lives of people."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.report.finished import FinishedRecording
from fgpose.report.series import known_quantile, root_m, sigma_m
from fgpose.report.suspicion import Suspicion
from fgpose.sampling import usual_step_s
from fgpose.trajectory import Status, Trajectory

# As fgpose info lists them. A gap in which the joint becomes three times as uncertain as usual is one that harms.
_GAP_S, _GAP_SIGMAS = 0.5, 3.0
# Of one kind: more are in the tables.
_AT_MOST = 3
# The fastest man: 12.4 m/s (Graubner and Nixdorf 2011, New Studies in Athletics 26). Of a limb's end: the foot of an
# instep kick reaches 28 m/s (Lees and Nolan 1998, J. Sports Sci. 16).
_MAX_ROOT_MPS, _MAX_JOINT_MPS = 12.4, 28.0
# A change of velocity this many times as large as is usual for the joint in this recording, and more than its own
# uncertainty explains. Not clear of all motion: in the embedded motion capture, unsmoothed, at 25 to 100 Hz, walking
# and running reach 3 to 7, punching 14, but climbing 38 and jumping 35 (benchmarks/report_checks.py).
_JUMP_RATIO, _JUMP_SIGMAS = 30.0, 5.0
# The hips turn by at most 700 degrees a second, in a baseball pitch (Fleisig et al. 1999, J. Biomech. 32).
_MAX_TURN_DEG_S = 700.0
# Leg lengths differ by 5.2 mm on average (standard deviation 4.1 mm); from about 20 mm on it is clinically significant
# for most people (Knutson 2005, Chiropr. Osteopat. 13:11). Of a whole leg; here each bone is compared.
_ASYMMETRY_M = 0.02
# Skin moves over bones by more than markers err (Leardini et al. 2005, Gait Posture 21); the 10 mm are chosen.
_DRIFT_M, _DRIFT_SIGMAS = 0.01, 5.0
_CORRELATED_S = 0.15  # the errors of detections, measured on real recordings
# Somebody who is there for less than this in a longer recording is perhaps nobody.
_SHORT_LIFE_S = 1.0


def gaps(recording: FinishedRecording) -> list[Suspicion]:
    """Joints that fewer than two cameras see for long."""
    found = [
        (duration_s, start_s, person, joint, ratio)
        for person, trajectory in recording.people.items()
        for joint, start_s, duration_s, ratio in harmful_gaps(trajectory)
    ]
    duration_s = recording.main.time_s[-1] - recording.main.time_s[0]
    return [
        Suspicion(
            _of(recording, person, joint),
            f"{_of(recording, person, joint)}: fewer than two cameras see it for {gap_s:.1f} s from {start_s:.1f} s on"
            + (f"; its sigma grows to {ratio:.0f} times the usual" if np.isfinite(ratio) else ""),
            "What stands there is predicted: leave it out of the analysis, or add a camera that sees the joint.",
            min(0.4, float(gap_s / max(duration_s, 1e-9)) + 0.05),
        )
        for gap_s, start_s, person, joint, ratio in sorted(found, reverse=True)[:_AT_MOST]
    ]


def harmful_gaps(trajectory: Trajectory) -> list[tuple[str, float, float, float]]:
    """Joint, start and duration in seconds, and largest sigma over the joint's median; the ratio is NaN without
    covariance."""
    sigma = sigma_m(trajectory)
    found = []
    for j, joint in enumerate(trajectory.skeleton.joints):
        edges = np.flatnonzero(np.diff(np.concatenate([[True], trajectory.observed[:, j], [True]]).astype(int)))
        for first, last in edges.reshape(-1, 2).tolist():
            duration_s = float(trajectory.time_s[last - 1] - trajectory.time_s[first])
            ratio = known_quantile(sigma[first:last, j], 1.0) / known_quantile(sigma[:, j], 0.5)
            if duration_s > _GAP_S and not ratio < _GAP_SIGMAS:
                found.append((joint, float(trajectory.time_s[first]), duration_s, ratio))
    return found


def unobservable(recording: FinishedRecording) -> list[Suspicion]:
    """Joints that nothing determines for some of the time."""
    found = []
    for person, trajectory in recording.people.items():
        shares = np.mean(trajectory.status == Status.UNOBSERVABLE, axis=0)
        joints = [joint for joint, share in zip(trajectory.skeleton.joints, shares, strict=True) if share > 0]
        if joints:
            named = ", ".join(joints[:6]) + (f" and {len(joints) - 6} more" if len(joints) > 6 else "")
            where = f"in up to {100 * shares.max():.0f} % of the frames"
            reason = f"{_of(recording, person, '')}nothing determines {named} {where}"
            remedy = "There are no numbers there. Add cameras, or a skeleton without these joints."
            found.append(Suspicion(recording.called(person), reason, remedy, float(shares.mean())))
    return found


def jumps(recording: FinishedRecording) -> list[Suspicion]:
    """Joints that move faster than anybody can, or as they never do otherwise."""
    found = []
    for person, trajectory in recording.people.items():
        for joint, at_s, words, size in _jumps_of(trajectory):
            name = _of(recording, person, joint)
            remedy = "Look at the images of that moment: a detection of somebody else, or left and right exchanged?"
            found.append((size, Suspicion(name, f"{name} jumps at {at_s:.2f} s: {words}", remedy, 0.35)))
    return [suspicion for _, suspicion in sorted(found, key=lambda each: -each[0])[:_AT_MOST]]


def _jumps_of(trajectory: Trajectory) -> list[tuple[str, float, str, float]]:
    """Joint, time, words and size of the largest jump of each joint that jumps; of the root too."""
    if trajectory.n_frames < 3:
        return []
    step_s, sigma = np.diff(trajectory.time_s), sigma_m(trajectory)
    found = []
    speed_mps = np.linalg.norm(np.diff(root_m(trajectory), axis=0), axis=-1) / step_s
    if (fastest := known_quantile(speed_mps, 1.0)) > _MAX_ROOT_MPS:
        at = int(np.nanargmax(speed_mps))
        words = f"{fastest:.0f} m/s, and nobody runs faster than {_MAX_ROOT_MPS} m/s"
        found.append(("the body", float(trajectory.time_s[at]), words, np.inf))
    for j, joint in enumerate(trajectory.skeleton.joints):
        speed_mps = np.linalg.norm(np.diff(trajectory.positions_m[:, j], axis=0), axis=-1) / step_s
        change_m = np.linalg.norm(np.diff(trajectory.positions_m[:, j], 2, axis=0), axis=-1)
        usual_m = known_quantile(change_m, 0.5)
        clear = (change_m > _JUMP_RATIO * usual_m) & ~(change_m <= _JUMP_SIGMAS * sigma[1:-1, j])
        if known_quantile(speed_mps, 1.0) > _MAX_JOINT_MPS:
            at = int(np.nanargmax(speed_mps))
            words = f"{speed_mps[at]:.0f} m/s; no limb is faster than {_MAX_JOINT_MPS:.0f} m/s"
            found.append((joint, float(trajectory.time_s[at]), words, float(speed_mps[at])))
        elif clear.any():
            at = int(np.nanargmax(np.where(clear, change_m, np.nan)))
            words = f"by {1000 * change_m[at]:.0f} mm between two frames, {change_m[at] / usual_m:.0f} times the usual"
            found.append((joint, float(trajectory.time_s[at + 1]), words, float(change_m[at])))
    return found


def turns(recording: FinishedRecording) -> list[Suspicion]:
    """A body that is turned round from one frame to the next: left and right exchanged in the result."""
    found = []
    for person, trajectory in recording.people.items():
        angle_deg = _turn_deg(trajectory, recording.axes[:2])
        fast = angle_deg / np.diff(trajectory.time_s) > _MAX_TURN_DEG_S
        fast &= angle_deg > 90  # Less, in one frame, may be the noise of two hips that are near to each other.
        if fast.any():
            at_s = trajectory.time_s[int(np.argmax(fast))]
            reason = (
                f"{_of(recording, person, '')}left and right change places {int(fast.sum())} times, first at "
                f"{at_s:.2f} s: nobody turns faster than {_MAX_TURN_DEG_S:.0f} degrees a second"
            )
            remedy = "Most cameras have exchanged the sides there: look at the images, leave the moment out."
            found.append(Suspicion(recording.called(person), reason, remedy, 0.6))
    return found


def _turn_deg(trajectory: Trajectory, floor: tuple[int, int]) -> Float[np.ndarray, " step"]:
    """By how much the direction over the floor from right to left turns, of all pairs together."""
    pairs = np.array(trajectory.skeleton.left_right, dtype=int).reshape(-1, 2)
    across_m = (trajectory.positions_m[:, pairs[:, 0]] - trajectory.positions_m[:, pairs[:, 1]])[..., list(floor)]
    across_m = np.nan_to_num(across_m).sum(axis=1)
    length_m = np.linalg.norm(across_m, axis=-1)
    cosine = np.sum(across_m[1:] * across_m[:-1], axis=-1) / np.maximum(length_m[1:] * length_m[:-1], 1e-12)
    return np.where(np.minimum(length_m[1:], length_m[:-1]) > 0, np.degrees(np.arccos(np.clip(cosine, -1, 1))), 0.0)


def bones(recording: FinishedRecording) -> list[Suspicion]:
    """Bones that differ between left and right, or whose length drifts."""
    found = []
    for person, trajectory in recording.people.items():
        lengths_m = trajectory.skeleton.bone_lengths(trajectory.positions_m)
        found += _asymmetric(recording, person, trajectory, lengths_m)
        found += _drifting(recording, person, trajectory, lengths_m)
    return sorted(found, key=lambda each: -each.weight)[:_AT_MOST]


def _asymmetric(
    recording: FinishedRecording, person: int, trajectory: Trajectory, lengths_m: Float[np.ndarray, "frame bone"]
) -> list[Suspicion]:
    skeleton, found = trajectory.skeleton, []
    number = {frozenset(bone): b for b, bone in enumerate(skeleton.bones)}
    for left, right in skeleton.limb_pairs:
        left_m, right_m = (known_quantile(lengths_m[:, number[frozenset(bone)]], 0.5) for bone in (left, right))
        if abs(left_m - right_m) > _ASYMMETRY_M:
            name = skeleton.bone_name(left)
            reason = (
                f"{_of(recording, person, name)} is {1000 * left_m:.0f} mm long and {1000 * right_m:.0f} mm on the "
                f"right: more than the {1000 * _ASYMMETRY_M:.0f} mm by which legs differ in few people"
            )
            remedy = "One side is seen worse, or a camera is off; check the calibration first."
            found.append(Suspicion(name, reason, remedy, 0.2 + min(abs(left_m - right_m), 0.1)))
    return found


def _drifting(
    recording: FinishedRecording, person: int, trajectory: Trajectory, lengths_m: Float[np.ndarray, "frame bone"]
) -> list[Suspicion]:
    """The first third of the recording against the last."""
    third = trajectory.n_frames // 3
    independent = third * min(usual_step_s(trajectory.time_s) / _CORRELATED_S, 1.0)
    if independent < 3:
        return []
    found = []
    for b, bone in enumerate(trajectory.skeleton.bones):
        parts = lengths_m[:third, b], lengths_m[-third:, b]
        drift_m = known_quantile(parts[1], 0.5) - known_quantile(parts[0], 0.5)
        spreads_m = [known_quantile(np.abs(part - known_quantile(part, 0.5)), 0.5) for part in parts]
        spread_m = float(np.linalg.norm(spreads_m))
        if abs(drift_m) > max(_DRIFT_M, _DRIFT_SIGMAS * 1.4826 * spread_m / np.sqrt(independent)):
            name = _of(recording, person, trajectory.skeleton.bone_name(bone))
            reason = f"the length of {name} drifts by {1000 * drift_m:+.0f} mm from the first third to the last"
            remedy = (
                "Bones do not grow: where did the person go? The calibration may be worse there; --refine-calibration."
            )
            found.append(Suspicion(name, reason, remedy, 0.2 + min(abs(drift_m), 0.1)))
    return found


def short_lives(recording: FinishedRecording) -> list[Suspicion]:
    """People who are there for a moment only, beside others who stay."""
    lives_s = {person: float(each.time_s[-1] - each.time_s[0]) for person, each in recording.people.items()}
    longest_s = max(lives_s.values())
    return [
        Suspicion(
            f"person {person}",
            f"person {person} is there for {life_s:.1f} s only: perhaps nobody, or somebody who was not recognised",
            "See the events of this person; accept fewer false tracks (--tracking.false-tracks-per-hour).",
            0.1,
        )
        for person, life_s in lives_s.items()
        if life_s < _SHORT_LIFE_S < longest_s / 2
    ]


def _of(recording: FinishedRecording, person: int, what: str) -> str:
    called = recording.called(person)
    return f"{called}: {what}" if called else what
