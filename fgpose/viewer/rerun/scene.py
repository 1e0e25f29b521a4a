"""How cameras, joints and bodies look in every recording, and a body over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import rerun as rr
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import UpAxis, nearest_axis
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.palette import Colour, faded
from fgpose.viewer.rerun.rows import Rows, bone_rows, ellipsoid_rows, point_rows, status_rows
from fgpose_factors.robust_statistics import known_medians

# Reprojections are smaller, so that a detection below one stays visible.
_DETECTION_RADIUS = rr.Radius.ui_points(3.5)
_REPROJECTION_RADIUS = rr.Radius.ui_points(1.5)
_LABEL_ABOVE_M = 0.2  # over the highest joint, so that it hides none
# The text is to be seen, not its point.
TEXT_LOOK: dict[str, Any] = {"radii": rr.Radius.ui_points(0.5), "colors": palette.TEXT, "show_labels": True}
# Half the length of a line, of the distance between two names.
_LEGEND_LINE, _LEGEND_RADIUS = 0.6, rr.Radius.ui_points(1.5)
# Pictures are a little darker, so that white skeletons and yellow points stand out.
_PICTURE_OPACITY = 0.7
_PICTURE_DRAW_ORDER = -10.0  # below all points
# A usual distance in a room; only used where the optical axes do not tell.
_DEFAULT_DISTANCE_M = 3.0
# A frustum that reaches this share of the way to the person shows its picture and hides nobody.
_FRUSTUM_SHARE = 0.14
# Thick enough to be seen from the distance of the cameras, thinner than a wrist.
_JOINT_RADIUS_M = 0.017
_BONE_RADIUS_M = 0.009
# And no thicker than such a share of their length: of fingers and faces, and of a board of small squares.
_JOINT_SHARE, _BONE_SHARE = 0.2, 0.1
# A predicted joint is half as thick as an observed one, and paler.
_PREDICTED_SCALE = 0.5


def log_cameras(
    stream: rr.RecordingStream,
    rig: CameraRig,
    up: UpAxis,
    colours: Sequence[Colour],
    around_m: Float[np.ndarray, " 3"] | None = None,
) -> None:
    """The world and the cameras in it, each in its colour, ready for their pictures and detections; around_m as of
    viewing_target_m."""
    sign, axis = nearest_axis(up)
    view = getattr(rr.ViewCoordinates, f"RIGHT_HAND_{axis.upper()}_{'UP' if sign == '+' else 'DOWN'}")
    stream.log(paths.WORLD, view, static=True)
    for camera, colour in zip(rig.cameras, colours, strict=True):
        _log_camera(stream, camera, colour, frustum_m(rig, around_m))
    log_camera_names(stream, rig, rig.names)
    log_legend(stream, paths.CAMERA_LEGEND, rig.names, [palette.camera_colour(c) for c in range(rig.n_cameras)])


def log_camera_names(stream: rr.RecordingStream, rig: CameraRig, names: Sequence[str]) -> None:
    """What is written at each camera."""
    text = rr.Points3D(rig.positions_m, labels=list(names), **TEXT_LOOK)
    stream.log(paths.CAMERA_NAMES, text, static=True)


def log_legend(stream: rr.RecordingStream, path: str, names: Sequence[str], colours: Sequence[Colour]) -> None:
    """Names below each other, each under a line in its colour: beside a plot, where they hide nothing."""
    rows = range(len(names))
    stream.log(path, rr.Points2D([(0.0, row) for row in rows], labels=list(names), **TEXT_LOOK), static=True)
    strips = [[(-_LEGEND_LINE, row), (_LEGEND_LINE, row)] for row in rows]
    lines = rr.LineStrips2D(strips, colors=list(colours), radii=_LEGEND_RADIUS)
    stream.log(paths.join(path, "lines"), lines, static=True)


def frustum_m(rig: CameraRig, around_m: Float[np.ndarray, " 3"] | None = None) -> float:
    """How far the frusta of cameras reach."""
    distances_m = np.linalg.norm(rig.positions_m - viewing_target_m(rig, around_m), axis=1)
    return _FRUSTUM_SHARE * float(distances_m.mean())


def viewing_target_m(rig: CameraRig, around_m: Float[np.ndarray, " 3"] | None = None) -> Float[np.ndarray, " 3"]:
    """Where the cameras look: the point nearest to all optical axes, with a weak prior around what they saw; None: that
    is not known, and taken to be in front of them."""
    forward = np.stack([camera.world_T_camera[:3, 2] for camera in rig.cameras])
    position_m = rig.positions_m
    prior_m = (position_m + _DEFAULT_DISTANCE_M * forward).mean(axis=0) if around_m is None else around_m
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    # The prior determines the depth where there is one camera, or where all are parallel.
    tie = 0.01 * np.eye(3)
    return np.linalg.solve(
        across.sum(axis=0) + tie, (across @ position_m[:, :, None]).sum(axis=0)[:, 0] + tie @ prior_m
    )


def annotation_class(
    number: int, label: str, colour: Colour | None, skeleton: Skeleton, bones: tuple[tuple[int, int], ...] = ()
) -> rr.ClassDescription:
    """Points of this class have the colour and the names of the joints; bones join them."""
    joints = [rr.AnnotationInfo(j, joint, colour) for j, joint in enumerate(skeleton.joints)]
    return rr.ClassDescription(
        info=rr.AnnotationInfo(number, label, colour), keypoint_annotations=joints, keypoint_connections=list(bones)
    )


def _log_camera(stream: rr.RecordingStream, camera: Camera, colour: Colour, frustum_m: float) -> None:
    pose, pinhole = pose_and_pinhole(camera, colour, frustum_m)
    stream.log(paths.camera(camera.name), pose, static=True)
    stream.log(paths.image(camera.name), pinhole, static=True)
    detections = rr.Points2D.from_fields(radii=_DETECTION_RADIUS, show_labels=False, draw_order=20.0)
    stream.log(paths.detections(camera.name), detections, static=True)


def pose_and_pinhole(camera: Camera, colour: Colour, frustum_m: float) -> tuple[rr.Transform3D, rr.Pinhole]:
    """Where a camera is, and what it shows, as a frustum of this length."""
    pinhole = rr.Pinhole(
        image_from_camera=camera.K,
        resolution=camera.size_px,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=frustum_m,
        color=colour,
    )
    return rr.Transform3D(translation=camera.position_m, mat3x3=camera.world_T_camera[:3, :3]), pinhole


def log_picture_style(stream: rr.RecordingStream, camera: str, scale: tuple[float, float]) -> None:
    """Appearance and place of a camera's pictures: undistorted pixels per pixel, across and down.

    OpenCV, and so every point here, counts pixels from the centre of the first one, Rerun from its corner.
    """
    place = rr.Transform3D(translation=(-0.5, -0.5, 0.0), scale=(*scale, 1.0))
    stream.log(paths.picture(camera), place, static=True)
    look = rr.EncodedImage.from_fields(opacity=_PICTURE_OPACITY, draw_order=_PICTURE_DRAW_ORDER)
    stream.log(paths.picture(camera), look, static=True)


def log_body_styles(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, name: str, class_id: int, colour: Colour
) -> None:
    """Appearance of a body in space and in the images, and of the status of its joints.

    Args:
        stream: of the recording.
        rig: the cameras.
        skeleton: the joints.
        name: of the result or of the person.
        class_id: of its annotation.
        colour: of its covariance.
    """
    path = paths.trajectory(name)
    joints = rr.Points3D.from_fields(class_ids=class_id, show_labels=False)
    stream.log(f"{path}/joints", joints, static=True)
    ellipsoids = rr.Ellipsoids3D.from_fields(
        colors=[*palette.faded(colour, 0.3), 60], fill_mode=rr.components.FillMode.TransparentFillMajorWireframe
    )
    stream.log(f"{path}/covariance", ellipsoids, static=True)
    for camera in rig.names:
        reprojections = rr.Points2D.from_fields(
            radii=_REPROJECTION_RADIUS, class_ids=class_id, show_labels=False, draw_order=10.0
        )
        stream.log(paths.reprojections(camera, name), reprojections, static=True)
    for joint in skeleton.joints:
        lanes = rr.StateConfiguration(values=list(palette.STATUS), colors=list(palette.STATUS.values()))
        stream.log(paths.join(paths.STATUS, name, joint), lanes, static=True)


def log_line(stream: rr.RecordingStream, path: str, name: str, colour: Colour, width: float = 1.5) -> None:
    """Name and appearance of a line in a plot."""
    stream.log(path, rr.SeriesLines(names=name, colors=[colour], widths=[width]), static=True)


def body_rows(
    name: str,
    trajectory: Trajectory,
    rig: CameraRig,
    colour: Colour,
    thickness: float = 1.0,
    before: np.ndarray | None = None,
) -> Iterator[Rows]:
    """Skeleton, covariance, reprojections and status.

    Args:
        name: of the result or of the person.
        trajectory: one frame or more.
        rig: the cameras.
        colour: of the skeleton.
        thickness: of the skeleton; 1 for a final result.
        before: (J,) status in the frame before the first, if there was one.
    """
    path = paths.trajectory(name)
    yield from _skeleton_rows(path, trajectory, colour, thickness)
    if trajectory.covariance_m2 is not None:
        yield ellipsoid_rows(f"{path}/covariance", trajectory.positions_m, trajectory.covariance_m2)
    reprojections_px = rig.project(trajectory.positions_m)
    for c, camera in enumerate(rig.names):
        yield point_rows(paths.reprojections(camera, name), rr.Points2D, reprojections_px[:, c])
    first = np.full(trajectory.skeleton.n_joints, Status.OBSERVED) if before is None else before
    for j in np.flatnonzero((np.diff(trajectory.status, axis=0, prepend=first[None]) != 0).any(axis=0)):
        path = paths.join(paths.STATUS, name, trajectory.skeleton.joints[j])
        yield status_rows(path, trajectory.status[:, j], int(first[j]))


def _skeleton_rows(path: str, trajectory: Trajectory, colour: Colour, thickness: float) -> Iterator[Rows]:
    skeleton, observed = trajectory.skeleton, trajectory.observed
    bones = (*skeleton.bones, *skeleton.lines)
    bone_observed = observed[:, np.array(bones, dtype=int).reshape(-1, 2)].all(axis=-1)
    pair = np.array([faded(colour), colour], dtype=np.uint8)
    scale = thickness * np.array([_PREDICTED_SCALE, 1.0])
    joint, bone = observed.astype(int), bone_observed.astype(int)
    joint_m, bone_m = _radii_m(trajectory.positions_m, bones)
    yield point_rows(f"{path}/joints", rr.Points3D, trajectory.positions_m, pair[joint], joint_m * scale[joint])
    yield bone_rows(f"{path}/bones", trajectory.positions_m, bones, pair[bone], bone_m * scale[bone])


def _radii_m(
    positions_m: Float[np.ndarray, "frame joint 3"], bones: Sequence[tuple[int, int]]
) -> tuple[Float[np.ndarray, " joint"], Float[np.ndarray, " bone"]]:
    """Of the joints and of the bones, at full thickness."""
    a, b = np.array(bones, dtype=int).reshape(-1, 2).T
    lengths_m = known_medians(np.linalg.norm(positions_m[:, a] - positions_m[:, b], axis=-1).T)
    lengths_m[lengths_m == 0] = np.nan  # two names of one place
    joint_m = np.full(positions_m.shape[1], _JOINT_RADIUS_M)
    for ends in (a, b):
        np.fmin.at(joint_m, ends, _JOINT_SHARE * lengths_m)
    return joint_m, np.fmin(_BONE_RADIUS_M, _BONE_SHARE * lengths_m)


def over_joints_m(
    positions_m: Float[np.ndarray, "frame joint 3"], up: Float[np.ndarray, " 3"], height_m: float = _LABEL_ABOVE_M
) -> Float[np.ndarray, "frame 3"]:
    """Over the middle of the joints, above the highest; NaN where none is known."""
    known = np.asarray(np.isfinite(positions_m).all(axis=-1))
    count = np.count_nonzero(known, axis=1, keepdims=True)
    middle_m = np.where(known[..., None], positions_m, 0.0).sum(axis=1) / np.where(count > 0, count, np.nan)
    highest_m = np.where(known, positions_m @ up, -np.inf).max(axis=1, keepdims=True)
    return middle_m + (highest_m + height_m - middle_m @ up[:, None]) * up
