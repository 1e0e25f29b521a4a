"""The methods of the open benchmark: what a user could run on the same recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.assessment.metrics import mean_known
from fgpose.calibration.self_calibration import self_calibrate
from fgpose.calibration.time_offsets import estimate_time_offsets
from fgpose.config import Config, MotionConfig, OnlineConfig, ProjectionConfig, SolverConfig
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.evidence.delays import motion_m
from fgpose.estimation.evidence.fusion import fuse
from fgpose.estimation.refinement import refine
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate, triangulate_robust
from fgpose.observations import Observations
from fgpose_benchmarks.accuracy.families import Variant
from fgpose_benchmarks.accuracy.linear import low_pass, triangulate_ransac
from fgpose_benchmarks.accuracy.peer_methods import eks_methods, peer_methods
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult

# The best for each on the tuning clips, clean and occluded, of 10 to 60 px. (Iskakov et al. publish 30 for RANSAC: on
# clean recordings as good, 59 instead of 53 mm on occluded ones.)
_RANSAC_PX = 45.0
_MSAC_PX = 30.0
_POSITIONS_ONLY = SolverConfig(covariance=False)

Positions = Float[np.ndarray, "frame joint 3"]


def methods(peer: Path | None = None, eks: Path | None = None) -> list[Method]:
    """All methods that can run here.

    Args:
        peer: Python of an environment that has aniposelib (see peer.find_peer); None: its lines are left out.
        eks: the same of the Ensemble Kalman Smoother.
    """
    peers = [*([] if peer is None else peer_methods(peer)), *([] if eks is None else eks_methods(eks))]
    return [*PER_FRAME, *LINEAR, *peers, *OURS, ORACLE]


@dataclass(frozen=True)
class _Timed:
    """A solver whose result is given the wall-clock time that it took."""

    solve: Callable[[BenchmarkRecording], MethodResult]

    def __call__(self, recording: BenchmarkRecording) -> MethodResult:
        start_s = time.perf_counter()
        result = self.solve(recording)
        return replace(result, time_s=time.perf_counter() - start_s)


def _positions_only(estimate: Callable[[BenchmarkRecording], Positions], recording: BenchmarkRecording) -> MethodResult:
    return MethodResult(estimate(recording), None, np.nan)


def _of_positions(name: str, group: str, estimate: Callable[[BenchmarkRecording], Positions]) -> Method:
    return Method(name, group, _Timed(partial(_positions_only, estimate)))


def _views_m(recording: BenchmarkRecording) -> Float[np.ndarray, "frame camera joint 3"]:
    observations = recording.observations
    if observations.points3d_m is None:
        return np.full((*observations.points2d_px.shape[:3], 3), np.nan)
    return observations.points3d_m


def _one_view(recording: BenchmarkRecording) -> Positions:
    """The absolute 3D of the first camera alone."""
    return _views_m(recording)[:, 0].copy()


def _mean_of_views(recording: BenchmarkRecording) -> Positions:
    return mean_known(_views_m(recording), axis=1)


def _fused(recording: BenchmarkRecording) -> Positions:
    return fuse(recording.observations, recording.rig).positions_m


def _dlt(recording: BenchmarkRecording, *, weighted: bool) -> Positions:
    """Direct linear transformation; weighted: each view's equations times its confidence, as the algebraic
    triangulation of Iskakov et al. (2019)."""
    observations, rig = recording.observations, recording.rig
    points_px = rig.undistort(observations.points2d_px).swapaxes(1, 2)
    confidence = observations.confidence.swapaxes(1, 2)
    # Equations times the confidence are information times its square.
    information = confidence**2 if weighted else np.ones_like(confidence)
    return triangulate(points_px, information, rig.projection_matrices)


def _ransac(recording: BenchmarkRecording) -> Positions:
    return triangulate_ransac(recording.rig.undistort(recording.observations.points2d_px), recording.rig, _RANSAC_PX)


def _msac(recording: BenchmarkRecording) -> Positions:
    """fgpose's robust triangulation. It gives nothing where no two views agree, which lowers its mean error."""
    observations, rig = recording.observations, recording.rig
    undistorted_px = rig.undistort(observations.points2d_px)
    return triangulate_robust(undistorted_px, observations.confidence, rig, _MSAC_PX).positions_m


