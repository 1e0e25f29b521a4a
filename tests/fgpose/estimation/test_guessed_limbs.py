"""Limbs that no camera sees, which all networks guess alike and say so by their confidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from tests.fgpose.calibration.changes.changing import RIG, SKELETON, filmed, walk_m
from tests.fgpose.estimation.guessed_legs import shorter_legs

LEGS = [SKELETON.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")]


@pytest.mark.parametrize("method", ["batch", pytest.param("online", marks=pytest.mark.slow)])
def test_bones_are_not_learned_of_what_is_guessed(method: str) -> None:
    """Legs at a fifth of the usual confidence for most of the recording: where they are seen, errors and covariances
    are as without. Their bones were 10 cm too short, and errors twice as large."""
    truth_m, hidden = walk_m(1, 9.0), slice(60, 210)
    seen = replace(filmed(shorter_legs(truth_m, hidden, 0.75), seed=21), points3d_m=None)
    confidence = seen.confidence.copy()
    confidence[hidden][:, :, LEGS] *= 0.2
    seen = replace(seen, confidence=confidence)
    if method == "batch":
        result = fgpose.smooth(seen, RIG)
    else:
        estimator = fgpose.Estimator(RIG, SKELETON)
        result = fgpose.Trajectory.from_estimates([estimator.update(frame) for frame in seen], RIG.names)
    assert result.covariance_m2 is not None
    after = slice(230, None)
    error_m = (result.positions_m - truth_m)[after][:, LEGS]
    squared = np.einsum("tji,tjik,tjk->tj", error_m, np.linalg.inv(result.covariance_m2[after][:, LEGS]), error_m)
    assert np.mean(squared < 7.81) > 0.85  # of the ellipsoids of 95 %; 18 % before
    assert np.linalg.norm(error_m, axis=-1).mean() < 0.025
    assert (result.status[hidden][30:-30][:, LEGS] == fgpose.Status.PREDICTED).all()
