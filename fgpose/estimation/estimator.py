"""Online estimation, frame by frame, in a window of fixed lag."""

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
from fgpose.estimation.factors.fading import maybe_unseen, with_references
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.arrivals import Arrivals, Turns, check_frame, one_frame, one_image, with_image
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.online.prediction import Prediction
from fgpose.estimation.online.window import Window
from fgpose.estimation.online.window_solver import REVISED_S
from fgpose.estimation.visibility.running_visibility import Filtered, RunningVisibility
from fgpose.estimation.visibility.sole_views import RunningSoleViews
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing
from fgpose.io.skeletons import as_skeleton
from fgpose.observations import Observations
from fgpose.sampling import TIME_ROUNDING_S
from fgpose.skeleton import Skeleton
from fgpose.trajectory import BoneLengths, Estimate

_APPLY_OFFSETS_S = 0.5  # a new rig costs a millisecond, and offsets change slowly
# The factors of a joint are replaced when the share of its weight that a detection should have has changed by this; at
# twice as much, the mean errors on the tuning clips are 1 to 2 % larger.
_CHANGED_SHARE = 0.15


class Estimator:
    """The pose of one person, live: each update takes the newest frame and returns the pose at its time, which is the
    mean time at which the cameras took it: time stamps, and the mean time offset of the rig.

    The window holds online.lag_s, and is solved by online.solver. Bone lengths are learned as it runs (RunningLengths)
    and are held in the graph, so that no Python callback is left in iSAM2. With online.estimate_time_offsets it also
    learns how late each camera is (rig_with_offsets); with estimators of other people in the room, where they share the
    offsets.

    With online.solver "window" it can be pickled and copied, to be continued elsewhere. With "isam2" it cannot: GTSAM's
    smoother has no serialisation. Start a new one and feed it the last few seconds again; it settles within a second.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton | str,
        config: Config | None = None,
        offsets: RunningOffsets | None = None,
    ) -> None:
        refuse_changing(rig)
        skeleton = as_skeleton(skeleton)
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
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
        self._offsets_applied_s = -np.inf
        self._revised_s = -np.inf
        self._is_tidy = True
        self._arrivals, self._turns = Arrivals(rig.names), Turns()
        self._plausibility = RunningPlausibility()
        self._credibility = RunningCredibility(rig.n_cameras, skeleton.n_joints)

    def __getstate__(self) -> dict[str, object]:
        if self.config.online.solver == "isam2":
            raise TypeError(
                "this Estimator cannot be saved: GTSAM's iSAM2 has no serialisation. Choose online.solver = "
                '"window", or start a new one and feed it the last few seconds again.'
            )
        return self.__dict__

    @property
    def rig_with_offsets(self) -> CameraRig:
        """The rig with the time offsets learned so far; as it was given unless online.estimate_time_offsets."""
        return self._rig.with_time_offsets(self._rig.time_offsets_s + self._late_s) if self._late_s else self._rig

    @property
    def newest(self) -> Estimate | None:
        """The pose of the newest frame, as the last update gave it; None: there was none."""
        return self._estimates.newest(self._window, self._rig) if len(self._window) else None

    @property
    def n_implausible(self) -> int:
        """In how many frames what was detected makes no body; those are left out, see Estimate.is_implausible."""
        return self._plausibility.n_implausible

    @property
    def repairs(self) -> int:
        """How often GTSAM failed and the window was eliminated anew; updates are slower for a while after that."""
        return self._window.repairs

    def know(self, lengths: BoneLengths) -> None:
        """Expect the bones of somebody who is known: Estimate.bone_lengths of before, or measured; until they have
        left, for who comes then may be somebody else. Raises ValueError: they are not those of the skeleton.
        """
        if lengths.lengths_m.shape != (self.skeleton.n_lengths,):
            raise ValueError(f"{self.skeleton.n_lengths} bone lengths are needed, got {lengths.lengths_m.shape}")
        self._lengths.know(lengths)

    def update(self, frame: Observations) -> Estimate:
        """Take the newest frame: any subset of the rig's cameras, any of the joints, even none.

        Detections that make no body are left out, as if nobody had been detected (Estimate.is_implausible). The image
        of one camera alone (the others have no time, or are not in the frame) is taken as update_camera takes it, as
        are those of cameras that show somebody in turns: it may join the frame before, whose pose is returned then.

        Raises:
            ValueError: there is more than one frame, a camera is not in the rig, the skeleton differs, or time does
                not increase (TooLateError: a repeated or older frame); or none of the first frames makes a body: the
                calibration is in millimetres. The estimator is then as it was before.
        """
        check_frame(frame, self.skeleton, self._window[-1].at.time_s if len(self._window) else -np.inf)
        seen = frame.with_cameras(self.rig.names)
        taken_s = np.broadcast_to(seen.time_s, (1, self.rig.n_cameras))[0]
        if frame.n_cameras < self.rig.n_cameras:
            taken_s = np.where(np.isin(self.rig.names, frame.camera_names), taken_s, np.nan)
        shows = seen.seen[0].any(axis=1)
        taken_s = self._turns.taken_s(shows, taken_s)
        estimate = (self._take_alone if np.isfinite(taken_s).sum() == 1 else self._begin)(seen, taken_s)
        self._turns.add(shows)
        return estimate

    def update_arrays(
        self,
        time_s: float | Float[np.ndarray, " camera"],
        points2d_px: Float[np.ndarray, "camera joint 2"],
        confidence: float | Float[np.ndarray, "camera joint"] = 1.0,
        points3d_m: Float[np.ndarray, "camera joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "camera joint 3 3"] | None = None,
    ) -> Estimate:
        """Take the newest frame as arrays, the cameras in the order of the rig; see Observations.

        Args:
            time_s: of the frame, or of each camera's image (NaN: none).
            points2d_px: pixels of the original images; NaN where a joint was not detected.
            confidence: in [0, 1].
            points3d_m: absolute 3D joints as each view alone gives them, in the world frame.
            covariance3d_m2: of points3d_m.

        Raises:
            ValueError: as update and Observations.
        """
        arrays = points2d_px, confidence, points3d_m, covariance3d_m2
        return self.update(one_frame(self.skeleton, time_s, self.rig.names, arrays))

    def update_camera(
        self,
        camera: str,
        time_s: float,
        points2d_px: Float[np.ndarray, "joint 2"],
        confidence: float | Float[np.ndarray, " joint"] = 1.0,
        points3d_m: Float[np.ndarray, "joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "joint 3 3"] | None = None,
    ) -> Estimate:
        """Take one image of one camera as it comes, at its own time; arguments as update_arrays.

        It begins a new frame or joins one that is there (see Arrivals), its detections moved to the time of that frame.
        A joint of a frame is predicted until a second camera sees it.

        Returns:
            The pose at the time of the newest frame, which need not be that of the image.

        Raises:
            ValueError: the camera is not in the rig, its image was there before, no frame of the window can take it
                (TooLateError), or the arrays are not as they should be. The estimator is then as it was before.
        """
        arrays = points2d_px, confidence, points3d_m, covariance3d_m2
        image = one_image(self.skeleton, time_s, camera, arrays).with_cameras(self.rig.names)
        return self._take_alone(image, np.where(np.array(self.rig.names) == camera, time_s, np.nan))

    def tidy(self) -> None:
        """Do what the next update would do first: learn from the newest frame, and revise the frames before. To be
        called in the time until the next images come, which are estimated sooner then. Images that join the newest
        frame afterwards are not learned from."""
        if self._is_tidy:
            return
        self._learn()
        changes = self._revised()
        if changes:
            self._window.change(changes, self._rig)
        self._is_tidy = True

    def _take_alone(self, image: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """The image of the one camera that has a time. Raises ValueError as update_camera."""
        is_own = np.isfinite(image_time_s)
        number = int(np.argmax(is_own))
        frames_s = self._window.times_s
        images_s = np.array([state.image_time_s for state in self._window]).reshape(-1, self.rig.n_cameras)
        at = self._arrivals.frame_of(number, float(image_time_s[number]), frames_s, images_s)
        return self._begin(image, image_time_s) if at is None else self._join(at, image, is_own)

    def _begin(self, frame: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """A new frame, later than all others. Images of the one before that come later are too late to learn from."""
        gathered, _ = self._gathered(frame, frame)
        self._arrivals.took(image_time_s)
        if not self._is_tidy:
            self._learn()
        before = self._window[-1] if len(self._window) else None
        state = self._prediction.frame(before, frame, gathered, image_time_s, self._rig)
        # In one update with the new frame, which costs less than one of its own.
        changes = {} if self._is_tidy else self._revised()
        self._is_tidy = False
        self._window.add(state, self._rig, changes)
        self._judge()
        for oldest in self._window.marginalise():
            self._learn_smoothed(oldest)
        return self._estimates.newest(self._window, self._rig)

    def _gathered(self, frame: Observations, new: Observations) -> tuple[Evidence, Bodies]:
        """Of a frame, of which some images are new. Raises ValueError as update."""
        credibility = self._credibility.plus(new.confidence, float(new.frame_time_s[0]))
        credible, may_leave_out = credibility.credible(frame.confidence), self._plausibility.may_leave_out
        gathered, bodies = gather_frame(frame, self._rig, self.config, credible, may_leave_out=may_leave_out)
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
        if gathered.implausible[0] and not state.evidence.implausible[0]:
            self._plausibility.count(bodies)
            return replace(self._estimates.newest(self._window, self._rig), is_implausible=True)
        delay_s = np.nan_to_num(image_time_s - state.at.time_s) + self._rig.time_offsets_s
        gathered = replace(gathered, time_s=np.array([state.at.time_s]), delay_s=delay_s[None])
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
        is_far = np.linalg.norm(guess_m - state.positions_m, axis=-1) > self.config.online.relinearize_m
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
        probability = self._visibility.probability
        self._window[-1] = replace(newest.judged(probability), filtered=probability)
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
        known, filtered = self._visibility.judged(
            gathered, *poses, self._rig, self._filtered(self._window.before(first))
        )
        unseen, changes = maybe_unseen(known), dict[int, FrameState]()
        for number, state in enumerate(frames):
            evidence, at = known.frames(slice(number, number + 1)), first + number
            self._lengths.revise(evidence)
            new_lengths = self._lengths.have_changed(state.lengths_m)
            changed = new_lengths | state.would_change(evidence, _CHANGED_SHARE)
            changed = state.active & with_references(changed, unseen[number], self.skeleton)
            state = state.weighted(evidence, changed)
            lengths_m = self._lengths.learned.lengths_m if new_lengths else state.lengths_m
            state = replace(state, filtered=filtered[number], lengths_m=lengths_m)
            if changed.any():
                changes[at] = replace(state, active=changed)
            self._window[at] = state
        return changes

    def _filtered(self, state: FrameState | None) -> Filtered:
        return self._visibility.at_first if state is None else Filtered(state.at.time_s, state.filtered)

    def _learn(self) -> None:
        """From the newest frame, all images of which are there that will be used."""
        self._lengths.add(self._window[-1].evidence)
        self._lengths.improve(self._rig)
        self._sole_views.learn(self._window[-1], self._lengths.learned.lengths_m, self._rig)

    def _learn_smoothed(self, oldest: FrameState) -> None:
        """From a frame that is one lag old."""
        self._visibility.marginalise(oldest.as_gathered, oldest.positions_m, oldest.velocities_mps, self._rig)
        information = oldest.evidence.information(oldest.positions_m[None], self._rig)[0]
        self._estimates.learn(oldest, information, self._rig)
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
