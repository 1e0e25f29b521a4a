"""The last images of each view, and the line on which its body moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

# A line through so many images errs less than one detection; somebody who walks leaves it within a step.
_N_IMAGES, RECENT_S = 4, 0.3


@dataclass(frozen=True, eq=False)
class RecentImages:
    """The last images of each view in which anything is detected, the newest last."""

    points_px: Float[np.ndarray, "image camera joint 2"]
    """Undistorted; NaN where nothing is detected."""
    time_s: Float[np.ndarray, "image camera"]
    """When they were taken; -inf: there was none."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> RecentImages:
        """Before the first image."""
        points_px = np.full((_N_IMAGES, n_cameras, n_joints, 2), np.nan)
        return RecentImages(points_px, np.full((_N_IMAGES, n_cameras), -np.inf))

    @property
    def newest_s(self) -> Float[np.ndarray, " camera"]:
        """When the last image of each view was taken."""
        return self.time_s[-1]

    def expected_px(self, time_s: float) -> Float[np.ndarray, "camera joint 2"]:
        """Where each joint is at this time if it goes on along a line, of the images of RECENT_S before; NaN: there are
        fewer than two."""
        passed_s = np.where(self.time_s >= time_s - RECENT_S, self.time_s - time_s, np.nan)
        passed_s = np.where(np.isnan(self.points_px), np.nan, passed_s[..., None, None])
        known = np.isfinite(passed_s)
        t, x = np.where(known, passed_s, 0.0), np.where(known, self.points_px, 0.0)
        n, t1, t2, x1, tx = known.sum(axis=0), t.sum(axis=0), (t * t).sum(axis=0), x.sum(axis=0), (t * x).sum(axis=0)
        determinant, nowhere_px = n * t2 - t1 * t1, np.full(t1.shape, np.nan)
        return np.divide(t2 * x1 - t1 * tx, determinant, out=nowhere_px, where=determinant > 0)

    def plus(
        self, points_px: Float[np.ndarray, "camera joint 2"], shows: Bool[np.ndarray, " camera"], time_s: float
    ) -> RecentImages:
        """With the images of those views that show anything."""
        moved_px = np.concatenate((self.points_px[1:], points_px[None]))
        moved_s = np.concatenate((self.time_s[1:], np.full((1, len(shows)), time_s)))
        return RecentImages(
            np.where(shows[:, None, None], moved_px, self.points_px), np.where(shows, moved_s, self.time_s)
        )
