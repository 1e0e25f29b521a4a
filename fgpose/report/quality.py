"""What the result of a recording is worth: numbers of one row of a table, and what is suspicious.

Everything is computed from the result, never from a truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fgpose.association.recording import Progress
from fgpose.diagnosis.diagnose import diagnose_finished
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import root_speed_mps, sigma_m
from fgpose.finding import Finding
from fgpose.sampling import frames_per_second
from fgpose.trajectory import Status, Trajectory
from fgpose_factors.robust_statistics import known_quantile

_CAMERAS, _DETECTIONS, _RESIDUALS, _COVARIANCES = "cameras", "detections", "reprojection errors", "covariances"
_BESIDE_MOTION = {_CAMERAS, _DETECTIONS, _RESIDUALS, _COVARIANCES}


@dataclass(frozen=True)
class Quality:
    """The numbers of one recording. Over all people, joints and frames in which somebody is there; NaN: not known."""

    name: str
    n_people: int
    n_cameras: int
    n_joints: int
    n_frames: int
    """From the first frame of anybody to the last."""
    rate_hz: float
    duration_s: float
    seen_share: float
    """Share of joints and frames that at least two cameras see."""
    predicted_share: float
    """Share that is predicted from bones and motion, because fewer than two cameras see it."""
    unobservable_share: float
    """Share that nothing determines."""
    views: float
    """Mean number of cameras that see a joint."""
    longest_gap_s: float
    """Longest time for which fewer than two cameras saw one of the joints, from the first frame in which its person is
    there to the last; all of it for a joint that is never seen. Whoever goes and comes back is not seen meanwhile."""
    reprojection_px: float
    """Median reprojection error of all detections, undistorted pixels."""
    reprojection_q90_px: float
    worst_camera_px: float
    """Median reprojection error of the camera with the largest."""
    hallucinated_share: float
    """Share of the detections that are more probably hallucinated than not."""
    sigma_mm: float
    """Median over joints and frames of the root of the largest eigenvalue of a joint's covariance."""
    sigma_q95_mm: float
    bone_spread_share: float
    """Median over the bones of the standard deviation of the length over time, relative to the length."""
    bone_asymmetry_share: float
    """Largest difference of a left limb's median length to its right one's, relative to their mean."""
    max_speed_mps: float
    """Largest speed of the root of a body from frame to frame, across gaps too."""
    converged: bool | None
    """Whether the optimiser ended by itself; None: not known."""
    suspicions: tuple[Finding, ...] = ()
    """The most important first."""
    unknown: tuple[str, ...] = ()
    """What is not known of the recording, and so not judged."""

    @property
    def only_motion(self) -> bool:
        """Whether nothing of the cameras is known, nor how sure the result is."""
        return set(self.unknown) >= _BESIDE_MOTION

    @property
    def not_judged(self) -> str:
        """The same in words; empty: all was judged."""
        if not self.unknown:
            return ""
        *others, last = self.unknown
        what = f"{', '.join(others)} and {last}" if others else last
        said = "only the motion itself was judged" if self.only_motion else "not all was judged"
        return f"{said}: {what} are not known"

    @property
    def numbers(self) -> dict[str, str | int | float | bool | None]:
        """All but words; of the suspicions there is the number, n_suspicions: a row of a table."""
        fields = [field.name for field in dataclasses.fields(self) if field.name not in ("suspicions", "unknown")]
        return {name: getattr(self, name) for name in fields} | {"n_suspicions": len(self.suspicions)}


def quality(recording: FinishedRecording, progress: Progress | None = None) -> Quality:
    """Judge a finished recording; told how many of how many steps of its diagnosis are done."""
    everybody = list(recording.people.values())
    first_s = min(float(each.time_s[0]) for each in everybody)
    last_s = max(float(each.time_s[-1]) for each in everybody)
    rate_hz = frames_per_second(max((each.time_s for each in everybody), key=len))
    status = np.concatenate([each.status.ravel() for each in everybody])
    converged = [each.convergence.converged for each in everybody if each.convergence is not None]
    return Quality(
        name=recording.name,
        n_people=len(everybody),
        n_cameras=len(recording.camera_names),
        n_joints=recording.main.skeleton.n_joints,
        n_frames=round((last_s - first_s) * rate_hz) + 1 if np.isfinite(rate_hz) else 1,
        rate_hz=rate_hz,
        duration_s=last_s - first_s,
        seen_share=float(np.mean(status == Status.OBSERVED)),
        predicted_share=float(np.mean(status == Status.PREDICTED)),
        unobservable_share=float(np.mean(status == Status.UNOBSERVABLE)),
        longest_gap_s=max(_longest_gap_s(each) for each in everybody),
        converged=all(converged) if converged else None,
        **_of_residuals(everybody),
        **_of_covariance(everybody),
        **_of_motion(everybody),
        suspicions=diagnose_finished(recording, progress).findings,
        unknown=tuple(_unknown(recording)),
    )


