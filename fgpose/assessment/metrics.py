"""How good a pose is: the errors that the field reports, by their published definitions.

Missing is NaN. A joint that is missing in the estimate or in the reference counts in no mean; share_missing tells how
much was left out, without which no mean should be reported. A mean of nothing is NaN.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.geometry.rigid import nearest_rotation
from fgpose.sampling import parts_of
from fgpose.skeleton import Skeleton

# Fewer points leave the rotation undetermined.
_MIN_PROCRUSTES_JOINTS = 3


def joint_errors_m(
    estimate_m: Float[np.ndarray, "*frames joint 3"],
    reference_m: Float[np.ndarray, "*frames joint 3"],
    root: tuple[int, ...] | None = None,
) -> Float[np.ndarray, "*frames joint"]:
    """Distance of every joint from its reference, metres; NaN where either is missing.

    Args:
        root: joints whose mean is subtracted from both sides first (root-relative); None: absolute. A frame whose root
            is missing on either side is NaN.

    Raises:
        ValueError: the shapes differ.
    """
    return np.linalg.norm(_difference(estimate_m, reference_m, root), axis=-1)


def _difference(
    estimate_m: np.ndarray, reference_m: np.ndarray, root: tuple[int, ...] | None = None
) -> Float[np.ndarray, "*frames joint 3"]:
    if estimate_m.shape != reference_m.shape:
        raise ValueError(f"estimate and reference must have one shape, got {estimate_m.shape} and {reference_m.shape}")
    difference_m = estimate_m - reference_m
    if root is None:
        return difference_m
    return difference_m - difference_m[..., list(root), :].mean(axis=-2, keepdims=True)


def mean_known(values: Float[np.ndarray, "*shape"], axis: int | None = None) -> Float[np.ndarray, "*reduced"]:
    """Mean of the values that are not NaN, over one axis or all; NaN where there are none.

    Of joint_errors_m: axis=0 gives the mean error of each joint, axis=1 that of each frame.
    """
    known = ~np.isnan(values)
    counts = np.asarray(known.sum(axis=axis))
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.divide(total, counts, out=np.full(counts.shape, np.nan), where=counts > 0)


def share_missing(values: Float[np.ndarray, "*shape"]) -> float:
    """Share of the values that are NaN, in [0, 1]: what a mean of them has left out."""
    return float(np.isnan(values).mean()) if values.size else 0.0


def mpjpe_m(
    estimate_m: Float[np.ndarray, "*frames joint 3"],
    reference_m: Float[np.ndarray, "*frames joint 3"],
    root: tuple[int, ...] | None = None,
) -> float:
    """Mean per-joint position error (Ionescu et al., Human3.6M, 2014), metres: over all joints and frames known.

    Args:
        root: as in joint_errors_m; the error relative to the root is Human3.6M's protocol 1.
    """
    return float(mean_known(joint_errors_m(estimate_m, reference_m, root)))


def procrustes_aligned_m(
    estimate_m: Float[np.ndarray, "frame joint 3"], reference_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, "frame joint 3"]:
    """The estimate after the similarity transform (rotation, translation, scale; no reflection) that brings each frame
    closest to its reference in the least-squares sense (Umeyama, 1991).

    The transform is fitted to the joints known on both sides. NaN in frames where these are fewer than three or
    coincide.
    """
    known = np.isfinite(_difference(estimate_m, reference_m)).all(axis=-1, keepdims=True)
    counts = known.sum(axis=1, keepdims=True)
    enough = counts[:, 0, 0] >= _MIN_PROCRUSTES_JOINTS
    centred, centres = [], []
    for points_m in (estimate_m, reference_m):
        filled = np.where(known, points_m, 0.0)
        centre = filled.sum(axis=1, keepdims=True) / np.maximum(counts, 1)
        centres.append(centre)
        centred.append(np.where(known, filled - centre, 0.0))
    source, target = centred
    R, values = nearest_rotation(target.swapaxes(1, 2) @ source)
    spread = (source**2).sum(axis=(1, 2))
    fitted = enough & (spread > 0)
    scale = np.divide(values.sum(axis=1), spread, out=np.full(len(spread), np.nan), where=fitted)
    return scale[:, None, None] * (estimate_m - centres[0]) @ R.swapaxes(1, 2) + centres[1]


def pa_mpjpe_m(
    estimate_m: Float[np.ndarray, "frame joint 3"], reference_m: Float[np.ndarray, "frame joint 3"]
) -> float:
    """MPJPE after Procrustes alignment of every frame (Human3.6M's protocol 2), metres: the error of shape alone."""
    return mpjpe_m(procrustes_aligned_m(estimate_m, reference_m), reference_m)


def pck(errors_m: Float[np.ndarray, "*shape"], threshold_m: float = 0.15) -> float:
    """Percentage of correct keypoints in 3D (Mehta et al., 2017) as a share in [0, 1]: errors of at most a threshold.

    Their threshold is 150 mm and their errors are root-relative; absolute ones are as good an argument.
    """
    return float(mean_known(np.where(np.isnan(errors_m), np.nan, errors_m <= threshold_m)))


def _derivative(
    positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"], order: int
) -> Float[np.ndarray, "window joint 3"]:
    """Finite difference over each order + 1 consecutive frames, as divided differences: exact for polynomials of that
    degree whatever the spacing of the frames."""
    result = positions_m
    for level in range(1, min(order, len(time_s) - 1) + 1):
        interval_s = time_s[level:] - time_s[:-level]
        result = level * np.diff(result, axis=0) / interval_s[:, None, None]
    return result if len(time_s) > order else np.empty((0, *positions_m.shape[1:]))


def jitter_mps3(positions_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " frame"]) -> float:
    """Mean magnitude of the third derivative of position (jerk), m/s^3 (Yi et al., TransPose, 2021).

    Over all joints and windows of four consecutive known frames. Human motion itself has some: compare with the
    reference's.
    """
    total_mps3, n_known = 0.0, 0
    for part in parts_of(max(len(time_s) - 3, 0)):
        around = slice(part.start, part.stop + 3)
        jerk_mps3 = np.linalg.norm(_derivative(positions_m[around], time_s[around], 3), axis=-1)
        known = ~np.isnan(jerk_mps3)
        total_mps3, n_known = total_mps3 + float(jerk_mps3[known].sum()), n_known + int(known.sum())
    return total_mps3 / n_known if n_known else np.nan


