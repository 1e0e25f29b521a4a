"""Which moments of a recording are the worst."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import camera_medians, sigma_m
from fgpose.sampling import usual_step_s
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile, lower_medians

_AT_MOST = 5
# Two moments are further apart than this share of the recording, or than this time where that is longer: else all five
# are one. Of a recording of some seconds they may be nearer, or there would be one or two.
_APART, _APART_S, _APART_OF_SHORT = 1 / 20, 1.0, 1 / 8
# The largest of two kinds that are nearer than this are one moment.
_SAME_S = 0.1
_OF_CAMERA = "errors of a camera"
_MISSING_STEPS = 1.5  # of the usual length: in a longer one frames are missing
# What else is so many times what it seldom exceeds is said of a moment, too.
_ALSO = 1.5


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


@dataclass(frozen=True, eq=False)
class _Judged:
    """What is said of one person, by kind."""

    trajectory: Trajectory
    ratios: Mapping[str, Float[np.ndarray, "frame part"]]
    """Of each joint or camera: how many times the usual it is; zero where it is not known."""
    scores: Mapping[str, Float[np.ndarray, " frame"]]
    """Of the body: over what it seldom exceeds."""


@dataclass(frozen=True)
class _Peak:
    """Where something is larger than around it."""

    person: int
    frame: int
    time_s: float
    kind: str
    score: float


def worst_moments(recording: FinishedRecording) -> list[WorstMoment]:
    """At most five of all people, the worst first: where uncertainty, reprojection errors, those of one camera in most
    of its joints, or changes of velocity are largest, each over its usual value in this recording.

    The largest of each kind is among them, however large others are: kinds cannot be compared.
    """
    judged = {person: _judged(trajectory) for person, trajectory in recording.people.items()}
    peaks = [peak for person, own in judged.items() for peak in _peaks(own, person)]
    peaks.sort(key=lambda peak: -peak.score)
    chosen: list[_Peak] = []
    largest = {peak.kind: peak for peak in reversed(peaks)}.values()
    for peak in sorted(largest, key=lambda peak: -peak.score):
        _choose(peak, chosen, _SAME_S)
    for peak in peaks:
        _choose(peak, chosen, _apart_s(recording.people[peak.person]))
    chosen.sort(key=lambda peak: -peak.score)
    return [_described(judged[peak.person], peak) for peak in chosen]


def _choose(peak: _Peak, chosen: list[_Peak], apart_s: float) -> None:
    """If there is room, and it is no moment that was chosen already."""
    is_new = all(peak.person != each.person or abs(peak.time_s - each.time_s) >= apart_s for each in chosen)
    if is_new and len(chosen) < _AT_MOST:
        chosen.append(peak)


def _judged(trajectory: Trajectory) -> _Judged:
    ratios = _ratios(trajectory)
    scores = {}
    for kind, own in ratios.items():
        # Of the body: one joint of thirty that is a little off is not the worst that can be, one that is far off is.
        n_worst = 1 if kind == _OF_CAMERA else _n_worst(trajectory)
        score = np.sqrt(np.mean(np.sort(own, axis=-1)[:, -n_worst:] ** 2, axis=-1)) if own.size else np.zeros(len(own))
        # Changes of velocity vary by more than sigma does.
        scores[kind] = score / max(float(np.quantile(score, 0.95)), 1e-12)
    return _Judged(trajectory, ratios, scores)


def _peaks(judged: _Judged, person: int) -> list[_Peak]:
    """The highest of each kind, well apart."""
    time_s = judged.trajectory.time_s
    return [
        _Peak(person, frame, float(time_s[frame]), kind, float(score[frame]))
        for kind, score in judged.scores.items()
        for frame in _highest(score, judged.trajectory).tolist()
    ]


def _highest(score: Float[np.ndarray, " frame"], trajectory: Trajectory) -> Int[np.ndarray, " peak"]:
    time_s, apart_s = trajectory.time_s, _apart_s(trajectory)
    left, peaks = score.copy(), []
    while len(peaks) < _AT_MOST and left.max() > 0:
        peaks.append(int(left.argmax()))
        left[np.abs(time_s - time_s[peaks[-1]]) < apart_s] = 0.0
    return np.array(peaks, dtype=int)


def _apart_s(trajectory: Trajectory) -> float:
    duration_s = float(trajectory.time_s[-1] - trajectory.time_s[0])
    # Of a single frame: any other is another one.
    return max(_APART * duration_s, min(_APART_S, _APART_OF_SHORT * duration_s), 1e-9)


def _described(judged: _Judged, peak: _Peak) -> WorstMoment:
    scores = {kind: float(score[peak.frame]) for kind, score in judged.scores.items()}
    also = [kind for kind in sorted(scores, key=lambda kind: -scores[kind]) if scores[kind] >= _ALSO]
    kinds = dict.fromkeys([peak.kind, *also])
    (words, worst), *others = (_said(judged, kind, peak.frame) for kind in kinds)
    trajectory, names = judged.trajectory, judged.trajectory.skeleton.joints
    said = [words, *(more for more, _ in others)]
    if trajectory.residual_px is not None:
        n_views = int(np.isfinite(trajectory.residual_px[peak.frame, :, worst[0]]).sum())
        said.append(f"{n_views} of {len(trajectory.camera_names)} cameras see {names[worst[0]]}")
    return WorstMoment(peak.person, peak.frame, peak.time_s, "; ".join(said), tuple(names[j] for j in worst))


def _said(judged: _Judged, kind: str, frame: int) -> tuple[str, list[int]]:
    """What is large there, and its worst joints."""
    own, names = judged.ratios[kind][frame], judged.trajectory.skeleton.joints
    if kind == _OF_CAMERA:
        return _said_of_camera(judged.trajectory, frame, int(own.argmax()), float(own.max()))
    worst = np.argsort(-own)[:3].tolist()
    words = f"{kind} of {names[worst[0]]} {own[worst[0]]:.1f} times the usual"
    if len(worst) > 1:
        others = " and ".join(names[joint] for joint in worst[1:])
        words += f", of {others} up to {own[worst[1]]:.1f} times"
    return words, worst


def _said_of_camera(trajectory: Trajectory, frame: int, camera: int, ratio: float) -> tuple[str, list[int]]:
    assert trajectory.residual_px is not None
    error_px = trajectory.residual_px[frame, camera]
    median_px = known_quantile(error_px, 0.5)
    words = (
        f"camera {trajectory.camera_names[camera]} is {median_px:.0f} px beside the result, median of its joints, "
        f"{ratio:.1f} times its usual"
    )
    return words, np.argsort(-np.nan_to_num(error_px))[:3].tolist()


def _ratios(trajectory: Trajectory) -> dict[str, Float[np.ndarray, "frame part"]]:
    """By kind."""
    return {
        "sigma": _ratio(sigma_m(trajectory)),
        "reprojection error": _ratio(_error_px(trajectory)),
        "change of velocity": _ratio(_change_mps(trajectory)),
        _OF_CAMERA: _camera_ratio(trajectory),
    }


def _ratio(values: Float[np.ndarray, "frame joint"]) -> Float[np.ndarray, "frame joint"]:
    """Over the median of all."""
    usual = known_quantile(values, 0.5)
    return np.nan_to_num(values / usual) if usual > 0 else np.zeros(values.shape)


def _camera_ratio(trajectory: Trajectory) -> Float[np.ndarray, "frame camera"]:
    """Of each camera over its own median."""
    median_px = _median_px(trajectory)
    usual_px = camera_medians(median_px[..., None])
    return np.nan_to_num(np.divide(median_px, usual_px, out=np.zeros(median_px.shape), where=usual_px > 0))


def _median_px(trajectory: Trajectory) -> Float[np.ndarray, "frame camera"]:
    """Of the errors of all detections, those that are not believed included; NaN where a camera sees few joints."""
    residual_px = trajectory.residual_px
    if residual_px is None:
        return np.full((trajectory.n_frames, 0), np.nan)
    n_seen = np.isfinite(residual_px).sum(axis=-1)
    return np.where(n_seen >= _n_worst(trajectory), lower_medians(residual_px), np.nan)


def _error_px(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """Largest over the cameras of those errors that count: hallucinated detections are left out."""
    if trajectory.residual_px is None:
        return np.full(trajectory.status.shape, np.nan)
    residual_px = np.where(np.isfinite(trajectory.residual_px), trajectory.residual_px, -np.inf)
    if trajectory.visibility is not None:
        residual_px = np.where(trajectory.visibility < 0.5, -np.inf, residual_px)
    largest_px = residual_px.max(axis=1, initial=-np.inf)
    return np.where(np.isfinite(largest_px), largest_px, np.nan)


def _change_mps(trajectory: Trajectory) -> Float[np.ndarray, "frame joint"]:
    """NaN beside frames that are missing: nobody knows when the velocity changed."""
    change_mps = np.full(trajectory.status.shape, np.nan)
    if trajectory.n_frames > 2:
        step_s = np.diff(trajectory.time_s)[:, None, None]
        velocity_mps = np.diff(trajectory.positions_m, axis=0) / step_s
        velocity_mps = np.where(step_s < _MISSING_STEPS * usual_step_s(trajectory.time_s), velocity_mps, np.nan)
        change_mps[1:-1] = np.linalg.norm(np.diff(velocity_mps, axis=0), axis=-1)
    return change_mps


def _n_worst(trajectory: Trajectory) -> int:
    """A quarter of the joints."""
    return max(trajectory.skeleton.n_joints // 4, 1)
