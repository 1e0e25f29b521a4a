"""Reading a recording, and running the estimators over it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fgpose.association.common_clock import on_common_clock
from fgpose.config import Config
from fgpose.estimation.estimator import Estimator
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.refinement import refine_evidence
from fgpose.estimation.smoother import smooth_evidence
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import is_changing
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.calibration import Unit, load_rig
from fgpose.io.camera_names import counted_otherwise, seen_cameras
from fgpose.io.keypoints import Person, keypoint_cameras, load_observations, load_people, person_of
from fgpose.observations import Observations, check_confidence
from fgpose.pipeline.detected_orientation import as_detected
from fgpose.pipeline.origin import origin_of
from fgpose.pipeline.people import PeopleSource
from fgpose.pipeline.results import Result
from fgpose.pipeline.source import Source
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Status, Trajectory, joint_status

Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of frames in all."""

OnUpdate = Callable[[Observations, Estimate, float], None]
"""Called after each update with the frame, the estimate and the milliseconds that it took."""


def load_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    *,
    cameras: tuple[str, ...] = (),
    fps: float | None = None,
    unit: Unit = "auto",
    points3d_frame: Literal["camera", "world"] = "camera",
    points3d_unit: Literal["mm", "m"] = "mm",
    min_confidence: float = 0.0,
    person: Person = "consistent",
) -> Source:
    """Read a recording: load_rig and load_observations, which say what is read and what each argument means. Where the
    cameras began at different moments (on_common_clock), its times are those of the rig.

    Args:
        keypoints: folder or file of the detected joints.
        calibration: file of the cameras.
        skeleton: what the keypoints are.
        cameras: use only these, in this order. Calibration and keypoints may then have cameras that the other lacks.
        min_confidence: detections below it are taken for missing.
        person: who, of several people.

    Raises:
        ValueError: something is wrong with a file, a camera is unknown, or the cameras that are wanted seem to have
            other numbers in the keypoints; the message names it.
        OSError: a file cannot be read.

    Warns:
        UserWarning: as load_observations.
    """
    check_confidence(min_confidence)
    rig = _rig(keypoints, calibration, unit, cameras)
    reading: dict[str, Any] = {
        "fps": fps,
        "points3d_frame": points3d_frame,
        "points3d_unit": points3d_unit,
        "ignore_other_cameras": bool(cameras),
    }
    rig = as_detected(
        rig, calibration, lambda each: load_observations(keypoints, each, skeleton, person=person, **reading)
    )
    origin = origin_of(rig, fps, Keypoints=keypoints, Calibration=calibration)
    if isinstance(person, int) and not rig.time_offsets_s.any() and not is_changing(rig):
        seen = load_observations(keypoints, rig, skeleton, person=person, **reading).confident(min_confidence)
        return Source(rig, seen, replace(origin, remarks=seen.remarks)).subset(cameras)
    people = load_people(keypoints, rig, skeleton, **reading).confident(min_confidence)
    origin = replace(origin, remarks=people.remarks)
    people, rig = on_common_clock(people, rig)
    return _one(keypoints, PeopleSource(rig, people, origin), person).subset(cameras)


def _one(path: Path, source: PeopleSource, person: Person) -> Source:
    """The person wanted, see load_observations. Raises ValueError, which names the file."""
    if isinstance(person, int):
        return Source(source.rig, person_of(path, source.people, source.rig, person), source.origin)
    with naming(path):
        return source.one(0 if person == "consistent" else person)


def load_people_source(
    keypoints: Path,
    calibration: Path,
    skeleton: str | Path | Skeleton,
    *,
    cameras: tuple[str, ...] = (),
    fps: float | None = None,
    unit: Unit = "auto",
    points3d_frame: Literal["camera", "world"] = "camera",
    points3d_unit: Literal["mm", "m"] = "mm",
    min_confidence: float = 0.0,
) -> PeopleSource:
    """Everybody in a recording, see load_source."""
    check_confidence(min_confidence)
    rig = _rig(keypoints, calibration, unit, cameras)
    reading: dict[str, Any] = {
        "fps": fps,
        "points3d_frame": points3d_frame,
        "points3d_unit": points3d_unit,
        "ignore_other_cameras": bool(cameras),
    }
    rig = as_detected(
        rig,
        calibration,
        lambda each: PeopleSource(each, load_people(keypoints, each, skeleton, **reading)).one().observations,
    )
    people = load_people(keypoints, rig, skeleton, **reading).confident(min_confidence)
    origin = origin_of(rig, fps, Keypoints=keypoints, Calibration=calibration)
    origin = replace(origin, remarks=people.remarks)
    people, rig = on_common_clock(people, rig)
    return PeopleSource(rig, people, origin).subset(cameras)


