"""The online estimator of a body without hands and face, or of one of these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.estimates import Estimates
from fgpose.estimation.evidence.credibility import RunningCredibility
from fgpose.estimation.evidence.evidence import Evidence, concatenated
from fgpose.estimation.evidence.gather import gather_frame
from fgpose.estimation.evidence.images import corrected, fits_better
from fgpose.estimation.evidence.plausibility import Bodies, RunningPlausibility
from fgpose.estimation.evidence.presence import Returns
from fgpose.estimation.factors.fading import maybe_unseen, with_references
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.arrivals import Arrivals, with_image
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.online.prediction import Prediction
from fgpose.estimation.online.window import Window
from fgpose.estimation.online.window_solver import REVISED_S
from fgpose.estimation.parts.holder import Holder
from fgpose.estimation.solvers.block_tridiagonal import blas_libraries, one_blas_thread
from fgpose.estimation.visibility.running_visibility import Filtered, RunningVisibility
from fgpose.estimation.visibility.sole_views import RunningSoleViews
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import TIME_ROUNDING_S
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import Estimate

_GOES_ON_S = 0.2  # velocities change within half a step
_APPLY_OFFSETS_S = 0.5  # a new rig costs a millisecond, and offsets change slowly
# The factors of a joint are replaced when the share of its weight that a detection should have has changed by this; at
# twice as much, the mean errors on the tuning clips are 1 to 2 % larger.
_CHANGED_SHARE = 0.15


class PartEstimator:
    """What Estimator is to a whole body, for joints that are estimated together.

    Args:
        rig, skeleton, config, offsets: as of Estimator.
        holder: of a hand or a face, what says where it hangs.
        is_one_person: whoever comes back is the same one.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        offsets: RunningOffsets | None = None,
        holder: Holder | None = None,
        *,
        is_one_person: bool = False,
    ) -> None:
        self.rig, self.skeleton, self.config, self._holder = rig, skeleton, config, holder
        # The time of a frame is by the mean clock, as in the batch (by_mean_clock): only what leaves has the true time.
        self._late_s, self._rig = rig.common_offset_s, rig.without_common_offset()
        self._lengths = RunningLengths(skeleton, self.config)
        self._window = Window(self._lengths, self.config)
        self._visibility = RunningVisibility(rig.n_cameras, skeleton, self.config)
        self._sole_views = RunningSoleViews(skeleton)
        learned = self._lengths, self._visibility, self._sole_views
        self._prediction = Prediction(skeleton.n_joints, *learned, self.config)
        self._estimates = Estimates(rig.n_cameras, skeleton, self.config, self._lengths, self._late_s)
        self._offsets = offsets or RunningOffsets(rig, self.config)
        blas_libraries()  # so that no update stops to load them
        self._offsets_applied_s = -np.inf
        self._revised_s = -np.inf
        self._is_tidy = True
        self._left: list[FrameState] = []
        """Frames that have left the window, and were not learned from yet."""
        self._returns = None if is_one_person else Returns()
        self._arrivals = Arrivals(rig.names, warns=holder is None)
        self._plausibility = RunningPlausibility()
        self._credibility = RunningCredibility(rig.n_cameras, skeleton.n_joints)

    @property
    def rig_with_offsets(self) -> CameraRig:
        """The rig with the time offsets learned so far; as it was given unless online.estimate_time_offsets."""
        return self._rig.with_time_offsets(self._rig.time_offsets_s + self._late_s) if self._late_s else self._rig

    @property
    def newest(self) -> Estimate | None:
        """The pose of the newest frame, as the last update gave it; None: there was none."""
        with one_blas_thread():
            return self._estimates.newest(self._window, self._rig) if len(self._window) else None

    @property
    def n_implausible(self) -> int:
        """In how many frames what was detected makes no body; those are left out, see Estimate.is_implausible."""
        return self._plausibility.n_implausible

    @property
    def repairs(self) -> int:
        """How often GTSAM failed and the window was eliminated anew; updates are slower for a while after that."""
        return self._window.repairs

    @property
    def newest_s(self) -> float:
        """Time of the newest frame, by the mean clock; -inf before the first."""
        return self._window[-1].at.time_s if len(self._window) else -np.inf

    @property
    def newest_images_s(self) -> Float[np.ndarray, " camera"]:
        """When each camera took its image of the newest frame; NaN: it has not come."""
        return self._window[-1].image_time_s

    @property
    def usual_step_s(self) -> float:
        """From one image of a camera to its next; 0 until a camera has given two."""
        return self._arrivals.pace.usual_step_s

    @property
    def offsets(self) -> RunningOffsets:
        """What is learned of the cameras' time offsets, to be shared."""
        return self._offsets

    def expected_m(self, time_s: float) -> Float[np.ndarray, "joint 3"]:
        """Where the joints of the newest frame are a moment later, by their velocities; world frame, NaN: there is no
        frame. After _GOES_ON_S they stay."""
        if not len(self._window):
            return np.full((self.skeleton.n_joints, 3), np.nan)
        newest = self._window[-1]
        passed_s = float(np.clip(time_s - newest.at.time_s, 0.0, _GOES_ON_S))
        return np.where(newest.active[:, None], newest.carried_on_m(passed_s), np.nan)

    def know(self, lengths: BoneLengths) -> None:
        """See Estimator."""
        self._lengths.know(lengths)

    def take(self, images: Observations, taken_s: Float[np.ndarray, " camera"]) -> Estimate:
        """Take images of all cameras of the rig that were taken at these times (NaN: there is none): of a new frame, or
        the image of one camera alone. Raises ValueError as Estimator.update and Estimator.update_camera."""
        with one_blas_thread():
            return (self._take_alone if np.isfinite(taken_s).sum() == 1 else self._begin)(images, taken_s)

    def tidy(self) -> None:
        """See Estimator."""
        if self._is_tidy:
            return
        with one_blas_thread():
            self._learn()
            changes = self._revised()
            if changes:
                self._window.change(changes, self._rig)
        self._is_tidy = True

    def _take_alone(self, image: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """The image of the one camera that has a time. Raises ValueError as Estimator.update_camera."""
        is_own = np.isfinite(image_time_s)
        number = int(np.argmax(is_own))
        frames_s = self._window.times_s
        images_s = np.array([state.image_time_s for state in self._window]).reshape(-1, self.rig.n_cameras)
        at = self._arrivals.frame_of(number, float(image_time_s[number]), frames_s, images_s)
        return self._begin(image, image_time_s) if at is None else self._join(at, image, is_own)

    def _begin(self, frame: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """A new frame, later than all others. Images of the one before that come later are too late to learn from.
        Raises ValueError as Estimator.update."""
        gathered, _ = self._gathered(frame, frame)
        self._arrivals.took(image_time_s)
        if not self._is_tidy:
            self._learn()
        self._meet(gathered)
        before = self._window[-1] if len(self._window) else None
        state = self._prediction.frame(before, frame, gathered, image_time_s, self._rig)
        # In one update with the new frame, which costs less than one of its own.
        changes = {} if self._is_tidy else self._revised()
        self._is_tidy = False
        self._window.add(state, self._rig, changes)
        self._judge()
        self._estimates.take_lagged(self._window, self._rig)
        for oldest in self._window.marginalise():
            self._left.append(oldest)
            self._estimates.take_lagged(self._window, self._rig)
        return self._estimates.newest(self._window, self._rig)

    def _meet(self, gathered: Evidence) -> None:
        """Whoever the newest frame shows."""
        if self._returns is not None and self._returns.is_one(gathered.detected[0], float(gathered.time_s[0])):
            self._lengths.forget()

    def _gathered(self, frame: Observations, new: Observations) -> tuple[Evidence, Bodies]:
        """Of a frame, of which some images are new. Raises ValueError as Estimator.update."""
        credibility = self._credibility.plus(new.confidence, float(new.frame_time_s[0]))
        credible, may_leave_out = credibility.credible(frame.confidence), self._plausibility.may_leave_out
        gathered, bodies = gather_frame(frame, self._rig, self.config, credible, may_leave_out=may_leave_out)
        if self._holder is not None:
            gathered = self._holder.held(gathered, is_new=frame is new)
        if frame is new:
            self._plausibility.count(bodies)
        self._credibility = credibility
        return gathered, bodies

    def _join(self, at: int, image: Observations, is_own: Bool[np.ndarray, " camera"]) -> Estimate:
        """Another image of a frame in the window: the evidence of the frame is gathered and weighted again."""
        state, is_newest = self._window.read(at), at == len(self._window) - 1
        observations = with_image(state.observations, image, is_own)
        image_time_s = np.where(is_own, image.frame_time_s[0], state.image_time_s)
        gathered, bodies = self._gathered(observations, image)
        self._arrivals.took(np.where(is_own, image_time_s, np.nan))
        if is_newest:
            self._meet(gathered)
        if gathered.implausible[0] and not state.evidence.implausible[0]:
            self._plausibility.count(bodies)
            return replace(self._estimates.newest(self._window, self._rig), is_implausible=True)
        delay_s = np.nan_to_num(image_time_s - state.at.time_s) + self._rig.time_offsets_s
        gathered = changed(gathered, time_s=np.array([state.at.time_s]), delay_s=delay_s[None])
        gathered = corrected(gathered, state.positions_m, state.velocities_mps, self._visibility.bias, self._rig)
        pose = state.positions_m, self._rig
        if is_newest:
            evidence = self._visibility.predicted(gathered, *pose)
            gathered, evidence = self._sole_views.with_distances(gathered, evidence, *pose)
        else:
            filtered = self._filtered(state), self._filtered(self._window.before(at))
            evidence = self._visibility.with_image(is_own, *filtered, state.evidence, gathered, *pose)
        entering = evidence.located[0] & ~state.active & is_newest
        state = state.joined(observations, image_time_s, gathered, evidence, entering)
        self._window.join(at, state, self._rig, entering)
        self._move(at)
        if is_newest:
            self._judge()
        else:
            self._prediction.note(state)
            self._window.read(-1)
        return self._estimates.newest(self._window, self._rig)

    def _move(self, at: int) -> None:
        """Move joints to their present triangulation, if that fits the images better. The robust kernels would keep
        them at the position that the first images gave."""
        state = self._window[at]
        guess_m = state.evidence.guess_m[0]
        better = fits_better(guess_m, state.positions_m, state.evidence, self._rig, self.config.projection)
        # Two views that agree by chance are contradicted by the next image.
        is_sure = (state.evidence.n_views[0] >= 3) | np.isfinite(state.image_time_s).all()
        is_far = norm(guess_m - state.positions_m) > self.config.online.relinearize_m
        moved = np.flatnonzero(state.active & is_sure & better & is_far).tolist()
        if moved:
            self._window.move(at, moved, guess_m, self._rig)

    def _judge(self) -> None:
        """Judge the detections of the newest frame."""
        newest = self._window[-1]
        has_image = np.isfinite(newest.image_time_s)
        # What was given up is found again where its detections fit each other.
        positions_m = np.where(newest.active[:, None], newest.positions_m, newest.evidence.guess_m[0])
        self._visibility.add(positions_m, newest.velocities_mps, newest.as_gathered, self._rig, has_image)
        self._window[-1] = newest.judged(self._visibility.probability)
        self._prediction.note(self._window[-1])

    def _revised(self) -> dict[int, FrameState]:
        """Weight the detections of the last frames by what their present poses tell, as the batch does: an update that
        accepted a hallucination takes it back. And give new lengths to their bones.

        Returns:
            The frames that change; see WindowGraph.
        """
        now_s, every_s = self._window[-1].at.time_s, min(self._window.revised_every_s, self.config.online.lag_s / 2)
        is_due = now_s >= self._revised_s + every_s - TIME_ROUNDING_S
        if not is_due and not self._lengths.have_changed(self._window[-1].lengths_m):
            return {}
        self._revised_s = now_s
        first = int(np.sum(self._window.times_s < now_s - REVISED_S))
        frames = [self._window.read(at) for at in range(first, len(self._window))]
        poses = np.stack([state.positions_m for state in frames]), np.stack([state.velocities_mps for state in frames])
        gathered = concatenated([state.as_gathered for state in frames])
        before = self._filtered(self._window.before(first))
        known, filtered = self._visibility.judged(gathered, *poses, self._rig, before)
        self._lengths.revise(known)
        new_lengths = self._lengths.have_changed(np.stack([state.lengths_m for state in frames]))
        share = np.abs(known.weights - np.concatenate([state.evidence.weights for state in frames])) / gathered.weights
        differs = new_lengths[:, None] | (known.detected & (share > _CHANGED_SHARE)).any(axis=1)
        unseen, changes = maybe_unseen(known), dict[int, FrameState]()
        for number, state in enumerate(frames):
            renewed = state.active & with_references(differs[number], unseen[number], self.skeleton)
            evidence = state.weighted(known, slice(number, number + 1), renewed)
            lengths_m = self._lengths.learned.lengths_m if new_lengths[number] else state.lengths_m
            state = changed(state, evidence=evidence, filtered=filtered[number], lengths_m=lengths_m)
            if renewed.any():
                changes[first + number] = changed(state, active=renewed)
            self._window[first + number] = state
        return changes

    def _filtered(self, state: FrameState | None) -> Filtered:
        return self._visibility.at_first if state is None else Filtered(state.at.time_s, state.filtered)

    def _learn(self) -> None:
        """From the newest frame, all images of which are there that will be used, and from those that have left."""
        while self._left:
            self._learn_smoothed(self._left.pop(0))
        self._lengths.add(self._window[-1].evidence)
        self._lengths.improve(self._rig, self._estimates.error_components)
        self._sole_views.learn(self._window[-1], self._lengths.learned.lengths_m, self._rig)

    def _learn_smoothed(self, oldest: FrameState) -> None:
        """From a frame that is one lag old."""
        self._visibility.marginalise(oldest, self._rig)
        information = oldest.evidence.information(oldest.positions_m[None], self._rig)[0]
        self._estimates.learn(oldest, self._rig)
        self._prediction.learn(oldest, information)
        if self.config.online.estimate_time_offsets and np.isfinite(oldest.step_s):
            self._learn_offsets(oldest)

    def _learn_offsets(self, oldest: FrameState) -> None:
        """The errors of its velocities, which shrink offsets, are least."""
        time_s, weights, sigma_px = oldest.at.time_s, oldest.evidence.weights[0], oldest.evidence.sigma_px[0]
        motion = oldest.step_s, oldest.positions_m, oldest.velocities_mps
        self._offsets.add(time_s, *motion, oldest.on_time_px(self._rig), weights, sigma_px, self.rig_with_offsets)
        if time_s >= self._offsets_applied_s + _APPLY_OFFSETS_S:
            learned, self._offsets_applied_s = self._offsets.rig(), time_s
            self._rig = learned.with_time_offsets(learned.time_offsets_s - self._late_s)
