"""Where the cameras are, before the adjustment: pairs that see the board at the same moment, chained by the best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.board.lenses import FittedLens
from fgpose.calibration.board.problem import BoardBundle, BoardProblem
from fgpose.calibration.board.sightings import BoardSightings
from fgpose.geometry.rigid import inverse, nearest_rotation, pose_of

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# Relative poses of two cameras by single views of the board, as a share of its distance.
_AGREEMENT = 0.05


class NotLinkedError(ValueError):
    """Some cameras never see the board together with the others."""


def place(sightings: BoardSightings, lenses: Sequence[FittedLens]) -> BoardBundle:
    """Cameras and boards in the frame of the first camera, to which the cameras are chained.

    Args:
        sightings: of all cameras, only with views that their lenses explain.
        lenses: of each, with the poses of the board at the moments at which it sees it.

    Raises:
        NotLinkedError: a camera is not linked to the first; the message names it.
    """
    poses = camera_T_boards(sightings, lenses)
    n_cameras = len(lenses)
    links = np.zeros((n_cameras, n_cameras), dtype=int)
    relative = np.full((n_cameras, n_cameras, 4, 4), np.nan)
    for a in range(n_cameras):
        for b in range(a + 1, n_cameras):
            links[a, b], relative[a, b] = _relative(poses[:, a], poses[:, b])
            links[b, a], relative[b, a] = links[a, b], inverse(relative[a, b])
    world_T_camera = _chained(links, relative, sightings.camera_names)
    numbers = np.stack([lens.numbers for lens in lenses])
    return BoardBundle.on_time(world_T_camera, numbers, _boards(sightings, lenses, world_T_camera, poses))


def strongest_tree(links: Int[np.ndarray, "camera camera"] | Float[np.ndarray, "camera camera"]) -> csr_matrix:
    """Of the links of pairs of cameras, by moments or whatever says how strong they are, those of the strongest tree;
    zero elsewhere."""
    from scipy.sparse.csgraph import minimum_spanning_tree

    return minimum_spanning_tree(np.divide(1.0, links, out=np.zeros(links.shape), where=links > 0))


def camera_T_boards(sightings: BoardSightings, lenses: Sequence[FittedLens]) -> Float[np.ndarray, "moment camera 4 4"]:
    """As each camera alone has them; NaN where it does not see the board."""
    poses = np.full((len(sightings.time_s), len(lenses), 4, 4), np.nan)
    for c, lens in enumerate(lenses):
        poses[np.isin(sightings.time_s, lens.sightings.time_s), c] = lens.camera_T_board
    return poses


def _relative(
    of_a: Float[np.ndarray, "moment 4 4"], of_b: Float[np.ndarray, "moment 4 4"]
) -> tuple[int, Float[np.ndarray, "4 4"]]:
    """a_T_b on which most moments agree, and how many they are."""
    both = np.flatnonzero(np.isfinite(of_a[:, 0, 0]) & np.isfinite(of_b[:, 0, 0]))
    if not len(both):
        return 0, np.full((4, 4), np.nan)
    candidates = np.stack([of_a[t] @ inverse(of_b[t]) for t in both])
    distance_m = float(np.median(np.linalg.norm(of_b[both, :3, 3], axis=1)))
    # By where they put a point before the camera and the camera itself.
    places = np.concatenate([candidates[:, :3, 3], candidates[:, :3, 3] + distance_m * candidates[:, :3, 2]], axis=1)
    apart = np.linalg.norm(places[:, None] - places, axis=-1) < _AGREEMENT * distance_m * np.sqrt(2)
    best = int(np.argmax(apart.sum(axis=1)))
    agreeing = candidates[apart[best]]
    R, _ = nearest_rotation(agreeing[:, :3, :3].mean(axis=0))
    return int(apart[best].sum()), pose_of(R, agreeing[:, :3, 3].mean(axis=0))


def _chained(
    links: Int[np.ndarray, "camera camera"], relative: Float[np.ndarray, "camera camera 4 4"], names: Sequence[str]
) -> Float[np.ndarray, "camera 4 4"]:
    """world_T_camera along the tree of the strongest links."""
    from scipy.sparse.csgraph import breadth_first_order

    order, before = breadth_first_order(strongest_tree(links), 0, directed=False)
    lost = [name for c, name in enumerate(names) if c not in order]
    if lost:
        placed = [str(names[c]) for c in sorted(order.tolist())]
        raise NotLinkedError(
            f"camera {', '.join(lost)}: never sees the board at the same moment as {' or '.join(placed)}; hold it "
            "where two cameras see it at once"
        )
    world_T_camera = np.tile(np.eye(4), (len(names), 1, 1))
    for c in order[1:].tolist():
        world_T_camera[c] = world_T_camera[before[c]] @ relative[before[c], c]
    return world_T_camera


def _boards(
    sightings: BoardSightings,
    lenses: Sequence[FittedLens],
    world_T_camera: Float[np.ndarray, "camera 4 4"],
    poses: Float[np.ndarray, "moment camera 4 4"],
) -> Float[np.ndarray, "moment 4 4"]:
    """Of each moment the pose, as one camera has it, that fits the views of all cameras best."""
    problem = BoardProblem(sightings, [lens.kind for lens in lenses], np.ones(len(lenses)))
    numbers = np.stack([lens.numbers for lens in lenses])
    by_camera, errors = world_T_camera @ poses, np.full(poses.shape[:2], np.inf)
    for c in range(len(lenses)):
        known = np.isfinite(by_camera[:, c, 0, 0])
        boards = np.where(known[:, None, None], by_camera[:, c], np.eye(4))
        residual_px = problem.residual_px(BoardBundle.on_time(world_T_camera, numbers, boards))
        total = np.nansum(np.linalg.norm(residual_px, axis=-1), axis=(1, 2))
        errors[known, c] = total[known]
    return by_camera[np.arange(len(poses)), np.argmin(errors, axis=1)]
