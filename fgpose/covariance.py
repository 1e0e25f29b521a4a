"""Marginal covariances of all joints in all frames, by the block-tridiagonal structure of a recording.

GTSAM's Marginals take about a millisecond a key. The information matrix of a recording couples a frame only with the
next one, apart from a few bone lengths that are shared by all frames; one sweep forward and one back gives all
diagonal blocks of its inverse (Asif and Moura 2005, "Block matrices with L-block-banded inverse").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int
from threadpoolctl import threadpool_limits

if TYPE_CHECKING:  # scipy takes half of the import time of fgpose, and few runs ask for covariances
    import scipy.sparse

_INDETERMINATE = "the linear system is indeterminate: a joint is not held by any factor"


def marginal_covariances(
    linear: gtsam.GaussianFactorGraph, active: Bool[np.ndarray, "frame joint"], *, with_velocity: bool
) -> Float[np.ndarray, "frame joint 3 3"]:
    """Covariance of every active joint's position, m^2; NaN elsewhere.

    Args:
        linear: the linearised graph at the solution. Keys sort as in fgpose.keys.
        active: which joints have variables in which frame.
        with_velocity: whether they also have a velocity.

    Raises:
        ValueError: the system is indeterminate.
    """
    n_states = int(active.sum()) * (6 if with_velocity else 3)
    if n_states == 0:
        return np.full((*active.shape, 3, 3), np.nan)
    n_lengths = _n_lengths(linear, n_states)
    information = _information(linear, n_lengths + n_states)
    frame_of, slot_of = _layout(active, with_velocity)
    diagonal, upper = _blocks(
        information[n_lengths:][:, n_lengths:], frame_of, slot_of, *_block_shape(active, with_velocity)
    )
    border = _scatter_rows(information[n_lengths:][:, :n_lengths].toarray(), frame_of, slot_of, diagonal.shape[:2])
    corner = information[:n_lengths][:, :n_lengths].toarray()
    # Blocks of 100 x 100 are too small to share between cores: threads that wait for each other take 100 times as long.
    with threadpool_limits(limits=1, user_api="blas"):
        marginals = _marginal_blocks(diagonal, upper, border, corner)
    covariance_m2 = np.full((*active.shape, 3, 3), np.nan)
    for frame in range(len(active)):
        joints = np.flatnonzero(active[frame])
        for slot, joint in enumerate(joints):
            covariance_m2[frame, joint] = marginals[frame, 3 * slot : 3 * slot + 3, 3 * slot : 3 * slot + 3]
    return covariance_m2


def _n_lengths(linear: gtsam.GaussianFactorGraph, n_states: int) -> int:
    keys = gtsam.Ordering.NaturalGaussianFactorGraph(linear)  # sorted, and unlike linear.keys() it can be read
    n_lengths = sum(gtsam.symbolChr(keys.at(index)) == ord("l") for index in range(keys.size()))
    if 3 * (keys.size() - n_lengths) != n_states:
        raise ValueError(_INDETERMINATE)
    return n_lengths


def _information(linear: gtsam.GaussianFactorGraph, n_variables: int) -> scipy.sparse.csr_matrix:
    """A^T A of the linear system, columns in key order: lengths, velocities, positions."""
    import scipy.sparse

    row, column, value = linear.sparseJacobian_()
    row, column = row.astype(int) - 1, column.astype(int) - 1
    keep = column < n_variables  # behind them is the right-hand side, of which GTSAM leaves out what is zero
    A = scipy.sparse.csr_matrix((value[keep], (row[keep], column[keep])), shape=(int(row.max()) + 1, n_variables))
    return (A.T @ A).tocsr()


def _block_shape(active: np.ndarray, with_velocity: bool) -> tuple[int, int]:
    return len(active), int(active.sum(axis=1).max(initial=0)) * (6 if with_velocity else 3)


def _layout(active: np.ndarray, with_velocity: bool) -> tuple[Int[np.ndarray, " state"], Int[np.ndarray, " state"]]:
    """Frame, and place within the frame's block, of each state in key order; positions come first in a block."""
    frame, _ = np.nonzero(active)
    rank = np.concatenate([np.arange(count) for count in active.sum(axis=1)]) if len(frame) else np.zeros(0, int)
    position = (3 * rank[:, None] + np.arange(3)).ravel()
    frames = np.repeat(frame, 3)
    if not with_velocity:
        return frames, position
    offset = 3 * active.sum(axis=1)[frames]
    return np.concatenate([frames, frames]), np.concatenate([offset + position, position])


