"""From a recording on disk to results on disk: source, estimator, sinks. Prints nothing."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.evidence import Evidence, gather
from fgpose.estimation.fusion import fuse
from fgpose.estimation.refinement import refine
from fgpose.estimation.residuals import whitened_residuals
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.atomic import check_writable
from fgpose.io.calibration import load_rig
from fgpose.io.keypoints import load_observations
from fgpose.io.trajectories import check_output, save_trajectory
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Status, Trajectory, joint_status
from fgpose.viewer import Recording, open_recording
from fgpose.viewer.recording import UpAxis

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of frames in all."""

OnUpdate = Callable[[Observations, Estimate, float], None]
"""Called after each update with the frame, the estimate and the milliseconds that it took."""

Format = Literal["parquet", "npz", "trc", "c3d", "rrd"]
WorldUp = Literal["z", "y"]


@dataclass(frozen=True, eq=False)
class Source:
    """A recording: its cameras and what they saw."""

    rig: CameraRig
    observations: Observations

    def subset(self, cameras: tuple[str, ...]) -> Source:
        """Some of the cameras, all if none is named. Raises ValueError for an unknown name."""
        return Source(self.rig.subset(cameras), self.observations.subset(cameras)) if cameras else self


@dataclass(frozen=True, eq=False)
class Result:
    """What a run gave."""

    source: Source
    config: Config
    trajectories: Mapping[str, Trajectory]
    """By name ("fused", "refined", "smoothed", "online"), the most important last."""
    saved: tuple[str, ...]
    """Names of the trajectories that are written as files of their own; the others are shown in the .rrd."""
    update_ms: Float[np.ndarray, " frame"] | None = None
    """How long each update of the online estimator took, milliseconds."""

    @property
    def main(self) -> Trajectory:
        """The most important trajectory."""
        return list(self.trajectories.values())[-1]


@dataclass(frozen=True)
class Outputs:
    """Where results go: folder/name.format, or folder/name_trajectory.format when there are several."""

    folder: Path
    name: str
    formats: tuple[Format, ...]
    world_up: WorldUp = "z"
    """The axis of the world that points up; for TRC, C3D and the viewer."""

    def path(self, file_format: Format, trajectory: str = "") -> Path:
        return self.folder / f"{self.name}{'_' if trajectory else ''}{trajectory}.{file_format}"

    def check(self, saved: tuple[str, ...], inputs: tuple[Path, ...] = ()) -> None:
        """Make sure, before any work is done, that everything can be written; the folder is made.

        Args:
            saved: names of the trajectories that will be saved (Result.saved).
            inputs: files that must not be overwritten.

        Raises:
            ValueError: a result would replace an input.
            OSError: the folder cannot be written into, or a folder has the name of a result.
            ImportError: the package that a format needs is not installed.
        """
        check_writable(self.folder)
        if "rrd" in self.formats:
            _require_rerun()
        for path in self._paths(saved):
            if path.is_dir():
                raise OSError(f"cannot write {path}: it is a folder")
            if any(path.resolve() == other.resolve() for other in inputs):
                raise ValueError(f"the result {path} would replace an input; choose another output folder or name")
            if path.suffix != ".rrd":
                check_output(path)

    def _paths(self, saved: tuple[str, ...]) -> list[Path]:
        labels = saved if len(saved) > 1 else ("",)
        return [
            self.path(file_format, label)
            for file_format in self.formats
            for label in (labels if file_format != "rrd" else ("",))
        ]


def _require_rerun() -> None:
    # Looked for, not imported: that takes a second.
    if importlib.util.find_spec("rerun") is None:
        raise ImportError("a .rrd file needs Rerun: pip install 'fgpose[viewer]'; or leave rrd out of the formats")


def load_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    *,
    cameras: tuple[str, ...] = (),
    fps: float | None = None,
    unit: Literal["auto", "m", "mm"] = "auto",
    points3d_frame: Literal["camera", "world"] = "camera",
    points3d_unit: Literal["mm", "m"] = "mm",
) -> Source:
    """Read a recording: load_rig and load_observations, which say what is read and what each argument means.

    Args:
        keypoints: folder or file of the detected joints.
        calibration: file of the cameras.
        skeleton: what the keypoints are.
        cameras: use only these, in this order. The calibration may then have cameras that the keypoints lack.

    Raises:
        ValueError: something is wrong with a file, or a camera is unknown; the message names it.
        OSError: a file cannot be read.
    """
    rig = load_rig(calibration, unit)
    rig.subset(cameras or rig.names)

    def load(rig: CameraRig) -> Source:
        observations = load_observations(
            keypoints, rig, skeleton, fps=fps, points3d_frame=points3d_frame, points3d_unit=points3d_unit
        )
        return Source(rig, observations)

    try:
        # All cameras together tell best which person is the subject.
        return load(rig).subset(cameras)
    except ValueError:
        if not cameras:
            raise
        return load(rig.subset(cameras))


def run_smooth(source: Source, config: Config, progress: Progress | None = None, *, compare: bool = True) -> Result:
    """The batch smoother over a whole recording.

    Args:
        source: the recording.
        config: the parameters.
        progress: told how far the smoother is.
        compare: also give the fused and the refined poses of every frame alone, to be seen beside the result.
    """
    smoothed = smooth(source.observations, source.rig, config, progress)
    before = _frame_by_frame(source, config) if compare else {}
    return Result(source, config, {**before, "smoothed": smoothed}, ("smoothed",))


def run_refine(source: Source, config: Config, progress: Progress | None = None) -> Result:
    """The paper's method: each frame alone."""
    refined = refine(source.observations, source.rig, config, progress)
    return Result(source, config, {"fused": fused_trajectory(source, config), "refined": refined}, ("refined",))


