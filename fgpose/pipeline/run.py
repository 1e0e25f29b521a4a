"""Calibrating the cameras on a recording, and running the smoother or the paper's method over it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.association.recording import Progress
from fgpose.calibration.moved_views import Recording
from fgpose.calibration.self_calibration import CameraCalibration, calibrate_cameras
from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.image_checks.left_out import with_left_out
from fgpose.estimation.refinement import refine_evidence
from fgpose.estimation.smoother import smooth_evidence
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline.origin import recalibrated
from fgpose.pipeline.result import Result
from fgpose.pipeline.source import AnySource, Source
from fgpose.skeleton import Skeleton
from fgpose.tracking import smooth_people
from fgpose.trajectory import Trajectory, joint_status


def run_calibrate(
    source: Source[Recording], config: Config, *, poses: bool, clocks: bool
) -> tuple[Source[Recording], CameraCalibration[Recording]]:
    """The recording with its cameras calibrated on it (calibrate_cameras), of everybody on all; and what was found."""
    found = calibrate_cameras(source.observations, source.rig, config, poses=poses, clocks=clocks)
    origin = source.origin and recalibrated(source.origin, source.rig, found)
    return replace(source, rig=found.rig, observations=found.observations, origin=origin), found


def run_smooth(
    source: AnySource,
    config: Config,
    progress: Progress | None = None,
    *,
    compare: int = 1,
    unfinished: Path | None = None,
) -> Result:
    """The batch smoother over a whole recording.

    Args:
        source: the recording, of one person or of everybody.
        config: the parameters.
        progress: told how far the smoother is.
        compare: of one person, also give the fused and the refined poses of one frame in so many, each alone, to be
            seen beside the result; 0: of none.
        unfinished: see fgpose.smooth.
    """
    if isinstance(source.observations, PeopleObservations):
        known = None if source.succession is None else source.succession.association
        if known is not None:
            # The cameras may have been calibrated since.
            rig = source.rig.subset(source.observations.camera_names)
            known = replace(known, rig=rig, observations=source.observations)
        people = smooth_people(source.observations, source.rig, config, progress, known, unfinished)
        return Result(source, config, {"smoothed": people.trajectories}, ("smoothed",), people.association)
    evidence, given = source.gathered(config), (source.observations.skeleton, source.rig, config)
    smoothed = with_left_out(
        smooth_evidence(evidence, *given, progress, unfinished, source.bones),
        source.observations,
        source.rig,
        evidence.sides_exchanged,
    )
    hand_back()
    if not compare:
        return _of_one(source, config, {"smoothed": smoothed}, "smoothed")
    some = evidence.frames(slice(None, None, compare))
    before = {"fused": fused_trajectory(some, *given), "refined": refine_evidence(some, *given)}
    before = {name: _to_be_shown(each) for name, each in before.items()}
    del some
    hand_back()
    return replace(_of_one(source, config, {**before, "smoothed": smoothed}, "smoothed"), compared_every=compare)


def run_refine(source: Source[Observations], config: Config, progress: Progress | None = None) -> Result:
    """The paper's method: each frame alone."""
    given = source.evidence(config), source.observations.skeleton, source.rig, config
    trajectories = {"fused": fused_trajectory(*given), "refined": refine_evidence(*given, progress)}
    return _of_one(source, config, trajectories, "refined")


def _of_one(source: AnySource, config: Config, trajectories: dict[str, Trajectory], saved: str) -> Result:
    return Result(source, config, {name: {0: each} for name, each in trajectories.items()}, (saved,))


def _to_be_shown(trajectory: Trajectory) -> Trajectory:
    """As the viewer and tables show it: of an hour residuals in double precision take 10 MB more."""
    residual_px = trajectory.residual_px
    return trajectory if residual_px is None else replace(trajectory, residual_px=residual_px.astype(np.float32))


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
