"""What the cameras saw in the frames that are used, and from which side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class Sightings:
    """The detections in the frames that are used; those of several people one after the other."""

    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    """With the lenses that the rig has, at the times of their frames as offsets_s say; NaN = missing."""
    weights: Float[np.ndarray, "frame camera joint"]
    """Information of each relative to a good detection with independent errors; 0: not used."""
    velocity_pxps: Float[np.ndarray, "frame camera joint 2"]
    """Of the joints in the images; zero where it is not known, or clocks are held."""
    offsets_s: Float[np.ndarray, " camera"]
    """Changes of the clocks that are accounted for in undistorted_px."""

    @staticmethod
    def on_time(
        undistorted_px: Float[np.ndarray, "frame camera joint 2"], weights: Float[np.ndarray, "frame camera joint"]
    ) -> Sightings:
        """Where clocks are held."""
        return Sightings(undistorted_px, weights, np.zeros_like(undistorted_px), np.zeros(weights.shape[1]))

    @staticmethod
    def together(people: Sequence[Sightings]) -> Sightings:
        """Those of several people; the cameras' clocks are the same."""
        names = ("undistorted_px", "weights", "velocity_pxps")
        arrays = {name: np.concatenate([getattr(own, name) for own in people]) for name in names}
        return Sightings(**arrays, offsets_s=people[0].offsets_s)

    def only(self, known: Bool[np.ndarray, "frame joint"]) -> Sightings:
        """Without the detections of joints that are not known."""
        return replace(self, weights=np.where(known[:, None], self.weights, 0.0))

    @property
    def measured_px(self) -> Float[np.ndarray, "frame camera joint 2"]:
        """Undistorted; NaN = not used."""
        return np.where(self.weights[..., None] > 0, self.undistorted_px, np.nan)


@dataclass(frozen=True, eq=False)
class SeenFrom:
    """How cameras stand to the body in each frame: a detector errs alike from one sector of directions."""

    sector: Float[np.ndarray, "frame camera sector"]
    """1 for the one in which the camera stands, 0 for the others; without sectors there are no biases."""
    axes: Float[np.ndarray, "camera 2 2"]
    """Of the image, in columns, with respect to the body: to its right and down."""

    @staticmethod
    def anywhere(n_frames: int, n_cameras: int) -> SeenFrom:
        """Where nothing is known of it."""
        return SeenFrom(np.zeros((n_frames, n_cameras, 0)), np.tile(np.eye(2), (n_cameras, 1, 1)))
