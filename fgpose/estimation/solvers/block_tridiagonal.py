"""Linear algebra of a recording: each frame is coupled with the next one, and all with a few shared unknowns.

The unknowns of a frame are ordered so that those which are coupled over time are neighbours. Then the matrix is a band
that is hardly wider than a block, and one call of LAPACK factorises it: to eliminate frame after frame takes twice as
long. Sets of unknowns that only the shared ones couple come one after the other, each with all of its frames: the band
is then hardly wider than the largest of them, and time grows with the square of its width. The diagonal blocks of the
inverse follow backwards from the factors (Asif and Moura 2005, "Block matrices with L-block-banded inverse").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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
    if not len(factor):
        return np.zeros_like(factor)
    lower, _ = _lapack("potri")(factor.copy(order="F"), lower=1, overwrite_c=1)
    inverse = lower.T
    np.copyto(inverse, lower, where=_below_diagonal(len(lower)))
    return inverse


@cache
def _below_block(size: int, n_rows: int) -> Bool[np.ndarray, "size row"]:
    """Where the columns of a frame (see Band) go on below its block."""
    return np.arange(size)[:, None] + np.arange(n_rows) >= size


@cache
def _below_diagonal(size: int) -> Bool[np.ndarray, "size size"]:
    return np.tri(size, k=-1, dtype=bool)


class Band:
    """Lower half of a symmetric matrix over sets of unknowns and their frames, as LAPACK stores a band: below every
    diagonal entry the rest of its column. Sets are not coupled, and frames between kinds of the same unknown only.

    Args:
        n_frames, n_unknowns, n_kinds: in a frame a set has so many unknowns, each of every kind; ordered by unknown,
            then kind. A set may be empty, but not all.
    """

    def __init__(self, n_frames: int, n_unknowns: Sequence[int], n_kinds: int) -> None:
        self.sizes = tuple(n_kinds * each for each in n_unknowns)
        ends = np.cumsum([n_frames * size for size in self.sizes]).tolist()
        self.spans = tuple(slice(end - n_frames * size, end) for end, size in zip(ends, self.sizes, strict=True))
        """The columns of each set."""
        self.columns: Float[np.ndarray, "unknown row"] = np.zeros((ends[-1], max(self.sizes) + n_kinds))
        self.n_frames, self._n_kinds = n_frames, n_kinds

    def diagonal(self, number: int) -> Float[np.ndarray, "frame size size"]:
        """A view of the blocks of a set. What is written above their diagonals ends in rows that couple fills anew."""
        size, (column, row) = self.sizes[number], self.columns.strides
        shape, strides = (self.n_frames, size, size), (size * column, row, column - row)
        # as_strided takes ten times as long. Views are not kept: of a copy they would be those of the original.
        return np.ndarray(shape, float, self.columns[self.spans[number]], strides=strides)

    def couple(self, couplings: Sequence[Float[np.ndarray, "step _ kind kind"]]) -> None:
        """Set what is between each frame and the next, by set and kind: row of the earlier frame, column of the later
        one."""
        kinds, n_rows = self._n_kinds, self.columns.shape[1]
        for size, span, coupling in zip(self.sizes, self.spans, couplings, strict=True):
            columns = self.columns[span].reshape(self.n_frames, size, n_rows)
            np.copyto(columns, 0.0, where=_below_block(size, n_rows))
            by_kind = columns.reshape(self.n_frames, size // kinds, kinds, n_rows)
            for kind in range(kinds if size else 0):
                by_kind[:-1, :, kind, size - kind : size - kind + kinds] = coupling[:, :, kind]

    def frame_of(self, column: int) -> int:
        number, span = next((n, span) for n, span in enumerate(self.spans) if column < span.stop)
        return (column - span.start) // self.sizes[number]


class BlockTridiagonal:
    """The factorised symmetric positive definite matrix of a recording, bordered by the shared unknowns.

    The shared unknowns are eliminated last.

    Args:
        band: of the frames, with the diagonal blocks only; overwritten, for it is the largest array of a run.
        couplings: of each set, between each frame and the next (Band.couple).
        border: columns of the shared unknowns; its rows, as all unknowns of the frames, in the order of the band.
        corner: block of the shared unknowns.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """

    def __init__(
        self,
        band: Band,
        couplings: Sequence[Float[np.ndarray, "step _ kind kind"]],
        border: Float[np.ndarray, "unknown shared"],
        corner: Float[np.ndarray, "shared shared"],
    ) -> None:
        band.couple(couplings)
        self._band, self._couplings = band, couplings
        self._factor = band.columns.T
        _, failed = _lapack("pbtrf")(self._factor, lower=1, overwrite_ab=1)
        if failed:
            raise np.linalg.LinAlgError(f"the unknowns of frame {band.frame_of(failed - 1)} are indeterminate")
        self._border = self._of_border(border, "N")
        self.shared_covariance = np.linalg.inv(corner - self._border.T @ self._border)
        if (np.diag(self.shared_covariance) < 0).any():
            raise np.linalg.LinAlgError("the shared unknowns are indeterminate")

    def solve(
        self, frames: Float[np.ndarray, " unknown"], shared: Float[np.ndarray, " shared"]
    ) -> tuple[Float[np.ndarray, " unknown"], Float[np.ndarray, " shared"]]:
        """Solution for this right-hand side."""
        reduced = self._triangular(frames[:, None], "N")
        solved = self.shared_covariance @ (shared - self._border.T @ reduced[:, 0])
        return self._triangular(reduced - (self._border @ solved)[:, None], "T")[:, 0], solved

    def shared_responses(self) -> Float[np.ndarray, "unknown shared"]:
        """The inverse between the unknowns of the frames and the shared ones: their covariance, if this is an
        information matrix."""
        return -self._of_border(self._border, "T") @ self.shared_covariance

    def inverse_blocks(self) -> Iterator[tuple[Float[np.ndarray, "size size"], ...]]:
        """Diagonal blocks of the inverse, of each set, from the last frame to the first: the marginal covariance of the
        set in each frame, if this is an information matrix.

        With W_t the inverse of frame t's information given all earlier frames, Sigma_t = W_t + G_t Sigma_{t+1} G_t^T
        with G_t = W_t U_t; then what the shared unknowns add.
        """
        responses = self._of_border(self._border, "T")
        return zip(
            *(self._blocks_of(number, responses[span]) for number, span in enumerate(self._band.spans)), strict=True
        )

    def _blocks_of(
        self, number: int, responses: Float[np.ndarray, "unknown shared"]
    ) -> Iterator[Float[np.ndarray, "size size"]]:
        """Of one set."""
        n_frames, size, coupling = self._band.n_frames, self._band.sizes[number], self._couplings[number]
        used = np.flatnonzero(responses.any(axis=0))
        by_frame, shared = (
            responses[:, used].reshape(n_frames, size, len(used)),
            self.shared_covariance[np.ix_(used, used)],
        )
        later = np.zeros((size, size))
        for t in reversed(range(n_frames)):
            block = self.inverse_given_next(t, number)
            if t < len(coupling):
                by_kind = block.reshape(*coupling.shape[1:3], size)
                gain_transposed = (coupling[t].swapaxes(1, 2) @ by_kind).reshape(size, size)
                block += gain_transposed.T @ later @ gain_transposed
            later = block
            yield block + by_frame[t] @ shared @ by_frame[t].T

    def inverse_given_next(self, t: int, number: int) -> Float[np.ndarray, "size size"]:
        """Of the information on a set in a frame that this and all earlier ones have, its motion to the next one
        included: its covariance, given the next one. The shared unknowns are held."""
        return _inverse_from(self._band.diagonal(number)[t])

    def _of_border(
        self, border: Float[np.ndarray, "unknown shared"], trans: str
    ) -> Float[np.ndarray, "unknown shared"]:
        """Of each set only the columns that are not zero: most of the shared unknowns are those of one set."""
        if not border.any():  # as where the shared unknowns are held
            return border
        solved = np.zeros_like(border)
        for span in self._band.spans:
            used = np.flatnonzero(border[span].any(axis=0))
            solved[span, used] = self._triangular(border[span][:, used], trans, span)
        return solved

    def _triangular(
        self, columns: Float[np.ndarray, "unknown column"], trans: str, span: slice = slice(None)
    ) -> Float[np.ndarray, "unknown column"]:
        """L^{-1} x ("N") or L^{-T} x ("T"), with the matrix L L^T of the frames, or of one set."""
        if not columns.any():  # LAPACK does not take none
            return columns
        solved, _ = _lapack("tbtrs")(self._factor[:, span], columns, uplo="L", trans=trans)
        return solved