def _rig(keypoints: Path, calibration: Path, unit: Unit, cameras: tuple[str, ...]) -> CameraRig:
    """The cameras wanted, and all others that saw something: together they tell best who is who."""
    rig = load_rig(calibration, unit)
    if not cameras:
        return rig
    rig.subset(cameras)
    theirs = keypoint_cameras(keypoints)
    if said := counted_otherwise(theirs, rig.names):
        raise ValueError(f"{keypoints}: {said}. If not, take the cameras that are not wanted out of both")
    seen = seen_cameras(theirs, rig.names)
    return rig.subset(name for name in rig.names if name in seen or name in cameras)


def run_smooth(source: Source, config: Config, progress: Progress | None = None, *, compare: bool = True) -> Result:
    """The batch smoother over a whole recording.

    Args:
        source: the recording.
        config: the parameters.
        progress: told how far the smoother is.
        compare: also give the fused and the refined poses of every frame alone, to be seen beside the result.
    """
    given = source.evidence(config), source.observations.skeleton, source.rig, config
    smoothed = smooth_evidence(*given, progress)
    before = {"fused": fused_trajectory(*given), "refined": refine_evidence(*given)} if compare else {}
    return Result(source, config, {**before, "smoothed": smoothed}, ("smoothed",))


def run_refine(source: Source, config: Config, progress: Progress | None = None) -> Result:
    """The paper's method: each frame alone."""
    given = source.evidence(config), source.observations.skeleton, source.rig, config
    trajectories = {"fused": fused_trajectory(*given), "refined": refine_evidence(*given, progress)}
    return Result(source, config, trajectories, ("refined",))


def fused_trajectory(evidence: Evidence, skeleton: Skeleton, rig: CameraRig, config: Config) -> Trajectory:
    """The fused pose (eq. 1-2) of every frame; robust triangulation where there is no per-view 3D."""
    known = np.asarray(np.isfinite(evidence.fused_m).all(axis=-1))
    return Trajectory(
        skeleton=skeleton,
        time_s=evidence.time_s,
        positions_m=evidence.fused_m,
        status=joint_status(known, evidence.observed),
        residual_px=reprojection_residual_px(evidence.undistorted_px, rig, evidence.fused_m),
        camera_names=rig.names,
        config=config,
        implausible_frames=evidence.implausible_frames,
    )


def run_track(
    source: Source, config: Config, progress: Progress | None = None, on_update: OnUpdate | None = None
) -> Result:
    """The online estimator, fed with a recording frame by frame as if it were live.

    Returns:
        "online": the newest estimate after each update; "smoothed": the estimate of each frame one lag later, up to
        the last frame that is that old (no such trajectory when the recording is shorter than the lag).

    Raises:
        ValueError: so many frames make no body that the calibration must be wrong.
    """
    source.evidence(config)  # raises before any work
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
    trajectories = {"online": Trajectory.from_estimates(estimates, source.rig.names, config)}
    if smoothed:
        trajectories = {"smoothed": _lagged(smoothed, source, config), **trajectories}
    return Result(source, config, trajectories, ("smoothed", "online"), update_ms)


def _lagged(smoothed: dict[int, Estimate], source: Source, config: Config) -> Trajectory:
    """Frames from the first to the last that is old enough; one that was skipped (uneven times) is unobservable."""
    evidence = source.evidence(config).frames(slice(0, max(smoothed) + 1))
    positions_m = np.full(evidence.guess_m.shape, np.nan)
    status = np.full(positions_m.shape[:2], Status.UNOBSERVABLE, dtype=np.int8)
    covariance_m2 = np.full((*positions_m.shape, 3), np.nan) if config.online.smoothed_covariance else None
    for frame, estimate in smoothed.items():
        positions_m[frame], status[frame] = estimate.positions_m, estimate.status
        if covariance_m2 is not None:
            covariance_m2[frame] = estimate.covariance_m2
    return Trajectory(
        skeleton=source.observations.skeleton,
        time_s=evidence.time_s,
        positions_m=positions_m,
        status=status,
        covariance_m2=covariance_m2,
        residual_px=reprojection_residual_px(evidence.undistorted_px, source.rig, positions_m),
        camera_names=source.rig.names,
        config=config,
        implausible_frames=evidence.implausible_frames,
    )
