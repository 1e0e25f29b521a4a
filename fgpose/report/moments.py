"""The worst moments of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import known_quantile, sigma_m
from fgpose.trajectory import Trajectory

_AT_MOST = 5
# Two moments are further apart than this, or than a twentieth of the recording: else all five are one.
_APART_S = 1.0


@dataclass(frozen=True)
class WorstMoment:
    """A frame in which much is wrong."""

    person: int
    frame: int
    """Of that person's trajectory."""
    time_s: float
    reason: str
    joints: tuple[str, ...]
    """Those that are worst."""


def worst_moments(recording: FinishedRecording) -> list[WorstMoment]:
    """At most five of all people, in the order of time: where uncertainty, reprojection errors and changes of velocity
    are largest, each over its usual value in this recording."""
    found: list[tuple[float, WorstMoment]] = []
    for person, trajectory in recording.people.items():
        ratios = {
            "sigma": _ratio(sigma_m(trajectory)),
            "reprojection error": _ratio(_error_px(trajectory)),
            "change of velocity": _ratio(_change_m(trajectory)),
        }
        together = np.stack(list(ratios.values()))
        # Of the body: one joint of thirty that is off is not the worst that can be. Mean of the worst quarter.
        n_worst = max(trajectory.skeleton.n_joints // 4, 1)
        scores = np.sort(together, axis=-1)[..., -n_worst:].mean(axis=-1)
        # Each kind over what it seldom exceeds: changes of velocity vary by more than sigma does.
        scores /= np.maximum(np.quantile(scores, 0.95, axis=-1, keepdims=True), 1e-12)
        for frame in _peaks(scores.max(axis=0), trajectory.time_s).tolist():
            kind = list(ratios)[int(scores[:, frame].argmax())]
            found.append((scores[:, frame].max(), _described(trajectory, person, frame, kind, ratios[kind][frame])))
    found.sort(key=lambda each: -each[0])
    return sorted((moment for _, moment in found[:_AT_MOST]), key=lambda moment: moment.time_s)


def _described(
    trajectory: Trajectory, person: int, frame: int, kind: str, ratio: Float[np.ndarray, " joint"]
) -> WorstMoment:
    worst = np.argsort(-ratio)[:3].tolist()
    joints = tuple(trajectory.skeleton.joints[j] for j in worst)
    worst_joint = trajectory.skeleton.joints[worst[0]]
    words = f"{kind} of {worst_joint} {ratio[worst[0]]:.1f} times the usual"
    if len(joints) > 1:
        words += f", of {' and '.join(joints[1:])} up to {ratio[worst[1]]:.1f} times"
    if trajectory.residual_px is not None:
        n_views = int(np.isfinite(trajectory.residual_px[frame, :, worst[0]]).sum())
        words += f"; {n_views} of {len(trajectory.camera_names)} cameras see {worst_joint}"
    return WorstMoment(person, frame, float(trajectory.time_s[frame]), words, joints)


def _ratio(values: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, "frame joint"]:
    """Over the median of all; zero where it is not known."""
    usual = known_quantile(values, 0.5)
    return np.nan_to_num(values / usual) if usual > 0 else np.zeros(values.shape)


def _error_px(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """Largest over the cameras of those errors that count: hallucinated detections are left out."""
    if trajectory.residual_px is None:
        return np.full(trajectory.status.shape, np.nan)
    residual_px = np.where(np.isfinite(trajectory.residual_px), trajectory.residual_px, -np.inf)
    if trajectory.visibility is not None:
        residual_px = np.where(trajectory.visibility < 0.5, -np.inf, residual_px)
    largest_px = residual_px.max(axis=1, initial=-np.inf)
    return np.where(np.isfinite(largest_px), largest_px, np.nan)


def _change_m(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    change_m = np.full(trajectory.status.shape, np.nan)
    if trajectory.n_frames > 2:
        change_m[1:-1] = np.linalg.norm(np.diff(trajectory.positions_m, 2, axis=0), axis=-1)
    return change_m


def _peaks(score: Float[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> Int[np.ndarray, " peak"]:
    """Frames of the highest scores, well apart."""
    apart_s = max(_APART_S, (time_s[-1] - time_s[0]) / 20)
    left, peaks = score.copy(), []
    while len(peaks) < _AT_MOST and np.isfinite(left).any() and left.max() > 0:
        peaks.append(int(left.argmax()))
        left[np.abs(time_s - time_s[peaks[-1]]) < apart_s] = -np.inf
    return np.array(peaks, dtype=int)
