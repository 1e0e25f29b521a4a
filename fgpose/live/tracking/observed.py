"""What the cameras observe: only there does nobody mean that nobody is there."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.live.frame import CameraState, CameraStatus

_FOCUS_M = 3.0  # in front of cameras that look in parallel: about the middle of a room
_PARALLEL = 1e-3  # mean squared sine of the angles between the optical axes, of cameras within two degrees
_POINTS_PER_SIDE = 16


@dataclass(frozen=True)
class Volume:
    """A box along the axes of the world in which people are expected.

    Raises:
        ValueError: a number is not finite, the lower corner is not below the upper one, the spacing is not positive or
            leaves more than a million points.
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    spacing_m: float = 0.25
    """Of the grid of points that stands for the volume: half the breadth of a person, so nobody fits in between."""

    def __post_init__(self) -> None:
        size_m = np.subtract(self.high_m, self.low_m)
        if not np.isfinite([*self.low_m, *self.high_m, self.spacing_m]).all() or (size_m <= 0).any():
            raise ValueError(f"low_m must be below high_m, got {self.low_m} and {self.high_m}")
        if self.spacing_m <= 0 or np.prod(size_m / self.spacing_m + 1) > 1e6:
            raise ValueError(f"spacing_m must be positive and leave at most a million points, got {self.spacing_m:g}")

    def points_m(self) -> Float[np.ndarray, "point 3"]:
        """Points of a grid with at most this spacing, on the faces too."""
        return box_grid(np.array(self.low_m), np.array(self.high_m), self.spacing_m)

    def contains(self, points_m: Float[np.ndarray, "*points 3"]) -> Bool[np.ndarray, "*points"]:
        inside = (points_m >= self.low_m) & (points_m <= self.high_m)
        return np.asarray(inside.all(axis=-1))


def box_grid(
    low_m: Float[np.ndarray, " 3"], high_m: Float[np.ndarray, " 3"], spacing_m: float
) -> Float[np.ndarray, "point 3"]:
    """Points of a box with at most this spacing, on its faces too."""
    sides = [
        np.linspace(low, high, int(np.ceil((high - low) / spacing_m)) + 1)
        for low, high in zip(low_m, high_m, strict=True)
    ]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def observed_share(rig: CameraRig, ok_cameras: Collection[str], points_m: Float[np.ndarray, "point 3"]) -> float:
    """Share of world points that lie in the images of at least two of these cameras; 0 if there are no points.

    Args:
        rig: the calibrated cameras.
        ok_cameras: names of those whose images can be trusted now.
        points_m: as volume_points_m gives them, for instance.
    """
    is_ok = np.isin(rig.names, list(ok_cameras))
    if not len(points_m):
        return 0.0
    return float((in_views(rig, points_m)[:, is_ok].sum(axis=1) >= 2).mean())


class ObservedVolume:
    """How much of a volume cameras observe. Any thread may ask; the last answer is remembered.

    Args:
        rig, points_m: as of observed_share.
    """

    def __init__(self, rig: CameraRig, points_m: Float[np.ndarray, "point 3"]) -> None:
        self._rig, self._points_m = rig, points_m
        self._last: tuple[frozenset[str], float] = frozenset(), 0.0

    def share(self, cameras: Iterable[CameraStatus]) -> float:
        """By those of the cameras that are ok, see observed_share."""
        ok, last = frozenset(camera.name for camera in cameras if camera.state is CameraState.OK), self._last
        if ok != last[0]:
            last = self._last = ok, observed_share(self._rig, ok, self._points_m)
        return last[1]


def volume_points_m(rig: CameraRig, volume: Volume | None = None) -> Float[np.ndarray, "point 3"]:
    """Points that stand for the volume in which people are expected, in the world frame.

    With no volume given, it is what the rig was set up to observe: of a grid in the cube around the point where the
    optical axes come nearest to each other, as wide as the median distance of the cameras from it, those points that at
    least two cameras observe while all are ok. (If the axes are parallel that point is taken 3 m in front of
    the cameras.) Without a second camera there are none.
    """
    if volume is not None:
        return volume.points_m()
    focus_m = _focus_m(rig)
    half_m = float(np.median([np.linalg.norm(camera.position_m - focus_m) for camera in rig.cameras])) / 2
    points_m = box_grid(focus_m - half_m, focus_m + half_m, 2 * half_m / (_POINTS_PER_SIDE - 1))
    return points_m[in_views(rig, points_m).sum(axis=1) >= 2]


def _focus_m(rig: CameraRig) -> Float[np.ndarray, " 3"]:
    """Where the optical axes come nearest to each other, in the world frame."""
    position_m = rig.positions_m
    axis = np.stack([camera.world_T_camera[:3, 2] for camera in rig.cameras])
    across = np.eye(3) - axis[:, :, None] * axis[:, None]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < _PARALLEL:
        return np.asarray((position_m + _FOCUS_M * axis).mean(axis=0))
    return np.linalg.solve(across.sum(axis=0), (across @ position_m[..., None]).sum(axis=0))[:, 0]
