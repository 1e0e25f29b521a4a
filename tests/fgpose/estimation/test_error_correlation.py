"""How errors are correlated, learned from residuals."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.noise import ErrorCorrelation, error_correlation


def residuals(errors: ErrorCorrelation, n_frames: int, step_s: float, seed: int = 0) -> np.ndarray:
    """Of four cameras and 17 joints, of variance 1."""
    rng = np.random.default_rng(seed)
    shape, keep = (4, 17, 2), np.exp(-step_s / errors.time_s)
    correlated = [rng.normal(size=shape)]
    for _ in range(n_frames - 1):
        correlated.append(keep * correlated[-1] + np.sqrt(1 - keep**2) * rng.normal(size=shape))
    white = rng.normal(size=(n_frames, *shape))
    white_share = 1 - errors.share - errors.constant_share
    return (
        np.sqrt(errors.share) * np.array(correlated)
        + np.sqrt(errors.constant_share) * rng.normal(size=shape)
        + np.sqrt(white_share) * white
    )


@pytest.mark.parametrize(
    "errors",
    [
        ErrorCorrelation(0.0, 0.1, 0.0),
        ErrorCorrelation(0.64, 0.12, 0.0),
        ErrorCorrelation(0.9, 0.3, 0.0),
        ErrorCorrelation(0.4, 0.1, 0.4),
    ],
)
@pytest.mark.parametrize("step_s", [1 / 30, 1 / 120])
def test_the_correlation_is_found(errors: ErrorCorrelation, step_s: float) -> None:
    found = error_correlation(
        residuals(errors, round(10 / step_s), step_s), np.ones((round(10 / step_s), 4, 17)), step_s
    )
    # 10 s of 136 sequences that are correlated over up to 0.3 s are 2,000 independent pairs: 0.02 each. A share that is
    # correlated over a time near the longest lag or the shortest step looks like a constant or like noise.
    time_s = np.array([0.05, 0.1, 0.2, 0.4])
    modelled = [fit.share * np.exp(-time_s / fit.time_s) + fit.constant_share for fit in (found, errors)]
    np.testing.assert_allclose(modelled[0], modelled[1], atol=0.07)


def test_hallucinated_and_missing_detections_do_not_count() -> None:
    residual, weights = residuals(ErrorCorrelation(0.0, 0.1, 0.0), 500, 0.02), np.ones((500, 4, 17))
    alone = error_correlation(residual[100:], weights[100:], 0.02)
    residual[:50], residual[50:100] = 40.0, np.nan
    weights[:50] = 0.01
    assert error_correlation(residual, weights, 0.02) == alone


@pytest.mark.parametrize("n_frames", [1, 2, 5])
def test_of_a_few_frames_what_is_usual(n_frames: int) -> None:
    found = error_correlation(np.zeros((n_frames, 1, 1, 2)), np.ones((n_frames, 1, 1)), 0.02)
    usual = ErrorCorrelation()
    # A fit on a grid of times; the prior stands for 100 pairs, these are less than one.
    assert found.share + found.constant_share == pytest.approx(usual.share, abs=0.1)


def test_without_a_single_good_detection() -> None:
    found = error_correlation(np.full((50, 2, 3, 2), np.nan), np.ones((50, 2, 3)), 0.02)
    assert found.share == pytest.approx(ErrorCorrelation().share, abs=0.1)
