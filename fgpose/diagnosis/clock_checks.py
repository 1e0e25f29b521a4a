"""What is suspicious of clocks and frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import ProjectionConfig
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.seen.presence import cameras_with_somebody
from fgpose.estimation.online.clock_offsets import offset_information
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import usual_step_s
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile

# Errors of detections are correlated over about 0.15 s: blocks of a second are independent of each other.
_BLOCK_S = 1.0
_MIN_BLOCKS = 5
# Of a camera that is on time, by Student's distribution: there are few blocks. With eight it asks for 7.9 standard
# deviations, with sixty for 4.2.
_BY_CHANCE = 1e-4
# As fgpose.calibration.camera_faults: at 50 Hz and walking speed 6 mm, half of the usual error.
_NOTICEABLE_FRAMES = 0.2
_DRIFT_FRAMES = 1.0  # from the first second to the last: half of it at either end
# A frame that comes later than this many steps has missed one.
_MISSING_STEPS = 1.5
_PAUSE_S = 1.0
_OUTLIER_RATIO = 5.0  # of the median error
_UNWEIGHTED = ProjectionConfig(kernel="none")
# Relative: the lag that all cameras have in common has none but by rounding and by what keeps unseen joints invertible.
_NO_INFORMATION = 1e-7
# Two checks, one after the other, ask of the same recording. It is not kept for that: it is large.
_KNOWN_LAGS: WeakKeyDictionary[FinishedRecording, dict[str, Lag]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Lag:
    """How much later than the result says a camera took its images, against the median of all cameras."""

    lag_s: float
    sigma_s: float
    """From the scatter of blocks of a second."""
    drift: float
    """How much the lag grows per second of the recording."""
    drift_sigma: float
    n_blocks: int
    """Seconds that say something."""
    duration_s: float
    """From the first to the last of them."""

    def is_late(self, least_s: float) -> bool:
        """By more than so much, and than by chance."""
        return abs(self.lag_s) > max(least_s, _significant(self.n_blocks - 1) * self.sigma_s)

    def drifts(self, least_s: float) -> bool:
        """By more than so much in all, and than by chance."""
        least = max(least_s / self.duration_s, _significant(self.n_blocks - 2) * self.drift_sigma)
        return abs(self.drift) > least


def _significant(freedom: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 1 - _BY_CHANCE / 2))


def lags(recording: FinishedRecording) -> dict[str, Lag]:
    """Of each camera that can be told to be late, by what it saw of the main person; of none where there are fewer than
    three cameras or five seconds."""
    if recording not in _KNOWN_LAGS:
        _KNOWN_LAGS[recording] = _lags(recording)
    return _KNOWN_LAGS[recording]


def _lags(recording: FinishedRecording) -> dict[str, Lag]:
    seen = recording.observations.get(recording.main_person)
    if seen is None or recording.rig is None or recording.rig.n_cameras < 3 or recording.main.n_frames < 3:
        return {}
    blocks = _blocks(recording.main, recording.on_time_px(recording.main_person), recording.rig)
    says = np.diagonal(blocks.information, axis1=1, axis2=2) > 0
    told = says.sum(axis=0) >= _MIN_BLOCKS
    if told.sum() < 3:
        return {}
    lag_s, sigma_s = _against_median(*_solved(blocks, degree=0), told)
    drift, drift_sigma = _against_median(*_solved(blocks, degree=1), told)
    found = {}
    for c in np.flatnonzero(told).tolist():
        own_s = blocks.time_s[says[:, c]]
        numbers = (float(each[c]) for each in (lag_s, sigma_s, drift, drift_sigma))
        found[recording.rig.names[c]] = Lag(*numbers, n_blocks=len(own_s), duration_s=float(np.ptp(own_s)))
    return found


class _Blocks(NamedTuple):
    """Normal equations of the cameras' lags, the joints eliminated, of each second that says something."""

    time_s: Float[np.ndarray, " block"]
    information: Float[np.ndarray, "block camera camera"]
    gradient: Float[np.ndarray, "block camera"]


def _blocks(
    trajectory: Trajectory, undistorted_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig
) -> _Blocks:
    error_px = undistorted_px - rig.project(trajectory.positions_m)
    # A constant error of a joint in a view is no lag.
    bias_px = np.array(
        [[[known_quantile(axis, 0.5) for axis in joint.T] for joint in view] for view in np.moveaxis(error_px, 0, 2)]
    )
    length_px = np.linalg.norm(error_px - bias_px, axis=-1)
    # Outliers would decide otherwise. A robust kernel shrinks lags by a fifth: what lags most has large errors.
    weights = (length_px < _OUTLIER_RATIO * known_quantile(length_px, 0.5)).astype(float)
    if trajectory.visibility is not None:
        weights *= np.nan_to_num(trajectory.visibility)
    velocity_mps = np.gradient(trajectory.positions_m, trajectory.time_s, axis=0)
    block = ((trajectory.time_s - trajectory.time_s[0]) / _BLOCK_S).astype(int)
    found = []
    for number in range(block[-1] + 1):
        own = block == number
        equations = offset_information(
            trajectory.positions_m[own],
            velocity_mps[own],
            undistorted_px[own] - bias_px,
            weights[own],
            np.ones_like(weights[own]),
            rig,
            _UNWEIGHTED,
        )
        if equations[0].any():
            found.append((number * _BLOCK_S, *equations))
    times_s, information, gradients = zip(*found, strict=True) if found else ((), np.zeros((0, 1, 1)), ())
    return _Blocks(np.array(times_s), np.array(information), np.array(gradients))


