"""Averages over the frames around each one in which a joint is seen by as many cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

AVERAGED_S = 0.3
"""About as long as the graph averages. Where a joint is first seen, or last, it averages less, which a second of frames
around would hide; of less, more samples are drawn."""
# Other frames count as so many: of the few that are alike, few samples are drawn.
_OTHERS = 5.0


@dataclass(frozen=True, eq=False)
class AlikeFrames:
    """Beside an occlusion, frames in which nobody sees a joint tell nothing of those in which all do: there the errors
    of detections do next to nothing, and motion does all."""

    known: Bool[np.ndarray, "frame slot"]
    n_views: Int[np.ndarray, "frame slot"]
    width: int
    """In frames."""
    inverse_root: Float[np.ndarray, "frame slot 3 3"]
    """Of the covariance of the graph, which knows each frame; 0 where not known."""

    @staticmethod
    def of(
        graph_m2: Float[np.ndarray, "frame slot 3 3"], n_views: Int[np.ndarray, "frame slot"], step_s: float
    ) -> AlikeFrames:
        """With the covariance of the graph; NaN = not known."""
        known = np.asarray(np.isfinite(graph_m2).all(axis=(-1, -2)))
        inverse_root = np.zeros_like(graph_m2)
        inverse_root[known] = np.linalg.inv(np.linalg.cholesky(graph_m2[known]))
        # Frames may be nanoseconds apart: to average more than there are tells nothing, and takes memory without bound.
        width = int(np.clip(int(AVERAGED_S / step_s), 1, 2 * len(known)))
        return AlikeFrames(known, n_views, width, inverse_root)

    def relative(self, covariance_m2: Float[np.ndarray, "frame slot 3 3"]) -> Float[np.ndarray, "frame slot 3 3"]:
        """The averaged covariance in the directions and units of that of the graph; 0 where not known."""
        return self.averaged(self.inverse_root @ covariance_m2 @ self.inverse_root.swapaxes(-1, -2))

    def averaged(self, values: Float[np.ndarray, "frame slot *more"]) -> Float[np.ndarray, "frame slot *more"]:
        """The same of any values; 0 where not known."""
        of_all, _ = self._mean(values, self.known)
        found = np.zeros_like(values)
        for n_views in np.unique(self.n_views[self.known]).tolist():
            alike = self.known & (self.n_views == n_views)
            own, n = self._mean(values, alike)
            found[alike] = ((n * own + _OTHERS * of_all) / (n + _OTHERS))[alike]
        return found

    def _mean(
        self, values: Float[np.ndarray, "frame slot *more"], counted: Bool[np.ndarray, "frame slot"]
    ) -> tuple[Float[np.ndarray, "frame slot *more"], Float[np.ndarray, "frame slot *#more"]]:
        """Over the frames that count, and how many they are."""
        from scipy.ndimage import uniform_filter1d

        share = uniform_filter1d(counted.astype(float), self.width, axis=0, mode="nearest")
        share = share.reshape(*share.shape, *(1,) * (values.ndim - 2))
        masked = np.where(counted.reshape(share.shape), values, 0.0)
        sums = uniform_filter1d(masked, self.width, axis=0, mode="nearest")
        return sums / np.maximum(share, 1e-9), self.width * share
