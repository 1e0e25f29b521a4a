"""The cameras of a rig from above, as a small picture: where they stand, and where they look."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.up_axis import WorldUp, z_up
from fgpose.kinematics.vertical import find_up
from fgpose.notebook.picture import label, svg
from fgpose.viewer.skeleton_picture import LEFT, MIDDLE

_SIDE_PX, _LEAST_SIDE_PX = 150.0, 60.0
_ACROSS_PX, _ALONG_PX, _BELOW_PX = 62.0, 30.0, 16.0  # around the cameras, for their names, and for the line
_VIEW_PX, _NAME_PX = 30.0, 12.0  # how far a field of view is drawn; how far behind a camera its name is
_LEAST_M = 0.5  # what fills the picture where cameras stand together
_MOST_NAMES = 16
_SIDEWAYS = 0.5  # of a direction, across: from there on the name is beside the camera
_STEEP = 0.17  # the sine of 10 degrees to the vertical, at which no direction is told


def from_above(rig: CameraRig) -> str:
    """Each camera as a dot with its field of view, and a line of a round length."""
    world_up = find_up([], rig).world_up
    # From above x is to the right, y away.
    places_m = z_up(rig.positions_m, world_up)[:, :2] * (1, -1)
    middle_m = (places_m.min(axis=0) + places_m.max(axis=0)) / 2
    size_m = max(float(np.ptp(places_m, axis=0).max()), _LEAST_M)
    px_per_m = _SIDE_PX / size_m
    across_px, along_px = np.maximum(np.ptp(places_m, axis=0) * px_per_m, _LEAST_SIDE_PX).tolist()
    width_px, height_px = across_px + 2 * _ACROSS_PX, along_px + 2 * _ALONG_PX
    at_px = (places_m - middle_m) * px_per_m + (width_px / 2, height_px / 2)
    drawn = list[str]()
    for camera, (x_px, y_px) in zip(rig.cameras, at_px.tolist(), strict=True):
        axis, view = _view(camera, x_px, y_px, world_up)
        drawn += [view, f'<circle cx="{x_px:.1f}" cy="{y_px:.1f}" r="3" fill="{LEFT}"/>']
        if rig.n_cameras <= _MOST_NAMES:
            x, y = (np.array([x_px, y_px]) - _NAME_PX * axis).tolist()
            anchor = "middle" if abs(axis[0]) < _SIDEWAYS else "end" if axis[0] > 0 else "start"
            drawn.append(label(camera.name, x, y + 4, anchor))
    length_m, line_px = _round(size_m / 3), height_px + _BELOW_PX - 8
    drawn.append(f'<path d="M6 {line_px:.1f}h{length_m * px_per_m:.1f}" stroke="{MIDDLE}" stroke-width="2"/>')
    drawn.append(label(f"{length_m:g} m", 12 + length_m * px_per_m, line_px + 4))
    return svg("cameras from above", width_px, height_px + _BELOW_PX, drawn)


def _view(camera: Camera, x_px: float, y_px: float, world_up: WorldUp) -> tuple[Float[np.ndarray, " 2"], str]:
    """Where it looks, and between the outermost of the rays through the middles of the borders of its image; upwards,
    and nothing, where it looks straight down."""
    width_px, height_px = camera.size_px
    borders_px = np.array([(0, height_px / 2), (width_px, height_px / 2), (width_px / 2, 0), (width_px / 2, height_px)])
    axis = z_up(camera.world_T_camera[:3, 2], world_up)[:2] * (1, -1)
    if np.linalg.norm(axis) < _STEEP:
        return np.array([0.0, 1.0]), ""
    rays = z_up(camera.ray(borders_px), world_up)[:, :2] * (1, -1)
    axis = axis / np.linalg.norm(axis)
    angles = np.arctan2(axis[0] * rays[:, 1] - axis[1] * rays[:, 0], rays @ axis)
    cos, sin = np.cos([angles.min(), angles.max()]), np.sin([angles.min(), angles.max()])
    tips_px = _VIEW_PX * np.stack([cos * axis[0] - sin * axis[1], sin * axis[0] + cos * axis[1]], axis=1)
    (left, up), (right, down) = (np.array([x_px, y_px]) + tips_px).tolist()
    triangle = f"M{x_px:.1f} {y_px:.1f}L{left:.1f} {up:.1f}L{right:.1f} {down:.1f}z"
    return axis, f'<path d="{triangle}" fill="{LEFT}" fill-opacity="0.2" stroke="{LEFT}"/>'


def _round(length_m: float) -> float:
    """The nearest smaller of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length_m))
    return float(max(step for step in (1, 2, 5) if step * power <= length_m * (1 + 1e-9)) * power)
