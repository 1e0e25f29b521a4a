"""GTSAM factors for articulated bodies: reprojection, bones, smoothness. Needs only numpy, gtsam and jaxtyping."""

from fgpose_factors.bone_length import (
    bone_length_and_direction,
    shared_bone_length_factor,
    shared_length_residual,
    symmetric_bone_length_factor,
    symmetric_length_residual,
)
from fgpose_factors.custom import custom_factor, freeze
from fgpose_factors.depth import depth_factor, depth_information
from fgpose_factors.kernels import Kernel, robust_loss, robust_weight
from fgpose_factors.noise import noise_model, robust
from fgpose_factors.projection import project, projection_factor, projection_residual
from fgpose_factors.smoothness import (
    Motion,
    State,
    constant_velocity_factor,
    fading_velocity_factor,
    fading_velocity_sigma_mps,
    interpolate_position,
    interpolated_factor,
    random_walk_factor,
)

__all__ = [
    "Kernel",
    "Motion",
    "State",
    "bone_length_and_direction",
    "constant_velocity_factor",
    "custom_factor",
    "depth_factor",
    "depth_information",
    "fading_velocity_factor",
    "fading_velocity_sigma_mps",
    "freeze",
    "interpolate_position",
    "interpolated_factor",
    "noise_model",
    "project",
    "projection_factor",
    "projection_residual",
    "random_walk_factor",
    "robust",
    "robust_loss",
    "robust_weight",
    "shared_bone_length_factor",
    "shared_length_residual",
    "symmetric_bone_length_factor",
    "symmetric_length_residual",
]