def _blocks(
    information: scipy.sparse.csr_matrix, frame_of: np.ndarray, slot_of: np.ndarray, n_frames: int, size: int
) -> tuple[Float[np.ndarray, "frame size size"], Float[np.ndarray, "frame size size"]]:
    """Diagonal blocks, and blocks to the next frame; places that a frame does not use are an identity."""
    entries = information.tocoo()
    row, column = entries.row, entries.col
    from_frame, to_frame = frame_of[row], frame_of[column]
    diagonal = np.zeros((n_frames, size, size))
    upper = np.zeros((n_frames, size, size))
    same, following = from_frame == to_frame, to_frame == from_frame + 1
    diagonal[from_frame[same], slot_of[row[same]], slot_of[column[same]]] = entries.data[same]
    upper[from_frame[following], slot_of[row[following]], slot_of[column[following]]] = entries.data[following]
    unused = np.ones((n_frames, size), dtype=bool)
    unused[frame_of, slot_of] = False
    frame, slot = np.nonzero(unused)
    diagonal[frame, slot, slot] = 1.0
    return diagonal, upper


def _scatter_rows(rows: np.ndarray, frame_of: np.ndarray, slot_of: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    blocks = np.zeros((*shape, rows.shape[1]))
    blocks[frame_of, slot_of] = rows
    return blocks


def _marginal_blocks(
    diagonal: Float[np.ndarray, "frame size size"],
    upper: Float[np.ndarray, "frame size size"],
    border: Float[np.ndarray, "frame size length"],
    corner: Float[np.ndarray, "length length"],
) -> Float[np.ndarray, "frame size size"]:
    """Diagonal blocks of the inverse of the bordered block-tridiagonal matrix.

    With S the information of a frame given all earlier ones: S_t = D_t - U_{t-1}^T S_{t-1}^{-1} U_{t-1}, and backwards
    Sigma_t = S_t^{-1} + G_t Sigma_{t+1} G_t^T with G_t = S_t^{-1} U_t. The border (the shared lengths) is eliminated
    by the same sweeps, its Schur complement adds Y_t Sigma_L Y_t^T. Overwrites its arguments.
    """
    from scipy.linalg import get_lapack_funcs

    potrf, potri = get_lapack_funcs(("potrf", "potri"), dtype=float)

    def inverse(matrix: np.ndarray) -> np.ndarray:
        """Inverse of a symmetric positive definite matrix from its Cholesky factor: half the work of a general one."""
        factor, failed = potrf(matrix, lower=1)
        if failed:
            raise ValueError(_INDETERMINATE)
        lower, _ = potri(factor, lower=1)
        return np.tril(lower) + np.tril(lower, -1).T

    n_frames = len(diagonal)
    inverses, gains = diagonal, upper  # in place: they are the largest arrays of a run, up to a gigabyte
    reduced = border.copy()
    for t in range(n_frames):
        inverses[t] = inverse(diagonal[t])
        gain = inverses[t] @ upper[t]
        if t < n_frames - 1:
            diagonal[t + 1] -= upper[t].T @ gain
            reduced[t + 1] -= gain.T @ reduced[t]
        gains[t] = gain
    response = np.empty_like(border)
    for t in reversed(range(n_frames)):
        response[t] = inverses[t] @ reduced[t]
        if t < n_frames - 1:
            response[t] -= gains[t] @ response[t + 1]
            inverses[t] += gains[t] @ inverses[t + 1] @ gains[t].T
    if border.shape[2]:
        lengths = inverse(corner - np.einsum("tsl,tsm->lm", border, response))
        for t in range(n_frames):
            inverses[t] += response[t] @ lengths @ response[t].T
    return inverses
