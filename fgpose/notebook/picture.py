"""Poses as a small picture, side by side, as SVG without anything from outside: of a motion, or in the images."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import zip_longest
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import z_up
from fgpose.kinematics.vertical import find_up
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.sampling import spread_evenly
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose.viewer.skeleton_picture import LEFT, MIDDLE, RIGHT

_POSES, _HEIGHT_PX, _GAP_PX, _MARGIN_PX = 5, 130.0, 14.0, 6.0
# Time to find the vertical in; a pose is taken near its moment, where most joints are known.
_MOST_FRAMES, _NEAR = 500, 0.05
_MOST_IMAGES, _LEAST_PX, _MOST_LETTERS = 8, 70.0, 12


def strip(trajectory: Trajectory) -> str:
    """Poses spread over the time, each from where the body is seen widest; empty where no joint is known.

    The left side is blue, the right one orange. Lengths compare: all poses have one scale.
    """
    sampled = trajectory.frames(_mask(trajectory.n_frames, spread_evenly(trajectory.n_frames, _MOST_FRAMES)))
    known = np.isfinite(sampled.positions_m).all(axis=-1).sum(axis=1)
    if not known.any():
        return ""
    upright_m = z_up(sampled.positions_m, find_up([sampled]).world_up)
    poses_m, across = list[np.ndarray](), np.array([1.0, 0.0])
    for frame in _moments(known):
        across = _across(upright_m[frame], across)
        poses_m.append(np.stack([upright_m[frame, :, :2] @ across, -upright_m[frame, :, 2]], axis=1)[None])
    return _side_by_side(poses_m, [], trajectory.skeleton)


def views(observations: Observations) -> str:
    """The keypoints in the image of each camera, of the frame in which most of them are seen; empty where none is."""
    seen = observations.seen
    if not seen.any():
        return ""
    frame = int(seen.sum(axis=(1, 2)).argmax())
    points_px = np.where(seen[frame, ..., None], observations.points2d_px[frame], np.nan)
    return _images(list(points_px[:, None]), observations.camera_names, observations.skeleton)


def views_of_people(observations: PeopleObservations) -> str:
    """The same of everybody, of the image of each camera in which most keypoints are seen near the moment when most
    are."""
    fullest = max(observations.images, key=_n_seen, default=None)
    if fullest is None or not _n_seen(fullest):
        return ""
    at_moment = [
        min(images, key=lambda image: abs(image.time_s - fullest.time_s))
        for images in observations.by_camera.values()
        if images
    ]
    return _images(
        [image.points2d_px for image in at_moment], [image.camera for image in at_moment], observations.skeleton
    )


def _n_seen(image: Detections) -> int:
    return int(np.count_nonzero(image.confidence))


def _images(points_px: Sequence[Float[np.ndarray, "_ joint 2"]], names: Sequence[str], skeleton: Skeleton) -> str:
    """Of the cameras that show somebody; of many, some."""
    showing = [camera for camera, each in enumerate(points_px) if np.isfinite(each).all(axis=-1).sum() > 1]
    chosen = [showing[index] for index in spread_evenly(len(showing), _MOST_IMAGES)]
    return _side_by_side([points_px[camera] for camera in chosen], [names[camera] for camera in chosen], skeleton)


def _side_by_side(panels: Sequence[Float[np.ndarray, "_ joint 2"]], names: Sequence[str], skeleton: Skeleton) -> str:
    """Poses, y downwards, as one picture. With names, below each its own, they are images and each has its own scale;
    without, they are of one world and have one."""
    if not panels:
        return ""
    lows, highs = ([bound(panel, axis=(0, 1)) for panel in panels] for bound in (np.nanmin, np.nanmax))
    sizes = np.maximum(np.array(highs) - np.array(lows), 1e-6)
    high_px = _HEIGHT_PX - 2 * _MARGIN_PX
    # Somebody who lies is not wider than two who stand.
    scales = np.minimum(high_px / sizes[:, 1], 2 * high_px / sizes[:, 0])
    if not names:
        scales[:] = high_px / sizes[:, 1].max()
        lows = [np.array([low[0], np.min(lows, axis=0)[1]]) for low in lows]
    left_px, drawn = _MARGIN_PX, list[str]()
    for panel, name, low, size, scale in zip_longest(panels, names, lows, sizes, scales):
        drawn += [_pose(_MARGIN_PX + (pose - low) * scale + (left_px - _MARGIN_PX, 0.0), skeleton) for pose in panel]
        width_px = max(size[0] * scale, _LEAST_PX if names else 0.0)
        drawn += [label(name, left_px, _HEIGHT_PX + _MARGIN_PX)] if name else []
        left_px += width_px + _GAP_PX
    height_px = _HEIGHT_PX + (2 * _MARGIN_PX if names else 0.0)
    return svg("poses", left_px - _GAP_PX + _MARGIN_PX, height_px, drawn)


def svg(what: str, width_px: float, height_px: float, drawn: Sequence[str]) -> str:
    """A picture; what it shows, for who does not see it."""
    size = f'width="{width_px:.0f}" height="{height_px:.0f}" viewBox="0 0 {width_px:.0f} {height_px:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{what}" {size}>{"".join(drawn)}</svg>'


def label(text: str, x_px: float, y_px: float, anchor: Literal["start", "middle", "end"] = "start") -> str:
    """A name in a picture, not too long. It is somebody else's, and escaped."""
    shown = text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 1]}…"
    at = f'x="{x_px:.1f}" y="{y_px:.1f}" text-anchor="{anchor}"'
    return f'<text {at} font-family="sans-serif" font-size="11" fill="{MIDDLE}">{escape(shown)}</text>'


