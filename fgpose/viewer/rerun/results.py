"""Results of one person in a recording: the static part, and the rows from arrays. A live frame is one frame of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose.viewer.rerun import palette, paths
from fgpose.viewer.rerun.palette import Colour, weight_colours
from fgpose.viewer.rerun.rows import Rows, document_rows, point_rows, scalar_rows
from fgpose.viewer.rerun.scene import (
    TEXT_LOOK,
    annotation_class,
    body_rows,
    log_body_styles,
    log_cameras,
    log_legend,
    log_line,
    over_joints_m,
)
from fgpose_factors.robust_statistics import known_medians

# Of Rerun's annotations; cameras and results follow, see _log_annotations.
_DETECTION_CLASS = 0
_VIEW_RADIUS_M = 0.008  # half of a joint of a result
# The largest residual of a joint is set in bold if it is more than this many sigmas.
_NOTABLE_SIGMAS = 2.0


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
    limbs = _limb_colours(skeleton)
    sides = [(f"{limb} {side}", colour) for limb, both in limbs.items() for side, colour in both.items()]
    log_legend(stream, paths.LIMB_LEGEND, [name for name, _ in sides], [colour for _, colour in sides])
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
    label = rr.Points3D.from_fields(**TEXT_LOOK)
    stream.log(paths.label(name), label, static=True)
    for c, camera in enumerate(rig.names):
        log_line(stream, paths.join(paths.REPROJECTION_PX, name, camera), camera, palette.camera_colour(c))
    for limb, sides in _limb_colours(skeleton).items():
        for side, colour in sides.items():
            path = paths.join(paths.BONE_LENGTH, name, limb, side)
            log_line(stream, path, f"{limb} {side}", colour, 2.0 if side == "left" else 1.0)


def _limb_colours(skeleton: Skeleton) -> dict[str, dict[str, Colour]]:
    """Of the lines of left and right limbs."""
    colours = zip(paths.limb_names(skeleton), palette.LIMBS * len(skeleton.limbs), strict=False)
    return {limb: {"left": colour, "right": palette.faded(colour, 0.35)} for limb, colour in colours}


def log_residual_styles(stream: rr.RecordingStream, rig: CameraRig, skeleton: Skeleton, factors: Sequence[str]) -> None:
    """Names and colours of the factors in the plots of the residuals."""
    colours = palette.factor_colours(factors, rig.names)
    for joint in paths.limb_joints(skeleton):
        lines = rr.SeriesLines(names=list(factors), colors=colours, widths=[1.5] * len(factors))
        stream.log(paths.join(paths.RESIDUAL, skeleton.joints[joint]), lines, static=True)


def observation_rows(
    observations: Observations,
    rig: CameraRig,
    weights: Float[np.ndarray, "frame camera joint"] | None,
    undistorted_px: Float[np.ndarray, "frame camera joint 2"] | None = None,
) -> Iterator[Rows]:
    """Detections in every camera, the views' own 3D poses, the weight of each view."""
    assert observations.confidence is not None
    undistorted_px = rig.undistort(observations.points2d_px) if undistorted_px is None else undistorted_px
    if weights is None:
        relative, share = observations.confidence, observations.confidence
    else:
        known = np.where(observations.seen, np.nan_to_num(weights), 0.0)
        relative, share = _divided(known, known.max(axis=1)), _divided(known, known.sum(axis=1))
    plotted = _mean_of_seen(share, observations.seen)
    for c, name in enumerate(rig.names):
        colours = weight_colours(relative[:, c])
        yield point_rows(paths.detections(name), rr.Points2D, undistorted_px[:, c], colours)
        yield scalar_rows(paths.join(paths.WEIGHT, name), plotted[:, c])
        if observations.points3d_m is not None:
            yield point_rows(paths.view(name), rr.Points3D, observations.points3d_m[:, c])


