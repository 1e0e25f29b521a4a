from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag

from fgpose.estimation.solvers.block_tridiagonal import Band, BlockTridiagonal

FRAMES, KINDS, UNKNOWNS, SHARED = 5, 2, 6, 3
SIZE = KINDS * UNKNOWNS


def random_system(kinds: int = KINDS, all_kept: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Diagonal, coupling, border and corner. Strong on the diagonal, so that the whole is positive definite."""
    rng = np.random.default_rng(0)
    size = kinds * UNKNOWNS
    root = rng.normal(size=(FRAMES, size, size))
    diagonal = root @ root.swapaxes(1, 2) + 20 * np.eye(size)
    strength = rng.uniform(0.2, 2.0, size=(FRAMES - 1, UNKNOWNS))
    if not all_kept:
        strength[rng.random(strength.shape) > 0.7] = 0.0
        strength[2] = 0.0
    coupling = strength[..., None, None] * rng.normal(size=(FRAMES - 1, 1, kinds, kinds))
    corner_root = rng.normal(size=(SHARED, SHARED))
    corner = corner_root @ corner_root.T + 20 * np.eye(SHARED)
    return diagonal, coupling, rng.normal(size=(FRAMES, size, SHARED)), corner


def factorized(diagonal: np.ndarray, coupling: np.ndarray, border: np.ndarray, corner: np.ndarray) -> BlockTridiagonal:
    kinds = coupling.shape[-1]
    band = Band(len(diagonal), diagonal.shape[1] // kinds, kinds)
    band.diagonal[:] = diagonal
    return BlockTridiagonal(band, coupling, border, corner)


def dense(diagonal: np.ndarray, coupling: np.ndarray, border: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """The same matrix, written out block by block."""
    n_frames, size = diagonal.shape[:2]
    whole = np.zeros((n_frames * size + len(corner),) * 2)
    for t in range(n_frames):
        at = slice(t * size, (t + 1) * size)
        whole[at, at] = diagonal[t]
        whole[at, n_frames * size :] = border[t]
        whole[n_frames * size :, at] = border[t].T
        if t < n_frames - 1:
            after = slice((t + 1) * size, (t + 2) * size)
            whole[at, after] = block_diag(*coupling[t])
            whole[after, at] = block_diag(*coupling[t]).T
    whole[n_frames * size :, n_frames * size :] = corner
    assert np.linalg.eigvalsh(whole).min() > 1
    return whole


@pytest.mark.parametrize("all_kept", [True, False])
@pytest.mark.parametrize("kinds", [1, 2])
def test_solves_what_the_dense_matrix_solves(kinds: int, all_kept: bool) -> None:
    system = random_system(kinds, all_kept)
    whole = dense(*system)
    rng = np.random.default_rng(1)
    frames, shared = rng.normal(size=(FRAMES, kinds * UNKNOWNS)), rng.normal(size=SHARED)
    expected = np.linalg.solve(whole, np.concatenate([frames.ravel(), shared]))
    solved, solved_shared = factorized(*system).solve(frames, shared)
    # rounding: the condition number is below 100
    np.testing.assert_allclose(np.concatenate([solved.ravel(), solved_shared]), expected, atol=1e-13)


@pytest.mark.parametrize("all_kept", [True, False])
def test_diagonal_blocks_of_the_inverse_are_those_of_the_dense_inverse(all_kept: bool) -> None:
    system = random_system(all_kept=all_kept)
    inverse = np.linalg.inv(dense(*system))
    for t, block in enumerate(reversed(list(factorized(*system).inverse_blocks()))):
        at = slice(t * SIZE, (t + 1) * SIZE)
        np.testing.assert_allclose(block, inverse[at, at], atol=1e-14)


@pytest.mark.parametrize("kinds", [1, 2])
def test_the_inverse_leaves_the_factors_as_they_are(kinds: int) -> None:
    matrix, rng = factorized(*random_system(kinds)), np.random.default_rng(1)
    right_hand_side = rng.normal(size=(FRAMES, kinds * UNKNOWNS)), rng.normal(size=SHARED)
    before, _ = matrix.solve(*right_hand_side)
    assert len(list(matrix.inverse_blocks())) == FRAMES
    np.testing.assert_array_equal(matrix.solve(*right_hand_side)[0], before)


def test_one_frame_without_anything_shared() -> None:
    diagonal, coupling, border, corner = random_system()
    system = factorized(diagonal[:1], coupling[:0], border[:1, :, :0], corner[:0, :0])
    solved, shared = system.solve(np.ones((1, SIZE)), np.zeros(0))
    np.testing.assert_allclose(solved[0], np.linalg.solve(diagonal[0], np.ones(SIZE)), atol=1e-14)
    assert shared.shape == (0,)


def test_what_nothing_determines_is_an_error_that_names_the_frame() -> None:
    diagonal, coupling, border, corner = random_system()
    diagonal[2] = 0.0
    with pytest.raises(np.linalg.LinAlgError, match="frame 2"):
        factorized(diagonal, coupling, border, corner)


def test_shared_unknowns_that_nothing_determines_are_an_error() -> None:
    diagonal, coupling, border, _ = random_system()
    with pytest.raises(np.linalg.LinAlgError, match="shared"):
        factorized(diagonal, coupling, border, np.zeros((SHARED, SHARED)))
