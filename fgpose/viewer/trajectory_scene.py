"""The static part of the recording of one person."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.viewer import palette, paths
from fgpose.viewer.scene import annotation_class, log_body_styles, log_cameras, log_line
from fgpose.viewer.session import UpAxis

# Of Rerun's annotations; cameras and results follow, see _log_annotations.
_DETECTION_CLASS = 0
_VIEW_RADIUS_M = 0.008  # half of a joint of a result (content.py)


def log_scene(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str], up: UpAxis
) -> None:
    """Everything static of it."""
    _log_annotations(stream, rig, skeleton, trajectories)
    colours = [palette.camera_colour(c) for c in range(rig.n_cameras)]
    log_cameras(stream, rig, up, colours)
    for c, (name, colour) in enumerate(zip(rig.names, colours, strict=True)):
        stream.log(paths.detections(name), rr.Points2D.from_fields(class_ids=_DETECTION_CLASS), static=True)
        view = rr.Points3D.from_fields(radii=_VIEW_RADIUS_M, class_ids=1 + c, show_labels=False)
        stream.log(paths.view(name), view, static=True)
        log_line(stream, paths.join(paths.WEIGHT, name), name, colour)
    for index, name in enumerate(trajectories):
        _log_trajectory_styles(stream, rig, skeleton, name, index)
    log_line(stream, paths.UPDATE_MS, "update", palette.camera_colour(0))


def _log_annotations(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, trajectories: Sequence[str]
) -> None:
    """Class 0: detections, one per camera: its 3D pose, then one per result: its reprojections."""
    classes = [annotation_class(_DETECTION_CLASS, "detections", None, skeleton)]
    bones = (*skeleton.bones, *skeleton.lines)
    for c, name in enumerate(rig.names):
        dark = palette.faded(palette.camera_colour(c), 0.3)
        classes.append(annotation_class(1 + c, f"pose of {name}", dark, skeleton, bones))
    for index, name in enumerate(trajectories):
        number = 1 + rig.n_cameras + index
        colour = palette.trajectory_colour(name, index)
        classes.append(annotation_class(number, name, colour, skeleton, bones))
    stream.log("/", rr.AnnotationContext(classes), static=True)


def _log_trajectory_styles(
    stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, name: str, index: int
) -> None:
    colour = palette.trajectory_colour(name, index)
    log_body_styles(stream, rig, skeleton, name, 1 + rig.n_cameras + index, colour)
    for c, camera in enumerate(rig.names):
        log_line(stream, paths.join(paths.REPROJECTION_PX, name, camera), camera, palette.camera_colour(c))
    for limb, of_limb in zip(paths.limb_names(skeleton), palette.LIMBS * len(skeleton.limbs), strict=False):
        path = paths.join(paths.BONE_LENGTH, name, limb)
        log_line(stream, f"{path}/left", f"{limb} left", of_limb, 2.0)
        log_line(stream, f"{path}/right", f"{limb} right", palette.faded(of_limb, 0.35), 1.0)


def log_residual_styles(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, factors: Sequence[str]) -> None:
    """Names and colours of the factors in the plots of the residuals."""
    colours = palette.factor_colours(factors, rig.names)
    for joint in paths.limb_joints(skeleton):
        lines = rr.SeriesLines(names=list(factors), colors=colours, widths=[1.5] * len(factors))
        stream.log(paths.join(paths.RESIDUAL, skeleton.joints[joint]), lines, static=True)
