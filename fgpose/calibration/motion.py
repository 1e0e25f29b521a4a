"""The smoothed motion by which a calibration is judged or delays are corrected."""

from __future__ import annotations

import warnings

from fgpose.config import Config
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.smoother import smooth_evidence
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.trajectory import Trajectory


def smoothed_motion(observations: Observations, rig: CameraRig, config: Config) -> Trajectory:
    """fgpose.smooth of the frames as they are, without covariances, and without its warning: whether it has converged
    is part of every result."""
    config = config.replace(solver={"covariance": False})
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*converge")
        return smooth_evidence(gather(observations, rig, config), observations.skeleton, rig, config)


def has_converged(trajectory: Trajectory) -> bool:
    return trajectory.convergence is None or trajectory.convergence.converged