def acceleration_error_mps2(
    estimate_m: Float[np.ndarray, "frame joint 3"],
    reference_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
) -> float:
    """Mean magnitude of the difference of the accelerations, m/s^2 (Kanazawa et al., 2019).

    Second differences of three consecutive known frames. Given frame numbers for time_s it is in metres per frame^2;
    Kanazawa et al. report millimetres per frame^2.
    """
    difference_m = _difference(estimate_m, reference_m)
    return float(mean_known(np.linalg.norm(_derivative(difference_m, time_s, 2), axis=-1)))


def bone_length_spread_m(
    skeleton: Skeleton, positions_m: Float[np.ndarray, "frame joint 3"]
) -> Float[np.ndarray, " bone"]:
    """Standard deviation over time of the length of every bone, metres; NaN where it is known in fewer than two frames.

    A rigid body has none.
    """
    lengths_m = skeleton.bone_lengths(positions_m)
    variance_m2 = mean_known((lengths_m - mean_known(lengths_m, axis=0)) ** 2, axis=0)
    return np.where(np.isfinite(lengths_m).sum(axis=0) >= 2, np.sqrt(variance_m2), np.nan)


def nees(
    errors_m: Float[np.ndarray, "*points 3"], covariance_m2: Float[np.ndarray, "*points 3 3"]
) -> Float[np.ndarray, "*points"]:
    """Normalised estimation error squared e' P^-1 e (Bar-Shalom et al., 2001) of every point.

    Its expectation is 3 where the covariance is right; more: overconfident. NaN where the error is missing or the
    covariance is missing or not positive definite.
    """
    result = np.full(errors_m.shape[:-1], np.nan)
    known = np.asarray(np.isfinite(errors_m).all(axis=-1)) & np.isfinite(covariance_m2).all(axis=(-2, -1))
    known[known] = np.linalg.eigvalsh(covariance_m2[known])[:, 0] > 0
    whitened = np.linalg.solve(covariance_m2[known], errors_m[known][..., None])[..., 0]
    result[known] = (errors_m[known] * whitened).sum(axis=-1)
    return result


def coverage(
    errors_m: Float[np.ndarray, "*points 3"], covariance_m2: Float[np.ndarray, "*points 3 3"], probability: float = 0.95
) -> float:
    """Share of the errors inside the ellipsoid that should hold them with this probability: equal to it where the
    covariance is right, less where it is overconfident. What nees leaves out is left out."""
    from scipy.stats import chi2

    squared = nees(errors_m, covariance_m2)
    return float(mean_known(np.where(np.isnan(squared), np.nan, squared <= chi2.ppf(probability, df=3))))