def _frame_by_frame(source: Source, config: Config) -> dict[str, Trajectory]:
    return {
        "fused": fused_trajectory(source, config),
        "refined": refine(source.observations, source.rig, config),
    }


def fused_trajectory(source: Source, config: Config) -> Trajectory:
    """The fused pose (eq. 1-2) of every frame; robust triangulation where there is no per-view 3D."""
    observations, rig = source.observations, source.rig
    positions_m = fuse(observations, rig, config.fusion).positions_m
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    return Trajectory(
        skeleton=observations.skeleton,
        time_s=observations.frame_time_s,
        positions_m=positions_m,
        status=joint_status(known, observations.seen.sum(axis=1) >= 2),
        residual_px=reprojection_residual_px(observations, rig, positions_m),
        camera_names=rig.names,
        config=config,
    )


def run_track(
    source: Source, config: Config, progress: Progress | None = None, on_update: OnUpdate | None = None
) -> Result:
    """The online estimator, fed with a recording frame by frame as if it were live.

    Returns:
        "online": the newest estimate after each update; "smoothed": the estimate of each frame one lag later, up to
        the last frame that is that old (no such trajectory when the recording is shorter than the lag).
    """
    observations, rig = source.observations, source.rig
    estimator = Estimator(rig, observations.skeleton, config)
    estimates, smoothed = [], {}
    update_ms = np.empty(observations.n_frames)
    for frame, seen in enumerate(observations):
        start_s = time.perf_counter()
        estimate = estimator.update(seen)
        update_ms[frame] = 1000 * (time.perf_counter() - start_s)
        estimates.append(estimate)
        if estimate.smoothed is not None:
            smoothed[estimate.smoothed.frame] = estimate.smoothed
        if on_update:
            on_update(seen, estimate, float(update_ms[frame]))
        if progress:
            progress(frame + 1, observations.n_frames)
    trajectories = {"online": Trajectory.from_estimates(estimates, rig.names, config)}
    if smoothed:
        trajectories = {"smoothed": _lagged(smoothed, source, config), **trajectories}
    return Result(source, config, trajectories, tuple(trajectories), update_ms)


def _lagged(smoothed: dict[int, Estimate], source: Source, config: Config) -> Trajectory:
    """Frames from the first to the last that is old enough; one that was skipped (uneven times) is unobservable."""
    n_frames, observations = max(smoothed) + 1, source.observations.frames(slice(0, max(smoothed) + 1))
    positions_m = np.full((n_frames, observations.skeleton.n_joints, 3), np.nan)
    status = np.full(positions_m.shape[:2], Status.UNOBSERVABLE, dtype=np.int8)
    covariance_m2 = np.full((*positions_m.shape, 3), np.nan) if config.online.smoothed_covariance else None
    for frame, estimate in smoothed.items():
        positions_m[frame], status[frame] = estimate.positions_m, estimate.status
        if covariance_m2 is not None:
            covariance_m2[frame] = estimate.covariance_m2
    return Trajectory(
        skeleton=observations.skeleton,
        time_s=observations.frame_time_s,
        positions_m=positions_m,
        status=status,
        covariance_m2=covariance_m2,
        residual_px=reprojection_residual_px(observations, source.rig, positions_m),
        camera_names=source.rig.names,
        config=config,
    )


def write_outputs(result: Result, outputs: Outputs) -> tuple[Path, ...]:
    """Write a result in every format wanted; each file appears whole or not at all.

    Returns:
        The files.

    Raises:
        ValueError: a format cannot hold the result.
        OSError: a file cannot be written.
        ImportError: the package that a format needs is not installed.
    """
    paths = save_trajectories(result, outputs)
    if "rrd" in outputs.formats:
        path = outputs.path("rrd")
        source, names = result.source, tuple(result.trajectories)
        up = up_axis(outputs.world_up)
        with open_recording(path, source.rig, source.observations.skeleton, names, up=up) as recording:
            try:
                show(result, recording)
            except KeyboardInterrupt:
                recording.discard()  # closing would leave half a file
                raise
        paths = (*paths, path)
    return paths


def up_axis(world_up: WorldUp) -> UpAxis:
    """The same axis as the viewer calls it."""
    return "+z" if world_up == "z" else "+y"


def save_trajectories(result: Result, outputs: Outputs) -> tuple[Path, ...]:
    """Write the saved trajectories of a result in every format wanted but .rrd; as write_outputs."""
    paths = []
    for file_format in outputs.formats:
        for name in result.saved if file_format != "rrd" else ():
            path = outputs.path(file_format, name if len(result.saved) > 1 else "")
            save_trajectory(result.trajectories[name], path, outputs.world_up)
            paths.append(path)
    return tuple(paths)


def show(result: Result, recording: Recording) -> None:
    """Show everything that is known of a result; see fgpose.viewer."""
    observations = result.source.observations
    evidence = gather(observations, result.source.rig, result.config)
    recording.log_observations(observations, evidence.weights)
    for name, trajectory in result.trajectories.items():
        recording.log_trajectory(name, trajectory)
    _show_residuals(result, evidence, recording)
    if result.update_ms is not None:
        recording.log_update_times(observations.frame_time_s, result.update_ms)


def _show_residuals(result: Result, evidence: Evidence, recording: Recording) -> None:
    main = result.main
    # The paper's method has other sigmas than the factor graph over time: its residuals are its reprojection errors.
    if "refined" not in result.saved:
        recording.log_residuals(main.time_s, whitened_residuals(main, evidence, result.config))
