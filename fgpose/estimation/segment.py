"""A segment of a recording that is solved as one: what both forms of the optimisation problem are made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.initial_guess import kept_joints
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class Segment:
    """Frames, and what is known of them before they are solved."""

    rig: CameraRig
    skeleton: Skeleton
    config: Config
    evidence: Evidence
    """Of these frames; its first guess must be finite wherever a joint is active."""
    active: Bool[np.ndarray, "frame joint"]
    """Which joints take part in which frame."""
    lengths_m: Float[np.ndarray, " length"]
    """First guess of every shared bone length; NaN where a bone has none."""
    length_sigma_m: float
    """How well it is known."""
    process_density: Float[np.ndarray, "frame joint"]
    """Power spectral density of the noise of the motion factors that lead to each frame, m^2/s^3 with constant
    velocity, m^2/s with random walk."""

    @property
    def with_velocity(self) -> bool:
        """Whether a joint's velocity is unknown too, besides its position."""
        return self.config.motion.model == "constant_velocity"

    @cached_property
    def joints(self) -> Int[np.ndarray, " slot"]:
        """The joints that take part in some frame."""
        return np.flatnonzero(self.active.any(axis=0))

    @cached_property
    def kept(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether a motion factor leads to this joint from the frame before."""
        return kept_joints(self.active, self.config.motion)

    def present(self, *joints: int) -> Bool[np.ndarray, " frame"]:
        """Whether all of these joints take part."""
        return np.all(self.active[:, list(joints)], axis=1)

    def bones_with_length(self) -> Iterator[tuple[int, int, int]]:
        """Start, end and length of every bone that is complete in some frame and has a first guess of its length."""
        if self.config.symmetry.form == "shared_length":
            for (start, end), length in zip(self.skeleton.bones, self.skeleton.length_of_bone, strict=True):
                if np.isfinite(self.lengths_m[length]) and self.present(start, end).any():
                    yield start, end, length
