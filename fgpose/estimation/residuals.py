"""Which factor pulls a joint, and how hard: the whitened residuals of a result."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence import Evidence
from fgpose.estimation.initial_guess import median_lengths
from fgpose.estimation.process_noise import process_density
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory


def whitened_residuals(
    trajectory: Trajectory, evidence: Evidence, config: Config
) -> dict[str, Float[np.ndarray, "frame joint"]]:
    """Norm of each factor's residual at the result, in its sigmas, before the robust kernel.

    Args:
        trajectory: of all the frames of the evidence, with residual_px.
        evidence: what it was made from.
        config: what it was made with.

    Returns:
        By factor: "projection/<camera>" per camera, "symmetry" and "motion"; NaN where a joint has no such factor.
        Several bones of one joint add up as the root of the sum of squares. The motion factors' velocities are
        eliminated: their residual is that of positions alone.
    """
    residuals = _projection(trajectory, evidence, config)
    if config.symmetry.form != "none":
        residuals["symmetry"] = _symmetry(trajectory, config)
    if config.motion.model != "none":
        residuals["motion"] = _motion(trajectory, config)
    return residuals


def _projection(
    trajectory: Trajectory, evidence: Evidence, config: Config
) -> dict[str, Float[np.ndarray, "frame joint"]]:
    if trajectory.residual_px is None:
        return {}
    weights = np.maximum(evidence.weights, config.projection.min_weight)
    whitened = trajectory.residual_px * np.sqrt(weights) / config.projection.sigma_px
    return {f"projection/{name}": whitened[:, c] for c, name in enumerate(trajectory.camera_names)}


def _symmetry(trajectory: Trajectory, config: Config) -> Float[np.ndarray, "frame joint"]:
    skeleton, positions_m = trajectory.skeleton, trajectory.positions_m
    of_bones_m = skeleton.bone_lengths(positions_m)
    if config.symmetry.form == "frame":
        bones = {frozenset(bone): index for index, bone in enumerate(skeleton.bones)}
        terms = []
        for left, right in skeleton.limb_pairs:
            difference_m = of_bones_m[:, bones[frozenset(left)]] - of_bones_m[:, bones[frozenset(right)]]
            terms.append(((*left, *right), difference_m))
    else:
        lengths_m = trajectory.bone_lengths_m
        lengths_m = median_lengths(skeleton, positions_m) if lengths_m is None else lengths_m
        errors_m = of_bones_m - lengths_m[list(skeleton.length_of_bone)]
        terms = list(zip(skeleton.bones, errors_m.T, strict=True))
    return _root_of_squares(skeleton, len(positions_m), terms) / config.symmetry.sigma_m


def _root_of_squares(
    skeleton: Skeleton, n_frames: int, terms: list[tuple[tuple[int, ...], np.ndarray]]
) -> Float[np.ndarray, "frame joint"]:
    """Each joint's share in terms that belong to several joints; NaN where it has none."""
    total = np.zeros((n_frames, skeleton.n_joints))
    known = np.zeros(total.shape, dtype=bool)
    for joints, values in terms:
        for joint in joints:
            total[:, joint] += np.where(np.isfinite(values), values, 0.0) ** 2
            known[:, joint] |= np.isfinite(values)
    return np.where(known, np.sqrt(total), np.nan)


def _motion(trajectory: Trajectory, config: Config) -> Float[np.ndarray, "frame joint"]:
    """The change that the model does not foresee, over its standard deviation; NaN at the ends.

    Random walk: the displacement since the frame before, variance q h. Constant velocity: the change of the mean
    velocity between two intervals h and h', variance q (h + h') / 3 (twice integrated white noise).
    """
    interval_s = np.diff(trajectory.time_s)[:, None]
    whitened = np.full(trajectory.status.shape, np.nan)
    steps_m = np.diff(trajectory.positions_m, axis=0)
    density = process_density(trajectory.positions_m, trajectory.time_s, config.motion)
    if config.motion.model == "random_walk":
        sigma_m = np.sqrt(density[1:] * interval_s)
        whitened[1:] = np.linalg.norm(steps_m, axis=-1) / sigma_m
    elif len(interval_s) > 1:
        change_mps = np.diff(steps_m / interval_s[..., None], axis=0)
        variance = density[1:-1] * (interval_s[1:] + interval_s[:-1]) / 3
        whitened[1:-1] = np.linalg.norm(change_mps, axis=-1) / np.sqrt(variance)
    return whitened