def _paper(recording: BenchmarkRecording) -> Positions:
    return refine(recording.observations, recording.rig).positions_m


def _filtered(estimate: Callable[[BenchmarkRecording], Positions], recording: BenchmarkRecording) -> Positions:
    return low_pass(estimate(recording), recording.fps)


_WEIGHTED_DLT = partial(_dlt, weighted=True)

PER_FRAME = (
    _of_positions("one view", "per-frame", _one_view),
    _of_positions("mean of views", "per-frame", _mean_of_views),
    _of_positions("fusion (eq. 1)", "per-frame", _fused),
    _of_positions("DLT", "per-frame", partial(_dlt, weighted=False)),
    _of_positions("DLT by confidence", "per-frame", _WEIGHTED_DLT),
    _of_positions("RANSAC", "per-frame", _ransac),
    _of_positions("MSAC by confidence", "per-frame", _msac),
    _of_positions("the paper's method", "per-frame", _paper),
)
LINEAR = (
    _of_positions("DLT by confidence, 6 Hz", "linear", partial(_filtered, _WEIGHTED_DLT)),
    _of_positions("RANSAC, 6 Hz", "linear", partial(_filtered, _ransac)),
    _of_positions("MSAC by confidence, 6 Hz", "linear", partial(_filtered, _msac)),
)


def _smoothed(observations: Observations, rig: CameraRig, config: Config) -> MethodResult:
    trajectory = smooth(observations, rig, config)
    # The truth is known at the times of the first camera, the pose is estimated at the mean time of all.
    earlier_s = observations.frame_time_s - trajectory.time_s
    moved_m = motion_m(trajectory.positions_m, trajectory.time_s, earlier_s[:, None])[:, 0]
    return MethodResult(trajectory.positions_m + moved_m, trajectory.covariance_m2, np.nan)


def _batch(config: Config, recording: BenchmarkRecording) -> MethodResult:
    return _smoothed(recording.observations, recording.rig, config)


def _self_calibrated(recording: BenchmarkRecording) -> MethodResult:
    """First corrects the poses and clocks of the cameras, from the recording itself."""
    calibrated = self_calibrate(recording.observations, recording.rig)
    result = _smoothed(calibrated.observations, calibrated.rig, Config())
    return replace(result, offsets_s=calibrated.rig.time_offsets_s)


def _synchronised(recording: BenchmarkRecording) -> MethodResult:
    """First estimates the time offsets of the cameras, from the recording itself."""
    rig = estimate_time_offsets(recording.observations, recording.rig).rig
    result = _smoothed(recording.observations, rig, Config())
    return replace(result, offsets_s=rig.time_offsets_s)


def _newest(recording: BenchmarkRecording) -> MethodResult:
    """The pose at the time of the newest frame, with nothing that came after it."""
    config = Config(online=OnlineConfig(lag_s=0.2))
    estimator = Estimator(recording.rig, recording.observations.skeleton, config)
    estimates = [estimator.update(frame) for frame in recording.observations]
    covariances_m2 = [estimate.covariance_m2 for estimate in estimates if estimate.covariance_m2 is not None]
    return MethodResult(np.stack([estimate.positions_m for estimate in estimates]), np.stack(covariances_m2), np.nan)


