"""When cameras began, coarsely: at the right lag the board that two cameras see has one pose between them.

With wrong lags it has as many as there were places of the board. Each image counts by how far the board has moved since
the one before: a board that is held still says nothing of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from fgpose.calibration.board.board import Board
from fgpose.calibration.board.lenses import board_pose, fit_lens, held_lens
from fgpose.calibration.board.placing import NotLinkedError, strongest_tree
from fgpose.calibration.board.starts.tracks import BoardTrack
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import spread_evenly
from fgpose_factors.robust_statistics import known_median, weighted_median

# Poses of both cameras agree within this share of the distance to the board.
_AGREEMENT = 0.05
# Steps of the lag: in the coarsest one a board that is carried moves less than that; the finest is far below an image.
_STEPS_S = (0.1, 0.02, 0.004)
# Of the way of the board that both cameras saw, the share on which they must agree, and how much more than at any other
# lag, that is further away than this.
_LEAST_SHARE, _CLEARER, _BESIDE_S = 0.4, 2.0, 1.0
# The way on which they agree, as a share of the distance to the board: one hand's motion says nothing.
_LEAST_WAY = 0.7
LONGEST_GAP_S = 0.5
"""Images further apart do not say where the board was between them."""
_LENS_VIEWS = 30


@dataclass(frozen=True, eq=False)
class _Poses:
    """The board in the frame of one camera, over its own time."""

    time_s: Float[np.ndarray, " image"]
    camera_T_board: Float[np.ndarray, "image 4 4"]
    """NaN where it is not seen."""
    way: Float[np.ndarray, " image"]
    """That it has moved since the image before, as a share of its distance, turns included; 0 where that is unknown."""


@dataclass(frozen=True)
class _Lag:
    """By how much later the clock of the second camera of a pair began."""

    lag_s: float
    way: float
    """On which both agree, as of _Poses."""


def find_starts(
    tracks: Sequence[BoardTrack], board: Board, intrinsics: CameraRig | None = None
) -> Float[np.ndarray, " camera"]:
    """When each camera began after the first, seconds; to about a hundredth.

    Args:
        tracks: of each camera, all over its recording.
        board: which one.
        intrinsics: of the cameras; None: they are found from the tracks.

    Raises:
        ValueError: a camera sees the board too rarely.
        NotLinkedError: the motion that it sees agrees with that of no other, at any lag. The message names it.
    """
    poses = [
        _poses(track, board, None if intrinsics is None else intrinsics.subset([track.camera])) for track in tracks
    ]
    n = len(tracks)
    links, lags_s = np.zeros((n, n)), np.zeros((n, n))
    for a in range(n):
        for b in range(a + 1, n):
            lag = _lag(poses[a], poses[b])
            if lag is not None:
                links[a, b] = links[b, a] = lag.way
                lags_s[a, b], lags_s[b, a] = lag.lag_s, -lag.lag_s
    return _chained(links, lags_s, [track.camera for track in tracks])


def _chained(
    links: Float[np.ndarray, "camera camera"], lags_s: Float[np.ndarray, "camera camera"], names: Sequence[str]
) -> Float[np.ndarray, " camera"]:
    from scipy.sparse.csgraph import breadth_first_order

    order, before = breadth_first_order(strongest_tree(links), 0, directed=False)
    lost = [name for c, name in enumerate(names) if c not in order]
    if lost:
        raise NotLinkedError(
            f"camera {', '.join(lost)}: at no time lag does it see the board move as the others do; carry it about "
            "where two cameras see it at once, with turns, for ten seconds or more"
        )
    start_s = np.zeros(len(names))
    for c in order[1:].tolist():
        start_s[c] = start_s[before[c]] + lags_s[before[c], c]
    return start_s


def _poses(track: BoardTrack, board: Board, known: CameraRig | None) -> _Poses:
    """Raises ValueError if there are too few views."""
    sightings = track.of(board)
    sees = np.flatnonzero(sightings.shows_board[:, 0])
    few = sightings.of_camera(0)
    chosen = spread_evenly(len(few.time_s), _LENS_VIEWS)
    few = few.at_moments(chosen)
    lens = fit_lens(few) if known is None else held_lens(few, known.cameras[0])
    camera_T_board = np.full((len(track.time_s), 4, 4), np.nan)
    for t in sees.tolist():
        pose, error_px = board_pose(sightings, t, lens.numbers, lens.kind.model)
        # Of a plane seen from far away two poses are as good as each other.
        if np.isfinite(error_px):
            camera_T_board[t] = pose
    middle = board.points_m.mean(axis=0)
    middle_m = camera_T_board[:, :3, :3] @ middle + camera_T_board[:, :3, 3]
    # A turn moves a point as far ahead as the board is away.
    ahead_m = middle_m + known_median(middle_m[:, 2]) * camera_T_board[:, :3, 2]
    stepped = np.linalg.norm(np.diff(np.concatenate([middle_m, ahead_m], axis=1), axis=0), axis=1)
    is_near = np.diff(track.time_s) <= LONGEST_GAP_S
    share = np.where(is_near & np.isfinite(stepped), stepped / known_median(middle_m[:, 2]), 0.0)
    # More in one step is another pose of the plane, or another board.
    return _Poses(track.time_s, camera_T_board, np.append(0.0, np.where(share < 0.5, share, 0.0)))


def _lag(a: _Poses, b: _Poses) -> _Lag | None:
    """At which both agree on most of the way; None if no lag is clearly the best."""
    overlap_s = np.arange(-(b.time_s[-1] - a.time_s[0]), a.time_s[-1] - b.time_s[0], _STEPS_S[0])
    if not len(overlap_s):
        return None
    way, share = np.array([_agreement(a, b, lag_s) for lag_s in overlap_s.tolist()]).T
    score = way * share
    best = int(np.argmax(score))
    others = np.abs(overlap_s - overlap_s[best]) > _BESIDE_S
    if way[best] < _LEAST_WAY or share[best] < _LEAST_SHARE or score[best] < _CLEARER * score[others].max(initial=0.0):
        return None
    lag_s = float(overlap_s[best])
    for before_s, step_s in pairwise(_STEPS_S):
        near_s = lag_s + np.arange(-before_s, before_s + step_s / 2, step_s)
        lag_s = float(near_s[np.argmin([_spread(a, b, each_s) for each_s in near_s.tolist()])])
    return _Lag(lag_s, float(way[best]))


def _agreement(a: _Poses, b: _Poses, lag_s: float) -> tuple[float, float]:
    """The way on which both agree, and its share in the way that both saw."""
    apart, way = _apart(a, b, lag_s)
    if not len(way):
        return 0.0, 0.0
    agreed = float(way[apart < _AGREEMENT].sum())
    return agreed, agreed / float(way.sum())


def _spread(a: _Poses, b: _Poses, lag_s: float) -> float:
    """How far the poses between both are apart, on average over the way; what does not agree at all counts alike."""
    apart, way = _apart(a, b, lag_s)
    return float(np.average(np.minimum(apart, _AGREEMENT) ** 2, weights=way)) if len(way) else np.inf


def _apart(a: _Poses, b: _Poses, lag_s: float) -> tuple[Float[np.ndarray, " image"], Float[np.ndarray, " image"]]:
    """At the images of the first camera where both see the board: how far the pose of the second in the frame of the
    first is from the usual one, as a share of the distance, and the way of the board."""
    own_s = a.time_s - lag_s
    after = np.clip(np.searchsorted(b.time_s, own_s), 1, len(b.time_s) - 1)
    step_s = b.time_s[after] - b.time_s[after - 1]
    share = (own_s - b.time_s[after - 1]) / step_s
    inside = (share >= 0) & (share <= 1) & (step_s <= LONGEST_GAP_S) & np.isfinite(a.camera_T_board[:, 0, 0])
    of_b = np.full_like(a.camera_T_board, np.nan)
    weight = share[inside, None, None]
    of_b[inside] = (1 - weight) * b.camera_T_board[after - 1][inside] + weight * b.camera_T_board[after][inside]
    both = np.isfinite(of_b[:, 0, 0])
    way = a.way[both]
    if way.sum() == 0:
        return np.zeros(0), np.zeros(0)
    # The mean of two rotations is one, but for an error of second order.
    R = a.camera_T_board[both, :3, :3] @ of_b[both, :3, :3].swapaxes(1, 2)
    t_m = a.camera_T_board[both, :3, 3] - np.einsum("nij,nj->ni", R, of_b[both, :3, 3])
    distance_m = float(np.median(np.linalg.norm(a.camera_T_board[both, :3, 3], axis=1)))
    places = np.concatenate([t_m, t_m + distance_m * R[:, :, 2]], axis=1)
    usual = np.array([weighted_median(values, way) for values in places.T])
    return np.linalg.norm(places - usual, axis=1) / (np.sqrt(2) * distance_m), way
