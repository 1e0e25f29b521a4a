"""What leaves the online estimator: poses of the window with their covariances."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.covariances.online_covariance import OnlineCovariances
from fgpose.estimation.covariances.variance_components import ErrorComponents
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.online.window import Window
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate
from fgpose_factors.robust_statistics import medians


class Estimates:
    """Of one person.

    Args:
        n_cameras, skeleton, config: of the estimator.
        lengths: as they are learned.
        late_s: by how much the times of the window are before those of its user.
    """

    def __init__(
        self, n_cameras: int, skeleton: Skeleton, config: Config, lengths: RunningLengths, late_s: float
    ) -> None:
        self._skeleton, self._config, self._lengths, self._late_s = skeleton, config.online, lengths, late_s
        self._knows_velocities = config.motion.model != "none"
        self._covariances = OnlineCovariances(n_cameras, skeleton, config)
        self._newly_smoothed: list[Estimate] = []
        self._smoothed_frame = -1

    @property
    def error_components(self) -> ErrorComponents:
        """Of the detections, as far as they are learned."""
        return self._covariances.errors.components

    def learn(self, oldest: FrameState, rig: CameraRig) -> None:
        """Take a frame that is one lag old."""
        if self._config.covariance:
            self._covariances.learn(oldest, rig)

    def take_lagged(self, window: Window, rig: CameraRig) -> None:
        """The oldest frame of the window, if it has become one lag old."""
        number = window[0].at.frame
        if number > self._smoothed_frame and (estimate := self._lagged(window, rig)) is not None:
            self._smoothed_frame = number
            self._newly_smoothed.append(estimate)

    def newest(self, window: Window, rig: CameraRig) -> Estimate:
        """Of the newest frame, and of those that became one lag old since the last time."""
        newly_smoothed, self._newly_smoothed = tuple(self._newly_smoothed), []
        smoothed = newly_smoothed[-1] if newly_smoothed else self._lagged(window, rig)
        state, covariance_m2 = window[-1], None
        residual_px = norm(rig.project(state.positions_m) - state.evidence.measured_px[0])
        if self._config.covariance:
            learned = state.unseen_s, window.usual_step_s, rig
            covariance_m2 = self._covariances.of_newest_m2(state, window.newest_covariances_m2(), *learned)
        return Estimate(
            skeleton=self._skeleton,
            frame=state.at.frame,
            time_s=state.at.time_s + self._late_s,
            positions_m=state.positions_m,
            status=state.status,
            covariance_m2=covariance_m2,
            residual_px=residual_px,
            visibility=state.evidence.detection_visibility[0],
            is_implausible=bool(state.evidence.implausible[0]),
            smoothed=smoothed,
            newly_smoothed=newly_smoothed,
            n_repairs=window.repairs,
            bone_lengths=self._lengths.stated,
            other_bone=self._lengths.other_bone,
            velocity_mps=self._velocity_mps(state),
        )

    def _velocity_mps(self, state: FrameState) -> Float[np.ndarray, " 3"] | None:
        if not (self._knows_velocities and state.active.any()):
            return None
        return medians(state.velocities_mps[state.active], axis=0)

    def _lagged(self, window: Window, rig: CameraRig) -> Estimate | None:
        state = window.lagged
        if state is None:
            return None
        covariance_m2 = self._lagged_covariance_m2(state, window, rig) if self._config.smoothed_covariance else None
        time_s = state.at.time_s + self._late_s
        return Estimate(self._skeleton, state.at.frame, time_s, state.positions_m, state.status, covariance_m2)

    def _lagged_covariance_m2(
        self, oldest: FrameState, window: Window, rig: CameraRig
    ) -> Float[np.ndarray, "joint 3 3"]:
        later_s = [state.since_seen_s(oldest.at.time_s) for state in window]
        unseen_s = np.min([oldest.unseen_s, *later_s], axis=0)
        linear_m2 = window.oldest_covariances_m2()
        return self._covariances.of_lagged_m2(oldest, linear_m2, unseen_s, window.usual_step_s, rig)
