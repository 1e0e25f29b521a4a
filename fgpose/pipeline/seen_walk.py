"""A walk and the cameras that saw it: what the viewer shows of a calibration, or of a rig that was bumped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.calibrate import CalibratedFromBoards
from fgpose.calibration.bumped import BumpedRig
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
from fgpose.calibration.from_people.starts.starts import Starts
from fgpose.calibration.from_people.starts.together import together
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.epipolar_distance import pairs_px
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline.board_report import board_markdown
from fgpose.pipeline.calibration_report import bumped_markdown, markdown
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory, joint_status
from fgpose.viewer import CalibrationRecording, CalibrationScene
from fgpose.viewer.recording import WALK


@dataclass(frozen=True, eq=False)
class SeenWalk:
    """What is shown."""

    rig: CameraRig
    walk: Walk
    """On the common clock; of the cameras of the rig."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """World frame; NaN = not determined."""
    residual_px: Float[np.ndarray, "frame camera joint"]
    """Length of the reprojection errors; NaN = missing."""
    position_sigma_m: Float[np.ndarray, " camera"]
    """NaN: not known."""
    report: str
    """Markdown."""
    before: CameraRig | None = None
    """The cameras as they were; None: nothing is known of that."""
    is_board: bool = False
    """Not somebody: then it is shown which parts of the images it covered."""


def of_calibrated(result: CalibratedFromPeople) -> SeenWalk:
    sigma_m = result.sigmas.position_m
    return SeenWalk(result.rig, result.walk, result.joints_m, result.residual_px, sigma_m, markdown(result))


def of_boards(result: CalibratedFromBoards) -> SeenWalk:
    """The board as a body whose joints are its corners."""
    sightings, board = result.sightings, result.sightings.board
    R, t = result.world_T_board[:, :3, :3], result.world_T_board[:, :3, 3]
    walk = Walk(
        _grid(board),
        sightings.camera_names,
        sightings.time_s,
        sightings.points_px,
        sightings.seen.astype(float),
    )
    return SeenWalk(
        rig=result.rig,
        walk=walk,
        joints_m=board.points_m @ R.swapaxes(1, 2) + t[:, None],
        residual_px=result.residual_px,
        position_sigma_m=result.sigmas.position_m,
        report=board_markdown(result),
        is_board=True,
    )


def _grid(board: Board) -> Skeleton:
    """Corners, each joined to the next of its row and column."""
    apart_m = np.linalg.norm(board.points_m[:, None] - board.points_m, axis=-1)
    nearest_m = np.min(apart_m[apart_m > 0])
    lines = np.argwhere(np.triu(apart_m < 1.1 * nearest_m, 1)).tolist()
    names = tuple(f"corner {number + 1}" for number in range(board.n_points))
    return Skeleton("board", names, (), tuple(range(board.n_points)), lines=tuple((a, b) for a, b in lines))


def of_bumped(bumped: BumpedRig[PeopleObservations], given: CameraRig) -> SeenWalk:
    """The one who is seen most, before the cameras as they are now and as they were.

    Args:
        bumped: what was found.
        given: the rig as it was.

    Raises:
        ValueError: no two cameras ever follow the same person at the same time.
    """
    rig = bumped.rig
    walk = _main_walk(bumped.observations, rig)
    undistorted_px = rig.undistort(walk.points2d_px)
    joints_m = triangulate_robust(undistorted_px, walk.confidence, rig).positions_m
    return SeenWalk(
        rig=rig,
        walk=walk,
        joints_m=joints_m,
        residual_px=reprojection_residual_px(undistorted_px, rig, joints_m),
        position_sigma_m=np.full(rig.n_cameras, np.nan),
        report=bumped_markdown(bumped),
        before=given.subset(rig.names),
    )


def _main_walk(people: PeopleObservations, rig: CameraRig) -> Walk:
    """Of the one who is seen most, by the clock of the rig, of all its cameras."""
    # Per-view 3D is in the world here, and would be taken for that of each camera.
    in_2d = replace(
        people, images=tuple(replace(image, points3d_m=None, covariance3d_m2=None) for image in people.images)
    )
    tracks = main_tracks(find_tracks(in_2d), people.skeleton)
    zero = np.zeros(rig.n_cameras)
    sees = np.array([len(track.time_s) > 0 for track in tracks])
    reference = rig.names[int(np.argmax(sees))]
    starts = Starts(rig.names, reference, rig.time_offsets_s.copy(), zero, zero.copy(), sees)
    walk = together(tracks, starts, people.skeleton)
    shape = len(walk.time_s), rig.n_cameras, people.skeleton.n_joints
    points2d_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    points2d_px[:, sees], confidence[:, sees] = walk.points2d_px, walk.confidence
    return replace(walk, camera_names=rig.names, points2d_px=points2d_px, confidence=confidence)


def show_walk(seen: SeenWalk, recording: CalibrationRecording) -> None:
    """Show the cameras, the walk, what every camera saw of it, and how well they agree."""
    walk, rig = seen.walk, seen.rig
    observed = Observations(
        walk.skeleton, walk.time_s, walk.points2d_px, walk.confidence, camera_names=walk.camera_names
    )
    recording.log_observations(observed)
    recording.log_trajectory(WALK, _trajectory(seen))
    undistorted_px = rig.undistort(walk.points2d_px)
    scene = CalibrationScene(
        walk.time_s,
        seen.position_sigma_m,
        hips_m(seen.joints_m, walk.skeleton),
        pairs_px(undistorted_px, rig),
        seen.report,
        seen.before,
        _covered_px(undistorted_px, rig) if seen.is_board else {},
    )
    recording.log_calibration(scene)


def _covered_px(
    points_px: Float[np.ndarray, "frame camera joint 2"], rig: CameraRig
) -> dict[str, Float[np.ndarray, "point 2"]]:
    own_px = dict(zip(rig.names, points_px.swapaxes(0, 1), strict=True))
    return {name: each[np.isfinite(each).all(axis=-1)] for name, each in own_px.items()}


def _trajectory(seen: SeenWalk) -> Trajectory:
    """The walker's joints, with the reprojection errors."""
    known = np.asarray(np.isfinite(seen.joints_m).all(axis=-1))
    by_two = np.isfinite(seen.residual_px).sum(axis=1) >= 2
    return Trajectory(
        skeleton=seen.walk.skeleton,
        time_s=seen.walk.time_s.copy(),
        positions_m=seen.joints_m.copy(),
        status=joint_status(known, by_two),
        residual_px=seen.residual_px.copy(),
        camera_names=seen.rig.names,
    )


def hips_m(joints_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> Float[np.ndarray, "frame 3"]:
    """The root of the skeleton in every frame; NaN where a joint of it is not known."""
    return joints_m[:, list(skeleton.root)].mean(axis=1)
