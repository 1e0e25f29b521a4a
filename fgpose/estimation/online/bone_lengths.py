"""Bone lengths learned while a recording is running."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.covariances.length_effects import LengthEffects
from fgpose.estimation.covariances.variance_components import ErrorComponents
from fgpose.estimation.evidence.evidence import Evidence, concatenated
from fgpose.estimation.evidence.other_bones import other_bone, without_known
from fgpose.estimation.factors.prior import length_prior
from fgpose.estimation.noise import shared_errors
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.levenberg_marquardt import Search
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import TIME_ROUNDING_S
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import OtherBone

_FIRST_STEP_S = 0.05  # from one frame of the sample to the next, until it is full
_MOST_FRAMES = 32  # twice as many change the errors on the tuning clips of the benchmark by less than 1 %
_GROWTH = 1.25  # the lengths are estimated again when the sample has grown by this factor
_STEPS = 5
# The last frames tell a length with 7 mm. They contradict what was learned without reason in 0 of 88 comparisons with
# three of four cameras occluded, in 2 of 88 with two of two, whose errors stay the same, and in 0 of 29 of real ones.
_LAST_FRAMES, _LAST_STEP_S = 10, 0.1


class RunningLengths:
    """The shared bone lengths of a sample of frames, spread over all of the recording so far: estimated with the joints
    of these frames, as the batch does.

    Medians of triangulated bones would not do. Errors of the joints make short bones longer, and hallucinated joints
    are at the end of bones of any length: with two occluded cameras they are wrong by 10 cm after four seconds.

    So that no update waits for all of it, each makes one step of the optimiser.

    Lengths that are known of the same person from before are a prior of these, until it is seen that they are somebody
    else's. And once a second the last frames alone are looked at: if their bones are others than those that were
    learned, somebody else has come, or what was learned is of limbs that were hidden and guessed, and only the last
    frames count. Without that, lengths that were learned for a minute were believed for another one.
    """

    def __init__(self, skeleton: Skeleton, config: Config) -> None:
        self._skeleton, self._config = skeleton, config
        self.forget()

    def forget(self) -> None:
        """Begin anew: who comes may be somebody else."""
        self._sample: dict[float, Evidence] = {}  # by time, in the order of time
        self._last: dict[float, Evidence] = {}
        self._compared_s = -np.inf  # the newest of the last frames that were compared
        self._step_s = _FIRST_STEP_S
        self._n_estimated = 0
        self._estimation: _Estimation | None = None  # while it goes on
        self._before = self.learned = self.stated = BoneLengths.unknown(self._skeleton.n_lengths)
        """Of bones that have been complete: learned with the standard deviations by which the graph holds them and they
        are compared, for errors that last are in all of its frames; stated with those of all errors."""
        self.other_bone: OtherBone | None = None
        """Why what was known from before, or learned, is not used any more."""

    def know(self, before: BoneLengths) -> None:
        """Go on from what is known of the same person already."""
        self._before, self.learned = before, before.or_else(self.learned)
        self.stated = before.or_else(self.stated)
        self._n_estimated, self._estimation = 0, None

    def add(self, evidence: Evidence) -> None:
        """Take a frame, with what is known of its detections, if it is time for one."""
        is_wanted, time_s = self._config.symmetry.form == "shared_length", float(evidence.time_s[0])
        is_last, is_of_sample = _is_due(self._last, time_s, _LAST_STEP_S), _is_due(self._sample, time_s, self._step_s)
        if not is_wanted or not (is_last or is_of_sample) or not self._knows_a_bone(evidence):
            return
        if is_last:
            self._last = dict([*self._last.items()][1 - _LAST_FRAMES :]) | {time_s: evidence}
        if not is_of_sample:
            return
        if len(self._sample) == _MOST_FRAMES:
            self._sample, self._step_s = dict([*self._sample.items()][::2]), 2 * self._step_s
            self._n_estimated = len(self._sample)
        self._sample[time_s] = evidence

    def revise(self, evidence: Evidence) -> None:
        """Take what is known of the detections of frames by now, of those in the sample or among the last."""
        for number, time_s in enumerate(evidence.time_s.tolist()):
            for frames in (self._sample, self._last):
                if time_s in frames:
                    frames[time_s] = evidence.frames(slice(number, number + 1))

    def improve(self, rig: CameraRig, errors: ErrorComponents) -> None:
        """The next step of an estimation that has begun; otherwise begin one if there is reason to.

        Args:
            rig: that of the evidence.
            errors: of the detections of all joints, as far as they are known by now.
        """
        if self._estimation is None:
            self._estimation = self._begun(rig)
            return
        if self._estimation.has_settled():
            settled, self._estimation = self._estimation.estimated(errors), None
            (self._compare if settled.is_of_last else self._take)(settled)

    def have_changed(self, lengths_m: Float[np.ndarray, "*frames length"]) -> Bool[np.ndarray, "*frames"]:
        """Whether a length is new since these, or differs by more than a bone varies."""
        same = np.abs(self.learned.lengths_m - lengths_m) <= self._config.symmetry.sigma_m
        return np.asarray((np.isfinite(self.learned.lengths_m) & ~same).any(axis=-1))

    def _knows_a_bone(self, evidence: Evidence) -> bool:
        return bool(np.isfinite(self._skeleton.bone_lengths(evidence.guess_m[0])).any())

    def _begun(self, rig: CameraRig) -> _Estimation | None:
        """Of the sample, if it has grown enough; of the last frames, if all are new and the sample has others."""
        if self._sample and len(self._sample) >= _GROWTH * self._n_estimated:
            self._n_estimated = len(self._sample)
            return _Estimation(self._sample, self._before, rig, self._skeleton, self._config)
        if len(self._last) < _LAST_FRAMES or next(iter(self._last)) <= max(self._compared_s, next(iter(self._sample))):
            return None
        self._compared_s = next(reversed(self._last))
        unknown = BoneLengths.unknown(self._skeleton.n_lengths)
        return _Estimation(self._last, unknown, rig, self._skeleton, self._config, is_of_last=True)

    def _take(self, sample: _Estimated) -> None:
        other = None
        if np.isfinite(self._before.lengths_m).any():
            seen = without_known(self._before, sample.lengths_m, sample.covariance_m2, sample.in_graph_m2)
            other = other_bone(self._before, *seen, self._skeleton.length_names)
        if other is None:
            self.learned = sample.in_graph.or_else(self.learned)
            self.stated = sample.stated.or_else(self.stated)
        else:
            self.know(BoneLengths.unknown(self._skeleton.n_lengths))
            self.other_bone = other

    def _compare(self, last: _Estimated) -> None:
        """Begin anew with the last frames where their bones are others than those that were learned."""
        other = other_bone(self.learned, last.lengths_m, last.in_graph_m2, self._skeleton.length_names)
        if other is not None:
            self.know(BoneLengths.unknown(self._skeleton.n_lengths))
            self._sample, self._step_s, self._n_estimated = last.frames, _LAST_STEP_S, len(last.frames)
            self.learned, self.stated, self.other_bone = last.in_graph, last.stated, other


def _is_due(frames: dict[float, Evidence], time_s: float, step_s: float) -> bool:
    return not frames or time_s >= next(reversed(frames)) + step_s - TIME_ROUNDING_S


class _Estimation:
    """The optimisation of a sample of frames. It starts at its prior: what the first frames tell may be far off."""

    def __init__(
        self,
        frames: dict[float, Evidence],
        before: BoneLengths,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        *,
        is_of_last: bool = False,
    ) -> None:
        self.frames, self.is_of_last = dict(frames), is_of_last
        sample = Segment.of_recording(concatenated([*frames.values()]), rig, skeleton, config)
        guess = sample.lengths_m, config.prior.length_sigma_m
        mean_m, _ = length_prior(skeleton, before, *guess)
        self._sample = replace(sample, known=before, lengths_m=mean_m)
        self._problem = NormalEquations(self._sample)
        self._search = Search(self._problem, self._problem.initial())
        self._steps_left = _STEPS

    def has_settled(self) -> bool:
        """After one more step; lengths settle long before the joints that are hardly seen."""
        size = self._search.descend()
        self._steps_left -= 1
        return size is None or size < self._problem.step_tolerance or not self._steps_left

    def estimated(self, errors: ErrorComponents) -> _Estimated:
        """What it has found, if these are the errors of the detections of all joints."""
        sample, state = self._sample, self._search.state
        linearized = self._problem.linearized(self._problem.positions_m(state))
        effects = LengthEffects.of(linearized, sample.evidence.time_s, sample.evidence.bias_share[:, sample.joints])
        covariance_m2 = effects.of_rest_m2 + effects.covariance_m2(errors.of_joints(sample.joints))
        in_graph_m2 = shared_errors(sample.evidence.time_s) ** 2 * linearized.length_covariance_m2()
        return _Estimated(self.frames, self.is_of_last, self._problem.lengths_m(state), covariance_m2, in_graph_m2)


@dataclass(frozen=True, eq=False)
class _Estimated:
    """The lengths of a sample of frames."""

    frames: dict[float, Evidence]
    is_of_last: bool
    lengths_m: Float[np.ndarray, " length"]
    """NaN: not estimated."""
    covariance_m2: Float[np.ndarray, "length length"]
    in_graph_m2: Float[np.ndarray, "length length"]
    """The same if errors lasted as usual."""

    @property
    def stated(self) -> BoneLengths:
        return self._with(self.covariance_m2)

    @property
    def in_graph(self) -> BoneLengths:
        return self._with(self.in_graph_m2)

    def _with(self, covariance_m2: Float[np.ndarray, "length length"]) -> BoneLengths:
        is_known = self.lengths_m > 0
        return BoneLengths(np.where(is_known, self.lengths_m, np.nan), np.sqrt(np.diag(covariance_m2)))
