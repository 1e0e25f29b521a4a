"""The bundle adjustment of a rig that was calibrated: the calibration is the prior."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.adjustment.noise import Noise
from fgpose.calibration.adjustment.problem import BundleProblem
from fgpose.calibration.adjustment.sightings import Sightings
from fgpose.calibration.adjustment.unknowns import Unknowns
from fgpose.config import Config
from fgpose.estimation.evidence.weights import LEAST_WEIGHT
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.geometry.camera import CameraRig

# 1e-4 degrees, 10 um: a tenth of what any result is stated to.
_STEP_TOLERANCE_M = 1e-5


def rig_problem(
    rig: CameraRig,
    sightings: Sightings,
    config: Config,
    *,
    poses: bool,
    clocks: bool,
    of_clocks: Float[np.ndarray, " camera"] | float = 1.0,
) -> BundleProblem:
    """The optimisation problem.

    Args:
        rig: the calibration as it was given, the mean of the priors.
        sightings: in the frames that are used.
        config: sigma and kernel of the reprojection errors; sigmas of the priors.
        poses: whether the cameras' poses are unknown; otherwise they are held.
        clocks: whether their time offsets are; that of the first camera is always held.
        of_clocks: see Noise.
    """
    prior, projection = config.calibration, config.projection
    noise = Noise(
        sigma_px=rig.in_own_px(projection.sigma_px).ravel(),
        kernel=projection.kernel,
        kernel_scale=projection.kernel_scale,
        rotation_rad=np.deg2rad(prior.rotation_sigma_deg),
        translation_m=prior.translation_sigma_m,
        moved_scale=prior.bumped_sigmas,
        offset_s=prior.offset_sigma_s,
        of_clocks=of_clocks,
    )
    unknowns = Unknowns.of(rig.n_cameras, range(rig.n_cameras) if poses else (), clocks=clocks)
    return BundleProblem(rig, sightings, unknowns, noise, step_tolerance_m=_STEP_TOLERANCE_M)


def sighting_weights(
    undistorted_px: Float[np.ndarray, "frame camera joint 2"],
    joints_m: Float[np.ndarray, "frame joint 3"],
    confidence: Float[np.ndarray, "frame camera joint"],
    step_s: float,
    config: Config,
    *,
    poses: bool,
) -> Float[np.ndarray, "frame camera joint"]:
    """Sightings.weights of one person, of detections and joints that are known: by confidence, discounted for errors
    that are correlated in time.

    The errors that matter to a pose do not average out, so that all detections of a person in a camera together count
    as calibration.independent_measurements at most. The agreement of the views, which the estimator uses too, depends
    on the calibration that is judged, so it is not used here.
    """
    used = np.asarray(np.isfinite(undistorted_px).all(axis=-1) & np.isfinite(joints_m[:, None]).all(axis=-1))
    counted_as_one = np.full(used.shape[1], correlated_frames(step_s, CORRELATION_S))
    if poses:
        of_camera = used.sum(axis=(0, 2)) / config.calibration.independent_measurements
        counted_as_one = np.maximum(counted_as_one, of_camera)
    weights = np.maximum(confidence, LEAST_WEIGHT) / counted_as_one[:, None]
    return np.where(used, weights, 0.0)
