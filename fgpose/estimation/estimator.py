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
from fgpose.estimation import frame_factors
from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.estimation.clock_offsets import RunningOffsets
from fgpose.estimation.evidence import Evidence, gather
from fgpose.estimation.frame_factors import FrameTime
from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.persistence import RunningPersistence
from fgpose.estimation.process_noise import RunningDensity, is_adaptive
from fgpose.estimation.solvers.fixed_lag import FixedLagSmoother
from fgpose.estimation.solvers.normal_equations import projections
from fgpose.estimation.solvers.terms import BatchState
from fgpose.estimation.uncertainty import doubt_online, with_correlated_errors, with_swing
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

    @property
    def joints(self) -> list[int]:
        return np.flatnonzero(self.active).tolist()


class Estimator:
    """The pose of one person, live: each update takes the newest frame and returns the pose at its time.

    The window holds online.lag_s. Bone lengths are learned as it runs (RunningLengths) and enter as GTSAM's native
    range factors, so that no Python callback is left in iSAM2. With online.estimate_time_offsets it also learns how
    late each camera is; its rig then changes.

    It cannot be pickled or copied: GTSAM's smoother has no serialisation. To continue elsewhere, start a new one and
    feed it the last few seconds again; it settles within a second.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config | None = None) -> None:
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        self._lengths = RunningLengths(skeleton)
        self._smoother = FixedLagSmoother(self.config.online.relinearize_m)
        self._window: deque[_State] = deque()
        self._last_triangulated_s = np.full(skeleton.n_joints, -np.inf)
        self._last_seen_s = np.full(skeleton.n_joints, -np.inf)
        self._density = RunningDensity(skeleton.n_joints, self.config.motion)
        self._persistence = RunningPersistence((rig.n_cameras, skeleton.n_joints), self.config.projection)
        self._n_frames = 0
        self._offsets = RunningOffsets(rig, self.config.projection)
        self._offsets_applied_s = -np.inf

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "an Estimator cannot be saved: GTSAM's fixed-lag smoother has no serialisation. "
            "Start a new one and feed it the last few seconds again."
        )

    @property
    def repairs(self) -> int:
        """How often GTSAM failed and the window was eliminated anew; updates are slower for a while after that."""
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
        self._lengths.add(evidence.guess_m[0], evidence.observed[0])
        self._add(before, state, evidence)
        state = self._read(state)
        self._window.append(state)
        self._let_go(now.time_s)
        self._n_frames += 1
        estimate = self._estimate(state, evidence)
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
        return gather(frame.with_cameras(self.rig.names), self.rig, self.config)

    def _on_time(self, before: _State | None, evidence: Evidence) -> Evidence:
        """The detections where they would be if all cameras were synchronous, as the motion so far foresees."""
        delay_s = evidence.delay_s[0]
        if before is None or not delay_s.any():
            return evidence
        foreseen_m = before.positions_m + before.velocities_mps * (evidence.time_s[0] - before.at.time_s)
        at_camera_m = foreseen_m + before.velocities_mps * delay_s[:, None, None]
        moved_px = np.nan_to_num(self.rig.project_each(at_camera_m) - self.rig.project(foreseen_m))
        return replace(evidence, undistorted_px=evidence.undistorted_px - moved_px)

    def _learn_offsets(self, step_s: float, state: _State, evidence: Evidence) -> None:
        detections = evidence.undistorted_px[0], evidence.weights[0]
        self._offsets.add(step_s, state.positions_m, state.velocities_mps, *detections, self.rig)
        # A new rig costs a millisecond, and offsets change slowly.
        if state.at.time_s >= self._offsets_applied_s + _APPLY_OFFSETS_S:
            self.rig, self._offsets_applied_s = self._offsets.rig(), state.at.time_s

    def _active(self, evidence: Evidence, time_s: float) -> Bool[np.ndarray, " joint"]:
        """Joints that take part: triangulated now or, with a motion model, not too long ago."""
        known = np.isfinite(evidence.guess_m[0]).all(axis=-1)
        self._last_triangulated_s[known] = time_s
        self._last_seen_s[evidence.seen[0]] = time_s
        if self.config.motion.model == "none":
            return np.asarray(known)
        return self._last_triangulated_s >= time_s - self.config.motion.max_unseen_s

    def _predicted(self, before: _State | None, now: FrameTime, active: np.ndarray, evidence: Evidence) -> _State:
        """First guess of the newest frame: the motion carried on or, where it explains the images better, the
        triangulated point."""
        guess_m = evidence.guess_m[0]
        status = joint_status(active, evidence.observed[0])
        if before is None:
            return _State(now, guess_m, np.zeros_like(guess_m), active, status)
        moved_m = before.positions_m + before.velocities_mps * (now.time_s - before.at.time_s)
        entering = ~before.active | np.isnan(moved_m).any(axis=-1)
        better = self._image_error(guess_m, evidence) < self._image_error(moved_m, evidence)
        positions_m = np.where((entering | better)[:, None], guess_m, moved_m)
        velocities_mps = np.where(entering[:, None], 0.0, before.velocities_mps)
        return _State(now, positions_m, velocities_mps, active, status)

    def _image_error(self, positions_m: np.ndarray, evidence: Evidence) -> Float[np.ndarray, " joint"]:
        """Robust (Geman-McClure) reprojection error per joint, in units of the kernel's scale; inf without a point."""
        scale_px = self.config.projection.sigma_px * self.config.projection.kernel_scale
        squared = np.sum((self.rig.project(positions_m) - evidence.undistorted_px[0]) ** 2, axis=-1) / scale_px**2
        # A point behind a camera that sees the joint has no image there: as bad as the farthest outlier.
        robust = np.where(np.isfinite(squared), squared / (1 + squared), 1.0)
        seen = np.isfinite(evidence.undistorted_px[0]).all(axis=-1)
        error = np.sum(np.where(seen, evidence.weights[0] * robust, 0.0), axis=0)
        return np.where(np.isfinite(positions_m).all(axis=-1), error, np.inf)

    def _let_go(self, time_s: float) -> None:
        """Marginalise what is older than the lag, but for the newest such frame: it is the lag-old result."""
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
        config, frame = self.config, state.at.frame
        yield from frame_factors.projection_factors(
            self.rig, frame, evidence.undistorted_px[0], evidence.weights[0], state.active, config.projection
        )
        yield from frame_factors.anchor_factors(frame, evidence.anchored[0], evidence.guess_m[0], config.fusion)
        yield from frame_factors.depth_factors(
            frame,
            np.inf if before is None else state.at.time_s - before.at.time_s,
            state.active,
            evidence.views_m[0],
            evidence.rays[0],
            evidence.depth_sigma_m[0],
            config.depth,
        )
        if config.symmetry.form == "frame":
            for factor in frame_factors.symmetry_factors(self.skeleton, frame, state.active, config.symmetry):
                yield freeze(factor, values)
        elif config.symmetry.form == "shared_length":
            sigmas_m = np.hypot(config.symmetry.sigma_m, self._lengths.sigma_m())
            yield from frame_factors.known_length_factors(
                self.skeleton, frame, state.active, state.positions_m, self._lengths.median_m(), sigmas_m
            )
        entering = state.active
        if before is not None and config.motion.model != "none":
            kept = state.active & before.active
            entering = state.active & ~before.active
            density, step_s = self._density.density(), state.at.time_s - before.at.time_s
            yield from frame_factors.motion_factors(
                before.at, state.at, np.flatnonzero(kept).tolist(), density, config.motion
            )
            yield from frame_factors.fading_factors(
                self.skeleton, frame, step_s, state.active, evidence.seen[0], density, config.motion
            )
        with_velocity = config.motion.model == "constant_velocity"
        joints = np.flatnonzero(entering).tolist()
        yield from frame_factors.prior_factors(
            frame, joints, state.positions_m, config.prior, with_velocity=with_velocity
        )

    def _read(self, state: _State) -> _State:
        """The state with the estimated values in place of the guesses."""
        velocities_mps = np.zeros((self.skeleton.n_joints, 3))
        if self.config.motion.model == "constant_velocity":
            velocities_mps[state.active] = self._points(velocity_key, state)[state.active]
        return replace(state, positions_m=self._points(position_key, state), velocities_mps=velocities_mps)

    def _points(self, key: Callable[[int, int], int], state: _State) -> Float[np.ndarray, "joint 3"]:
        """Current positions or velocities of a frame in the window; NaN where a joint takes no part."""
        points = np.full((self.skeleton.n_joints, 3), np.nan)
        points[state.active] = self._smoother.points([key(joint, state.at.frame) for joint in state.joints])
        return points

    def _estimate(self, state: _State, evidence: Evidence) -> Estimate:
        residual_px = np.linalg.norm(self.rig.project(state.positions_m) - evidence.undistorted_px[0], axis=-1)
        return Estimate(
            skeleton=self.skeleton,
            frame=state.at.frame,
            time_s=state.at.time_s,
            positions_m=state.positions_m,
            status=state.status,
            covariance_m2=self._covariance(state, evidence, residual_px) if self.config.online.covariance else None,
            residual_px=residual_px,
            smoothed=self._lagged(state.at.time_s),
        )

    def _covariance(
        self, state: _State, evidence: Evidence, residual_px: Float[np.ndarray, "camera joint"]
    ) -> Float[np.ndarray, "joint 3 3"]:
        joints, step_s = state.joints, usual_step_s(np.array([state.at.time_s for state in self._window]))
        self._persistence.add(step_s, residual_px)
        covariance_m2 = np.full((self.skeleton.n_joints, 3, 3), np.nan)
        if joints:
            keys = [position_key(joint, state.at.frame) for joint in joints]
            linear_m2, alone = self._smoother.covariances(keys), self._frame_information(state, evidence)
            factor = doubt_online(self._trusted(evidence).total_weight[0, joints], evidence.total_weight[0, joints])
            covariance_m2[joints] = factor[:, None, None] * with_correlated_errors(linear_m2, alone, step_s)
        unseen_s = state.at.time_s - self._last_seen_s
        return with_swing(
            covariance_m2[None], state.positions_m[None], unseen_s[None], self.skeleton, self.config.swing
        )[0]

    def _frame_information(self, state: _State, evidence: Evidence) -> Float[np.ndarray, "active_joint 3 3"]:
        """Of the detections of this frame alone."""
        joints = state.joints
        detections = evidence.undistorted_px[:, :, joints], evidence.weights[:, :, joints]
        at = BatchState(state.positions_m[None, None, joints], np.zeros(0))
        terms = projections(self.rig, *detections, self.config.projection)
        return np.sum([term.information(at)[0] for term in terms], axis=0)

    def _trusted(self, evidence: Evidence) -> Evidence:
        return replace(evidence, weights=evidence.weights * self._persistence.weights())

    def _lagged(self, time_s: float) -> Estimate | None:
        """The newest frame that is at least one lag old, as everything since has changed it."""
        oldest = self._window[0]
        if not self._is_lagged(oldest, time_s):
            return None
        positions_m = self._points(position_key, oldest)
        return Estimate(self.skeleton, oldest.at.frame, oldest.at.time_s, positions_m, oldest.status)
