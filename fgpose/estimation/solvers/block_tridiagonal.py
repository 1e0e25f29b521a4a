"""Linear algebra of a recording: each frame is coupled with the next one, and all with a few shared unknowns.

One sweep of Cholesky factorisations forward and one back solves the normal equations in time linear in the number of
frames, and gives the diagonal blocks of their inverse (Asif and Moura 2005, "Block matrices with L-block-banded
inverse").
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Blocks of 100 x 100 are too small to share between cores: threads that wait for each other take 100 times as
    long."""
    import scipy.linalg  # noqa: F401  brings a BLAS of its own, which must be there to be limited

    with threadpool_limits(limits=1, user_api="blas"):
        yield


@dataclass(frozen=True, eq=False)
class Coupling:
    """Blocks U_t between each frame and the next: of each unknown alone, and the same for all of a kind."""

    matrices: Float[np.ndarray, "step kind kind"]
    """By kind of unknown (position, velocity): row of the earlier frame, column of the later one."""
    strength: Float[np.ndarray, "step unknown"]
    """Factor on the matrix for each unknown of every kind; zero where it is not coupled."""

    def to_later(self, step: int, values: np.ndarray) -> np.ndarray:
        """U_t^T x, for x (size, columns) of the earlier frame."""
        return self._apply(self.matrices[step].T, step, values)

    def to_earlier(self, step: int, values: np.ndarray) -> np.ndarray:
        """U_t x, for x (size, columns) of the later frame."""
        return self._apply(self.matrices[step], step, values)

    def _apply(self, matrix: np.ndarray, step: int, values: np.ndarray) -> np.ndarray:
        kinds = len(matrix)
        coupled = (matrix @ values.reshape(kinds, -1)).reshape(kinds, self.strength.shape[1], -1)
        coupled *= self.strength[step][:, None]
        return coupled.reshape(values.shape)

    @cached_property
    def _squares(self) -> Float[np.ndarray, "step kinds2 kinds2"]:
        """kron(U_t^T, U_t^T) of the blocks by kind."""
        products = np.einsum("tka,tlb->tabkl", self.matrices, self.matrices)
        return products.reshape(len(products), *(self.matrices.shape[1] ** 2,) * 2)

    def sandwich(self, step: int, matrix: Float[np.ndarray, "size size"]) -> Float[np.ndarray, "size size"]:
        """U_t^T W U_t. U is so sparse that this is a sum of scaled blocks of W: one small matrix product."""
        kinds, unknowns = self.matrices.shape[1], self.strength.shape[1]
        blocks = matrix.reshape(kinds, unknowns, kinds, unknowns).swapaxes(1, 2).reshape(kinds**2, -1)
        product = (self._squares[step] @ blocks).reshape(kinds, kinds, unknowns, unknowns)
        product *= np.outer(self.strength[step], self.strength[step])
        return product.swapaxes(1, 2).reshape(matrix.shape)


class BlockTridiagonal:
    """The factorised symmetric positive definite matrix of a recording, bordered by the shared unknowns.

    With W_t the inverse of frame t's information given all earlier frames, W_t^{-1} = D_t - U_{t-1}^T W_{t-1} U_{t-1}.
    The shared unknowns are eliminated last: the same sweeps are run on their columns.

    Args:
        diagonal: D_t; overwritten, for it is the largest array of a run.
        coupling: U_t.
        border: columns of the shared unknowns.
        corner: block of the shared unknowns.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """

    def __init__(
        self,
        diagonal: Float[np.ndarray, "frame size size"],
        coupling: Coupling,
        border: Float[np.ndarray, "frame size shared"],
        corner: Float[np.ndarray, "shared shared"],
    ) -> None:
        self._coupling = coupling
        self._inverses = _eliminate(diagonal, coupling)
        self._response = self._sweep(border)
        self._border = border
        self._shared = np.linalg.inv(corner - np.einsum("tsl,tsm->lm", border, self._response))
        if (np.diag(self._shared) < 0).any():
            raise np.linalg.LinAlgError("the shared unknowns are indeterminate")

    def solve(
        self, frames: Float[np.ndarray, "frame size"], shared: Float[np.ndarray, " shared"]
    ) -> tuple[Float[np.ndarray, "frame size"], Float[np.ndarray, " shared"]]:
        """Solution for this right-hand side."""
        alone = self._sweep(frames[..., None])[..., 0]
        solved = self._shared @ (shared - np.einsum("tsl,ts->l", self._border, alone))
        return alone - self._response @ solved, solved

    def inverse_blocks(self) -> Float[np.ndarray, "frame size size"]:
        """Diagonal blocks of the inverse: the marginal covariance of each frame, if this is an information matrix.

        Backwards, Sigma_t = W_t + G_t Sigma_{t+1} G_t^T with G_t = W_t U_t; then what the shared unknowns add.
        Takes the place of the factorisation, for want of memory: nothing can be solved afterwards.
        """
        blocks = self._inverses
        del self._inverses
        for t in reversed(range(len(blocks) - 1)):
            gain_transposed = self._coupling.to_later(t, blocks[t])
            blocks[t] += gain_transposed.T @ blocks[t + 1] @ gain_transposed
        for block, response in zip(blocks, self._response, strict=True):
            block += response @ self._shared @ response.T
        return blocks

    def _sweep(self, columns: Float[np.ndarray, "frame size column"]) -> Float[np.ndarray, "frame size column"]:
        """Solution for these columns without the shared unknowns."""
        solved = np.empty_like(columns)
        inverses, coupling = self._inverses, self._coupling
        for t, column in enumerate(columns):
            reduced = column if t == 0 else column - coupling.to_later(t - 1, solved[t - 1])
            np.matmul(inverses[t], reduced, out=solved[t])
        for t in reversed(range(len(columns) - 1)):
            solved[t] -= inverses[t] @ coupling.to_earlier(t, solved[t + 1])
        return solved


def _eliminate(
    diagonal: Float[np.ndarray, "frame size size"], coupling: Coupling
) -> Float[np.ndarray, "frame size size"]:
    """W_t of every frame, in place of D_t."""
    from scipy.linalg import get_lapack_funcs  # takes half of the import time of fgpose

    potrf, potri = get_lapack_funcs(("potrf", "potri"), dtype=float)
    below = np.tri(diagonal.shape[1], k=-1, dtype=bool)
    for t, block in enumerate(diagonal):
        if t and coupling.strength[t - 1].any():
            block -= coupling.sandwich(t - 1, diagonal[t - 1])
        # Of a C-ordered block, LAPACK's "lower" is the upper triangle; potri needs two thirds of a general inverse.
        _, failed = potrf(block.T, lower=1, clean=0, overwrite_a=1)
        if failed:
            raise np.linalg.LinAlgError(f"the unknowns of frame {t} are indeterminate")
        potri(block.T, lower=1, overwrite_c=1)
        np.copyto(block, block.T, where=below)
    return diagonal