def _lagged(online: OnlineConfig, recording: BenchmarkRecording) -> MethodResult:
    """The pose at the time of each frame as it is estimated one lag later. Empty frames follow the recording, so that
    its last frames too are estimated one lag later."""
    estimator = Estimator(recording.rig, recording.observations.skeleton, Config(online=online))
    positions_m = np.full_like(recording.truth_m, np.nan)
    for frame in [*recording.observations, *empty_frames(recording, online.lag_s)]:
        for smoothed in estimator.update(frame).newly_smoothed:
            if smoothed.frame < len(positions_m):
                positions_m[smoothed.frame] = smoothed.positions_m
    return MethodResult(positions_m, None, np.nan)


def empty_frames(recording: BenchmarkRecording, duration_s: float) -> Observations:
    """Frames after the recording in which the cameras see nothing."""
    observations = recording.observations
    n_frames = int(np.ceil(duration_s * recording.fps)) + 1
    after_s = observations.frame_time_s[-1] + np.arange(1, n_frames + 1) / recording.fps
    shape = (n_frames, *observations.points2d_px.shape[1:])
    return Observations(observations.skeleton, after_s, np.full(shape, np.nan), camera_names=observations.camera_names)


def batch(name: str, config: Config) -> Method:
    """fgpose.smooth with this configuration."""
    return Method(name, "ours", _Timed(partial(_batch, config)))


def _online(name: str, config: OnlineConfig) -> Method:
    return Method(name, "ours", _Timed(partial(_lagged, config)))


OURS = (
    batch("fgpose per frame", Config(motion=MotionConfig(model="none"), solver=_POSITIONS_ONLY)),
    Method("fgpose online, lag 0", "ours", _Timed(_newest)),
    _online("fgpose online, lag 0.2 s", OnlineConfig(lag_s=0.2, covariance=False)),
    _online("fgpose online by window, lag 0.2 s", OnlineConfig(lag_s=0.2, covariance=False, solver="window")),
    _online("fgpose online, lag 0.5 s", OnlineConfig(lag_s=0.5, covariance=False)),
    batch("fgpose batch", Config()),
    Method("fgpose batch, time offsets", "ours", _Timed(_synchronised)),
    Method("fgpose batch, self-calibrated", "ours", _Timed(_self_calibrated)),
)


def what_an_oracle_knows(recording: BenchmarkRecording) -> tuple[Observations, Config]:
    """The detections that are not occluded, and the configuration that says how large their noise is. The oracle knows
    the true rig too, where the cameras are and when they took their images.

    Raises:
        ValueError: nobody knows that of this recording.
    """
    if recording.oracle_observations is None or recording.sigma_px is None:
        raise ValueError(f"nobody knows what is occluded in {recording.clip} ({recording.variant}): there is no oracle")
    own_px = float(recording.true_rig.in_own_px(1.0).mean())
    known = ProjectionConfig(weighting="uniform", sigma_px=recording.sigma_px / own_px)
    return recording.oracle_observations, Config(projection=known, visibility={"model": "none"})


def _oracle(recording: BenchmarkRecording) -> MethodResult:
    """The batch that knows all this. Raises ValueError as what_an_oracle_knows."""
    observations, config = what_an_oracle_knows(recording)
    return _smoothed(observations, recording.true_rig, config)


ORACLE = Method("oracle", "oracle", _Timed(_oracle))

# All methods on all variants take too long. Batch, online and oracle say how well the defaults hold on errors for which
# they were not chosen; MSAC is the best of the methods that take each frame alone.
_OUTSIDE_STANDARD = ("MSAC by confidence", "fgpose online, lag 0.2 s", "fgpose batch", "oracle")


def methods_for(variant: Variant, among: Sequence[Method]) -> list[Method]:
    """The methods that run on a variant unless others are named: on the standard family all."""
    return [method for method in among if variant.family == "standard" or method.name in _OUTSIDE_STANDARD]


def find_methods(names: Sequence[str], among: Sequence[Method]) -> list[Method]:
    """Methods by name. Raises ValueError, which lists them, for an unknown one."""
    by_name = {method.name: method for method in among}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise ValueError(f"no method {', '.join(unknown)}; there is {'; '.join(by_name)}")
    return [by_name[name] for name in names]
