"""A motion as a small picture: some poses side by side, as SVG without anything from outside."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.up_axis import z_up
from fgpose.kinematics.vertical import find_up
from fgpose.sampling import spread_evenly
from fgpose.trajectory import Trajectory
from fgpose.viewer.skeleton_picture import LEFT, MIDDLE, RIGHT

_POSES, _HEIGHT_PX, _GAP_PX, _MARGIN_PX = 5, 130.0, 14.0, 6.0
# Time to find the vertical in; a pose is taken near its moment, where most joints are known.
_MOST_FRAMES, _NEAR = 500, 0.05


def strip(trajectory: Trajectory) -> str:
    """Poses spread over the time, each from where the body is seen widest; empty where no joint is known.

    The left side is blue, the right one orange. Lengths compare: all poses have one scale.
    """
    sampled = trajectory.frames(_mask(trajectory.n_frames, spread_evenly(trajectory.n_frames, _MOST_FRAMES)))
    known = np.isfinite(sampled.positions_m).all(axis=-1).sum(axis=1)
    if not known.any():
        return ""
    upright_m = z_up(sampled.positions_m, find_up([sampled]).world_up)
    poses_m, across = [], np.array([1.0, 0.0])
    for frame in _moments(known):
        across = _across(upright_m[frame], across)
        poses_m.append(np.stack([upright_m[frame, :, :2] @ across, upright_m[frame, :, 2]], axis=1))
    lows, highs = zip(*((np.nanmin(pose, axis=0), np.nanmax(pose, axis=0)) for pose in poses_m), strict=True)
    height_m = max(float(np.max(highs, axis=0)[1] - np.min(lows, axis=0)[1]), 1e-6)
    px_per_m = (_HEIGHT_PX - 2 * _MARGIN_PX) / height_m
    top_m, left_px, drawn = float(np.max(highs, axis=0)[1]), _MARGIN_PX, []
    for pose_m, low, high in zip(poses_m, lows, highs, strict=True):
        in_px = np.stack(
            [left_px + (pose_m[:, 0] - low[0]) * px_per_m, _MARGIN_PX + (top_m - pose_m[:, 1]) * px_per_m], 1
        )
        drawn.append(_pose(in_px, trajectory))
        left_px += (high[0] - low[0]) * px_per_m + _GAP_PX
    width_px = left_px - _GAP_PX + _MARGIN_PX
    size = f'width="{width_px:.0f}" height="{_HEIGHT_PX:.0f}" viewBox="0 0 {width_px:.0f} {_HEIGHT_PX:.0f}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="poses" {size}>{"".join(drawn)}</svg>'


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


def _pose(in_px: Float[np.ndarray, "joint 2"], trajectory: Trajectory) -> str:
    skeleton = trajectory.skeleton
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
