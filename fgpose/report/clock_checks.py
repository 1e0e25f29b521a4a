"""What is suspicious of clocks and frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera
from fgpose.report.finished import FinishedRecording
from fgpose.report.series import known_quantile
from fgpose.report.suspicion import Suspicion
from fgpose.sampling import usual_step_s
from fgpose.trajectory import Trajectory

# Errors of detections are correlated over about 0.15 s: blocks of a second are independent of each other.
_BLOCK_S = 1.0
_MIN_BLOCKS = 5
# Standard errors. One camera in a thousand recordings of ten exceeds four by chance; block errors have heavy tails.
_SIGNIFICANT = 5.0
# As fgpose.calibration.camera_faults: at 50 Hz and walking speed 6 mm, half of the usual error.
_NOTICEABLE_FRAMES = 0.2
# A frame that comes later than this many steps has missed one.
_MISSING_STEPS = 1.5


@dataclass(frozen=True)
class Lag:
    """How much later than the result says a camera took its images, by what its errors have in common with the speed
    of the joints in its image. The result has followed the camera by its share, so the true lag is larger."""

    lag_s: float
    sigma_s: float
    """From the scatter of blocks of a second."""


def lag_of(
    trajectory: Trajectory,
    detected_px: Float[np.ndarray, "frame joint 2"],
    camera: Camera,
) -> Lag | None:
    """Lag of a camera; None where less than five seconds say something.

    Args:
        trajectory: the result.
        detected_px: undistorted, of this camera, in its frames.
        camera: as calibrated.
    """
    projected_px = camera.project(trajectory.positions_m)
    speed_px_s = np.gradient(projected_px, trajectory.time_s, axis=0) if trajectory.n_frames > 2 else 0 * projected_px
    error_px = detected_px - projected_px
    # A constant error of a joint is no lag.
    error_px = error_px - np.array(
        [[known_quantile(axis, 0.5) for axis in joint.T] for joint in error_px.swapaxes(0, 1)]
    )
    known = np.isfinite(error_px).all(axis=-1) & np.isfinite(speed_px_s).all(axis=-1)
    # Outliers would decide otherwise.
    length_px = np.linalg.norm(error_px, axis=-1)
    known &= length_px < 5 * known_quantile(length_px, 0.5)
    product = np.where(known, np.einsum("tji,tji->tj", np.nan_to_num(error_px), np.nan_to_num(speed_px_s)), 0).sum(1)
    square = np.where(known, np.einsum("tji,tji->tj", *2 * [np.nan_to_num(speed_px_s)]), 0).sum(1)
    block = ((trajectory.time_s - trajectory.time_s[0]) / _BLOCK_S).astype(int)
    products, squares = np.bincount(block, product), np.bincount(block, square)
    if (squares > 0).sum() < _MIN_BLOCKS:
        return None
    lag_s = products.sum() / squares.sum()
    scatter = np.sqrt(np.sum((products - lag_s * squares) ** 2)) / squares.sum()
    return Lag(float(lag_s), float(scatter))


def late_cameras(recording: FinishedRecording) -> list[Suspicion]:
    """A camera whose detections run ahead of the motion, or behind it."""
    seen = recording.observations.get(recording.main_person)
    if seen is None or recording.rig is None or recording.rig.n_cameras < 3 or recording.main.n_frames < 3:
        return []
    step_s = usual_step_s(recording.main.time_s)
    on_time_px = recording.on_time_px(recording.main_person)
    found = []
    for c, camera in enumerate(recording.rig.cameras):
        lag = lag_of(recording.main, on_time_px[:, c], camera)
        if lag and abs(lag.lag_s) > max(_SIGNIFICANT * lag.sigma_s, _NOTICEABLE_FRAMES * step_s):
            reason = (
                f"camera {camera.name} is {'late' if lag.lag_s > 0 else 'early'} by at least "
                f"{1000 * abs(lag.lag_s):.1f} ± {1000 * lag.sigma_s:.1f} ms ({abs(lag.lag_s) / step_s:.1f} frames)"
            )
            remedy = (
                "Smooth again with --estimate-time-offsets; with --refine-calibration too if it may have been moved."
            )
            found.append(Suspicion(camera.name, reason, remedy, 0.45))
    return found


def undetermined_clocks(recording: FinishedRecording) -> list[Suspicion]:
    """A time offset that was estimated, and whose standard deviation matters."""
    step_s = usual_step_s(recording.main.time_s)
    return [
        Suspicion(
            camera,
            f"the clock of camera {camera} is known to ± {1000 * sigma_s:.1f} ms only ({sigma_s / step_s:.1f} frames)",
            "Let the person move more, and fast, where this camera sees them; or synchronise the cameras.",
            0.3,
        )
        for camera, sigma_s in recording.offset_sigma_s.items()
        if sigma_s > _NOTICEABLE_FRAMES * step_s
    ]


def missing_frames(recording: FinishedRecording) -> list[Suspicion]:
    """Frames that the recording lacks."""
    trajectory = recording.main
    steps_s = np.diff(trajectory.time_s)
    step_s = usual_step_s(trajectory.time_s)
    missed = steps_s > _MISSING_STEPS * step_s
    if not missed.any():
        return []
    longest = int(np.argmax(steps_s))
    share = float(steps_s[missed].sum() / steps_s.sum())
    reason = (
        f"frames are missing at {int(missed.sum())} moments, {100 * share:.1f} % of the time; the longest for "
        f"{steps_s[longest]:.2f} s at {trajectory.time_s[longest]:.1f} s"
    )
    return [
        Suspicion("", reason, "Look for dropped images in the log of the recorder; a slower disk loses them.", share)
    ]