@dataclass(frozen=True, eq=False)
class ResultLook:
    """How a result is told from others."""

    colour: Colour
    thickness: float
    """Of its skeleton; 1 for a final result."""
    name_over_m: Float[np.ndarray, " 3"] | None
    """Where its name stands, over the highest joint; None: nowhere, as there is no other."""


def trajectory_rows(
    name: str, trajectory: Trajectory, rig: CameraRig, look: ResultLook, before: np.ndarray | None = None
) -> Iterator[Rows]:
    """Skeleton, name, covariance, reprojections, status and plots of a result.

    Args:
        name: of the result.
        trajectory: one frame or more.
        rig: the cameras.
        look: of the result.
        before: (J,) status in the frame before the first, if there was one.
    """
    skeleton, positions_m = trajectory.skeleton, trajectory.positions_m
    yield from body_rows(name, trajectory, rig, look.colour, look.thickness, before)
    if look.name_over_m is not None:
        height_m = float(np.linalg.norm(look.name_over_m))
        place_m = over_joints_m(positions_m, look.name_over_m / height_m, height_m)
        known = np.isfinite(place_m).all(axis=-1)
        fields = {"positions": place_m[known], "labels": [name] * int(known.sum())}
        yield Rows(paths.label(name), rr.Points3D, known.astype(int), fields)
    if trajectory.residual_px is not None:
        for camera, residual_px in zip(rig.names, trajectory.residual_px.swapaxes(0, 1), strict=True):
            yield scalar_rows(paths.join(paths.REPROJECTION_PX, name, camera), known_medians(residual_px))
    for limb, sides in zip(paths.limb_names(skeleton), skeleton.limb_pairs, strict=True):
        for side, (a, b) in zip(("left", "right"), sides, strict=True):
            length_m = np.linalg.norm(positions_m[:, a] - positions_m[:, b], axis=-1)
            yield scalar_rows(paths.join(paths.BONE_LENGTH, name, limb, side), length_m)


def residual_rows(skeleton: Skeleton, residuals: Mapping[str, Float[np.ndarray, "frame joint"]]) -> Iterator[Rows]:
    """One plot per limb joint with a series per factor, and a table of all joints."""
    values = np.stack(list(residuals.values()), axis=-1)
    for j in paths.limb_joints(skeleton):
        yield scalar_rows(paths.join(paths.RESIDUAL, skeleton.joints[j]), values[:, j])
    yield document_rows(paths.RESIDUAL_TABLE, [_table(skeleton, tuple(residuals), frame) for frame in values])


def _table(skeleton: Skeleton, factors: tuple[str, ...], values: Float[np.ndarray, "joint factor"]) -> str:
    """Markdown: one line per joint, the factor with the largest residual in bold."""
    names = [factor.rpartition("/")[2] for factor in factors]
    lines = [f"| sigmas | {' | '.join(names)} |", "|---" * (len(factors) + 1) + "|"]
    for joint, row in zip(skeleton.joints, values, strict=True):
        hardest = np.nanargmax(row) if np.isfinite(row).any() else -1
        cells = ["" if np.isnan(value) else f"{value:.1f}" for value in row]
        if hardest >= 0 and row[hardest] > _NOTABLE_SIGMAS:
            cells[hardest] = f"**{cells[hardest]}**"
        lines.append(f"| {joint} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _divided(values: Float[np.ndarray, "frame camera joint"], by: Float[np.ndarray, "frame joint"]) -> np.ndarray:
    divisor = np.broadcast_to(by[:, None], values.shape)
    return np.divide(values, divisor, out=np.zeros_like(values), where=divisor > 0)


def _mean_of_seen(values: np.ndarray, seen: np.ndarray) -> Float[np.ndarray, "frame camera"]:
    """Mean over the joints that a camera sees; 0 for a camera that sees none."""
    count = seen.sum(axis=-1)
    total = np.where(seen, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.zeros(count.shape), where=count > 0)
