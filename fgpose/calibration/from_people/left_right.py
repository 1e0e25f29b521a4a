"""Left and right of a body that one camera follows: a detector exchanges them for some images, a body does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.body_size import steady_radius
from fgpose.calibration.from_people.walk import Track
from fgpose.skeleton import Skeleton

# In radii of the body, as in tracks.py: how far a joint is from where it was in the image before.
_NEAR, _SPREAD_PER_S = 0.1, 1.0
# A joint that is farther away than three spreads is an outlier and says no more.
_MAX_SQUARE = 4.5
# Cost of a second with exchanged sides, in squared spreads. So of two ways to read a track that are equally steady, the
# one with fewer exchanged images counts, and nobody whose left and right coincide for a moment is turned for good.
_PER_S = 1.0


def with_steady_sides(track: Track, skeleton: Skeleton) -> Track:
    """The track with left and right exchanged in the images in which the detector had exchanged them.

    Two states in each image, as detected or exchanged; the most likely sequence (Viterbi), given how far the joints
    would jump and that most images are right.
    """
    exchanged = exchanged_images(track, skeleton)
    if not exchanged.any():
        return track

    def put_right(array: np.ndarray) -> np.ndarray:
        return np.where(exchanged.reshape(-1, *(1,) * (array.ndim - 1)), array[:, skeleton.mirror], array)

    points3d_m = None if track.points3d_m is None else put_right(track.points3d_m)
    confidence = put_right(track.confidence)
    return replace(track, points2d_px=put_right(track.points2d_px), confidence=confidence, points3d_m=points3d_m)


def exchanged_images(track: Track, skeleton: Skeleton) -> Bool[np.ndarray, " image"]:
    """Whether left and right of the body are exchanged in each image."""
    exchanged = np.zeros(len(track.time_s), dtype=bool)
    seen = np.flatnonzero(np.isfinite(track.points2d_px).all(axis=-1).any(axis=-1))
    if len(seen) < 2 or not skeleton.left_right:
        return exchanged
    time_s, points2d_px = track.time_s[seen], track.points2d_px[seen]
    spread_px = steady_radius(time_s, points2d_px)[1:] * (_NEAR + _SPREAD_PER_S * np.diff(time_s))
    stays, changes = _jumps(points2d_px, spread_px, skeleton)
    exchanged[seen] = _cheapest(stays, changes, _PER_S * np.gradient(time_s))
    return exchanged


def _jumps(
    points2d_px: Float[np.ndarray, "image joint 2"], spread_px: Float[np.ndarray, " step"], skeleton: Skeleton
) -> tuple[Float[np.ndarray, " step"], Float[np.ndarray, " step"]]:
    """Sums over the joints of the squared distances in spreads from image to image, each limited: as they are, and with
    left and right exchanged in the second of two images. Of pairs of joints that are known in both."""
    before_px, after_px = points2d_px[:-1], points2d_px[1:]
    left, right = np.array(skeleton.left_right).T
    sums = []
    for first, second in ((left, right), (right, left)):
        moved_px = np.stack([after_px[:, first] - before_px[:, left], after_px[:, second] - before_px[:, right]])
        square = np.sum(moved_px**2, axis=-1) / (2 * spread_px[:, None] ** 2)
        sums.append(np.minimum(square, _MAX_SQUARE).sum(axis=0))
    known = np.isfinite(sums).all(axis=0)
    stays, changes = (np.where(known, each, 0.0).sum(axis=-1) for each in sums)
    return stays, changes


def _cheapest(
    stays: Float[np.ndarray, " step"], changes: Float[np.ndarray, " step"], exchanged: Float[np.ndarray, " image"]
) -> Bool[np.ndarray, " image"]:
    """State of each image on the cheapest way: 0 as detected, 1 exchanged (which costs so much in each image)."""
    costs = np.array([0.0, exchanged[0]])
    came_from = np.zeros((len(exchanged), 2), dtype=int)
    for image, (stay, change) in enumerate(zip(stays.tolist(), changes.tolist(), strict=True), start=1):
        ways = costs[:, None] + np.array([[stay, change], [change, stay]])
        came_from[image] = ways.argmin(axis=0)
        costs = ways.min(axis=0) + np.array([0.0, exchanged[image]])
    state = np.zeros(len(exchanged), dtype=int)
    state[-1] = costs.argmin()
    for image in range(len(exchanged) - 1, 0, -1):
        state[image - 1] = came_from[image, state[image]]
    return state.astype(bool)
