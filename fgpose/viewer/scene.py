"""The static part of a recording: cameras, joint names, and the appearance of each entity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.skeleton import Skeleton
from fgpose.viewer import palette, paths
from fgpose.viewer.palette import Colour
from fgpose.viewer.recording import UpAxis

# Of Rerun's annotations; cameras and results follow, see _log_annotations.
_DETECTION_CLASS = 0
# Reprojections are smaller, so that a detection below one stays visible.
_DETECTION_RADIUS = rr.Radius.ui_points(3.5)
_REPROJECTION_RADIUS = rr.Radius.ui_points(1.5)
# Pictures are a little darker, so that white skeletons and yellow points stand out.
_PICTURE_OPACITY = 0.7
_PICTURE_DRAW_ORDER = -10.0  # below all points
_VIEW_RADIUS_M = 0.008  # half of a joint of a result (content.py)
# A usual distance in a room; only used where the optical axes do not tell.
_DEFAULT_DISTANCE_M = 3.0
# A frustum that reaches this share of the way to the person shows its picture and hides nobody.
_FRUSTUM_SHARE = 0.14


def log_scene(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str], up: UpAxis
) -> None:
    """Everything static of a recording."""
    sign = "UP" if up[0] == "+" else "DOWN"
    stream.log(paths.WORLD, getattr(rr.ViewCoordinates, f"RIGHT_HAND_{up[1].upper()}_{sign}"), static=True)
    _log_annotations(stream, rig, skeleton, trajectories)
    frustum_m = _FRUSTUM_SHARE * viewing_distance_m(rig)
    for c, camera in enumerate(rig.cameras):
        _log_camera(stream, camera, c, frustum_m)
        _log_line(stream, paths.join(paths.WEIGHT, camera.name), camera.name, palette.camera_colour(c))
    for index, name in enumerate(trajectories):
        _log_trajectory_styles(stream, rig, skeleton, name, index)
    _log_line(stream, paths.UPDATE_MS, "update", palette.camera_colour(0))


def viewing_target_m(rig: CameraRig) -> Float[np.ndarray, 3]:
    """Where the cameras look: the point nearest to all optical axes, with a weak prior at a point in front of them."""
    forward = np.stack([camera.world_T_camera[:3, 2] for camera in rig.cameras])
    position_m = np.stack([camera.position_m for camera in rig.cameras])
    ahead_m = (position_m + _DEFAULT_DISTANCE_M * forward).mean(axis=0)
    across = np.eye(3) - forward[:, :, None] * forward[:, None]
    # The prior determines the depth where there is one camera, or where all are parallel.
    tie = 0.01 * np.eye(3)
    return np.linalg.solve(
        across.sum(axis=0) + tie, (across @ position_m[:, :, None]).sum(axis=0)[:, 0] + tie @ ahead_m
    )


def viewing_distance_m(rig: CameraRig) -> float:
    """Mean distance of the cameras from where they look."""
    target_m = viewing_target_m(rig)
    return float(np.mean([np.linalg.norm(camera.position_m - target_m) for camera in rig.cameras]))


def _log_annotations(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str]
) -> None:
    """Class 0: detections, one per camera: its 3D pose, then one per result: its reprojections."""
    classes = [_class(_DETECTION_CLASS, "detections", None, skeleton, ())]
    bones = (*skeleton.bones, *skeleton.lines)
    for c, name in enumerate(rig.names):
        dark = palette.faded(palette.camera_colour(c), 0.3)
        classes.append(_class(1 + c, f"pose of {name}", dark, skeleton, bones))
    for index, name in enumerate(trajectories):
        number = 1 + rig.n_cameras + index
        colour = palette.trajectory_colour(name, index)
        classes.append(_class(number, name, colour, skeleton, bones))
    stream.log("/", rr.AnnotationContext(classes), static=True)


def _class(
    number: int, label: str, colour: Colour | None, skeleton: Skeleton, bones: tuple[tuple[int, int], ...]
) -> rr.ClassDescription:
    joints = [rr.AnnotationInfo(j, joint, colour) for j, joint in enumerate(skeleton.joints)]
    return rr.ClassDescription(
        info=rr.AnnotationInfo(number, label, colour), keypoint_annotations=joints, keypoint_connections=list(bones)
    )


def _log_camera(stream: rr.RecordingStream, camera: Camera, c: int, frustum_m: float) -> None:
    pose = rr.Transform3D(translation=camera.position_m, mat3x3=camera.world_T_camera[:3, :3])
    stream.log(paths.camera(camera.name), pose, static=True)
    pinhole = rr.Pinhole(
        image_from_camera=camera.K,
        resolution=camera.size_px,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=frustum_m,
        color=palette.camera_colour(c),
    )
    stream.log(paths.image(camera.name), pinhole, static=True)
    detections = rr.Points2D.from_fields(
        radii=_DETECTION_RADIUS, class_ids=_DETECTION_CLASS, show_labels=False, draw_order=20.0
    )
    stream.log(paths.detections(camera.name), detections, static=True)
    view = rr.Points3D.from_fields(radii=_VIEW_RADIUS_M, class_ids=1 + c, show_labels=False)
    stream.log(paths.view(camera.name), view, static=True)


def log_picture_style(stream: rr.RecordingStream, camera: str, shrink: int) -> None:
    """Appearance and place of a camera's pictures: each of their pixels covers a square of undistorted ones.

    OpenCV, and so every point here, counts pixels from the centre of the first one, Rerun from its corner.
    """
    place = rr.Transform3D(translation=(-0.5, -0.5, 0.0), scale=shrink)
    stream.log(paths.picture(camera), place, static=True)
    look = rr.EncodedImage.from_fields(opacity=_PICTURE_OPACITY, draw_order=_PICTURE_DRAW_ORDER)
    stream.log(paths.picture(camera), look, static=True)


def _log_trajectory_styles(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, name: str, index: int
) -> None:
    path, colour = paths.trajectory(name), palette.trajectory_colour(name, index)
    class_id = 1 + rig.n_cameras + index
    joints = rr.Points3D.from_fields(class_ids=class_id, show_labels=False)
    stream.log(f"{path}/joints", joints, static=True)
    ellipsoids = rr.Ellipsoids3D.from_fields(
        colors=[*palette.faded(colour, 0.3), 60], fill_mode=rr.components.FillMode.TransparentFillMajorWireframe
    )
    stream.log(f"{path}/covariance", ellipsoids, static=True)
    for c, camera in enumerate(rig.names):
        reprojections = rr.Points2D.from_fields(
            radii=_REPROJECTION_RADIUS, class_ids=class_id, show_labels=False, draw_order=10.0
        )
        stream.log(paths.reprojections(camera, name), reprojections, static=True)
        line = paths.join(paths.REPROJECTION_PX, name, camera)
        _log_line(stream, line, camera, palette.camera_colour(c))
    for limb, of_limb in zip(paths.limb_names(skeleton), palette.LIMBS * len(skeleton.limbs), strict=False):
        path = paths.join(paths.BONE_LENGTH, name, limb)
        _log_line(stream, f"{path}/left", f"{limb} left", of_limb, 2.0)
        _log_line(stream, f"{path}/right", f"{limb} right", palette.faded(of_limb, 0.35), 1.0)
    for joint in skeleton.joints:
        lanes = rr.StateConfiguration(values=list(palette.STATUS), colors=list(palette.STATUS.values()))
        stream.log(paths.join(paths.STATUS, name, joint), lanes, static=True)


def log_residual_styles(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, factors: Sequence[str]) -> None:
    """Names and colours of the factors in the plots of the residuals."""
    colours = palette.factor_colours(factors, rig.names)
    for joint in paths.limb_joints(skeleton):
        lines = rr.SeriesLines(names=list(factors), colors=colours, widths=[1.5] * len(factors))
        stream.log(paths.join(paths.RESIDUAL, skeleton.joints[joint]), lines, static=True)


def _log_line(stream: rr.RecordingStream, path: str, name: str, colour: Colour, width: float = 1.5) -> None:
    stream.log(path, rr.SeriesLines(names=name, colors=[colour], widths=[width]), static=True)
