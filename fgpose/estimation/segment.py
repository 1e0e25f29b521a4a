"""A segment of a recording that is solved as one: what the factors are made from; and the recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gathered import Gathered
from fgpose.estimation.initial_guess import active_joints, fill_gaps, median_lengths
from fgpose.estimation.keys import Keys
from fgpose.estimation.process_noise import initial_density
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import BoneLengths, Skeleton


@dataclass(frozen=True)
class FrameTime:
    """A frame's number and time."""

    frame: int
    time_s: float


@dataclass(frozen=True, eq=False)
class Predecessor:
    """The frame before a segment. Its variables are in the graph already; factors of the first frame may join them."""

    time_s: float
    active: Bool[np.ndarray, " joint"]


@dataclass(frozen=True, eq=False)
class LinkageBlocks:
    """A matrix of the unknowns of all joints in a frame: its blocks within each of the skeleton's linkages, whose
    unknowns are ordered by joint, axis and kind."""

    linkages: tuple[tuple[int, ...], ...]
    blocks: tuple[Float[np.ndarray, "_ _"], ...]

    def times(self, unknowns: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """The product with a vector of the unknowns, linkage by linkage; nothing is between them."""
        product, first = np.empty_like(unknowns), 0
        for block in self.blocks:
            own = slice(first, first := first + len(block))
            np.matmul(block, unknowns[own], out=product[own])
        return product

    def of_positions(self) -> Float[np.ndarray, "joint 3 3"]:
        """Of each position alone."""
        of_positions = np.empty((sum(len(joints) for joints in self.linkages), 3, 3))
        for joints, block in zip(map(list, self.linkages), self.blocks, strict=True):
            of_positions[joints] = position_blocks(block, len(joints))
        return of_positions


def position_blocks(matrix: Float[np.ndarray, "unknown unknown"], n_joints: int) -> Float[np.ndarray, "joint 3 3"]:
    """Of each position alone, in a matrix of the unknowns of a frame."""
    n_kinds = len(matrix) // (3 * n_joints) if n_joints else 1
    return np.einsum("jajb->jab", matrix[::n_kinds, ::n_kinds].reshape(n_joints, 3, n_joints, 3))


@dataclass(frozen=True, eq=False)
class Marginal:
    """What the frames before a segment tell about the joints that motion links to its first frame: a quadratic cost of
    the unknowns of all joints of the skeleton; zero for those that are not linked."""

    information: LinkageBlocks
    gradient: Float[np.ndarray, "kind joint 3"]
    """At `around`."""
    around: Float[np.ndarray, "kind joint 3"]


@dataclass(frozen=True, eq=False)
class Segment:
    """Frames with everything that is known before they are solved: many frames (batch), or the newest one (online)."""

    rig: CameraRig
    skeleton: Skeleton
    config: Config
    evidence: Evidence
    """Of these frames."""
    active: Bool[np.ndarray, "frame joint"]
    """Which joints are estimated in which frame."""
    lengths_m: Float[np.ndarray, " length"]
    """First guess of every shared bone length; NaN where a bone has none."""
    process_density: Float[np.ndarray, "frame joint"]
    """Power spectral density of the noise of the motion factors that lead to each frame, m^2/s^3 with constant
    velocity, m^2/s with random walk."""
    known: BoneLengths | None = None
    """What was known of the lengths before."""
    lengths_known: bool = False
    """Whether the lengths are held at what was known, its sigma added to that of each bone (online); otherwise they are
    estimated."""
    initial_m: Float[np.ndarray, "frame joint 3"] | None = None
    """First guess of the joints and mean of the weak priors, if not the guess of the evidence."""
    before: Predecessor | None = None
    """The vectorised solver knows it by its marginal only."""
    marginal: Marginal | None = None
    """Of the predecessor and all frames before it."""
    linked: Bool[np.ndarray, "frame joint"] | None = None
    """Which joints motion may link to the frame before; None: all that are estimated in both."""
    first_frame: int = 0
    """Number of the first frame in the graph; that of the predecessor is one less."""

    @staticmethod
    def of_recording(evidence: Evidence, rig: CameraRig, skeleton: Skeleton, config: Config) -> Segment:
        """A whole recording, with what its first guess tells."""
        return Recording.of(evidence, np.arange(len(evidence.time_s)), rig, skeleton, config).frames(slice(None))

    @property
    def n_frames(self) -> int:
        return len(self.active)

    def frames(self, frames: slice | np.ndarray) -> Segment:
        """Some of the frames of a recording."""
        return replace(
            self,
            evidence=self.evidence.frames(frames),
            active=self.active[frames],
            process_density=self.process_density[frames],
        )

    @property
    def n_lengths(self) -> int:
        """How many shared lengths are unknown, with those that no bone has; none where all are held."""
        return 0 if self.lengths_known else self.skeleton.n_lengths

    @property
    def with_velocity(self) -> bool:
        """Whether a joint's velocity is unknown too, besides its position."""
        return self.config.motion.model == "constant_velocity"

    @cached_property
    def joints(self) -> Int[np.ndarray, " slot"]:
        """The joints that are estimated in some frame. The factors number them by their slots."""
        return np.flatnonzero(self.active.any(axis=0))

    @cached_property
    def slots(self) -> Int[np.ndarray, " joint"]:
        """Slot of each joint; -1 if it is estimated in no frame."""
        slots = np.full(self.skeleton.n_joints, -1)
        slots[self.joints] = np.arange(len(self.joints))
        return slots

    @cached_property
    def linkages(self) -> tuple[Int[np.ndarray, " own"], ...]:
        """The slots of each of the skeleton's linkages, of those of its joints that are estimated in some frame. Only
        lengths have to do with joints of several."""
        slots = [self.slots[list(joints)] for joints in self.skeleton.linkages]
        return tuple(of_linkage[of_linkage >= 0] for of_linkage in slots)

    @cached_property
    def keys(self) -> Keys:
        return Keys(tuple(self.joints.tolist()), self.first_frame)

    @property
    def start_m(self) -> Float[np.ndarray, "frame joint 3"]:
        """Where the joints start; finite where they are active."""
        return self.evidence.guess_m if self.initial_m is None else self.initial_m

    @cached_property
    def step_s(self) -> Float[np.ndarray, " frame"]:
        """Time since the frame before; inf for the first frame, unless it has a predecessor."""
        return np.diff(self.evidence.time_s, prepend=-np.inf if self.before is None else self.before.time_s)

    @cached_property
    def kept(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether a motion factor leads to this joint from the frame before; an active joint that is not kept enters
        the graph."""
        kept = np.zeros_like(self.active)
        if self.config.motion.model != "none":
            kept[1:] = self.active[1:] & self.active[:-1]
            if self.before is not None:
                kept[0] = self.active[0] & self.before.active
        return kept if self.linked is None else kept & self.linked

    @cached_property
    def bones(self) -> Int[np.ndarray, "3 bone"]:
        """Start, end and length of every bone that is complete in some frame and has a first guess of its length."""
        if self.config.symmetry.form != "shared_length":
            return np.zeros((3, 0), dtype=int)
        start, end = self.skeleton.bone_ends
        length = np.array(self.skeleton.length_of_bone, dtype=int)
        complete = (self.active[:, start] & self.active[:, end]).any(axis=0)
        return np.stack([start, end, length])[:, complete & np.isfinite(self.lengths_m[length])]

    @cached_property
    def estimated_lengths(self) -> Int[np.ndarray, " estimated"]:
        """The shared lengths that are variables."""
        return np.zeros(0, dtype=int) if self.lengths_known else np.unique(self.bones[2])


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames in which somebody is there, with what is known of all of them before any is solved."""

    rig: CameraRig
    skeleton: Skeleton
    config: Config
    evidence: Evidence | Gathered
    """Of more frames."""
    here: Int[np.ndarray, " frame"]
    """Which of them are those of the recording."""
    time_s: Float[np.ndarray, " frame"]
    guess_m: Float[np.ndarray, "frame joint 3"] | None
    """First guess, also where there is none of the frame alone; None: everything is solved, and it is not needed."""
    active: Bool[np.ndarray, "frame joint"]
    lengths_m: Float[np.ndarray, " length"]
    known: BoneLengths | None = None
    """What was known of them before."""

    @staticmethod
    def of(
        evidence: Evidence | Gathered,
        here: Int[np.ndarray, " frame"],
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        known: BoneLengths | None = None,
    ) -> Recording:
        """With what the first guess tells."""
        known_m = evidence.hand_over_guess_m() if isinstance(evidence, Gathered) else evidence.guess_m
        time_s, of_frames_m = evidence.time_s[here], known_m[here]
        guess_m = fill_gaps(of_frames_m, time_s)
        active = active_joints(of_frames_m, time_s, config.motion)
        lengths_m = median_lengths(skeleton, guess_m)
        return Recording(rig, skeleton, config, evidence, here, time_s, guess_m, active, lengths_m, known)

    @property
    def n_frames(self) -> int:
        return len(self.here)

    def evidence_of(self, frames: slice | Int[np.ndarray, " sample"]) -> Evidence:
        """Of some of its frames."""
        evidence = self.evidence.frames(self.here[frames])
        return evidence if self.guess_m is None else replace(evidence, guess_m=self.guess_m[frames])

    def frames(self, frames: slice | Int[np.ndarray, " sample"]) -> Segment:
        """Some of its frames, to be solved as one."""
        active = self.active[frames]
        return Segment(
            rig=self.rig,
            skeleton=self.skeleton,
            config=self.config,
            evidence=self.evidence_of(frames),
            active=active,
            lengths_m=self.lengths_m,
            known=self.known,
            process_density=np.full(active.shape, initial_density(self.config.motion)),
        )
