"""Detections that are those of the image before, to the last digit: the image came again, or a tracker held what it has
lost. They tell where a joint was and not where it is, for as long as they are held, and look like the best of all."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.observations import Observations

# On such a grid joints that stand still come again by chance. Networks give more digits.
_GRID_PX = 0.25
_MOST = 0.5  # of the detections of an image that is new


def without_repeats(observations: Observations) -> Observations:
    """A recording without what comes again in the next frame."""
    points_px = observations.points2d_px
    repeated = np.zeros(observations.confidence.shape, dtype=bool)
    repeated[1:] = _repeated(points_px[1:], points_px[:-1], np.zeros(observations.n_cameras, dtype=bool))[0]
    return observations.without(repeated)


class RunningRepeats:
    """What comes again, image by image.

    Args:
        n_cameras, n_joints: of the images.
    """

    def __init__(self, n_cameras: int, n_joints: int) -> None:
        self._before_px, self._is_new = np.full((1, n_cameras, n_joints, 2), np.nan), np.zeros(n_cameras, dtype=bool)

    def without(self, images: Observations) -> Observations:
        """The images, some of all cameras, without what is in the image before of the same camera."""
        return images.without(_repeated(images.points2d_px, self._before_px, self._is_new)[0])

    def add(self, images: Observations) -> None:
        """Take the images that the next ones come after."""
        came = images.seen[0].any(axis=-1)
        is_new = _repeated(images.points2d_px, self._before_px, self._is_new)[1][0]
        self._is_new = np.where(came, is_new, self._is_new)
        self._before_px = np.where(came[:, None, None], images.points2d_px, self._before_px)


def _repeated(
    points_px: Float[np.ndarray, "frame camera joint 2"],
    before_px: Float[np.ndarray, "frame camera joint 2"],
    was_new: Bool[np.ndarray, " camera"],
) -> tuple[Bool[np.ndarray, "frame camera joint"], Bool[np.ndarray, "frame camera"]]:
    """Which detections come again, and which images are new. None comes again where nothing else in the frame moves, as
    where detections have no noise and somebody stands still.

    Args:
        points_px: detections.
        before_px: those of the image before.
        was_new: for each camera that has no image in a frame, whether its last one was new.
    """
    same = np.asarray((points_px == before_px).all(axis=-1))
    n_seen = np.isfinite(points_px).all(axis=-1).sum(axis=-1)
    is_new = np.where(n_seen > 0, same.sum(axis=-1) < _MOST * n_seen, was_new)
    same &= np.asarray(is_new.any(axis=-1))[:, None, None]
    in_grid = points_px[same] / _GRID_PX
    same[same] = (in_grid != np.round(in_grid)).any(axis=-1)
    return same, is_new