def _unknown(recording: FinishedRecording) -> Iterator[str]:
    everybody = recording.people.values()
    if recording.rig is None:
        yield _CAMERAS
    if not recording.observations:
        yield _DETECTIONS
    if any(each.residual_px is None for each in everybody):
        yield _RESIDUALS
    if any(each.covariance_m2 is None for each in everybody):
        yield _COVARIANCES
    if not recording.main.skeleton.bones:
        yield "bones"


def _longest_gap_s(trajectory: Trajectory) -> float:
    """See longest_gap_s."""
    there = np.flatnonzero(~trajectory.absent)
    if len(there) < 2:
        return 0.0
    own = trajectory.frames(slice(there[0], there[-1] + 1))
    step_s = 1 / frames_per_second(own.time_s)
    before_s, after_s = own.time_s[0] - step_s, own.time_s[-1] + step_s
    seen_s = (np.array([before_s, *own.time_s[seen], after_s]) for seen in own.observed.T)
    return max(0.0, max(float(np.diff(each).max()) for each in seen_s) - step_s)


def _of_residuals(everybody: list[Trajectory]) -> dict[str, Any]:
    residuals = [each.residual_px for each in everybody if each.residual_px is not None]
    if len(residuals) < len(everybody):
        names = ("views", "reprojection_px", "reprojection_q90_px", "worst_camera_px", "hallucinated_share")
        return dict.fromkeys(names, np.nan)
    together_px = np.concatenate(residuals)
    cameras_px = [known_quantile(together_px[:, camera], 0.5) for camera in range(together_px.shape[1])]
    visibility = [each.visibility for each in everybody if each.visibility is not None]
    judged = np.concatenate(visibility) if visibility else np.zeros((0,))
    judged = judged[np.isfinite(judged)]
    return {
        "views": float(np.isfinite(together_px).sum(axis=1).mean()),
        "reprojection_px": known_quantile(together_px, 0.5),
        "reprojection_q90_px": known_quantile(together_px, 0.9),
        "worst_camera_px": known_quantile(np.array(cameras_px), 1.0),
        "hallucinated_share": float(np.mean(judged < 0.5)) if judged.size else np.nan,
    }


def _of_covariance(everybody: list[Trajectory]) -> dict[str, Any]:
    sigma_mm = 1000 * np.concatenate([sigma_m(each).ravel() for each in everybody])
    return {"sigma_mm": known_quantile(sigma_mm, 0.5), "sigma_q95_mm": known_quantile(sigma_mm, 0.95)}


def _of_motion(everybody: list[Trajectory]) -> dict[str, Any]:
    def worst(figure: Callable[[Trajectory], float]) -> float:
        return known_quantile(np.array([figure(each) for each in everybody]), 1.0)

    return {
        "bone_spread_share": worst(_bone_spread),
        "bone_asymmetry_share": worst(_bone_asymmetry),
        "max_speed_mps": worst(lambda each: known_quantile(root_speed_mps(each), 1.0)),
    }


def _bone_spread(trajectory: Trajectory) -> float:
    lengths_m = trajectory.skeleton.bone_lengths(trajectory.positions_m)
    known_m = [own_m[np.isfinite(own_m)] for own_m in lengths_m.T]
    relative = [own_m.std() / np.median(own_m) for own_m in known_m if own_m.size and np.median(own_m) > 0]
    return known_quantile(np.array(relative), 0.5)


def _bone_asymmetry(trajectory: Trajectory) -> float:
    skeleton = trajectory.skeleton
    lengths_m = dict(zip(skeleton.bones, skeleton.bone_lengths(trajectory.positions_m).T, strict=True))
    shares = []
    for left, right in skeleton.limb_pairs:
        both_m = [known_quantile(lengths_m[bone], 0.5) for bone in (left, right) if bone in lengths_m]
        shares += [abs(both_m[0] - both_m[1]) / np.mean(both_m)] if len(both_m) == 2 and any(both_m) else []
    return known_quantile(np.array(shares, dtype=float), 1.0)
