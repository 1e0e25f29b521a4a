"""Online estimation, frame by frame: iSAM2 in a fixed-lag smoother."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import replace
from typing import NoReturn

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.covariances.online_covariance import OnlineCovariances
from fgpose.estimation.evidence.credibility import RunningCredibility
from fgpose.estimation.evidence.evidence import FARTHEST_M, Evidence, concatenated, gather_frame
from fgpose.estimation.evidence.images import corrected, fits_better
from fgpose.estimation.evidence.plausibility import Bodies, RunningPlausibility
from fgpose.estimation.evidence.presence import has_left
from fgpose.estimation.factors.fading import maybe_unseen, with_references
from fgpose.estimation.frame_state import FrameState, LastSeen
from fgpose.estimation.online.arrivals import Arrivals, Turns, check_frame, one_frame, one_image, with_image
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.online.window_graph import WindowGraph
from fgpose.estimation.process_noise import RunningDensity, is_adaptive
from fgpose.estimation.segment import FrameTime
from fgpose.estimation.visibility.sole_views import RunningSoleViews
from fgpose.estimation.visibility.visibility import Filtered, RunningVisibility
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing
from fgpose.observations import Observations
from fgpose.sampling import TIME_ROUNDING_S, usual_step_s
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, joint_status

_APPLY_OFFSETS_S = 0.5  # a new rig costs a millisecond, and offsets change slowly
# So many of the last seconds are revised, after so much time or half the lag. Joints stay hidden for about as long
# (visibility.hidden_s), so later images hardly tell more. Half of the time between changes the errors on the tuning
# clips of the benchmark by less than 1 %; half of what is revised makes them 3 % larger with two occluded cameras.
_REVISED_S, _REVISE_EVERY_S = 0.25, 0.2
# The factors of a joint are replaced when the share of its weight that a detection should have has changed by this; at
# twice as much, the mean errors on the tuning clips are 1 to 2 % larger.
_CHANGED_SHARE = 0.15
_FASTEST_MPS = 1e4  # frames that are microseconds apart hardly tell velocities


class Estimator:
    """The pose of one person, live: each update takes the newest frame and returns the pose at its time, which is the
    mean time at which the cameras took it: time stamps, and the mean time offset of the rig.

    The window holds online.lag_s. Bone lengths are learned as it runs (RunningLengths) and enter as GTSAM's native
    range factors, so that no Python callback is left in iSAM2. With online.estimate_time_offsets it also learns how
    late each camera is (rig_with_offsets); with estimators of other people in the room, where they share the offsets.

    It cannot be pickled or copied: GTSAM's smoother has no serialisation. To continue elsewhere, start a new one and
    feed it the last few seconds again; it settles within a second.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config | None = None,
        offsets: RunningOffsets | None = None,
    ) -> None:
        refuse_changing(rig)
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        # The time of a frame is by the mean clock, as in the batch (by_mean_clock): only what leaves has the true time.
        self._late_s, self._rig = rig.common_offset_s, rig.without_common_offset()
        self._lengths = RunningLengths(skeleton, self.config)
        self._window: deque[FrameState] = deque()
        self._left: FrameState | None = None
        """The last frame that has left the window."""
        self._last = LastSeen(skeleton.n_joints)
        self._density = RunningDensity(skeleton.n_joints, self.config.motion)
        self._graph = WindowGraph(self._lengths, self.config)
        self._visibility = RunningVisibility(rig.n_cameras, skeleton, self.config)
        self._sole_views = RunningSoleViews(skeleton)
        self._covariances = OnlineCovariances(rig.n_cameras, skeleton.n_joints, self.config)
        self._offsets = offsets or RunningOffsets(rig, self.config)
        self._offsets_applied_s = -np.inf
        self._revised_s = -np.inf
        self._is_tidy = True
        self._arrivals, self._turns = Arrivals(rig.names), Turns()
        self._plausibility = RunningPlausibility()
        self._credibility = RunningCredibility(rig.n_cameras, skeleton.n_joints)

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "an Estimator cannot be saved: GTSAM's fixed-lag smoother has no serialisation. "
            "Start a new one and feed it the last few seconds again."
        )

    @property
    def rig_with_offsets(self) -> CameraRig:
        """The rig with the time offsets learned so far; as it was given unless online.estimate_time_offsets."""
        return self._rig.with_time_offsets(self._rig.time_offsets_s + self._late_s) if self._late_s else self._rig

    @property
    def newest(self) -> Estimate | None:
        """The pose of the newest frame, as the last update gave it; None: there was none."""
        return self._estimate() if self._window else None

    @property
    def n_implausible(self) -> int:
        """In how many frames what was detected makes no body; those are left out, see Estimate.is_implausible."""
        return self._plausibility.n_implausible

    @property
    def repairs(self) -> int:
        """How often GTSAM failed and the window was eliminated anew; updates are slower for a while after that."""
        return self._graph.repairs

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
        check_frame(frame, self.skeleton, self._window[-1].at.time_s if self._window else -np.inf)
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
            self._graph.replace(changes, self._rig)
            self._window[-1] = self._graph.read(self._window[-1])
        self._is_tidy = True

    def _take_alone(self, image: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """The image of the one camera that has a time. Raises ValueError as update_camera."""
        is_own = np.isfinite(image_time_s)
        number = int(np.argmax(is_own))
        frames_s = np.array([state.at.time_s for state in self._window])
        images_s = np.array([state.image_time_s for state in self._window]).reshape(-1, self.rig.n_cameras)
        at = self._arrivals.frame_of(number, float(image_time_s[number]), frames_s, images_s)
        return self._begin(image, image_time_s) if at is None else self._join(at, image, is_own)

    def _begin(self, frame: Observations, image_time_s: Float[np.ndarray, " camera"]) -> Estimate:
        """A new frame, later than all others. Images of the one before that come later are too late to learn from."""
        gathered, _ = self._gathered(frame, frame)
        self._arrivals.took(image_time_s)
        if not self._is_tidy:
            self._learn()
        state = self._predicted(frame, gathered, image_time_s)
        # In one update with the new frame, which costs less than one of its own.
        changes = {} if self._is_tidy else self._revised()
        self._is_tidy = False
        self._graph.add(state, self._rig, changes)
        self._window.append(self._graph.read(state))
        self._judge()
        self._marginalise_old(state.at.time_s)
        return self._estimate()

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
        state, is_newest = self._graph.read(self._window[at]), at == len(self._window) - 1
        observations = with_image(state.observations, image, is_own)
        image_time_s = np.where(is_own, image.frame_time_s[0], state.image_time_s)
        gathered, bodies = self._gathered(observations, image)
        self._arrivals.took(np.where(is_own, image_time_s, np.nan))
        if gathered.implausible[0] and not state.evidence.implausible[0]:
            self._plausibility.count(bodies)
            return replace(self._estimate(), is_implausible=True)
        delay_s = np.nan_to_num(image_time_s - state.at.time_s) + self._rig.time_offsets_s
        gathered = replace(gathered, time_s=np.array([state.at.time_s]), delay_s=delay_s[None])
        gathered = corrected(gathered, state.positions_m, state.velocities_mps, self._visibility.bias, self._rig)
        pose = state.positions_m, self._rig
        if is_newest:
            evidence = self._visibility.predicted(gathered, *pose)
            gathered, evidence = self._sole_views.with_distances(gathered, evidence, *pose)
        else:
            filtered = self._filtered(at), self._filtered(at - 1)
            evidence = self._visibility.with_image(is_own, *filtered, state.evidence, gathered, *pose)
        entering = evidence.located[0] & ~state.active & is_newest
        state = state.joined(observations, image_time_s, gathered, evidence, entering)
        self._graph.replace({at: state}, self._rig, entering)
        self._move(at, state)
        self._window[at] = self._graph.read(state)
        if is_newest:
            self._judge()
        else:
            self._last.note(state)
            self._window[-1] = self._graph.read(self._window[-1])
        return self._estimate()

    def _move(self, at: int, state: FrameState) -> None:
        """Move joints to their present triangulation, if that fits the images better. The robust kernels would keep
        them at the position that the first images gave."""
        current, guess_m = self._graph.read(state), state.evidence.guess_m[0]
        better = fits_better(guess_m, current.positions_m, state.evidence, self._rig, self.config.projection)
        # Two views that agree by chance are contradicted by the next image.
        is_sure = (state.evidence.n_views[0] >= 3) | np.isfinite(state.image_time_s).all()
        is_far = np.linalg.norm(guess_m - current.positions_m, axis=-1) > self.config.online.relinearize_m
        moved = np.flatnonzero(state.active & is_sure & better & is_far).tolist()
        if moved:
            self._graph.move(at, current, moved, guess_m, self._rig)

    def _judge(self) -> None:
        """Judge the detections of the newest frame."""
        newest = self._window[-1]
        has_image = np.isfinite(newest.image_time_s)
        # What was given up is found again where its detections fit each other.
        positions_m = np.where(newest.active[:, None], newest.positions_m, newest.evidence.guess_m[0])
        self._visibility.add(positions_m, newest.velocities_mps, newest.as_gathered, self._rig, has_image)
        probability = self._visibility.probability
        self._window[-1] = replace(newest.judged(probability), filtered=probability)
        self._last.note(self._window[-1])

    def _revised(self) -> dict[int, FrameState]:
        """Weight the detections of the last frames by what their present poses tell, as the batch does: an update that
        accepted a hallucination takes it back. And give new lengths to their bones.

        Returns:
            The frames that change; see WindowGraph.
        """
        now_s, every_s = self._window[-1].at.time_s, min(_REVISE_EVERY_S, self.config.online.lag_s / 2)
        is_due = now_s >= self._revised_s + every_s - TIME_ROUNDING_S
        if not is_due and not self._lengths.have_changed(self._window[-1].lengths_m):
            return {}
        self._revised_s = now_s
        first = sum(state.at.time_s < now_s - _REVISED_S for state in self._window)
        frames = [self._graph.read(state) for state in itertools.islice(self._window, first, None)]
        poses = np.stack([state.positions_m for state in frames]), np.stack([state.velocities_mps for state in frames])
        gathered = concatenated([state.as_gathered for state in frames])
        known, filtered = self._visibility.judged(gathered, *poses, self._rig, self._filtered(first - 1))
        unseen, changes = maybe_unseen(known), dict[int, FrameState]()
        for number, state in enumerate(frames):
            evidence, at = known.frames(slice(number, number + 1)), first + number
            self._lengths.revise(evidence)
            new_lengths = self._lengths.have_changed(state.lengths_m)
            changed = new_lengths | state.would_change(evidence, _CHANGED_SHARE)
            changed = state.active & with_references(changed, unseen[number], self.skeleton)
            state = state.weighted(evidence, changed)
            lengths_m = self._lengths.lengths_m.copy() if new_lengths else state.lengths_m
            state = replace(state, filtered=filtered[number], lengths_m=lengths_m)
            if changed.any():
                changes[at] = replace(state, active=changed)
            self._window[at] = state
        return changes

    def _filtered(self, at: int) -> Filtered:
        """Of a frame of the window; -1: of the one before it."""
        state = self._window[at] if at >= 0 else self._left
        return self._visibility.at_first if state is None else Filtered(state.at.time_s, state.filtered)

    def _learn(self) -> None:
        """From the newest frame, all images of which are there that will be used."""
        self._lengths.add(self._window[-1].evidence)
        self._lengths.improve(self._rig)
        self._sole_views.learn(self._window[-1], self._lengths.lengths_m, self._rig)

    def _learn_offsets(self, oldest: FrameState) -> None:
        """From a frame that is one lag old: the errors of its velocities, which shrink offsets, are least."""
        time_s, weights, sigma_px = oldest.at.time_s, oldest.evidence.weights[0], oldest.evidence.sigma_px[0]
        motion = oldest.step_s, oldest.positions_m, oldest.velocities_mps
        self._offsets.add(time_s, *motion, oldest.on_time_px(self._rig), weights, sigma_px, self.rig_with_offsets)
        if time_s >= self._offsets_applied_s + _APPLY_OFFSETS_S:
            learned, self._offsets_applied_s = self._offsets.rig(), time_s
            self._rig = learned.with_time_offsets(learned.time_offsets_s - self._late_s)

    def _predicted(
        self, frame: Observations, gathered: Evidence, image_time_s: Float[np.ndarray, " camera"]
    ) -> FrameState:
        """First guess of the newest frame: the predicted position or, if its reprojection error is smaller, the
        triangulated point. The joints that are estimated are located now or, with a motion model, were in the graph
        before and not given up."""
        before = self._window[-1] if self._window else None
        time_s, guess_m = float(gathered.time_s[0]), gathered.guess_m[0]
        linked, step_s = np.zeros(len(guess_m), dtype=bool), np.inf
        positions_m, velocities_mps = guess_m, np.zeros_like(guess_m)
        if before is not None:
            step_s = time_s - before.at.time_s
            moved_m = before.carried_on_m(step_s)
            gathered = corrected(gathered, moved_m, before.velocities_mps, self._visibility.bias, self._rig)
            given_up = self._last.before(time_s - self.config.motion.max_unseen_s)
            unseen_s, known_m = (
                time_s - self._last.person_s,
                np.where(before.active[:, None], before.positions_m, np.nan),
            )
            if has_left(known_m, guess_m, unseen_s, self.config.tracking.coast_s):
                given_up[:] = True
                self._lengths.forget()
            within = (np.abs(moved_m) < FARTHEST_M) & (np.abs(before.velocities_mps) < _FASTEST_MPS)
            kept = before.active & within.all(axis=-1) & ~given_up
            if self.config.motion.model != "none":
                linked = kept
            positions_m = np.where(kept[:, None], moved_m, guess_m)
            velocities_mps = np.where(kept[:, None], before.velocities_mps, 0.0)
        evidence = self._visibility.predicted(gathered, positions_m, self._rig)
        gathered, evidence = self._sole_views.with_distances(gathered, evidence, positions_m, self._rig)
        better = fits_better(guess_m, positions_m, evidence, self._rig, self.config.projection)
        density, off_m = self._density.density(), evidence.off_path_m[0]
        if before is not None:
            # A step of one standard deviation to where the detections agree.
            density = np.fmax(density, np.sum((off_m - positions_m) ** 2, axis=-1) / step_s**3)
        positions_m = np.where(better[:, None], guess_m, positions_m)
        positions_m = np.where(np.isnan(off_m), positions_m, off_m)
        active = linked | evidence.located[0]
        return FrameState(
            at=FrameTime(0 if before is None else before.at.frame + 1, time_s),
            step_s=step_s,
            observations=frame,
            image_time_s=image_time_s,
            gathered=gathered,
            evidence=evidence,
            positions_m=positions_m,
            velocities_mps=velocities_mps,
            lengths_m=self._lengths.lengths_m.copy(),
            active=active,
            linked=linked,
            process_density=density,
            status=joint_status(active, evidence.observed[0]),
            filtered=evidence.visibility[0],
            unseen_before_s=time_s - self._last.seen_s,
        )

    def _marginalise_old(self, time_s: float) -> None:
        """Marginalise the frames older than the lag, except the newest of them: that one is the smoothed result."""
        while len(self._window) > 1 and self._is_lagged(self._window[1], time_s):
            self._left = self._window.popleft()
            self._graph.drop_oldest()
            oldest = self._graph.read(self._window[0])
            self._visibility.marginalise(oldest.as_gathered, oldest.positions_m, oldest.velocities_mps, self._rig)
            if self.config.online.covariance:
                self._covariances.learn(oldest, self._rig)
            if is_adaptive(self.config.motion):
                velocities_mps = np.where(oldest.active[:, None], oldest.velocities_mps, np.nan)
                information = oldest.evidence.information(oldest.positions_m[None], self._rig)[0]
                self._density.add(oldest.at.time_s, velocities_mps, information)
            if self.config.online.estimate_time_offsets and np.isfinite(oldest.step_s):
                self._learn_offsets(oldest)

    def _is_lagged(self, state: FrameState, time_s: float) -> bool:
        return state.at.time_s <= time_s - self.config.online.lag_s + TIME_ROUNDING_S

    def _estimate(self) -> Estimate:
        """Of the newest frame."""
        state = self._window[-1]
        residual_px = np.linalg.norm(self._rig.project(state.positions_m) - state.evidence.measured_px[0], axis=-1)
        covariance_m2 = None
        if self.config.online.covariance:
            linear_m2 = self._graph.covariances_m2(state)
            covariance_m2 = self._covariances.of_newest_m2(state, linear_m2, state.unseen_s, self._step_s, self._rig)
        return Estimate(
            skeleton=self.skeleton,
            frame=state.at.frame,
            time_s=state.at.time_s + self._late_s,
            positions_m=state.positions_m,
            status=state.status,
            covariance_m2=covariance_m2,
            residual_px=residual_px,
            visibility=state.evidence.detection_visibility[0],
            is_implausible=bool(state.evidence.implausible[0]),
            smoothed=self._lagged(state.at.time_s),
            n_repairs=self.repairs,
        )

    def _lagged(self, time_s: float) -> Estimate | None:
        """The newest frame that is at least one lag old, with its present estimate."""
        oldest = self._window[0]
        if not self._is_lagged(oldest, time_s):
            return None
        oldest = self._graph.read(oldest)
        covariance_m2 = self._lagged_covariance_m2(oldest) if self.config.online.smoothed_covariance else None
        frame, taken_s = oldest.at.frame, oldest.at.time_s + self._late_s
        return Estimate(self.skeleton, frame, taken_s, oldest.positions_m, oldest.status, covariance_m2)

    def _lagged_covariance_m2(self, oldest: FrameState) -> np.ndarray:
        later_s = [state.since_seen_s(oldest.at.time_s) for state in self._window]
        linear_m2 = self._graph.lagged_covariances_m2(oldest)
        unseen_s = np.min([oldest.unseen_s, *later_s], axis=0)
        return self._covariances.of_lagged_m2(oldest, linear_m2, unseen_s, self._step_s, self._rig)

    @property
    def _step_s(self) -> float:
        """Usual time from frame to frame."""
        return usual_step_s(np.array([state.at.time_s for state in self._window]))
