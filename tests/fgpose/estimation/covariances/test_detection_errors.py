"""What the views of a frame contradict each other by, and the components of errors that follow."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.covariances.detection_errors import ErrorProducts, Parity, lags_of, share_of_visible
from fgpose.estimation.covariances.variance_components import TIMES_S, ErrorComponents
from fgpose_benchmarks.synthetic.noise import correlated_normal

STEP_S = 0.02
FRAMES = 250
SHAPE = (FRAMES, 4, 6)  # frame, camera, joint


def jacobians(rng: np.random.Generator) -> np.ndarray:
    """Of four cameras that see the joints from everywhere."""
    return np.broadcast_to(rng.standard_normal((1, *SHAPE[1:], 2, 3)), (*SHAPE, 2, 3))


def components(errors: np.ndarray, jacobian: np.ndarray) -> ErrorComponents:
    lags = lags_of(FRAMES, STEP_S)
    parity = Parity.of(errors, jacobian, np.ones(SHAPE, dtype=bool))
    return ErrorComponents.of(ErrorProducts.of(parity, lags, np.arange(FRAMES)), lags * STEP_S, STEP_S)


def test_a_move_of_the_joint_is_in_no_parity_space() -> None:
    rng = np.random.default_rng(0)
    jacobian, errors = jacobians(rng), rng.standard_normal((*SHAPE, 2))
    known = np.ones(SHAPE, dtype=bool)
    known[:, 3, 0] = False
    moved = errors + np.einsum("tcjia,tja->tcji", jacobian, rng.standard_normal((FRAMES, 6, 3)))
    before, after = (Parity.of(e, jacobian, known).residual for e in (errors, moved))
    np.testing.assert_allclose(before, after, atol=1e-6)  # the information is regularised by 1e-9 of its trace


def test_the_variances_and_times_of_errors_are_found() -> None:
    """Of 6 joints in 4 views for 5 s; a variance is known to 10 % if errors are white, to 30 % if they last."""
    rng = np.random.default_rng(0)
    white, lasting = rng.standard_normal((*SHAPE, 2)), correlated_normal(rng, (*SHAPE, 2), 1 / STEP_S, 0.5)
    found = components(white + 2 * lasting, jacobians(rng)).variances.mean(axis=0)
    assert found[0] == pytest.approx(1.0, rel=0.3)
    assert found[1:].sum() == pytest.approx(4.0, rel=0.3)
    assert found[TIMES_S.index(0.5) :].sum() > 0.6 * found[1:].sum()


def test_joints_that_err_more_are_found_and_equal_ones_stay_equal() -> None:
    rng = np.random.default_rng(0)
    errors, jacobian = rng.standard_normal((*SHAPE, 2)), jacobians(rng)
    equal = components(errors, jacobian).variances.sum(axis=1)
    assert equal.max() < 1.1 * equal.min()
    differing = components(errors * np.array([3.0, 1, 1, 1, 1, 1])[:, None], jacobian).variances.sum(axis=1)
    # A standard deviation of 3; white errors of 250 frames are known to 10 %, shrunk towards the others by less.
    assert differing[0] == pytest.approx(9.0, rel=0.25)
    assert differing[1:].max() < 1.5


def test_errors_that_differ_by_the_axis_of_the_image_are_found() -> None:
    """Hips err sideways; and vertical errors tell nothing of horizontal ones where views contradict each other
    vertically alone."""
    rng = np.random.default_rng(0)
    errors, jacobian = rng.standard_normal((*SHAPE, 2)), jacobians(rng)
    equal = components(errors, jacobian).axes
    np.testing.assert_allclose(equal, 1.0, atol=0.2)  # 1,250 dimensions of each joint, of which one axis has half
    errors[:, :, 0, 0] *= 2.0
    sideways, up = components(errors, jacobian).axes[0]
    assert sideways / up == pytest.approx(4.0, rel=0.3)
    forwards = np.array([[[1.0, 0, 0], [0, 0, 1.0]], [[0, 1.0, 0], [0, 0, 1.0]]])  # two cameras at a right angle
    two = Parity.of(
        errors[:, :2],
        np.broadcast_to(forwards[None, :, None], (FRAMES, 2, 6, 2, 3)),
        np.ones((FRAMES, 2, 6), dtype=bool),
    )
    lags = lags_of(FRAMES, STEP_S)
    found = ErrorComponents.of(ErrorProducts.of(two, lags, np.arange(FRAMES)), lags * STEP_S, STEP_S)
    np.testing.assert_allclose(found.axes, 1.0, atol=1e-6)


def test_what_is_usual_of_hips_counts_where_nothing_tells() -> None:
    rng = np.random.default_rng(0)
    errors, names = rng.standard_normal((*SHAPE, 2)), ("left_hip", *"bcdef")
    lags, known = lags_of(FRAMES, STEP_S), np.ones(SHAPE, dtype=bool)
    forwards = np.array([[[1.0, 0, 0], [0, 0, 1.0]], [[0, 1.0, 0], [0, 0, 1.0]]])  # two cameras at a right angle
    level = np.broadcast_to(forwards[None, :, None], (FRAMES, 2, 6, 2, 3))
    found = []
    for parity in (Parity.of(errors[:, :2], level, known[:, :2]), Parity.of(errors, jacobians(rng), known)):
        products = ErrorProducts.of(parity, lags, np.arange(FRAMES))
        found.append(ErrorComponents.of(products, lags * STEP_S, STEP_S, names).axes)
    of_two, of_four = found
    # What is seen, the vertical errors, stays as it is found.
    np.testing.assert_allclose(of_two[:, 1], 1.0, atol=1e-6)
    np.testing.assert_allclose(of_two[1:, 0], 1.0, atol=1e-6)
    assert of_two[0, 0] == pytest.approx(2.0)
    np.testing.assert_allclose(of_four, 1.0, atol=0.2)


def test_joints_that_share_their_errors_are_found() -> None:
    rng = np.random.default_rng(0)
    errors, jacobian = rng.standard_normal((*SHAPE, 2)), jacobians(rng)
    jacobian = np.broadcast_to(jacobian[:, :, :1], jacobian.shape)
    errors[:, :, 1] = errors[:, :, 0]
    found = components(errors, jacobian).correlation
    assert found[0, 1] > 0.9
    others = found - np.eye(6)
    others[[0, 1], [1, 0]] = 0.0
    assert np.abs(others).max() < 0.2  # by chance one in 1,250 dimensions of each: 0.03
    assert np.linalg.eigvalsh(found).min() > -1e-9


def test_hallucinations_are_told_from_large_errors_by_what_surrounds_them() -> None:
    assert share_of_visible(100.0, 0.0) == 1.0
    assert share_of_visible(100.0, 125.0) == 0.0  # as dense in the ring, which is 1.25 times as large
    assert share_of_visible(0.0, 10.0) == 0.0
