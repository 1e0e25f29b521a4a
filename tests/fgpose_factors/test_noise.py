from __future__ import annotations

from collections.abc import Callable
from typing import cast

import gtsam
import jaxtyping
import numpy as np
import pytest

from fgpose_factors import Kernel, depth_factor, noise_model, robust, robust_loss, robust_weight

KEY = gtsam.symbol("x", 0)


def huber(x: np.ndarray, k: float) -> np.ndarray:
    return np.where(x <= k, 1.0, k / np.maximum(x, k))


def cauchy(x: np.ndarray, k: float) -> np.ndarray:
    return 1.0 / (1.0 + (x / k) ** 2)


def geman_mcclure(x: np.ndarray, k: float) -> np.ndarray:
    return (k**2 / (k**2 + x**2)) ** 2


def tukey(x: np.ndarray, k: float) -> np.ndarray:
    return np.where(x <= k, (1.0 - (x / k) ** 2) ** 2, 0.0)


WEIGHTS: dict[Kernel, Callable[[np.ndarray, float], np.ndarray]] = {
    "huber": huber,
    "cauchy": cauchy,
    "geman_mcclure": geman_mcclure,
    "tukey": tukey,
}


def whitened_row_norm(noise: gtsam.noiseModel.Base, off_m: float) -> float:
    """How strongly a prior that is off by so much along x enters the normal equations, per coordinate."""
    values = gtsam.Values()
    values.insert(KEY, np.array([off_m, 0.0, 0.0]))
    A, _ = gtsam.PriorFactorPoint3(KEY, np.zeros(3), noise).linearize(values).jacobian()
    return float(A[0, 0])


@pytest.mark.parametrize("sigma", [0.01, 1.0, 6.0])
def test_without_a_kernel_a_residual_of_one_sigma_costs_one_half(sigma):
    noise = noise_model(3, sigma)
    values = gtsam.Values()
    values.insert(KEY, np.array([0.0, sigma, 0.0]))
    assert gtsam.PriorFactorPoint3(KEY, np.zeros(3), noise).error(values) == pytest.approx(0.5)


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("kernel", list(WEIGHTS))
def test_kernels_discount_by_the_textbook_weight_of_the_whitened_residual(kernel, scale):
    sigma_m = 0.02
    noise = noise_model(3, sigma_m, kernel, scale)
    for in_sigmas in (0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 30.0):
        weight = (whitened_row_norm(noise, in_sigmas * sigma_m) * sigma_m) ** 2
        expected = WEIGHTS[kernel](np.array(in_sigmas), scale)
        assert weight == pytest.approx(float(expected), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kernel", list(WEIGHTS))
def test_every_kernel_costs_as_much_as_the_square_for_small_residuals(kernel):
    sigma_m, off_m = 0.02, 1e-5
    values = gtsam.Values()
    values.insert(KEY, np.array([off_m, 0.0, 0.0]))
    error = gtsam.PriorFactorPoint3(KEY, np.zeros(3), noise_model(3, sigma_m, kernel)).error(values)
    # the next term of the series is (off / sigma)^2 = 2.5e-7 relative
    assert error == pytest.approx(0.5 * (off_m / sigma_m) ** 2, rel=1e-6)


@pytest.mark.parametrize(("sigma", "scale"), [(0.0, 1.0), (-1.0, 1.0), (float("nan"), 1.0), (1.0, 0.0), (1.0, -2.0)])
def test_a_sigma_or_scale_that_is_not_positive_is_refused(sigma, scale):
    with pytest.raises(ValueError, match="must be positive"):
        noise_model(2, sigma, "huber", scale)


@pytest.mark.parametrize(
    "unknown",
    [
        lambda kernel: noise_model(2, 1.0, kernel),
        lambda kernel: robust(gtsam.noiseModel.Isotropic.Sigma(2, 1.0), kernel, 1.0),
        lambda kernel: robust_loss(np.ones(3), kernel, 1.0),
        lambda kernel: robust_weight(np.ones(3), kernel, 1.0),
        lambda kernel: depth_factor(KEY, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.1, kernel),
    ],
    ids=["noise_model", "robust", "robust_loss", "robust_weight", "depth_factor"],
)
def test_an_unknown_kernel_is_refused_and_the_known_ones_are_named(monkeypatch, unknown):
    # as in production, where types are not checked at run time
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match="unknown kernel 'l1'; known: none, huber, cauchy, geman_mcclure, tukey"):
        unknown(cast("Kernel", "l1"))


@pytest.mark.parametrize("kernel", ["none", *WEIGHTS])
def test_loss_and_weight_in_numpy_are_those_of_gtsam(kernel: Kernel) -> None:
    scale, sigma_m = 1.7, 0.02
    offsets_sigmas = np.array([0.0, 0.3, 1.6999, 1.7001, 3.0, 50.0])
    noise = noise_model(3, sigma_m, kernel, scale)
    for offset_sigmas in offsets_sigmas:
        factor = gtsam.PriorFactorPoint3(KEY, np.zeros(3), noise)
        values = gtsam.Values()
        values.insert(KEY, np.array([0.0, offset_sigmas * sigma_m, 0.0]))
        squared = np.array([offset_sigmas**2])
        assert robust_loss(squared, kernel, scale)[0] == pytest.approx(factor.error(values), rel=1e-12, abs=1e-15)
        A, _ = factor.linearize(values).jacobian()
        assert robust_weight(squared, kernel, scale)[0] == pytest.approx((A[0, 0] * sigma_m) ** 2, rel=1e-12, abs=1e-15)
