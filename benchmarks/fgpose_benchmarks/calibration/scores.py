"""From a rig that was found to numbers: one score for every recording and method."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment import rigs
from fgpose.assessment.metrics import mean_known
from fgpose.assessment.rig_alignment import fitted
from fgpose.config import Config
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_benchmarks.calibration.recording import (
    CalibrationMethod,
    CalibrationResult,
    KnownRigRecording,
    Outcome,
)
from fgpose_benchmarks.comparison.scores import Scored

RIGHT_PEAK_S = 0.15
"""A larger error of a start is another peak of the correlation: gait repeats itself at each step, about 0.55 s."""
FAILED_DEG = 5.0
"""A rotation between cameras that is further off makes a calibration one that failed."""
GOOD_DEG = 1.5
"""And one that is nowhere further off makes it a good one."""
MOST_SIGMAS = 99.0
"""What is larger is called so."""
SMOOTHED_FRAMES = 300
"""Of the walk, to compare what the smoother makes of it: 10 s at 30 Hz."""
_MOST_JOINT_FRAMES = 300  # for the induced error; more change it by less than a tenth of a millimetre


@dataclass(frozen=True)
class CalibrationScore(Scored):
    """How good one method was on one recording. Tuples have one number for each camera, or each pair; empty where the
    method refused. NaN where a number does not exist."""

    outcome: Outcome
    reasons: tuple[str, ...]
    n_cameras: int
    position_mm: tuple[float, ...]
    """After the similarity of the rigs."""
    rotation_deg: tuple[float, ...]
    """Between the cameras of each pair."""
    induced_mm: float
    """Mean error of true joints that are triangulated with the rig, after a similarity."""
    smoothed_mm: float
    """MPJPE of the smoothed walk with the true rig."""
    ratio: float
    """MPJPE with the rig, after a similarity, over that."""
    metric_ratio: float
    """The same without the scale: after the best rigid motion."""
    scale_percent: float
    vertical_deg: float
    floor_mm: float
    """Height over the true floor, under the middle of the walk."""
    focal_percent: tuple[float, ...]
    """Empty where the focal lengths were given."""
    start_frames: tuple[float, ...]
    """Of all cameras but the first; empty where the cameras were said to be synchronised."""
    right_peak: tuple[float, ...]
    """1 where the start is within RIGHT_PEAK_S, else 0, also for a camera that is left out."""
    position_sigmas: tuple[float, ...]
    """Errors in stated standard deviations; empty where there are none."""
    direction_sigmas: tuple[float, ...]
    focal_sigmas: tuple[float, ...]
    start_sigmas: tuple[float, ...]
    time_s: float

    @property
    def has_failed(self) -> bool:
        """Whether the rig is wrong, whatever the verdict says."""
        return not self.rotation_deg or max(self.rotation_deg) > FAILED_DEG or 0.0 in self.right_peak

    @property
    def is_right(self) -> bool:
        return bool(self.rotation_deg) and max(self.rotation_deg) <= GOOD_DEG and 0.0 not in self.right_peak


def score_calibration(
    recording: KnownRigRecording, result: CalibrationResult, method: CalibrationMethod
) -> CalibrationScore:
    """How good the rig of a result is; cameras that it leaves out do not count.

    Raises:
        ValueError: the rig has a camera that the recording has not.
    """
    refused = _refused(recording, result, method)
    if result.rig is None:
        return refused
    if result.rig.names != recording.rig.names:
        recording = recording.of_cameras(result.rig.names)
    rig, true_rig = result.rig, recording.rig
    joints_m = recording.joints_m[:: max(len(recording.joints_m) // _MOST_JOINT_FRAMES, 1)]
    starts_s = np.empty(0) if recording.given.synchronised else rigs.start_errors_s(rig, true_rig)[1:]
    focal = np.empty(0) if recording.given.focal == "known" else rigs.focal_errors(rig, true_rig)
    smoothed_mm, ratio, metric_ratio = _smoothed(recording, result, starts_s)
    scored = replace(
        refused,
        position_mm=_listed(1000 * rigs.position_errors_m(rig, true_rig)),
        rotation_deg=_listed(rigs.rotation_errors_deg(rig, true_rig)),
        induced_mm=1000 * float(mean_known(rigs.induced_errors_m(rig, true_rig, joints_m))),
        smoothed_mm=smoothed_mm,
        ratio=ratio,
        metric_ratio=metric_ratio,
        focal_percent=_listed(100 * focal),
        start_frames=_listed(recording.fps * starts_s),
        right_peak=(*_listed(np.abs(starts_s) <= RIGHT_PEAK_S), *_left_out(refused, recording)),
    )
    return _with_sigmas(_with_metric(scored, recording, result), recording, result)


def _left_out(refused: CalibrationScore, recording: KnownRigRecording) -> tuple[float, ...]:
    """For each camera that is not in the rig because nobody knows when it started."""
    n_left_out = refused.n_cameras - recording.rig.n_cameras
    return () if recording.given.synchronised else (0.0,) * n_left_out


def _refused(recording: KnownRigRecording, result: CalibrationResult, method: CalibrationMethod) -> CalibrationScore:
    """Of a method that gives no rig."""
    nan = float("nan")
    named = (recording.variant, recording.clip, method.name, method.group)
    numbers = ((), (), nan, nan, nan, nan, nan, nan, nan)
    return CalibrationScore(
        *named, result.outcome, result.reasons, recording.rig.n_cameras, *numbers, *((),) * 7, time_s=result.time_s
    )


def _with_metric(scored: CalibrationScore, recording: KnownRigRecording, result: CalibrationResult) -> CalibrationScore:
    """Scale, vertical and floor; the world of a real recording need not have z up nor the floor at 0."""
    rig, true_rig = result.rig, recording.rig
    if rig is None or not result.is_metric:
        return scored
    scored = replace(scored, scale_percent=100 * rigs.scale_error(rig, true_rig))
    if recording.scene is None:
        return scored
    around_m = mean_known(recording.joints_m.reshape(-1, 3), axis=0) * np.array([1.0, 1.0, 0.0])
    return replace(
        scored,
        vertical_deg=rigs.vertical_error_deg(rig, true_rig),
        floor_mm=1000 * rigs.floor_error_m(rig, true_rig, around_m),
    )


def _with_sigmas(scored: CalibrationScore, recording: KnownRigRecording, result: CalibrationResult) -> CalibrationScore:
    if result.rig is None or result.sigmas is None:
        return scored
    stated, rig, true_rig = result.sigmas, result.rig, recording.rig
    direction_deg = rigs.direction_errors_deg(rig, true_rig)
    return replace(
        scored,
        position_sigmas=_in_sigmas(np.array(scored.position_mm) / 1000, stated.position_m),
        direction_sigmas=_in_sigmas(direction_deg, stated.direction_deg),
        focal_sigmas=_in_sigmas(np.array(scored.focal_percent) / 100, stated.focal),
        start_sigmas=_in_sigmas(np.array(scored.start_frames) / recording.fps, stated.offset_s[1:]),
    )


def _in_sigmas(errors: Float[np.ndarray, " error"], sigma: Float[np.ndarray, " camera"]) -> tuple[float, ...]:
    """Empty where there are no errors. At most MOST_SIGMAS, also where an error has no standard deviation."""
    if not len(errors):
        return ()
    sigmas = np.divide(np.abs(errors), sigma, out=np.full(len(errors), MOST_SIGMAS), where=sigma > 0)
    return _listed(np.minimum(sigmas, MOST_SIGMAS))


def _listed(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _smoothed(
    recording: KnownRigRecording, result: CalibrationResult, starts_s: Float[np.ndarray, " camera"]
) -> tuple[float, float, float]:
    """MPJPE in mm with the true rig, and its ratios with the rig of the result: after a similarity, and after a rigid
    motion. NaN where there is no truth, or the frames of the cameras do not belong together."""
    nan = float("nan")
    if recording.scene is None or result.rig is None or (np.abs(starts_s) > RIGHT_PEAK_S).any():
        return nan, nan, nan
    offsets_s = result.rig.time_offsets_s - result.rig.time_offsets_s[0]
    own_s = recording.on_time_s if recording.given.synchronised else recording.image_s + offsets_s
    true_mm, _ = _errors_mm(recording, recording.rig, recording.on_time_s)
    similar_mm, rigid_mm = _errors_mm(recording, result.rig, own_s)
    return true_mm, similar_mm / true_mm, (rigid_mm if result.is_metric else nan) / true_mm


def _errors_mm(
    recording: KnownRigRecording, rig: CameraRig, time_s: Float[np.ndarray, "frame camera"]
) -> tuple[float, float]:
    """MPJPE of the smoothed walk after a similarity, and after a rigid motion; 2D alone, so that the calibration is all
    that gives depth."""
    assert recording.scene is not None
    frames = slice(0, SMOOTHED_FRAMES)
    walk = recording.told
    shown = np.isfinite(time_s[frames])[..., None]
    observations = Observations(
        skeleton=walk.skeleton,
        time_s=time_s[frames],
        points2d_px=np.where(shown[..., None], walk.points2d_px[frames], np.nan),
        confidence=np.where(shown, walk.confidence[frames], 0.0),
        camera_names=rig.names,
    )
    config = Config().replace(solver={"covariance": False})
    trajectory = smooth(observations, rig.with_time_offsets(np.zeros(rig.n_cameras)), config)
    true_m = recording.scene.joints_m(trajectory.time_s)
    found_m, target_m = trajectory.positions_m.reshape(-1, 3), true_m.reshape(-1, 3)
    errors_mm = []
    for with_scale in (True, False):
        motion = fitted(found_m, target_m, with_scale=with_scale)
        errors_mm.append(1000 * float(mean_known(np.linalg.norm(motion.of(found_m) - target_m, axis=-1))))
    return errors_mm[0], errors_mm[1]
