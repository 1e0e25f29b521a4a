"""Online estimation, frame by frame: iSAM2 in a fixed-lag smoother."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NoReturn

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.estimation.clock_offsets import RunningOffsets
from fgpose.estimation.evidence import Evidence, gather
from fgpose.estimation.factors.kinds import graph_factors
from fgpose.estimation.factors.projection import detection_information
from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.persistence import RunningPersistence
from fgpose.estimation.process_noise import RunningDensity, is_adaptive
from fgpose.estimation.segment import FrameTime, Predecessor, Segment
from fgpose.estimation.solvers.fixed_lag import FixedLagSmoother
from fgpose.estimation.uncertainty import distrust_factor_online, with_correlated_errors, with_swing
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, joint_status
from fgpose_factors import freeze

_APPLY_OFFSETS_S = 0.5
_TIME_ROUNDING_S = 1e-6  # a frame that is exactly one lag old is old enough


@dataclass(frozen=True, eq=False)
class _State:
    """What is kept of a frame that is still in the window."""

    at: FrameTime
    positions_m: Float[np.ndarray, "joint 3"]
    velocities_mps: Float[np.ndarray, "joint 3"]
    active: Bool[np.ndarray, " joint"]
    status: np.ndarray
    evidence: Evidence
    """Of this frame."""
    unseen_s: Float[np.ndarray, " joint"]
    """Time since any camera saw each joint."""
    trust: Float[np.ndarray, " joint"]
    """Weights of the detections of each joint that have fitted lately, summed over the cameras."""

    @property
    def joints(self) -> list[int]:
        return np.flatnonzero(self.active).tolist()


class Estimator:
    """The pose of one person, live: each update takes the newest frame and returns the pose at its time.

    The window holds online.lag_s. Bone lengths are learned as it runs (RunningLengths) and enter as GTSAM's native
    range factors, so that no Python callback is left in iSAM2. With online.estimate_time_offsets it also learns how
    late each camera is (rig_with_offsets).

    It cannot be pickled or copied: GTSAM's smoother has no serialisation. To continue elsewhere, start a new one and
    feed it the last few seconds again; it settles within a second.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config | None = None) -> None:
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        self._rig = rig
        self._lengths = RunningLengths(skeleton)
        self._smoother = FixedLagSmoother(self.config.online.relinearize_m)
        self._window: deque[_State] = deque()
        self._last_triangulated_s = np.full(skeleton.n_joints, -np.inf)
        self._last_seen_s = np.full(skeleton.n_joints, -np.inf)
        self._density = RunningDensity(skeleton.n_joints, self.config.motion)
        self._persistence = RunningPersistence((rig.n_cameras, skeleton.n_joints), self.config.projection)
        self._n_frames = 0
        self._offsets = RunningOffsets(rig, self.config)
        self._offsets_applied_s = -np.inf

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "an Estimator cannot be saved: GTSAM's fixed-lag smoother has no serialisation. "
            "Start a new one and feed it the last few seconds again."
        )

    @property
    def rig_with_offsets(self) -> CameraRig:
        """The rig with the time offsets learned so far; as it was given unless online.estimate_time_offsets."""
        return self._rig

    @property
    def repairs(self) -> int:
        """How often iSAM2 failed and the window was rebuilt from its own estimates."""
        return self._smoother.repairs

    def update(self, frame: Observations) -> Estimate:
        """Take the newest frame: any subset of the rig's cameras, any of the joints, even none.

        Raises:
            ValueError: there is more than one frame, a camera is not in the rig, the skeleton differs, or time does
                not increase (a repeated or older frame). The estimator is then as it was before.
        """
        evidence = self._evidence(frame)
        before = self._window[-1] if self._window else None
        evidence = self._on_time(before, evidence)
        now = FrameTime(self._n_frames, float(evidence.time_s[0]))
        active = self._active(evidence, now.time_s)
        state = self._predicted(before, now, active, evidence)
        step_s = np.inf if before is None else now.time_s - before.at.time_s
        self._lengths.add(step_s, evidence.guess_m[0], evidence.observed[0])
        self._add(before, state, evidence)
        state = self._read(state)
        self._window.append(state)
        self._marginalise_old(now.time_s)
        self._n_frames += 1
        estimate = self._estimate(state)
        if self.config.online.estimate_time_offsets and before is not None:
            self._learn_offsets(now.time_s - before.at.time_s, state, evidence)
        return estimate

    def _evidence(self, frame: Observations) -> Evidence:
        if frame.n_frames != 1:
            raise ValueError(f"update takes one frame at a time, got {frame.n_frames}; use observations.frames(...)")
        if frame.skeleton != self.skeleton:
            raise ValueError(f"the frame has skeleton {frame.skeleton.name}, the estimator {self.skeleton.name}")
        if self._window and frame.frame_time_s[0] <= self._window[-1].at.time_s:
            raise ValueError(
                f"time must increase: got a frame at {frame.frame_time_s[0]:g} s after one at "
                f"{self._window[-1].at.time_s:g} s; it was not used"
            )
        return gather(frame.with_cameras(self._rig.names), self._rig, self.config)

    def _on_time(self, before: _State | None, evidence: Evidence) -> Evidence:
        """The detections where they would be if all cameras were synchronous, by the predicted motion."""
        delay_s = evidence.delay_s[0]
        if before is None or not delay_s.any():
            return evidence
        predicted_m = before.positions_m + before.velocities_mps * (evidence.time_s[0] - before.at.time_s)
        at_camera_m = predicted_m + before.velocities_mps * delay_s[:, None, None]
        moved_px = np.nan_to_num(self._rig.project_each(at_camera_m) - self._rig.project(predicted_m))
        return replace(evidence, undistorted_px=evidence.undistorted_px - moved_px)

    def _learn_offsets(self, step_s: float, state: _State, evidence: Evidence) -> None:
        detections = evidence.undistorted_px[0], evidence.weights[0]
        self._offsets.add(step_s, state.positions_m, state.velocities_mps, *detections, self._rig)
        # A new rig costs a millisecond, and offsets change slowly.
        if state.at.time_s >= self._offsets_applied_s + _APPLY_OFFSETS_S:
            self._rig, self._offsets_applied_s = self._offsets.rig(), state.at.time_s

    def _active(self, evidence: Evidence, time_s: float) -> Bool[np.ndarray, " joint"]:
        """The joints that are estimated: triangulated in this frame or, with a motion model, not longer ago than
        max_unseen_s."""
        known = np.isfinite(evidence.guess_m[0]).all(axis=-1)
        self._last_triangulated_s[known] = time_s
        self._last_seen_s[evidence.seen[0]] = time_s
        if self.config.motion.model == "none":
            return np.asarray(known)
        return self._last_triangulated_s >= time_s - self.config.motion.max_unseen_s

    def _predicted(self, before: _State | None, now: FrameTime, active: np.ndarray, evidence: Evidence) -> _State:
        """First guess of the newest frame: the predicted position or, if its reprojection error is smaller, the
        triangulated point."""
        guess_m = evidence.guess_m[0]
        known = joint_status(active, evidence.observed[0]), evidence, now.time_s - self._last_seen_s, _total(evidence)
        if before is None:
            return _State(now, guess_m, np.zeros_like(guess_m), active, *known)
        moved_m = before.positions_m + before.velocities_mps * (now.time_s - before.at.time_s)
        entering = ~before.active | np.isnan(moved_m).any(axis=-1)
        better = self._image_error(guess_m, evidence) < self._image_error(moved_m, evidence)
        positions_m = np.where((entering | better)[:, None], guess_m, moved_m)
        velocities_mps = np.where(entering[:, None], 0.0, before.velocities_mps)
        return _State(now, positions_m, velocities_mps, active, *known)

    def _image_error(self, positions_m: np.ndarray, evidence: Evidence) -> Float[np.ndarray, " joint"]:
        """Robust (Geman-McClure) reprojection error per joint, in units of the kernel's scale; inf without a point."""
        scale_px = self.config.projection.sigma_px * self.config.projection.kernel_scale
        squared = np.sum((self._rig.project(positions_m) - evidence.undistorted_px[0]) ** 2, axis=-1) / scale_px**2
        # A point behind a camera that sees the joint has no image there: as bad as the farthest outlier.
        robust = np.where(np.isfinite(squared), squared / (1 + squared), 1.0)
        seen = np.isfinite(evidence.undistorted_px[0]).all(axis=-1)
        error = np.sum(np.where(seen, evidence.weights[0] * robust, 0.0), axis=0)
        return np.where(np.isfinite(positions_m).all(axis=-1), error, np.inf)

    def _marginalise_old(self, time_s: float) -> None:
        """Marginalise the frames older than the lag, except the newest of them: that one is the smoothed result."""
        while len(self._window) > 1 and self._is_lagged(self._window[1], time_s):
            self._window.popleft()
            self._smoother.drop_oldest()
            if is_adaptive(self.config.motion):
                oldest = self._window[0]
                self._density.add(oldest.at.time_s, self._points(velocity_key, oldest))

    def _is_lagged(self, state: _State, time_s: float) -> bool:
        return state.at.time_s <= time_s - self.config.online.lag_s + _TIME_ROUNDING_S

    def _keys(self, state: _State) -> Iterator[int]:
        for joint in state.joints:
            yield position_key(joint, state.at.frame)
            if self.config.motion.model == "constant_velocity":
                yield velocity_key(joint, state.at.frame)

    def _add(self, before: _State | None, state: _State, evidence: Evidence) -> None:
        new = gtsam.NonlinearFactorGraph()
        values = gtsam.Values()
        for joint in state.joints:
            values.insert(position_key(joint, state.at.frame), state.positions_m[joint])
            if self.config.motion.model == "constant_velocity":
                values.insert(velocity_key(joint, state.at.frame), state.velocities_mps[joint])
        for factor in self._factors(before, state, evidence, values):
            new.add(factor)
        self._smoother.add(new, values, list(self._keys(state)))

    def _factors(
        self, before: _State | None, state: _State, evidence: Evidence, values: gtsam.Values
    ) -> Iterator[gtsam.NonlinearFactor]:
        segment = Segment(
            self._rig,
            self.skeleton,
            self.config,
            evidence,
            state.active[None],
            self._lengths.median_m(),
            self._lengths.sigma_m(),
            self._density.density()[None],
            lengths_known=True,
            initial_m=state.positions_m[None],
            before=None if before is None else Predecessor(before.at.time_s, before.active),
            first_frame=state.at.frame,
        )
        for factor in graph_factors(segment):
            # No Python callback may be left in iSAM2.
            yield freeze(factor, values) if isinstance(factor, gtsam.CustomFactor) else factor

    def _read(self, state: _State) -> _State:
        """The state with the estimated values in place of the guesses."""
        velocities_mps = np.zeros((self.skeleton.n_joints, 3))
        if self.config.motion.model == "constant_velocity":
            velocities_mps[state.active] = self._points(velocity_key, state)[state.active]
        return replace(state, positions_m=self._points(position_key, state), velocities_mps=velocities_mps)

    def _points(self, key: Callable[[int, int], int], state: _State) -> Float[np.ndarray, "joint 3"]:
        """Current positions or velocities of a frame in the window; NaN where a joint is not estimated."""
        points = np.full((self.skeleton.n_joints, 3), np.nan)
        points[state.active] = self._smoother.points([key(joint, state.at.frame) for joint in state.joints])
        return points

    def _estimate(self, state: _State) -> Estimate:
        residual_px = np.linalg.norm(self._rig.project(state.positions_m) - state.evidence.undistorted_px[0], axis=-1)
        self._persistence.add(self._usual_step_s(), residual_px)
        state = replace(state, trust=_total(state.evidence, self._persistence.weights()))
        self._window[-1] = state
        return Estimate(
            skeleton=self.skeleton,
            frame=state.at.frame,
            time_s=state.at.time_s,
            positions_m=state.positions_m,
            status=state.status,
            covariance_m2=self._covariance(state) if self.config.online.covariance else None,
            residual_px=residual_px,
            smoothed=self._lagged(state.at.time_s),
        )

    def _usual_step_s(self) -> float:
        return usual_step_s(np.array([state.at.time_s for state in self._window]))

    def _covariance(self, state: _State) -> Float[np.ndarray, "joint 3 3"]:
        """Of the newest pose."""
        return self._widened(state, self._smoother.covariances(self._position_keys(state)), state.unseen_s)

    def _lagged(self, time_s: float) -> Estimate | None:
        """The newest frame that is at least one lag old, with its present estimate."""
        oldest = self._window[0]
        if not self._is_lagged(oldest, time_s):
            return None
        oldest = replace(oldest, positions_m=self._points(position_key, oldest))
        wanted = self.config.online.smoothed_covariance
        return Estimate(
            skeleton=self.skeleton,
            frame=oldest.at.frame,
            time_s=oldest.at.time_s,
            positions_m=oldest.positions_m,
            status=oldest.status,
            covariance_m2=self._lagged_covariance(oldest) if wanted else None,
        )

    def _lagged_covariance(self, oldest: _State) -> Float[np.ndarray, "joint 3 3"]:
        """Of the pose that is one lag old. As in batch the frames after it are known; but hallucinated detections keep
        the weight that they had in the newest pose, while the batch would lower it."""
        linear_m2 = self._smoother.oldest_covariances(self._position_keys(oldest))
        seen = np.stack([state.evidence.seen[0] for state in self._window])
        until_s = np.array([state.at.time_s - oldest.at.time_s for state in self._window])
        until_seen_s = np.where(seen, until_s[:, None], np.inf).min(axis=0)
        return self._widened(oldest, linear_m2, np.minimum(oldest.unseen_s, until_seen_s))

    def _position_keys(self, state: _State) -> list[int]:
        return [position_key(joint, state.at.frame) for joint in state.joints]

    def _widened(
        self,
        state: _State,
        linear_m2: Float[np.ndarray, "active_joint 3 3"],
        unseen_s: Float[np.ndarray, " joint"],
    ) -> Float[np.ndarray, "joint 3 3"]:
        """The covariance of the graph, scaled and widened for errors that the graph does not model; see uncertainty."""
        covariance_m2 = np.full((self.skeleton.n_joints, 3, 3), np.nan)
        if state.joints:
            correlated_m2 = with_correlated_errors(linear_m2, self._frame_information(state), self._usual_step_s())
            factor = distrust_factor_online(state.trust, _total(state.evidence))
            covariance_m2[state.joints] = factor[state.joints, None, None] * correlated_m2
        return with_swing(
            covariance_m2[None], state.positions_m[None], unseen_s[None], self.skeleton, self.config.swing
        )[0]

    def _frame_information(self, state: _State) -> Float[np.ndarray, "active_joint 3 3"]:
        """Of the detections of this frame alone."""
        joints, evidence = state.joints, state.evidence
        detections = evidence.undistorted_px[:, :, joints], evidence.weights[:, :, joints]
        points_m = state.positions_m[None, joints]
        return detection_information(self._rig, *detections, points_m, self.config.projection)[0]


def _total(evidence: Evidence, share: float | Float[np.ndarray, "camera joint"] = 1.0) -> Float[np.ndarray, " joint"]:
    """Weights of the detections of each joint in one frame, each times its share, summed over the cameras."""
    return replace(evidence, weights=evidence.weights * share).total_weight[0]
