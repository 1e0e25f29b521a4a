"""Frames of a recording that are solved as one: what both forms of the optimisation problem are made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.initial_guess import active_joints, fill_gaps, kept_joints, median_lengths
from fgpose.estimation.process_noise import initial_density
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

    @staticmethod
    def of_recording(evidence: Evidence, rig: CameraRig, skeleton: Skeleton, config: Config) -> Segment:
        """A whole recording, with what its first guess tells."""
        active = active_joints(evidence.guess_m, evidence.time_s, config.motion)
        guess_m = fill_gaps(evidence.guess_m, evidence.time_s)
        return Segment(
            rig=rig,
            skeleton=skeleton,
            config=config,
            evidence=replace(evidence, guess_m=guess_m),
            active=active,
            lengths_m=median_lengths(skeleton, guess_m),
            length_sigma_m=config.prior.length_sigma_m,
            process_density=np.full(active.shape, initial_density(config.motion)),
        )

    @property
    def n_frames(self) -> int:
        return len(self.active)

    def frames(self, frames: slice | np.ndarray) -> Segment:
        """Some of the frames."""
        return replace(
            self,
            evidence=self.evidence.frames(frames),
            active=self.active[frames],
            process_density=self.process_density[frames],
        )

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
