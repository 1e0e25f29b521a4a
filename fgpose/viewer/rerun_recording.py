"""The recording of one person in Rerun."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun.blueprint as rrb
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Trajectory
from fgpose.viewer import palette, paths
from fgpose.viewer.blueprint import blueprint
from fgpose.viewer.content import observation_rows, residual_rows, trajectory_rows
from fgpose.viewer.pictures import PictureOptions
from fgpose.viewer.recording import Recording
from fgpose.viewer.rerun_session import RerunSession, Target
from fgpose.viewer.rows import scalar_rows
from fgpose.viewer.session import UpAxis
from fgpose.viewer.trajectory_scene import log_residual_styles, log_scene

_EARLIER_THICKNESS = 0.5  # of all results but the last, which shall stand out


class RerunRecording(RerunSession, Recording):
    """See Recording and open_recording."""

    def __init__(
        self,
        target: Target,
        scene: tuple[CameraRig, Skeleton, tuple[str, ...]],
        up: UpAxis,
        pictures: PictureOptions,
        layout: rrb.Blueprint | None = None,
    ) -> None:
        rig, skeleton, self._trajectories = scene
        self._last_status: dict[str, np.ndarray] = {}
        self._factors: tuple[str, ...] = ()
        layout = layout or blueprint(rig, skeleton, self._trajectories, up, following=target.port is not None)
        super().__init__(target, rig, skeleton, layout, pictures)
        log_scene(self._open_stream, rig, skeleton, self._trajectories, up)

    def log_observations(
        self,
        observations: Observations,
        weights: Float[np.ndarray, "frame camera joint"] | None = None,
        undistorted_px: Float[np.ndarray, "frame camera joint 2"] | None = None,
    ) -> None:
        self._check_observations(observations, weights)
        self._send(observation_rows(observations, self._rig, weights, undistorted_px), observations.frame_time_s)

    def log_trajectory(self, name: str, trajectory: Trajectory) -> None:
        self._check_trajectory(name, trajectory)
        self._send(trajectory_rows(name, trajectory, self._rig, *self._look(name)), trajectory.time_s)

    def log_residuals(
        self, time_s: Float[np.ndarray, " frame"], residuals: Mapping[str, Float[np.ndarray, "frame joint"]]
    ) -> None:
        self._check_residuals(len(time_s), residuals)
        if residuals:
            self._name_factors(tuple(residuals))
            self._send(residual_rows(self._skeleton, residuals), time_s)

    def log_update_times(self, time_s: Float[np.ndarray, " frame"], update_ms: Float[np.ndarray, " frame"]) -> None:
        self._send([scalar_rows(paths.UPDATE_MS, update_ms)], time_s)

    def log_estimate(
        self,
        estimate: Estimate,
        observations: Observations | None = None,
        weights: Float[np.ndarray, "camera joint"] | None = None,
        *,
        update_ms: float | None = None,
        residuals: Mapping[str, Float[np.ndarray, " joint"]] | None = None,
    ) -> None:
        now = np.array([estimate.time_s]), estimate.frame
        if observations is not None:
            of_frame = None if weights is None else weights[None]
            self._check_observations(observations, of_frame)
            self._send(observation_rows(observations, self._rig, of_frame), *now)
        if update_ms is not None:
            self._send([scalar_rows(paths.UPDATE_MS, np.array([update_ms]))], *now)
        if residuals:
            by_factor = {factor: np.asarray(values)[None] for factor, values in residuals.items()}
            self._check_residuals(1, by_factor)
            self._name_factors(tuple(residuals))
            self._send(residual_rows(self._skeleton, by_factor), *now)
        self._log_frame("online", estimate)
        if estimate.smoothed is not None and "smoothed" in self._trajectories:
            self._log_frame("smoothed", estimate.smoothed)

    def _log_frame(self, name: str, estimate: Estimate) -> None:
        trajectory = Trajectory.from_estimates([estimate], self._rig.names)
        self._check_trajectory(name, trajectory)
        before = self._last_status.get(name)
        rows = trajectory_rows(name, trajectory, self._rig, *self._look(name), before)
        self._send(rows, trajectory.time_s, estimate.frame)
        self._last_status[name] = trajectory.status[0]

    def _look(self, name: str) -> tuple[palette.Colour, float]:
        """Colour and thickness of a result; the last one stands out."""
        index = self._trajectories.index(name)
        return palette.trajectory_colour(name, index), 1.0 if name == self._trajectories[-1] else _EARLIER_THICKNESS

    def _name_factors(self, factors: tuple[str, ...]) -> None:
        if factors != self._factors:
            log_residual_styles(self._open_stream, self._rig, self._skeleton, factors)
            self._factors = factors

    def _check_observations(self, observations: Observations, weights: np.ndarray | None) -> None:
        self._check_skeleton("the observations", observations.skeleton)
        observations.check_cameras(self._rig.names)
        if weights is not None and weights.shape != observations.seen.shape:
            raise ValueError(f"weights must be {observations.seen.shape} as the points are, got {weights.shape}")

    def _check_trajectory(self, name: str, trajectory: Trajectory) -> None:
        if name not in self._trajectories:
            raise ValueError(f"the recording was opened for {', '.join(self._trajectories)}, not for {name!r}")
        self._check_skeleton(f"trajectory {name}", trajectory.skeleton)
        if trajectory.residual_px is not None and trajectory.residual_px.shape[1] != self._rig.n_cameras:
            raise ValueError(
                f"trajectory {name} has residuals in {trajectory.residual_px.shape[1]} cameras, "
                f"the recording has {self._rig.n_cameras}"
            )

    def _check_residuals(self, n_frames: int, residuals: Mapping[str, np.ndarray]) -> None:
        expected = (n_frames, self._skeleton.n_joints)
        for factor, values in residuals.items():
            if values.shape != expected:
                raise ValueError(f"residuals of {factor} must be {expected} (frames, joints), got {values.shape}")
