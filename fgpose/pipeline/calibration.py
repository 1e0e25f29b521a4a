"""Writing and showing a calibration from people."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, Grade
from fgpose.geometry.epipolar_distance import pairs_px
from fgpose.io.calibration import RigFormat, save_rig
from fgpose.observations import Observations
from fgpose.pipeline.calibration_report import markdown
from fgpose.pipeline.results import write_all
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory, joint_status
from fgpose.viewer import CalibrationRecording, CalibrationScene, open_calibration_recording
from fgpose.viewer.calibration_recording import WALK

Display = Callable[[CalibratedFromPeople, CalibrationRecording], None]


def write_calibration(
    result: CalibratedFromPeople,
    path: Path,
    file_format: RigFormat = "auto",
    rrd: Path | None = None,
    display: Display | None = None,
) -> tuple[Path, ...]:
    """Write the rig, unless the calibration failed, and the scene for the viewer, which shows why too.

    Args:
        result: of the calibration.
        path: of the rig, see save_rig.
        file_format: of the rig.
        rrd: of the scene; None: there is none.
        display: how it is shown, show_calibrated by default.

    Returns:
        The files.

    Raises:
        OutputError: one could not be written; the others were.
    """
    writers: dict[Path | str, Callable[[], object]] = {}
    if result.grade is not Grade.FAILED:
        writers[path] = partial(save_rig, result.rig, path, file_format)
    if rrd is not None:
        writers[rrd] = partial(_write_scene, result, rrd, display or show_calibrated)
    return write_all(writers)


def _write_scene(result: CalibratedFromPeople, path: Path, display: Display) -> None:
    walk = result.walk
    with open_calibration_recording(path, result.rig, walk.skeleton, n_frames=len(walk.time_s)) as recording:
        display(result, recording)


def show_calibrated(result: CalibratedFromPeople, recording: CalibrationRecording) -> None:
    """Show the cameras, the walk, what every camera saw of it, and how well they agree."""
    walk, rig = result.walk, result.rig
    seen = Observations(walk.skeleton, walk.time_s, walk.points2d_px, walk.confidence, camera_names=walk.camera_names)
    recording.log_observations(seen)
    recording.log_trajectory(WALK, walked(result))
    scene = CalibrationScene(
        walk.time_s,
        result.sigmas.position_m,
        hips_m(result.joints_m, walk.skeleton),
        pairs_px(rig.undistort(walk.points2d_px), rig),
        markdown(result),
    )
    recording.log_calibration(scene)


def walked(result: CalibratedFromPeople) -> Trajectory:
    """The walker's joints, with the reprojection errors."""
    known = np.asarray(np.isfinite(result.joints_m).all(axis=-1))
    by_two = np.isfinite(result.residual_px).sum(axis=1) >= 2
    return Trajectory(
        skeleton=result.walk.skeleton,
        time_s=result.walk.time_s.copy(),
        positions_m=result.joints_m.copy(),
        status=joint_status(known, by_two),
        residual_px=result.residual_px.copy(),
        camera_names=result.rig.names,
    )


def hips_m(joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> Float[np.ndarray, "frame 3"]:
    """The root of the skeleton in every frame; NaN where a joint of it is not known."""
    return joints_m[:, list(skeleton.root)].mean(axis=1)
