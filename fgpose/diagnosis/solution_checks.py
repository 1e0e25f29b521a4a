"""What is suspicious of the solution as a whole: convergence, covered volume, errors of all cameras."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording, of_each_person
from fgpose.diagnosis.series import SAMPLES, USUAL_ERROR_M, camera_medians, errors_m, root_m, sigma_m, together_px
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import MEDIAN_LENGTH, known_quantile

# Less is somebody who comes and goes. Where it is not often, the covariances say enough.
_OUTSIDE_SHARE, _OFTEN_OUTSIDE = 0.05, 0.2
# 18 mm along each axis of the image, of BlazePose and OpenPose (fgpose.config.VisibilityConfig); three times as much.
_LARGE_ERROR_M = 3 * USUAL_ERROR_M
# 0.52 with 20 px of noise in all detections; 0.2 to 0.35 of real detectors, less of calibrations that are wrong.
_JUMPY = 0.45


@of_each_person
def not_converged(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """The optimiser was stopped."""
    convergence = trajectory.convergence
    if convergence is None or convergence.converged:
        return None
    reason = f"the optimiser has not converged after {convergence.iterations} iterations"
    remedy = "Raise --solver.max-iterations; if it stays so, look for a wrong calibration below."
    return Finding(Code.NOT_CONVERGED, Severity.DOUBTFUL, reason, remedy, 0.9)


@of_each_person
def other_bones(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """Bone lengths that were given, or learned online, and are not those that are seen."""
    other = trajectory.other_bone
    if other is None:
        return None
    reason = f"the bones that were known are not those that were seen, and were not used any more: {other}"
    remedy = (
        "If they were given: give a result of this person; if it was, look for a wrong calibration of one of the two "
        "recordings. If not, somebody else came, or limbs were hidden and guessed: leave out that part."
    )
    numbers = {"known_m": other.known_m, "seen_m": other.seen_m, "sigmas": other.sigmas}
    return Finding(Code.OTHER_BONES, Severity.NOTE, reason, remedy, 0.3, numbers=numbers)


@of_each_person
def outside(recording: FinishedRecording, person: int, trajectory: Trajectory) -> Finding | None:
    """Somebody who is where fewer than two cameras look."""
    known = np.isfinite(root_m(trajectory)).all(axis=-1)
    if recording.rig is None or recording.rig.n_cameras < 2 or not known.any():
        return None
    share = float(np.mean(in_views(recording.rig, root_m(trajectory)[known]).sum(axis=1) < 2))
    if share <= _OUTSIDE_SHARE:
        return None
    who = recording.called(person) or "the person"
    severity = Severity.DOUBTFUL if share > _OFTEN_OUTSIDE else Severity.NOTE
    reason = f"{who} is outside of the volume that two cameras see in {100 * share:.0f} % of the frames"
    remedy = "Leave these frames out; turn the cameras to where people walk, or keep people inside."
    return Finding(Code.OUTSIDE, severity, reason, remedy, share)


def large_errors(recording: FinishedRecording) -> list[Finding]:
    """Detections that are further from the result than those of any network."""
    if recording.rig is None or together_px(recording) is None:
        return []
    median_m = known_quantile(
        np.concatenate([errors_m(each, recording.rig).ravel() for each in recording.people.values()]), 0.5
    )
    if not median_m > _LARGE_ERROR_M:
        return []
    reason = (
        f"half of the reprojection errors are larger than {1000 * median_m:.0f} mm at the body; those of networks on "
        f"people that they see are about {1000 * USUAL_ERROR_M:.0f} mm"
    )
    if jumpiness(recording) > _JUMPY:
        reason += (
            ". They are other ones in every frame and lean to no side: the detections are noisy, not the calibration"
        )
        remedy = "Use a larger network, or larger images of the person; more cameras help too."
        return [Finding(Code.LARGE_ERRORS, Severity.NOTE, reason, remedy, 0.5)]
    remedy = "Is the calibration that of this recording, and are the cameras in its order? Calibrate anew."
    return [Finding(Code.LARGE_ERRORS, Severity.WRONG, reason, remedy, 0.9)]


def jumpiness(recording: FinishedRecording) -> float:
    """By how much reprojection errors change from one frame to the next, as a share of them (medians): 0.53 of normal
    noise that is new in every frame, 0 of what lasts; NaN of a single frame."""
    changes_px, errors_px = [], []
    for trajectory in recording.people.values():
        if trajectory.residual_px is not None and trajectory.n_frames > 1:
            first = spread_evenly(trajectory.n_frames - 1, SAMPLES)
            errors_px.append(trajectory.residual_px[first].ravel())
            changes_px.append(np.abs(trajectory.residual_px[first + 1] - trajectory.residual_px[first]).ravel())
    if not changes_px:
        return np.nan
    return known_quantile(np.concatenate(changes_px), 0.5) / known_quantile(np.concatenate(errors_px), 0.5)


def sigma_ratio(recording: FinishedRecording) -> float:
    """Median of the sigma of joints over that of a triangulation of the frame alone, by the residuals as they are;
    NaN where rig, residuals or covariance are missing."""
    if recording.rig is None or together_px(recording) is None:
        return np.nan
    ratios = [_sigma_ratios(trajectory, recording.rig).ravel() for trajectory in recording.people.values()]
    return known_quantile(np.concatenate(ratios), 0.5)


def _sigma_ratios(trajectory: Trajectory, rig: CameraRig) -> Float[np.ndarray, "frame joint"]:
    assert trajectory.residual_px is not None
    sampled = spread_evenly(trajectory.n_frames, SAMPLES)
    seen = np.isfinite(trajectory.residual_px[sampled])
    # Three numbers are estimated from two of each camera, so residuals are smaller than errors.
    n_views = max(float(seen.sum(axis=1)[seen.sum(axis=1) >= 2].mean()) if seen.any() else 2.0, 2.0)
    spread_px = camera_medians(trajectory.residual_px) / MEDIAN_LENGTH / np.sqrt(max(1 - 3 / (2 * n_views), 0.25))
    information = _information(trajectory.positions_m[sampled], seen, spread_px, rig)
    known = seen.sum(axis=1) >= 2
    known &= np.isfinite(trajectory.positions_m[sampled]).all(axis=-1)
    ratios = np.full(known.shape, np.nan)
    smallest = np.linalg.eigvalsh(information[known])[..., 0]
    ratios[known] = sigma_m(trajectory)[sampled][known] * np.sqrt(np.maximum(smallest, 0.0))
    return ratios


def _information(
    positions_m: Float[np.ndarray, "frame joint 3"],
    seen: Float[np.ndarray, "frame camera joint"] | np.ndarray,
    spread_px: Float[np.ndarray, " camera"],
    rig: CameraRig,
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Of the detections of a frame on each joint: each tells the two directions across its ray."""
    places_m = rig.positions_m
    ray_m = positions_m[:, None] - places_m[:, None]
    ray = ray_m / np.linalg.norm(ray_m, axis=-1, keepdims=True)
    strength = np.where(seen, np.nan_to_num((rig.px_per_m(positions_m) / spread_px[:, None]) ** 2), 0.0)
    across = np.eye(3) - np.nan_to_num(ray)[..., :, None] * np.nan_to_num(ray)[..., None, :]
    return np.einsum("tcj,tcjkl->tjkl", strength, across)


def equal_confidences(recording: FinishedRecording) -> list[Finding]:
    """A detector that says of no detection how sure it is."""
    confidences = [seen.confidence[seen.seen] for seen in recording.observations.values()]
    together = np.concatenate(confidences) if confidences else np.zeros(0)
    if together.size < 2 or np.ptp(together) > 0:
        return []
    return [
        Finding(
            Code.EQUAL_CONFIDENCE,
            Severity.NOTE,
            f"all detections have the confidence {together[0]:g}: bad ones have the weight of good ones",
            "Give the network's scores with the keypoints, if it has any.",
            0.25,
        )
    ]
