"""Joints that views show in different places than the others do."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.body.joint_names import in_words, limb_of
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import known_quantile
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import usual_step_s

# One joint that a view shows elsewhere more often than not, and hardly any other.
_OFTEN, _HARDLY = 0.5, 0.1
_LEAST_S = 1.0


def misplaced_joints(recording: FinishedRecording) -> list[Finding]:
    """A joint that one view shows in another place than the others: its network takes something else for it. Where
    no two views agree, none is right: it is the joint that is not to be seen."""
    found = []
    for person, trajectory in recording.people.items():
        if trajectory.visibility is None or trajectory.n_frames < 2:
            continue
        known = np.isfinite(trajectory.visibility)
        judged = known.sum(axis=0) * usual_step_s(trajectory.time_s) > _LEAST_S
        shares = ((trajectory.visibility < 0.5) & known).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        elsewhere = (shares > _OFTEN) & judged
        wrong = elsewhere & (np.median(shares, axis=1, keepdims=True) < _HARDLY)
        nowhere = (wrong.sum(axis=0) >= 2) & ((judged & ~elsewhere).sum(axis=0) < 2)
        if nowhere.any():
            found.append(_seen_by_nobody(recording, person, np.flatnonzero(nowhere).tolist(), shares))
        groups: dict[tuple[int, str], list[int]] = {}
        for c, j in np.argwhere(wrong & ~nowhere).tolist():
            groups.setdefault((c, limb_of(trajectory.skeleton.joints[j])), []).append(j)
        found += [_misplaced(recording, person, c, joints, shares[c]) for (c, _), joints in groups.items()]
    return found


def _seen_by_nobody(
    recording: FinishedRecording, person: int, joints: list[int], shares: Float[np.ndarray, "camera joint"]
) -> Finding:
    """Of joints of which no two views agree."""
    names = recording.people[person].skeleton.joints
    low, high = np.quantile(shares[:, joints][shares[:, joints] > _OFTEN], (0.0, 1.0))
    return Finding(
        Code.MISPLACED_JOINT,
        Severity.DOUBTFUL,
        f"{_who(recording, person)}no two cameras agree where {in_words(names[joint] for joint in joints)} "
        f"{'are' if len(joints) > 1 else 'is'}: they contradict each other in {100 * low:.0f} to {100 * high:.0f} % of "
        "the detections",
        "Look at the images: hidden from all, guessed by the network, or not there? Leave such detections out with "
        "--min-confidence, or use a skeleton without these joints.",
        0.3 * float(high),
        joint=names[joints[0]],
        person=recording.number(person),
    )


def _misplaced(
    recording: FinishedRecording, person: int, camera: int, joints: list[int], shares: Float[np.ndarray, " joint"]
) -> Finding:
    """Of joints of one limb in one view."""
    names = recording.people[person].skeleton.joints
    worst = max(joints, key=lambda joint: float(shares[joint]))
    what, name = in_words(names[joint] for joint in joints), recording.camera_names[camera]
    return Finding(
        Code.MISPLACED_JOINT,
        Severity.DOUBTFUL,
        f"{_who(recording, person)}camera {name} shows {what} elsewhere than the others do in "
        f"{100 * shares[worst]:.0f} % of its detections{_displacement(recording, person, camera, worst)}",
        "Look at its images: what does the network take for this? A coat, a chair, the other side?",
        0.3 * float(shares[worst]),
        camera=name,
        joint=names[worst],
        person=recording.number(person),
    )


def _who(recording: FinishedRecording, person: int) -> str:
    return f"{recording.called(person)}: " if recording.called(person) else ""


def _displacement(recording: FinishedRecording, person: int, camera: int, joint: int) -> str:
    """By how far on the body, where the detections are known."""
    seen = recording.observations.get(person)
    if seen is None or recording.rig is None:
        return ""
    joint_m = recording.people[person].positions_m[:, [joint]]
    pinhole = recording.rig.cameras[camera]
    error_px = pinhole.undistort(seen.points2d_px[:, camera, [joint]]) - pinhole.project(joint_m)
    error_m = error_px[:, 0] / recording.rig.px_per_m(joint_m)[:, camera]
    distance_m = float(np.linalg.norm([known_quantile(axis_m, 0.5) for axis_m in error_m.T]))
    return f", by {100 * distance_m:.0f} cm (median)" if np.isfinite(distance_m) else ""
