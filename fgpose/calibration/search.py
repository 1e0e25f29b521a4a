"""Calibration while the motion is unknown too: smoothing and bundle adjustment in turns, by one objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.bundle_adjustment import BundleProblem, Calibration, moved_rig, prior_sigmas
from fgpose.calibration.motion import has_converged, smoothed_motion
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.calibration.sightings import (
    Adjusted,
    Sightings,
    agreed_joints_m,
    best_seen_of_each,
    frames_of_each,
    seen_by_two,
    sighting_weights,
)
from fgpose.config import Config
from fgpose.estimation.delays import on_time_px
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import usual_step_s
from fgpose.trajectory import Trajectory

# Smaller changes cannot be seen in an image: 0.03 frames are 0.6 ms at 50 Hz, and a tenth of a sigma of the poses'
# priors is 0.01 degrees, 0.2 px.
_TOLERANCE_FRAMES = 0.03
_TOLERANCE_SIGMAS = 0.1


@dataclass(frozen=True, eq=False)
class Found(Adjusted):
    """The best of the calibrations that were tried."""

    sigmas: Float[np.ndarray, "camera 7"]
    """Standard deviations of what was estimated: radians, metres, seconds; zero for what was held."""
    objective: float
    """See fgpose.calibration.bundle_adjustment; at the smoothed motion."""


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of one person in the frames that are used."""

    sightings: Sightings
    joints_m: Float[np.ndarray, "frame joint 3"]
    """Zero where not known."""
    smoothed: bool
    """Whether the smoother has converged."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A calibration, and the motions that are most probable with it."""

    rig: CameraRig
    problem: BundleProblem
    state: Calibration
    objective: float
    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    smoothed: bool
    """Whether the smoother has converged."""


def search(people: Sequence[Observations], rig: CameraRig, config: Config, *, poses: bool, clocks: bool) -> Found:
    """Smooth the motions with the calibration so far, adjust cameras and joints to the detections, and so on.

    Every person has joints of their own, and all share the cameras. Every calibration is judged by the objective of the
    adjustment, at the motions that were smoothed with it, and the best one counts; the given one is the first. At most
    calibration.max_rounds times motions of calibration.max_duration_s, all together, are smoothed.

    Raises:
        ValueError: poses are wanted, and no joint is seen by two cameras that agree.
    """
    setting = _setting(people, rig, config, poses=poses, clocks=clocks)
    tolerances, changes, rounds = setting.tolerances(), np.zeros((rig.n_cameras, 7)), 1
    best = setting.candidate(changes)
    solution = best.problem.solve(best.state)
    proposed = solution.state.changes
    while (
        unsettled := bool((np.abs(proposed - changes) > tolerances).any())
    ) and rounds < config.calibration.max_rounds:
        changes, rounds = proposed, rounds + 1
        candidate = setting.candidate(changes)
        if candidate.objective < best.objective:
            best, solution = candidate, candidate.problem.solve(candidate.state)
            proposed = solution.state.changes
        else:  # too far
            proposed = (best.state.changes + changes) / 2
    return Found(
        rig=best.rig,
        sigmas=best.problem.sigmas(best.state) * prior_sigmas(config),
        objective=best.objective,
        converged=not unsettled and best.smoothed and solution.convergence.converged,
        undistorted_px=best.undistorted_px,
        confidence=setting.confidence,
    )


@dataclass(frozen=True, eq=False)
class _Setting:
    """What stays the same from one calibration to the next."""

    parts: list[Observations]
    """What is smoothed of each person."""
    frames: list[Int[np.ndarray, " _"]]
    """The frames of each part that are used in the adjustment."""
    rig: CameraRig
    config: Config
    poses: bool
    clocks: bool

    def tolerances(self) -> Float[np.ndarray, " 7"]:
        """Changes of a camera, in standard deviations of the priors, that are negligible."""
        step_s = min(usual_step_s(part.frame_time_s) for part in self.parts)
        sigma_s = self.config.calibration.offset_sigma_s
        return np.array([*6 * [_TOLERANCE_SIGMAS], _TOLERANCE_FRAMES * step_s / sigma_s])

    @property
    def confidence(self) -> Float[np.ndarray, "frame camera joint"]:
        """Of the detections in the frames that are used."""
        return np.concatenate([part.confidence[used] for part, used in zip(self.parts, self.frames, strict=True)])

    def candidate(self, changes: Float[np.ndarray, "camera 7"]) -> _Candidate:
        """The motions with a calibration, and the adjustment that starts from there."""
        rig = moved_rig(self.rig, changes, self.config)
        motions = [self._motion(*own, rig, changes) for own in zip(self.parts, self.frames, strict=True)]
        sightings = Sightings.together([motion.sightings for motion in motions])
        problem = BundleProblem(self.rig, sightings, self.config, poses=self.poses, clocks=self.clocks)
        state = Calibration(changes, np.concatenate([motion.joints_m for motion in motions]))
        smoothed = all(motion.smoothed for motion in motions)
        return _Candidate(rig, problem, state, problem.error(state), sightings.undistorted_px, smoothed)

    def _motion(
        self,
        part: Observations,
        frames: Int[np.ndarray, " sample"],
        rig: CameraRig,
        changes: Float[np.ndarray, "camera 7"],
    ) -> _Motion:
        trajectory = smoothed_motion(moved_with_cameras(part, self.rig, rig), rig, self.config)
        undistorted_px = on_time_px(part, rig, trajectory.positions_m)[frames]
        joints_m, velocities_mps = trajectory.positions_m[frames], _velocities_mps(trajectory)[frames]
        known = np.asarray(np.isfinite(joints_m + velocities_mps).all(axis=-1))
        used = np.isfinite(undistorted_px).all(axis=-1) & known[:, None]
        step_s = usual_step_s(part.frame_time_s[frames])
        sightings = Sightings(
            undistorted_px,
            sighting_weights(used, part.confidence[frames], step_s, self.config, poses=self.poses),
            np.where(known[..., None], velocities_mps, 0.0),
            changes[:, 6],
        )
        return _Motion(sightings, np.where(known[..., None], joints_m, 0.0), has_converged(trajectory))


def _setting(people: Sequence[Observations], rig: CameraRig, config: Config, *, poses: bool, clocks: bool) -> _Setting:
    parts = best_seen_of_each(seen_by_two(people), config.calibration.max_duration_s)
    setting = _Setting(parts, frames_of_each(parts, config.calibration.max_frames), rig, config, poses, clocks)
    if poses:
        pairs = zip(parts, setting.frames, strict=True)
        points2d_px = np.concatenate([part.points2d_px[frames] for part, frames in pairs])
        agreed_joints_m(rig.undistort(points2d_px), setting.confidence, rig, config)
    return setting


def _velocities_mps(trajectory: Trajectory) -> Float[np.ndarray, "frame joint 3"]:
    if trajectory.n_frames < 2:
        return np.zeros_like(trajectory.positions_m)
    return np.gradient(trajectory.positions_m, trajectory.time_s, axis=0)
