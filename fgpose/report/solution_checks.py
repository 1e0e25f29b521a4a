"""What is suspicious of the solution as a whole: convergence, covered volume, covariance against residuals."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.report.camera_checks import together_px
from fgpose.report.finished import FinishedRecording
from fgpose.report.series import known_quantile, root_m, sigma_m
from fgpose.report.suspicion import Suspicion
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory

# Less is somebody who comes and goes.
_OUTSIDE_SHARE = 0.05
# A smoother that is three times as sure as one frame alone claims nine independent frames; as errors of detections are
# correlated over 0.15 s, that is 1.3 s in which a limb does not stay where it is. Three times less sure than one frame
# alone, it has not used what the cameras saw.
_SIGMA_RATIO = 3.0
_SAMPLES = 200  # frames; the median needs no more
# Median of the length of a vector of two normal numbers of standard deviation one.
_MEDIAN_LENGTH = 1.1774


def not_converged(recording: FinishedRecording) -> list[Suspicion]:
    """The optimiser was stopped."""
    found = []
    for person, trajectory in recording.people.items():
        convergence = trajectory.convergence
        if convergence is not None and not convergence.converged:
            reason = f"the optimiser has not converged after {convergence.iterations} iterations"
            remedy = "Raise --solver.max-iterations; if it stays so, look for a wrong calibration below."
            found.append(Suspicion(recording.called(person), reason, remedy, 0.9))
    return found


def outside(recording: FinishedRecording) -> list[Suspicion]:
    """People who are where fewer than two cameras look."""
    if recording.rig is None or recording.rig.n_cameras < 2:
        return []
    found = []
    for person, trajectory in recording.people.items():
        known = np.isfinite(root_m(trajectory)).all(axis=-1)
        if not known.any():
            continue
        share = float(np.mean(views_of(root_m(trajectory)[known], recording.rig) < 2))
        if share > _OUTSIDE_SHARE:
            who = recording.called(person) or "the person"
            reason = f"{who} is outside of the volume that two cameras see in {100 * share:.0f} % of the frames"
            remedy = "Leave these frames out; turn the cameras to where people walk, or keep people inside."
            found.append(Suspicion(recording.called(person), reason, remedy, share))
    return found


def views_of(points_m: Float[np.ndarray, "point 3"], rig: CameraRig) -> Float[np.ndarray, " point"]:
    """How many cameras have each point in their image."""
    sizes_px = np.array([camera.size_px for camera in rig.cameras])
    pixels = rig.project(points_m[:, None])[:, :, 0]
    distorted = np.stack([camera.distort(pixels[:, c]) for c, camera in enumerate(rig.cameras)], axis=1)
    inside = np.isfinite(distorted).all(axis=-1) & (distorted >= 0).all(axis=-1) & (distorted < sizes_px).all(axis=-1)
    return inside.sum(axis=1).astype(float)


def covariance_scale(recording: FinishedRecording) -> list[Suspicion]:
    """A covariance that does not fit the residuals."""
    ratio = sigma_ratio(recording)
    if not np.isfinite(ratio) or 1 / _SIGMA_RATIO <= ratio <= _SIGMA_RATIO:
        return []
    if ratio < 1:
        reason = f"sigma is {1 / ratio:.1f} times smaller than the residuals of one frame allow: it is too sure"
        remedy = "Do not use the bands; check --motion.* and the noise of the detections in the configuration."
    else:
        reason = f"sigma is {ratio:.1f} times larger than the residuals of one frame suggest: it is too careful"
        remedy = "Check the noise of the detections in the configuration: most residuals are smaller than it says."
    return [Suspicion("", reason, remedy, 0.3)]


def sigma_ratio(recording: FinishedRecording) -> float:
    """Median of the sigma of joints over that of a triangulation of the frame alone, by the residuals as they are;
    NaN where rig, residuals or covariance are missing."""
    if recording.rig is None or together_px(recording) is None:
        return np.nan
    ratios = [_sigma_ratios(trajectory, recording.rig).ravel() for trajectory in recording.people.values()]
    return known_quantile(np.concatenate(ratios), 0.5)


def _sigma_ratios(trajectory: Trajectory, rig: CameraRig) -> Float[np.ndarray, "frame joint"]:
    assert trajectory.residual_px is not None
    sampled = spread_evenly(trajectory.n_frames, _SAMPLES)
    seen = np.isfinite(trajectory.residual_px[sampled])
    by_camera = np.array([known_quantile(own, 0.5) for own in np.moveaxis(trajectory.residual_px, 1, 0)])
    # Three numbers are estimated from two of each camera, so residuals are smaller than errors.
    n_views = max(float(seen.sum(axis=1)[seen.sum(axis=1) >= 2].mean()) if seen.any() else 2.0, 2.0)
    spread_px = by_camera / _MEDIAN_LENGTH / np.sqrt(max(1 - 3 / (2 * n_views), 0.25))
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
    places_m = np.array([camera.position_m for camera in rig.cameras])
    ray_m = positions_m[:, None] - places_m[:, None]
    ray = ray_m / np.linalg.norm(ray_m, axis=-1, keepdims=True)
    strength = np.where(seen, np.nan_to_num((rig.px_per_m(positions_m) / spread_px[:, None]) ** 2), 0.0)
    across = np.eye(3) - np.nan_to_num(ray)[..., :, None] * np.nan_to_num(ray)[..., None, :]
    return np.einsum("tcj,tcjkl->tjkl", strength, across)


def equal_confidences(recording: FinishedRecording) -> list[Suspicion]:
    """A detector that says of no detection how sure it is."""
    confidences = [seen.confidence[seen.seen] for seen in recording.observations.values()]
    together = np.concatenate(confidences) if confidences else np.zeros(0)
    if together.size < 2 or np.ptp(together) > 0:
        return []
    return [
        Suspicion(
            "",
            f"all detections have the confidence {together[0]:g}: bad ones have the weight of good ones",
            "Give the network's scores with the keypoints, if it has any.",
            0.25,
        )
    ]