def _solved(blocks: _Blocks, degree: int) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, "camera camera"]]:
    """Highest coefficient of the polynomial of each camera's lag over time, and its covariance from the scatter of
    blocks about it. What all cameras have in common is no lag, but another motion: it is 0 on average."""
    unit_s = float(np.ptp(blocks.time_s))  # of time: of a long recording the numbers would be too different
    powers = ((blocks.time_s - blocks.time_s.mean()) / unit_s) ** np.arange(degree + 1)[:, None]
    together = [np.einsum("b,bij->ij", a * b, blocks.information) for a in powers for b in powers]
    n_cameras = blocks.information.shape[1]
    shape = (degree + 1, degree + 1, n_cameras, n_cameras)
    information = np.reshape(together, shape).transpose(0, 2, 1, 3).reshape(2 * ((degree + 1) * n_cameras,))
    inverse = np.linalg.pinv(information, rcond=_NO_INFORMATION, hermitian=True)
    solution = -inverse @ np.concatenate([power @ blocks.gradient for power in powers])
    lag_s = powers.T @ solution.reshape(degree + 1, n_cameras)
    misfit = blocks.gradient + np.einsum("bij,bj->bi", blocks.information, lag_s)
    scores = (powers.T[:, :, None] * misfit[:, None]).reshape(len(misfit), -1)
    # A curve through few blocks is nearer to them than the truth is (MacKinnon and White 1985, HC1).
    covariance = inverse @ scores.T @ scores @ inverse * len(misfit) / (len(misfit) - degree - 1)
    return solution[-n_cameras:] / unit_s**degree, covariance[-n_cameras:, -n_cameras:] / unit_s ** (2 * degree)


def _against_median(
    values: Float[np.ndarray, " camera"],
    covariance: Float[np.ndarray, "camera camera"],
    told: Bool[np.ndarray, " camera"],
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """Most cameras are taken to be on time."""
    return values - np.median(values[told]), np.sqrt(np.maximum(np.diag(covariance), 0.0))


def late_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera whose detections run ahead of the motion, or behind it."""
    step_s = usual_step_s(recording.main.time_s)
    found = []
    for camera, lag in lags(recording).items():
        if lag.is_late(_NOTICEABLE_FRAMES * step_s):
            reason = (
                f"camera {camera} is {'late' if lag.lag_s > 0 else 'early'} by at least "
                f"{1000 * abs(lag.lag_s):.1f} ± {1000 * lag.sigma_s:.1f} ms ({abs(lag.lag_s) / step_s:.1f} frames)"
            )
            remedy = (
                "Smooth again with --estimate-time-offsets; with --refine-calibration too if it may have been moved."
            )
            found.append(Finding(Code.LATE_CAMERA, Severity.DOUBTFUL, reason, remedy, 0.45, camera=camera))
    return found


def drifting_cameras(recording: FinishedRecording) -> list[Finding]:
    """A camera that falls behind the others, or gains on them: another frame rate than is said, or lost images."""
    step_s = usual_step_s(recording.main.time_s)
    found = []
    for camera, lag in lags(recording).items():
        if lag.drifts(_DRIFT_FRAMES * step_s):
            reason = (
                f"camera {camera} {'falls behind' if lag.drift > 0 else 'gains on'} the others by at least "
                f"{1000 * abs(lag.drift):.1f} ± {1000 * lag.drift_sigma:.1f} ms a second, "
                f"{abs(lag.drift) * lag.duration_s / step_s:.1f} frames in all"
            )
            remedy = (
                "Its frame rate is not what was said, or it lost images: give the times of its images, or its true "
                "rate. Constant time offsets do not help."
            )
            found.append(Finding(Code.CLOCK_RATE, Severity.DOUBTFUL, reason, remedy, 0.5, camera=camera))
    return found


def undetermined_clocks(recording: FinishedRecording) -> list[Finding]:
    """A time offset that was estimated, and whose standard deviation matters."""
    step_s = usual_step_s(recording.main.time_s)
    return [
        Finding(
            Code.UNDETERMINED_CLOCK,
            Severity.DOUBTFUL,
            f"the clock of camera {camera} is known to ± {1000 * sigma_s:.1f} ms only ({sigma_s / step_s:.1f} frames)",
            "Let the person move more, and fast, where this camera sees them; or synchronise the cameras.",
            0.3,
            camera=camera,
        )
        for camera, sigma_s in recording.offset_sigma_s.items()
        if sigma_s > _NOTICEABLE_FRAMES * step_s
    ]


def missing_frames(recording: FinishedRecording) -> list[Finding]:
    """Frames that the recording lacks."""
    return _missing(recording.main.time_s)


def pauses(examined: Examined) -> list[Finding]:
    """The same before there is a result, of all cameras and of more than moments: streams drop images."""
    if examined.result is not None:
        return []
    return _missing(cameras_with_somebody(examined)[0], _PAUSE_S)


def _missing(time_s: Float[np.ndarray, " frame"], least_s: float = 0.0) -> list[Finding]:
    steps_s = np.diff(time_s)
    step_s = usual_step_s(time_s)
    missed = steps_s > max(_MISSING_STEPS * step_s, least_s)
    if not missed.any():
        return []
    longest = int(np.argmax(steps_s))
    share = float(steps_s[missed].sum() / steps_s.sum())
    n_moments = int(missed.sum())
    moments = "one moment" if n_moments == 1 else f"{n_moments} moments"
    reason = (
        f"frames are missing at {moments}, {100 * share:.1f} % of the time; the longest for "
        f"{steps_s[longest]:.2f} s at {time_s[longest]:.1f} s"
    )
    return [
        Finding(
            Code.MISSING_FRAMES,
            Severity.NOTE,
            reason,
            "Look for dropped images in the log of the recorder; a slower disk loses them. Or was it paused?",
            share,
        )
    ]
