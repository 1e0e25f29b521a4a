"""Refining the poses of the cameras on the recording itself: bundle adjustment with the calibration as prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import gtsam
import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.cameras import adjusted_rig
from fgpose.calibration.adjustment.problem import Bundle
from fgpose.calibration.adjustment.scores import covariance_by_errors
from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA
from fgpose.calibration.everybody import on_everybody
from fgpose.calibration.large_moves import refuse_large_moves
from fgpose.calibration.motion import has_converged, smoothed_motion
from fgpose.calibration.moved_views import Recording, moved_with_cameras
from fgpose.calibration.rig_problem import rig_problem, sighting_weights
from fgpose.calibration.used_parts import (
    Adjusted,
    Ending,
    agreed_joints_m,
    frames_of_each,
    seen_by_two,
    stretches,
)
from fgpose.config import Config
from fgpose.estimation.evidence.delays import by_mean_clock, delays_s, on_time_px
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.shown import Shown

# By chance a camera is that far off in one of 400 recordings.
SIGNIFICANT_SIGMAS = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class RigRefinement(Shown, Generic[Recording]):
    """A rig whose cameras agree better, and how far each was moved."""

    rig: CameraRig
    observations: Recording
    """The observations, their per-view 3D moved with the cameras that saw it."""
    rotation_deg: Float[np.ndarray, " camera"]
    translation_m: Float[np.ndarray, " camera"]
    rotation_sigma_deg: Float[np.ndarray, " camera"]
    """Standard deviation of the refined orientation about each axis (root mean square), from the errors that the views
    contradict each other by and from how far the calibration was off. It is in the world of the calibration, so that a
    shift of everything is in it."""
    translation_sigma_m: Float[np.ndarray, " camera"]
    """The same of each coordinate of the refined position."""
    residual_before_px: Float[np.ndarray, " camera"]
    """Median reprojection error of the triangulated joints, with the rig as it was and as it is now; NaN for a camera
    that sees nothing."""
    residual_after_px: Float[np.ndarray, " camera"]
    shift_sigma_m: float = 0.0
    """Standard deviation of each coordinate by which all cameras and joints may have been shifted together. Images tell
    little of it, and no covariance of a joint contains it."""
    ending: Ending = Ending.SETTLED
    reassigned: tuple[float, ...] = ()
    """Of several people, each time that they were told apart with the new rig: the share of the detected joints that
    belonged to somebody else then, of the camera where it is largest. Above 5 % the cameras were calibrated again."""

    @property
    def converged(self) -> bool:
        return self.ending.converged


def refine_rig(observations: Recording, rig: CameraRig, config: Config | None = None) -> RigRefinement[Recording]:
    """Move the cameras, as little as needed, so that they agree on the person, or on everybody.

    Poses of the cameras and joints of up to calibration.max_frames frames are variables; the calibration is the prior,
    robust, for most cameras were not touched (fgpose.calibration.adjustment). Known delays (time stamps, offsets
    of the rig) are corrected first. A common shift of all cameras and joints by a few centimetres cannot be seen in the
    images; it is known only as well as the calibration was (shift_sigma_m). The errors of a detector are correlated
    from frame to frame, so the detections of a person in a camera together count as
    calibration.independent_measurements measurements, not as thousands. A camera without detections keeps its pose.

    Several people (fgpose.load_people) are told apart with the rig as it was given, and again with the refined one,
    which may be refined once more then (reassigned). The frames are shared out among them, so that everybody is used.

    Raises:
        ValueError: the cameras of observations and rig differ, no joint is seen by two cameras that agree, or cameras
            would have to be moved by more than a bump does, or the body would have another size then.
    """
    config = config or Config()
    refined, reassigned = on_everybody(observations, rig, config, _refined)
    return refinement(observations, rig, refined, config, reassigned)


def refinement(
    observations: Recording, before: CameraRig, found: Adjusted, config: Config, reassigned: tuple[float, ...]
) -> RigRefinement[Recording]:
    """How a rig was changed, judged by the detections that were used. Raises ValueError if by more than a bump does."""
    after, (rotation_deg, translation_m) = found.rig, moves(before, found.rig)
    refuse_large_moves(before, found, rotation_deg, translation_m, observations.skeleton, config)
    return RigRefinement(
        rig=after,
        observations=moved_with_cameras(observations, before, after),
        rotation_deg=rotation_deg,
        translation_m=translation_m,
        rotation_sigma_deg=found.rotation_sigma_deg,
        translation_sigma_m=found.translation_sigma_m,
        residual_before_px=_residual_px(found.undistorted_px, found.confidence, before, config),
        residual_after_px=_residual_px(found.undistorted_px, found.confidence, after, config),
        shift_sigma_m=found.shift_sigma_m,
        ending=found.ending,
        reassigned=reassigned,
    )


def moves(before: CameraRig, after: CameraRig) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """How far each camera was turned, degrees, and moved, metres."""
    moves = [
        gtsam.Pose3(old.world_T_camera).between(gtsam.Pose3(new.world_T_camera))
        for old, new in zip(before.cameras, after.cameras, strict=True)
    ]
    rotation_deg = np.array([np.rad2deg(np.linalg.norm(gtsam.Rot3.Logmap(move.rotation()))) for move in moves])
    return rotation_deg, np.array([np.linalg.norm(move.translation()) for move in moves])


def has_moved(
    rotation_deg: Float[np.ndarray, " camera"], translation_m: Float[np.ndarray, " camera"], config: Config
) -> Bool[np.ndarray, " camera"]:
    """Whether cameras that had to be turned and moved by this were touched: more than the calibration can be wrong."""
    prior = config.calibration
    turned = rotation_deg > SIGNIFICANT_SIGMAS * prior.rotation_sigma_deg
    return turned | (translation_m > SIGNIFICANT_SIGMAS * prior.translation_sigma_m)


def _refined(people: Sequence[Observations], rig: CameraRig, config: Config) -> Adjusted:
    people = seen_by_two(people)
    frames = frames_of_each(people, config.calibration.max_frames)
    on_time = [_on_time_px(own, rig, config) for own in people]
    undistorted_px = np.concatenate([px[used] for (px, _), used in zip(on_time, frames, strict=True)])
    confidence = np.concatenate([own.confidence[used] for own, used in zip(people, frames, strict=True)])
    joints_m = agreed_joints_m(undistorted_px, confidence, rig, config)
    begins = np.cumsum([len(own) for own in frames])[:-1]
    used = stretches(people, frames)
    arrays = (np.split(array, begins) for array in (undistorted_px, joints_m, confidence))
    weights = [
        sighting_weights(own_px, own_m, own_confidence, stretch.step_s, config, poses=True)
        for own_px, own_m, own_confidence, stretch in zip(*arrays, used, strict=True)
    ]
    sightings = Sightings.on_time(undistorted_px, np.concatenate(weights))
    start = Bundle.of(np.zeros((rig.n_cameras, N_OF_CAMERA)), joints_m)
    problem = rig_problem(rig, sightings, config, poses=True, clocks=False)
    solution = problem.solve(start)
    smoothed = all(smoothed for _, smoothed in on_time)
    ending = Ending.of(smoothed=smoothed, settled=True, adjusted=solution.convergence.converged)
    return Adjusted(
        rig=adjusted_rig(rig, solution.state.changes),
        undistorted_px=undistorted_px,
        confidence=confidence,
        ending=ending,
        shift_sigma_m=problem.shift_sigma_m(solution.state),
        covariance=covariance_by_errors(problem, solution.state, confidence, used, people[0].skeleton.joints),
    )


def _on_time_px(
    observations: Observations, rig: CameraRig, config: Config
) -> tuple[Float[np.ndarray, "frame camera joint 2"], bool]:
    """The detections of all frames, undistorted, and whether what they rest on has converged; the motion is only
    estimated where there are delays to be undone."""
    if not delays_s(*by_mean_clock(observations, rig)).any():
        return rig.undistort(observations.points2d_px), True
    trajectory = smoothed_motion(observations, rig, config)
    return on_time_px(observations, rig, trajectory.positions_m), has_converged(trajectory)


def _residual_px(
    undistorted_px: np.ndarray, confidence: np.ndarray, rig: CameraRig, config: Config
) -> Float[np.ndarray, " camera"]:
    inlier_px = rig.in_own_px(config.fusion.inlier_px)
    points_m = triangulate_robust(undistorted_px, confidence, rig, inlier_px).positions_m
    errors_px = np.linalg.norm(rig.project(points_m) - undistorted_px, axis=-1).swapaxes(0, 1)
    return np.array([np.nanmedian(errors) if np.isfinite(errors).any() else np.nan for errors in errors_px])
