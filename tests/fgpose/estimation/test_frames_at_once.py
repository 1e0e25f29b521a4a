"""How many frames are gathered at once bounds the memory, and changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.config import Config
from fgpose.estimation.evidence import gather
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking


@pytest.mark.parametrize("use", ["always", "few_views"])
def test_frames_at_once_change_nothing(
    use: str, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does what the whole recording tells, as how good the depths of each view are, if they do not state it."""
    scene = simulate(walking(40, 30.0, skeleton), skeleton, rig, 30.0, DetectionNoise(), NO_OCCLUSION, seed=0)
    points_px = scene.observations.points2d_px.copy()
    points_px[20:, 2:] = np.nan
    observations = replace(scene.observations, points2d_px=points_px, covariance3d_m2=None)
    config = Config().replace(depth={"use": use})
    whole = gather.gather(observations, rig, config)
    assert np.isfinite(whole.depth_sigma_m).any()
    monkeypatch.setattr(gather, "FRAMES_AT_ONCE", 7)
    for name, array in vars(gather.gather(observations, rig, config)).items():
        # Sums of matrix products may be ordered otherwise.
        np.testing.assert_allclose(array, getattr(whole, name), rtol=1e-9, atol=1e-9, err_msg=name)
