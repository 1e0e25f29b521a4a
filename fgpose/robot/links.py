"""The links of a cell where their poses put them, and how much around them is observed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.live.tracking.observed import box_grid
from fgpose.robot.cell import Cell, Link
from fgpose.robot.clearance import Shapes

_POINTS_PER_SIDE = 6  # of the grid that stands for the surroundings of a link: 0.4 m apart for 1 m around a small one
_ROTATION_TOLERANCE = 1e-3  # as for the poses of cameras: every real mistake is larger
_LAST_ROW_TOLERANCE = 1e-5  # single precision has it exactly


class PlacedLinks:
    """Links with their poses; those of zones are fixed.

    Raises:
        ValueError: even with all cameras ok too little around a zone is observed; the message names it.
    """

    def __init__(self, cell: Cell, rig: CameraRig) -> None:
        self.links = cell.links
        self._rig = rig
        self._volume = cell.volume
        capsules = [(number, shape) for number, link in enumerate(self.links) for shape in link.capsules]
        boxes = [(number, shape) for number, link in enumerate(self.links) for shape in link.boxes]
        self._capsule_link = np.array([number for number, _ in capsules], dtype=int)
        self._box_link = np.array([number for number, _ in boxes], dtype=int)
        self._ends_m = np.array([[shape.from_m, shape.to_m] for _, shape in capsules]).reshape(-1, 2, 3)
        self._radius_m = np.array([shape.radius_m for _, shape in capsules])
        self._low_m = np.array([shape.low_m for _, shape in boxes]).reshape(-1, 3)
        self._high_m = np.array([shape.high_m for _, shape in boxes]).reshape(-1, 3)
        self.link_of_shape = np.concatenate([self._capsule_link, self._box_link])
        """Of each shape of shapes(): the index of its link."""
        self._around_m = [_surroundings_m(link, cell.limits.surroundings_m) for link in self.links]
        self._fixed_views = {
            link.name: in_views(rig, points_m)
            for link, points_m in zip(self.links, self._around_m, strict=True)
            if link.is_fixed
        }
        for number, link in enumerate(self.links):
            share = self.observed_share(number, np.eye(4), np.ones(rig.n_cameras, dtype=bool)) if link.is_fixed else 1.0
            if share < cell.limits.min_observed_share:
                raise ValueError(
                    f"zones.{link.name}: with all cameras ok, two of them observe {share:.0%} of its surroundings, but "
                    f"min_observed_share is {cell.limits.min_observed_share:.0%}: move cameras, or change "
                    "min_observed_share or surroundings_m"
                )

    def shapes(self, world_T_link: Float[np.ndarray, "link 4 4"]) -> Shapes:
        """All shapes in the world frame."""
        of_capsule = world_T_link[self._capsule_link]
        ends_m = np.einsum("cij,cej->cei", of_capsule[:, :3, :3], self._ends_m) + of_capsule[:, None, :3, 3]
        return Shapes(ends_m, self._radius_m, self._low_m, self._high_m, world_T_link[self._box_link])

    def observed_share(
        self, number: int, world_T_link: Float[np.ndarray, "4 4"], is_ok: Bool[np.ndarray, " camera"]
    ) -> float:
        """Share of the surroundings of a link, as far as people can be there, that at least two cameras that are ok
        observe; 0 where people cannot be.

        Without a volume people are taken to be where at least two cameras observe them while all are ok.
        """
        link = self.links[number]
        points_m = self._around_m[number]
        if link.is_fixed:
            views = self._fixed_views[link.name]
        else:
            points_m = points_m @ world_T_link[:3, :3].T + world_T_link[:3, 3]
            views = in_views(self._rig, points_m)
        within = views.sum(axis=1) >= 2 if self._volume is None else self._volume.contains(points_m)
        observed = views[within][:, is_ok].sum(axis=1) >= 2
        return float(observed.mean()) if len(observed) else 0.0


def world_poses(
    links: Sequence[Link], poses: Mapping[str, np.ndarray]
) -> tuple[Float[np.ndarray, "link 4 4"], Bool[np.ndarray, " link"]]:
    """The pose of each link in the world, and whether it is a rigid transform; it is the identity where it is not."""
    world_T_link, is_rigid = np.tile(np.eye(4), (len(links), 1, 1)), np.ones(len(links), dtype=bool)
    for number, link in enumerate(links):
        if not link.is_fixed:
            is_rigid[number] = link.name in poses and _is_rigid(poses[link.name])
            if is_rigid[number]:
                world_T_link[number] = poses[link.name]
    return world_T_link, is_rigid


def _is_rigid(pose: np.ndarray) -> bool:
    pose = np.asarray(pose)
    if pose.shape != (4, 4) or pose.dtype.kind not in "fiu" or not np.isfinite(pose).all():
        return False
    R = pose[:3, :3]
    is_rotation = np.abs(R @ R.T - np.eye(3)).max() <= _ROTATION_TOLERANCE and np.linalg.det(R) > 0
    return bool(is_rotation and np.abs(pose[3] - (0, 0, 0, 1)).max() <= _LAST_ROW_TOLERANCE)


def _surroundings_m(link: Link, around_m: float) -> Float[np.ndarray, "point 3"]:
    """Points of the box around a link, in its frame."""
    low_m, high_m = link.corners_m()
    low_m, high_m = low_m - around_m, high_m + around_m
    return box_grid(low_m, high_m, float((high_m - low_m).max()) / (_POINTS_PER_SIDE - 1))
