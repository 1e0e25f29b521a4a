"""The evidence of a long recording, made again where it is asked for: as a whole it takes more memory than the
observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config
from fgpose.estimation.evidence.corrected import Corrected
from fgpose.estimation.evidence.credibility import credible
from fgpose.estimation.evidence.delays import by_mean_clock
from fgpose.estimation.evidence.evidence import Evidence, concatenated
from fgpose.estimation.evidence.gather import FRAMES_AT_ONCE, gather, without, without_depths
from fgpose.estimation.evidence.image_checks.checks import checked
from fgpose.estimation.evidence.plausibility import Bodies
from fgpose.estimation.evidence.presence import present
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing
from fgpose.observations import Observations
from fgpose.sampling import parts_of

LONG_FRAMES = 20_000
"""With 17 joints and four cameras their evidence takes 50 MB."""
_KEPT_PARTS = 4


@dataclass(frozen=True, eq=False)
class Gathered:
    """What is needed of all frames at once, and what the evidence of some of them is made from."""

    time_s: Float[np.ndarray, " frame"]
    _guess_m: list[np.ndarray]
    """Until it is handed over; see hand_over_guess_m."""
    implausible: Bool[np.ndarray, " frame"]
    """See Evidence."""
    sides_exchanged: Bool[np.ndarray, "frame camera joint"]
    """See Evidence; of the parts that are made again it is not kept."""
    _seen: Bool[np.ndarray, "frame joint"]
    _located: Bool[np.ndarray, "frame joint"]
    _left_out: Bool[np.ndarray, " frame"]
    _is_doubted: Bool[np.ndarray, " frame"]
    """Frames with a joint that is not surely credible."""
    _credible: Float[np.ndarray, "doubted joint"]
    """Of these."""
    _observations: Observations | Corrected
    _rig: CameraRig
    """By the mean clock of the cameras."""
    _config: Config
    _joints: tuple[int, ...] | None = None
    """Of some joints of the observations alone; None: of all."""
    _held: tuple[int, np.ndarray, np.ndarray, bool] | None = None
    """What Evidence.held takes, of all frames."""
    _newest: dict[int, Evidence] = field(default_factory=dict, repr=False)
    """Parts by their first frame, of all joints: windows that overlap ask for the same."""

    @staticmethod
    def of(observations: Observations, rig: CameraRig, config: Config) -> Gathered:
        """As gather, of observations whose per-view 3D is not used."""
        observations.check_cameras(rig.names)
        refuse_changing(rig)
        observations, rig = by_mean_clock(observations, rig)
        (n_frames, _, n_joints), time_s = observations.confidence.shape, observations.frame_time_s
        guess_m, (implausible, left_out) = np.empty((n_frames, n_joints, 3)), np.zeros((2, n_frames), dtype=bool)
        seen, located = np.zeros((2, n_frames, n_joints), dtype=bool)
        said = credible(observations.confidence, time_s)
        none_exchanged = np.broadcast_to(np.False_, observations.confidence.shape)
        is_doubted = np.asarray((said != 1.0).any(axis=1))
        known = implausible, none_exchanged, seen, located, left_out, is_doubted, said[is_doubted]
        del said
        gathered = Gathered(time_s, [guess_m], *known, observations, rig, config)
        parts, of_parts = parts_of(n_frames, FRAMES_AT_ONCE), []
        for part in parts:
            learned = gathered._learn(part, guess_m)
            of_parts.append(Bodies.of(learned.guess_m, learned.n_views, learned.implausible, observations.skeleton))
        bodies = Bodies.of_all(of_parts)
        bodies.refuse_millimetres()
        if not bodies.are_mostly_implausible:
            gathered._left_out[:] = bodies.implausible
            for part in parts:
                if bodies.implausible[part].any():
                    gathered._learn(part, guess_m)
        return gathered

    def _learn(self, part: slice, guess_m: Float[np.ndarray, "frame joint 3"]) -> Evidence:
        """What is needed of all frames, of those of a part."""
        evidence = self._part(part)
        guess_m[part], self.implausible[part] = evidence.guess_m, evidence.implausible
        self._seen[part], self._located[part] = evidence.seen, evidence.located
        return evidence

    def _part(self, part: slice) -> Evidence:
        observations, left_out = self._observations.frames(part), self._left_out[part]
        evidence, _ = without_depths(observations, self._rig, self._config, self._credible_of(part))
        return without(evidence, observations, left_out, self._rig, self._config) if left_out.any() else evidence

    def _credible_of(self, part: slice) -> Float[np.ndarray, "frame joint"]:
        """See Evidence."""
        is_doubted = self._is_doubted[part]
        found = np.ones((len(is_doubted), self._credible.shape[1]))
        first = np.count_nonzero(self._is_doubted[: part.start])
        found[is_doubted] = self._credible[first : first + np.count_nonzero(is_doubted)]
        return found

    @property
    def guess_m(self) -> Float[np.ndarray, "frame joint 3"]:
        """First guesses; made again after they were handed over."""
        if self._guess_m:
            return self._guess_m[0]
        guess_m = np.empty((*self._seen.shape, 3))
        for part in parts_of(len(guess_m), FRAMES_AT_ONCE):
            guess_m[part] = self.frames(part).guess_m
        return guess_m

    def hand_over_guess_m(self) -> Float[np.ndarray, "frame joint 3"]:
        """The same, which is not kept here any more: the smoother asks for them once, and nobody else."""
        guess_m = self.guess_m
        self._guess_m.clear()
        return guess_m

    def frames(self, frames: slice | Bool[np.ndarray, " frame"] | Int[np.ndarray, " sample"]) -> Evidence:
        """The evidence of some frames, one at least, in the order of time. It is the same whichever are asked for
        together, as it is made in the same parts."""
        wanted = np.arange(len(self.time_s))[frames]
        of_part = wanted // FRAMES_AT_ONCE
        parts = []
        for start in (FRAMES_AT_ONCE * np.unique(of_part)).tolist():
            own = wanted[of_part == start // FRAMES_AT_ONCE]
            evidence = self._kept_part(start)
            parts.append((evidence if self._joints is None else evidence.joints(self._joints)).frames(own - start))
        found = concatenated(parts)
        if self._held is None:
            return found
        joint, at_m, covariance_m2, instead = self._held
        return found.held(joint, at_m[wanted], covariance_m2[wanted], instead=instead)

    def joints(self, joints: Sequence[int]) -> Gathered:
        """See Evidence.joints; of all joints of the observations."""
        own = list(joints)
        of_own = {"_guess_m": [self.guess_m[:, own]], "_seen": self._seen[:, own], "_located": self._located[:, own]}
        return replace(self, **of_own, sides_exchanged=self.sides_exchanged[:, :, own], _joints=tuple(own))

    def held(
        self,
        joint: int,
        at_m: Float[np.ndarray, "frame 3"],
        covariance_m2: Float[np.ndarray, "frame 3 3"],
        *,
        instead: bool = False,
    ) -> Gathered:
        """See Evidence.held."""
        guess_m, seen, located = self.guess_m.copy(), self._seen.copy(), self._located.copy()
        if instead:
            guess_m[:, joint], seen[:, joint], located[:, joint] = np.nan, False, False
        guess_m[:, joint] = np.where(np.isnan(guess_m[:, joint]), at_m, guess_m[:, joint])
        held = joint, at_m, covariance_m2, instead
        return replace(self, _guess_m=[guess_m], _seen=seen, _located=located, _held=held)

    def _kept_part(self, start: int) -> Evidence:
        if start not in self._newest:
            if len(self._newest) >= _KEPT_PARTS:
                del self._newest[next(iter(self._newest))]
            self._newest[start] = self._part(slice(start, start + FRAMES_AT_ONCE))
        return self._newest[start]

    @property
    def implausible_frames(self) -> tuple[int, ...]:
        return tuple(np.flatnonzero(self.implausible).tolist())

    def present(self, coast_s: float) -> Bool[np.ndarray, " frame"]:
        """See Evidence.present."""
        seen, located = (np.asarray(each.any(axis=1)) for each in (self._seen, self._located))
        return present(seen, located, self.time_s, coast_s)


def gather_long(observations: Observations, rig: CameraRig, config: Config) -> Evidence | Gathered:
    """As gather, without detections that are not of the person at their moment; of a long recording part by part, where
    it is needed."""
    corrected, flipped = checked(observations, rig)
    uses_depths = observations.points3d_m is not None and config.depth.use != "never"
    if observations.n_frames <= LONG_FRAMES or uses_depths:
        return replace(gather(corrected, rig, config), sides_exchanged=flipped)
    hand_back()
    gathered = Gathered.of(corrected, rig, config)
    # Those that were given stay in memory anyway.
    own = Corrected.of(by_mean_clock(observations, rig)[0], corrected)
    return replace(gathered, sides_exchanged=flipped, _observations=own)
