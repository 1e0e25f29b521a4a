"""Which factor pulls a joint, and how hard: the whitened residuals of a result."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.factors.bone_length import KnownLengths
from fgpose.estimation.factors.joint_rows import JointRows
from fgpose.estimation.factors.state import BatchState
from fgpose.estimation.factors.symmetry import Symmetries
from fgpose.estimation.initial_guess import median_lengths
from fgpose.estimation.process_noise import process_density
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.trajectory import Trajectory


def whitened_residuals(
    trajectory: Trajectory, evidence: Evidence, rig: CameraRig, config: Config
) -> dict[str, Float[np.ndarray, "frame joint"]]:
    """Norm of each factor's residual at the result, in its sigmas, before the robust kernel.

    Args:
        trajectory: of all the frames of the evidence, with residual_px.
        evidence: what it was made from, informed by it (fgpose.estimation.settling.informed).
        rig: cameras of the evidence.
        config: what it was made with.

    Returns:
        By factor: "projection/<camera>" per camera, "symmetry" and "motion"; NaN where a joint has no such factor.
        Several bones of one joint add up as the root of the sum of squares. The motion factors' velocities are
        eliminated: their residual is that of positions alone.
    """
    residuals = _projection(trajectory, evidence)
    if config.symmetry.form != "none":
        residuals["symmetry"] = _symmetry(trajectory, config)
    if config.motion.model != "none":
        residuals["motion"] = _motion(trajectory, evidence.information(trajectory.positions_m, rig), config)
    return residuals


def _projection(trajectory: Trajectory, evidence: Evidence) -> dict[str, Float[np.ndarray, "frame joint"]]:
    if trajectory.residual_px is None:
        return {}
    whitened = np.where(evidence.detected, trajectory.residual_px / evidence.detection_sigma_px, np.nan)
    return {f"projection/{name}": whitened[:, c] for c, name in enumerate(trajectory.camera_names)}


def _symmetry(trajectory: Trajectory, config: Config) -> Float[np.ndarray, "frame joint"]:
    """Each joint's share in rows that join several; NaN where it has none."""
    rows = _rows(trajectory, config)
    state = BatchState(np.nan_to_num(trajectory.positions_m)[:, None], np.zeros(0))
    residual, _ = rows.whitened(state)
    total = np.zeros(trajectory.status.shape)
    known = np.zeros(total.shape, dtype=bool)
    for joints in rows.slots:
        for row, joint in enumerate(joints.tolist()):
            total[:, joint] += residual[:, row] ** 2
            known[:, joint] |= rows.present[:, row]
    return np.where(known, np.sqrt(total), np.nan)


def _rows(trajectory: Trajectory, config: Config) -> JointRows:
    """The factors on bones, joints numbered as in the skeleton."""
    skeleton, positions_m = trajectory.skeleton, trajectory.positions_m
    active = np.asarray(np.isfinite(positions_m).all(axis=-1))
    if config.symmetry.form == "frame":
        pairs = np.array([(*left, *right) for left, right in skeleton.limb_pairs], dtype=int).reshape(-1, 4)
        return Symmetries(
            pairs.T, np.asarray(active[:, pairs].all(axis=-1)), np.full(len(pairs), config.symmetry.sigma_m)
        )
    bones = skeleton.bone_ends
    lengths_m = trajectory.bone_lengths_m
    lengths_m = median_lengths(skeleton, positions_m) if lengths_m is None else lengths_m
    of_bones_m = lengths_m[list(skeleton.length_of_bone)]
    present = np.asarray(active[:, bones].all(axis=1) & np.isfinite(of_bones_m))
    return KnownLengths(
        bones, present, np.full(len(skeleton.bones), config.symmetry.sigma_m), np.nan_to_num(of_bones_m)
    )


def _motion(
    trajectory: Trajectory, information: Float[np.ndarray, "frame joint"], config: Config
) -> Float[np.ndarray, "frame joint"]:
    """The change that the model does not predict, over its standard deviation; NaN at the ends.

    Random walk: the displacement since the frame before, variance q h. Constant velocity: the change of the mean
    velocity between two intervals h and h', variance q (h + h') / 3 (twice integrated white noise).
    """
    interval_s = np.diff(trajectory.time_s)[:, None]
    whitened = np.full(trajectory.status.shape, np.nan)
    steps_m = np.diff(trajectory.positions_m, axis=0)
    density = process_density(trajectory.positions_m, trajectory.time_s, information, config.motion)
    if config.motion.model == "random_walk":
        sigma_m = np.sqrt(density[1:] * interval_s)
        whitened[1:] = norm(steps_m) / sigma_m
    elif len(interval_s) > 1:
        change_mps = np.diff(steps_m / interval_s[..., None], axis=0)
        variance = density[1:-1] * (interval_s[1:] + interval_s[:-1]) / 3
        whitened[1:-1] = norm(change_mps) / np.sqrt(variance)
    return whitened
