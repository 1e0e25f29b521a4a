"""Bone lengths learned while a recording is running."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence, concatenated
from fgpose.estimation.evidence.other_bones import other_bone, without_known
from fgpose.estimation.factors.prior import length_prior
from fgpose.estimation.noise import shared_errors
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.block_tridiagonal import blas_libraries, one_blas_thread
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


class RunningLengths:
    """The shared bone lengths of a sample of frames, spread over all of the recording so far: estimated with the joints
    of these frames, as the batch does.

    Medians of triangulated bones would not do. Errors of the joints make short bones longer, and hallucinated joints
    are at the end of bones of any length: with two occluded cameras they are wrong by 10 cm after four seconds.

    So that no update waits for all of it, each makes one step of the optimiser.

    Lengths that are known of the same person from before are a prior of these, until it is seen that they are somebody
    else's.
    """

    def __init__(self, skeleton: Skeleton, config: Config) -> None:
        self._skeleton, self._config = skeleton, config
        self.forget()
        blas_libraries()  # so that no update stops to load them

    def forget(self) -> None:
        """Begin anew: who comes may be somebody else."""
        self._sample: dict[float, Evidence] = {}  # by time, in the order of time
        self._step_s = _FIRST_STEP_S
        self._n_estimated = 0
        self._estimation: _Estimation | None = None  # while it goes on
        self._before = self.learned = BoneLengths.unknown(self._skeleton.n_lengths)
        """Of bones that have been complete."""
        self.other_bone: OtherBone | None = None
        """Why what was known from before is not used any more."""

    def know(self, before: BoneLengths) -> None:
        """Go on from what is known of the same person already."""
        self._before, self.learned = before, before.or_else(self.learned)
        self._n_estimated, self._estimation = 0, None

    def add(self, evidence: Evidence) -> None:
        """Take a frame, with what is known of its detections, if it is time for one."""
        is_wanted, time_s = self._config.symmetry.form == "shared_length", float(evidence.time_s[0])
        if not is_wanted or not self._is_due(time_s) or not self._knows_a_bone(evidence):
            return
        if len(self._sample) == _MOST_FRAMES:
            self._sample, self._step_s = dict([*self._sample.items()][::2]), 2 * self._step_s
            self._n_estimated = len(self._sample)
        self._sample[time_s] = evidence

    def revise(self, evidence: Evidence) -> None:
        """Take what is known of the detections of a frame by now, if it is one of the sample."""
        time_s = float(evidence.time_s[0])
        if time_s in self._sample:
            self._sample[time_s] = evidence

    def improve(self, rig: CameraRig) -> None:
        """The next step of an estimation that has begun; otherwise begin one if there is reason to. The rig is that of
        the evidence."""
        if self._estimation is None:
            self._estimation = self._begun(rig)
            return
        with one_blas_thread():
            if self._estimation.has_settled():
                self._take_lengths(self._estimation)
                self._estimation = None

    def have_changed(self, lengths_m: Float[np.ndarray, " length"]) -> bool:
        """Whether a length is new since these, or differs by more than a bone varies."""
        same = np.abs(self.learned.lengths_m - lengths_m) <= self._config.symmetry.sigma_m
        return bool((np.isfinite(self.learned.lengths_m) & ~same).any())

    def _is_due(self, time_s: float) -> bool:
        return not self._sample or time_s >= next(reversed(self._sample)) + self._step_s - TIME_ROUNDING_S

    def _knows_a_bone(self, evidence: Evidence) -> bool:
        return bool(np.isfinite(self._skeleton.bone_lengths(evidence.guess_m[0])).any())

    def _begun(self, rig: CameraRig) -> _Estimation | None:
        """Of the sample, if it has grown enough."""
        if not self._sample or len(self._sample) < _GROWTH * self._n_estimated:
            return None
        self._n_estimated = len(self._sample)
        sample = Segment.of_recording(concatenated([*self._sample.values()]), rig, self._skeleton, self._config)
        return _Estimation(sample, self._before)

    def _take_lengths(self, estimation: _Estimation) -> None:
        lengths_m, covariance_m2 = estimation.lengths_m, estimation.covariance_m2
        other = None
        if np.isfinite(self._before.lengths_m).any():
            seen = without_known(self._before, lengths_m, covariance_m2)
            other = other_bone(self._before, *seen, self._skeleton.length_names)
        if other is not None:
            self.know(BoneLengths.unknown(self._skeleton.n_lengths))
            self.other_bone = other
            return
        sigma_m = np.sqrt(np.diag(covariance_m2))
        known = (lengths_m > 0) & np.isfinite(sigma_m)
        self.learned = BoneLengths(np.where(known, lengths_m, np.nan), sigma_m).or_else(self.learned)


class _Estimation:
    """The optimisation of a sample of frames. It starts at its prior: what the first frames tell may be far off."""

    def __init__(self, sample: Segment, before: BoneLengths) -> None:
        self._inflation = shared_errors(sample.evidence.time_s)  # all deviations of the problem are too small by it
        guess = sample.lengths_m, sample.config.prior.length_sigma_m
        mean_m, _ = length_prior(sample.skeleton, before, *guess)
        self._problem = NormalEquations(replace(sample, known=before, lengths_m=mean_m))
        self._search = Search(self._problem, self._problem.initial())
        self._steps_left = _STEPS

    @property
    def lengths_m(self) -> Float[np.ndarray, " length"]:
        """NaN: not estimated."""
        return self._problem.lengths_m(self._search.state)

    @property
    def covariance_m2(self) -> Float[np.ndarray, "length length"]:
        return self._inflation**2 * self._problem.length_covariance_m2(self._search.state)

    def has_settled(self) -> bool:
        """After one more step; lengths settle long before the joints that are hardly seen."""
        size = self._search.descend()
        self._steps_left -= 1
        return size is None or size < self._problem.step_tolerance or not self._steps_left
