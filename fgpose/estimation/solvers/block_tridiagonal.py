"""Linear algebra of a recording: each frame is coupled with the next one, and all with a few shared unknowns.

The unknowns of a frame are ordered so that those which are coupled over time are neighbours. Then the matrix is a band
that is hardly wider than a block, and one call of LAPACK factorises it: to eliminate frame after frame takes twice as
long. The diagonal blocks of the inverse follow backwards from the factors (Asif and Moura 2005, "Block matrices with
L-block-banded inverse").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Blocks of 100 x 100 are too small to share between cores: threads that wait for each other take 100 times as
    long."""
    with blas_libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def blas_libraries() -> ThreadpoolController:
    """Those of numpy and scipy. To import scipy takes 0.2 s, and to look for them as long as some factorisations."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()


@cache
def _lapack(name: str) -> Callable[..., tuple[np.ndarray, int]]:
    """A routine for double precision. To import scipy takes half of the import time of fgpose."""
    from scipy.linalg import get_lapack_funcs

    (routine,) = get_lapack_funcs((name,), dtype=float)
    return routine


def _inverse_from(factor: Float[np.ndarray, "size size"]) -> Float[np.ndarray, "size size"]:
    """The inverse of L L^T, given L."""
    lower, _ = _lapack("potri")(factor.copy(order="F"), lower=1, overwrite_c=1)
    inverse = lower.T
    np.copyto(inverse, lower, where=_below_diagonal(len(lower)))
    return inverse


@cache
def _below_block(size: int, n_kinds: int) -> Bool[np.ndarray, "size row"]:
    """Where the columns of a frame (see Band) go on below its block."""
    return np.arange(size)[:, None] + np.arange(size + n_kinds) >= size


@cache
def _below_diagonal(size: int) -> Bool[np.ndarray, "size size"]:
    return np.tri(size, k=-1, dtype=bool)


class Band:
    """Lower half of a symmetric matrix over frames, as LAPACK stores a band: below every diagonal entry the rest of its
    column. Frames are coupled between kinds of the same unknown only.

    Args:
        n_frames, n_unknowns, n_kinds: a frame has every unknown of every kind, ordered by unknown, then kind.
    """

    def __init__(self, n_frames: int, n_unknowns: int, n_kinds: int) -> None:
        self.size, self._n_kinds = n_unknowns * n_kinds, n_kinds
        self.columns: Float[np.ndarray, "frame size row"] = np.zeros((n_frames, self.size, self.size + n_kinds))

    @property
    def diagonal(self) -> Float[np.ndarray, "frame size size"]:
        """A view of the frames' blocks. What is written above their diagonals ends in rows that couple fills anew."""
        frame, column, row = self.columns.strides
        shape, strides = (len(self.columns), self.size, self.size), (frame, row, column - row)
        return np.ndarray(shape, float, self.columns, strides=strides)  # as_strided takes ten times as long

    def couple(self, coupling: Float[np.ndarray, "step unknown kind kind"]) -> None:
        """Set what is between each frame and the next, by kind: row of the earlier frame, column of the later one."""
        size, kinds = self.size, self._n_kinds
        np.copyto(self.columns, 0.0, where=_below_block(size, kinds))
        by_kind = self.columns.reshape(len(self.columns), -1, kinds, size + kinds)
        for kind in range(kinds):
            by_kind[:-1, :, kind, size - kind : size - kind + kinds] = coupling[:, :, kind]


class BlockTridiagonal:
    """The factorised symmetric positive definite matrix of a recording, bordered by the shared unknowns.

    The shared unknowns are eliminated last.

    Args:
        band: of the frames, with the diagonal blocks only; overwritten, for it is the largest array of a run.
        coupling: between each frame and the next (Band.couple).
        border: columns of the shared unknowns.
        corner: block of the shared unknowns.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """

    def __init__(
        self,
        band: Band,
        coupling: Float[np.ndarray, "step unknown kind kind"],
        border: Float[np.ndarray, "frame size shared"],
        corner: Float[np.ndarray, "shared shared"],
    ) -> None:
        band.couple(coupling)
        self._band, self._coupling = band, coupling
        self._factor = band.columns.reshape(-1, band.columns.shape[-1]).T
        _, failed = _lapack("pbtrf")(self._factor, lower=1, overwrite_ab=1)
        if failed:
            raise np.linalg.LinAlgError(f"the unknowns of frame {(failed - 1) // band.size} are indeterminate")
        self._border = self._halfway(border.reshape(self._factor.shape[1], len(corner)))
        self.shared_covariance = np.linalg.inv(corner - self._border.T @ self._border)
        if (np.diag(self.shared_covariance) < 0).any():
            raise np.linalg.LinAlgError("the shared unknowns are indeterminate")

    def solve(
        self, frames: Float[np.ndarray, "frame size"], shared: Float[np.ndarray, " shared"]
    ) -> tuple[Float[np.ndarray, "frame size"], Float[np.ndarray, " shared"]]:
        """Solution for this right-hand side."""
        reduced = self._halfway(frames.reshape(-1, 1))
        solved = self.shared_covariance @ (shared - self._border.T @ reduced[:, 0])
        return self._back(reduced - (self._border @ solved)[:, None]).reshape(frames.shape), solved

    def shared_responses(self) -> Float[np.ndarray, "frame size shared"]:
        """The inverse between the unknowns of the frames and the shared ones: their covariance, if this is an
        information matrix."""
        responses = -self._back(self._border) @ self.shared_covariance
        return responses.reshape(len(self._band.diagonal), self._band.size, len(self.shared_covariance))

    def inverse_blocks(self) -> Iterator[Float[np.ndarray, "size size"]]:
        """Diagonal blocks of the inverse, from the last frame to the first: the marginal covariance of each frame, if
        this is an information matrix.

        With W_t the inverse of frame t's information given all earlier frames, Sigma_t = W_t + G_t Sigma_{t+1} G_t^T
        with G_t = W_t U_t; then what the shared unknowns add.
        """
        factors, size = self._band.diagonal, self._band.size
        responses = self._back(self._border).reshape(len(factors), size, len(self.shared_covariance))
        later = np.zeros((size, size))
        for t in reversed(range(len(factors))):
            block = self.inverse_given_next(t)
            if t < len(self._coupling):
                by_kind = block.reshape(*self._coupling.shape[1:3], size)
                gain_transposed = (self._coupling[t].swapaxes(1, 2) @ by_kind).reshape(size, size)
                block += gain_transposed.T @ later @ gain_transposed
            later = block
            yield block + responses[t] @ self.shared_covariance @ responses[t].T

    def inverse_given_next(self, t: int) -> Float[np.ndarray, "size size"]:
        """Of the information on a frame that it and all earlier ones have, its motion to the next one included: its
        covariance, given the next one. The shared unknowns are held."""
        return _inverse_from(self._band.diagonal[t])

    def _halfway(self, columns: Float[np.ndarray, "unknown column"]) -> Float[np.ndarray, "unknown column"]:
        """L^{-1} x, with the matrix L L^T of the frames."""
        return self._triangular(columns, "N")

    def _back(self, columns: Float[np.ndarray, "unknown column"]) -> Float[np.ndarray, "unknown column"]:
        """L^{-T} x."""
        return self._triangular(columns, "T")

    def _triangular(self, columns: np.ndarray, trans: str) -> np.ndarray:
        if not columns.any():  # as where the shared unknowns are held; and LAPACK does not take none
            return columns
        solved, _ = _lapack("tbtrs")(self._factor, columns, uplo="L", trans=trans)
        return solved