def _mask(n_frames: int, frames: np.ndarray) -> np.ndarray:
    chosen = np.zeros(n_frames, dtype=bool)
    chosen[frames] = True
    return chosen


def _moments(known: np.ndarray) -> list[int]:
    """Frames spread over the time, near which most joints are known."""
    reach = max(1, round(_NEAR * len(known)))
    wanted = spread_evenly(len(known), _POSES).tolist()
    ranges = [(max(0, frame - reach), frame + reach + 1) for frame in wanted]
    chosen = [begin + int(known[begin:end].argmax()) for begin, end in ranges]
    return [frame for frame in dict.fromkeys(chosen) if known[frame]] or [int(known.argmax())]


def _across(positions_m: Float[np.ndarray, "joint 3"], before: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
    """The horizontal direction in which the joints lie farthest apart, of the two the one nearer to that of before."""
    known_m = positions_m[np.isfinite(positions_m).all(axis=1), :2]
    across = np.linalg.svd(known_m - known_m.mean(axis=0))[2][0]
    return across if across @ before >= 0 else -across


def _pose(in_px: Float[np.ndarray, "joint 2"], skeleton: Skeleton) -> str:
    side = {joint: colour for pair in skeleton.left_right for joint, colour in zip(pair, (LEFT, RIGHT), strict=True)}
    known = np.asarray(np.isfinite(in_px).all(axis=1))
    lines = [
        f'<path d="M{in_px[a, 0]:.1f} {in_px[a, 1]:.1f}L{in_px[b, 0]:.1f} {in_px[b, 1]:.1f}" '
        f'stroke="{side.get(b, side.get(a, MIDDLE))}"/>'
        for a, b in (*skeleton.bones, *skeleton.lines)
        if known[a] and known[b]
    ]
    joints = [
        f'<circle cx="{in_px[joint, 0]:.1f}" cy="{in_px[joint, 1]:.1f}" r="1.8" fill="{side.get(joint, MIDDLE)}"/>'
        for joint in np.flatnonzero(known).tolist()
    ]
    return f'<g fill="none" stroke-width="2" stroke-linecap="round">{"".join(lines)}</g>{"".join(joints)}'
