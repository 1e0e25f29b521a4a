from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from fgpose.estimation.solvers.block_tridiagonal import Band, BlockTridiagonal

FRAMES, KINDS, SHARED = 5, 2, 3
SETS = pytest.mark.parametrize("sets", [(6,), (2, 4), (3, 0, 2, 1)], ids=str)
"""How many unknowns there are in each: one, the second larger, one of a joint that is never estimated."""


@dataclass(frozen=True)
class System:
    """Diagonals and couplings by set, border and corner."""

    diagonals: list[np.ndarray]
    couplings: list[np.ndarray]
    border: np.ndarray
    corner: np.ndarray

    def factorized(self) -> BlockTridiagonal:
        kinds = self.couplings[0].shape[-1]
        band = Band(len(self.diagonals[0]), [each.shape[1] // kinds for each in self.diagonals], kinds)
        for number, diagonal in enumerate(self.diagonals):
            band.diagonal(number)[:] = diagonal
        return BlockTridiagonal(band, self.couplings, self.border, self.corner)

    def dense(self) -> np.ndarray:
        """The same matrix, written out block by block."""
        frames = block_diag(*map(dense_of_set, self.diagonals, self.couplings))
        whole = np.block([[frames, self.border], [self.border.T, self.corner]])
        assert np.linalg.eigvalsh(whole).min() > 1
        return whole


def dense_of_set(diagonal: np.ndarray, coupling: np.ndarray) -> np.ndarray:
    size = diagonal.shape[1]
    whole = block_diag(*diagonal)
    for t in range(len(coupling)):
        at, after = slice(t * size, (t + 1) * size), slice((t + 1) * size, (t + 2) * size)
        whole[at, after] = block_diag(*coupling[t]) if size else np.zeros((0, 0))
        whole[after, at] = whole[at, after].T
    return whole


def random_system(sets: tuple[int, ...] = (6,), kinds: int = KINDS, all_kept: bool = False) -> System:
    """Strong on the diagonal, so that the whole is positive definite. The first shared unknown is of the first set
    only, as the lengths of its bones are."""
    rng = np.random.default_rng(0)
    diagonals, couplings = [], []
    for n_unknowns in sets:
        size = kinds * n_unknowns
        root = rng.normal(size=(FRAMES, size, size))
        diagonals.append(root @ root.swapaxes(1, 2) + 20 * np.eye(size))
        strength = rng.uniform(0.2, 2.0, size=(FRAMES - 1, n_unknowns))
        if not all_kept:
            strength[rng.random(strength.shape) > 0.7] = 0.0
            strength[2] = 0.0
        couplings.append(strength[..., None, None] * rng.normal(size=(FRAMES - 1, 1, kinds, kinds)))
    corner_root = rng.normal(size=(SHARED, SHARED))
    corner = corner_root @ corner_root.T + 20 * np.eye(SHARED)
    border = rng.normal(size=(FRAMES * kinds * sum(sets), SHARED))
    border[FRAMES * kinds * sets[0] :, 0] = 0.0
    return System(diagonals, couplings, border, corner)


@SETS
@pytest.mark.parametrize("all_kept", [True, False])
@pytest.mark.parametrize("kinds", [1, 2])
def test_solves_what_the_dense_matrix_solves(kinds: int, all_kept: bool, sets: tuple[int, ...]) -> None:
    system = random_system(sets, kinds, all_kept)
    rng = np.random.default_rng(1)
    frames, shared = rng.normal(size=len(system.border)), rng.normal(size=SHARED)
    expected = np.linalg.solve(system.dense(), np.append(frames, shared))
    # rounding: the condition number is below 100
    np.testing.assert_allclose(np.append(*system.factorized().solve(frames, shared)), expected, atol=1e-13)


@SETS
@pytest.mark.parametrize("all_kept", [True, False])
def test_diagonal_blocks_of_the_inverse_are_those_of_the_dense_inverse(all_kept: bool, sets: tuple[int, ...]) -> None:
    system = random_system(sets, all_kept=all_kept)
    inverse = np.linalg.inv(system.dense())
    for t, blocks in enumerate(reversed(list(system.factorized().inverse_blocks()))):
        first = 0
        for block in blocks:
            at = slice(first + t * len(block), first + (t + 1) * len(block))
            np.testing.assert_allclose(block, inverse[at, at], atol=1e-14)
            first += FRAMES * len(block)


@SETS
def test_responses_are_those_of_the_dense_inverse(sets: tuple[int, ...]) -> None:
    system = random_system(sets)
    expected = np.linalg.inv(system.dense())[:-SHARED, -SHARED:]
    np.testing.assert_allclose(system.factorized().shared_responses(), expected, atol=1e-14)


@pytest.mark.parametrize("kinds", [1, 2])
def test_the_inverse_leaves_the_factors_as_they_are(kinds: int) -> None:
    matrix, rng = random_system((2, 4), kinds).factorized(), np.random.default_rng(1)
    right_hand_side = rng.normal(size=FRAMES * kinds * 6), rng.normal(size=SHARED)
    before, _ = matrix.solve(*right_hand_side)
    assert len(list(matrix.inverse_blocks())) == FRAMES
    np.testing.assert_array_equal(matrix.solve(*right_hand_side)[0], before)


def test_one_frame_without_anything_shared() -> None:
    whole = random_system()
    diagonal = whole.diagonals[0][:1]
    size = diagonal.shape[1]
    system = System([diagonal], [whole.couplings[0][:0]], np.zeros((size, 0)), np.zeros((0, 0)))
    solved, shared = system.factorized().solve(np.ones(size), np.zeros(0))
    np.testing.assert_allclose(solved, np.linalg.solve(diagonal[0], np.ones(size)), atol=1e-14)
    assert shared.shape == (0,)


def test_what_nothing_determines_is_an_error_that_names_the_frame() -> None:
    system = random_system((4, 2))
    system.diagonals[1][2] = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="frame 2"):
        system.factorized()


def test_shared_unknowns_that_nothing_determines_are_an_error() -> None:
    system = replace(random_system(), corner=np.zeros((SHARED, SHARED)))
    with pytest.raises(np.linalg.LinAlgError, match="shared"):
        system.factorized()
