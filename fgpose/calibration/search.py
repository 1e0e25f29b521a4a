"""Calibration while the motion is unknown too: smoothing and bundle adjustment in turns, by one objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.calibration.adjustment.cameras import adjusted_rig
from fgpose.calibration.adjustment.problem import Bundle, BundleProblem
from fgpose.calibration.adjustment.scores import covariance_by_errors
from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA, OFFSET, ROTATION, TRANSLATION
from fgpose.calibration.motion import has_converged, smoothed_motion
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.calibration.rig_problem import rig_problem, sighting_weights
from fgpose.calibration.used_parts import (
    Adjusted,
    Ending,
    agreed_joints_m,
    best_seen_of_each,
    frames_of_each,
    seen_by_two,
    stretches,
)
from fgpose.config import Config
from fgpose.estimation.evidence.delays import on_time_px
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import linearized_projection
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

    objective: float
    """See fgpose.calibration.adjustment.problem; at the smoothed motion."""


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of one person in the frames that are used."""

    sightings: Sightings
    joints_m: Float[np.ndarray, "frame joint 3"]
    """NaN where not known."""
    for_clocks: Float[np.ndarray, " camera"]
    """Sum of the weights of the sightings if only clocks were unknown."""
    smoothed: bool
    """Whether the smoother has converged."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A calibration, and the motions that are most probable with it."""

    rig: CameraRig
    problem: BundleProblem
    state: Bundle
    objective: float
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
    tolerances, changes, rounds = setting.tolerances(), np.zeros((rig.n_cameras, N_OF_CAMERA)), 1
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
        covariance=setting.covariance(best),
        objective=best.objective,
        ending=Ending.of(smoothed=best.smoothed, settled=not unsettled, adjusted=solution.convergence.converged),
        undistorted_px=best.problem.sightings.undistorted_px,
        confidence=setting.confidence,
        shift_sigma_m=best.problem.shift_sigma_m(best.state) if poses else 0.0,
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

    def tolerances(self) -> Float[np.ndarray, " 11"]:
        """Changes of a camera that are negligible."""
        prior, negligible = self.config.calibration, np.zeros(N_OF_CAMERA)
        negligible[ROTATION] = _TOLERANCE_SIGMAS * np.deg2rad(prior.rotation_sigma_deg)
        negligible[TRANSLATION] = _TOLERANCE_SIGMAS * prior.translation_sigma_m
        negligible[OFFSET] = _TOLERANCE_FRAMES * min(usual_step_s(part.frame_time_s) for part in self.parts)
        return negligible

    @property
    def confidence(self) -> Float[np.ndarray, "frame camera joint"]:
        """Of the detections in the frames that are used."""
        return np.concatenate([part.confidence[used] for part, used in zip(self.parts, self.frames, strict=True)])

    def covariance(self, of: _Candidate) -> Float[np.ndarray, "camera 11 camera 11"]:
        """Of the changes of the cameras."""
        used = stretches(self.parts, self.frames)
        joints = self.parts[0].skeleton.joints
        return covariance_by_errors(of.problem, of.state, self.confidence, used, joints)

    def candidate(self, changes: Float[np.ndarray, "camera 11"]) -> _Candidate:
        """The motions with a calibration, and the adjustment that starts from there."""
        rig = adjusted_rig(self.rig, changes)
        motions = [self._motion(*own, rig, changes) for own in zip(self.parts, self.frames, strict=True)]
        sightings = Sightings.together([motion.sightings for motion in motions])
        for_clocks = np.sum([motion.for_clocks for motion in motions], axis=0)
        counted = sightings.weights.sum(axis=(0, 2))
        of_clocks = np.divide(for_clocks, counted, out=np.ones(self.rig.n_cameras), where=counted > 0)
        problem = rig_problem(
            self.rig, sightings, self.config, poses=self.poses, clocks=self.clocks, of_clocks=of_clocks
        )
        state = Bundle.of(changes, np.concatenate([motion.joints_m for motion in motions]))
        smoothed = all(motion.smoothed for motion in motions)
        return _Candidate(rig, problem, state, problem.error(state), smoothed)

    def _motion(
        self,
        part: Observations,
        frames: Int[np.ndarray, " sample"],
        rig: CameraRig,
        changes: Float[np.ndarray, "camera 11"],
    ) -> _Motion:
        trajectory = smoothed_motion(moved_with_cameras(part, self.rig, rig), rig, self.config)
        undistorted_px = on_time_px(part, rig, trajectory.positions_m)[frames]
        velocities_mps = _velocities_mps(trajectory)[frames]
        known = np.isfinite(velocities_mps).all(axis=-1, keepdims=True)
        joints_m = np.where(known, trajectory.positions_m[frames], np.nan)
        _, by_joint, _ = linearized_projection(undistorted_px, rig, joints_m)
        confidence, step_s = part.confidence[frames], usual_step_s(part.frame_time_s[frames])
        counted, for_clocks = (
            sighting_weights(undistorted_px, joints_m, confidence, step_s, self.config, poses=poses)
            for poses in (self.poses, False)
        )
        sightings = Sightings(
            undistorted_px,
            counted,
            (by_joint @ np.where(known, velocities_mps, 0.0)[:, None, ..., None])[..., 0],
            changes[:, OFFSET],
        )
        return _Motion(sightings, joints_m, for_clocks.sum(axis=(0, 2)), has_converged(trajectory))


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
