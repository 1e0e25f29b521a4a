"""What is printed of a long recording is counted in parts."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.cli.tables import median_in_parts


@pytest.mark.parametrize("n_frames", [1, 2, 3, 2500])
def test_medians_are_exact(n_frames: int) -> None:
    """In single precision, in which residuals are kept; also of many equal ones, and across powers of two."""
    rng = np.random.default_rng(n_frames)
    for values in (
        rng.rayleigh(3.0, (n_frames, 4, 3)),
        rng.choice([1.0, 1.999, 2.0, 64.0], (n_frames, 2, 2)),
        np.geomspace(1e-30, 1e30, 4 * n_frames).reshape(n_frames, 4),
    ):
        values[rng.random(values.shape) < 0.2] = np.nan
        values.flat[0] = 0.0
        expected = float(np.nanmedian(values.astype(np.float32)))
        assert median_in_parts(values) == pytest.approx(expected, rel=1e-6)


def test_nothing_is_known() -> None:
    assert np.isnan(median_in_parts(np.full((5, 2), np.nan)))
    assert np.isnan(median_in_parts(np.zeros((0, 2))))
