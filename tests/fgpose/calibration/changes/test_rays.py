"""Rays of a whole recording are made part by part."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fgpose.calibration.changes import lag_costs, rays
from fgpose.calibration.changes.comparison import Comparison
from fgpose.calibration.changes.lost_images import fine_costs
from fgpose.geometry.camera import CameraRig
from fgpose.sampling import parts_of
from tests.fgpose.calibration.changes.changing import FPS, RIG, filmed, walk_m


def test_rays_do_not_depend_on_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of lenses that distort, and of a camera without an image now and then."""
    bent = CameraRig(tuple(replace(each, distortion=np.array([-0.2, 0.05, 0.0, 0.0])) for each in RIG.cameras))
    seen = filmed(walk_m(3), bent).first_frames(200)
    time_s = np.tile(seen.time_s[:, None], bent.n_cameras)
    time_s[40:150:3, 1] = np.nan
    seen = seen.without(np.isnan(time_s)[..., None] & np.ones(seen.confidence.shape, dtype=bool))
    seen = replace(seen, time_s=time_s)
    in_one = rays.rays_of([seen], bent, (), 1 / FPS, 10)
    assert np.isfinite(in_one.direction[1, 40:150]).any()
    monkeypatch.setattr(rays, "parts_of", partial(parts_of, at_once=7))
    in_parts = rays.rays_of([seen], bent, (), 1 / FPS, 10)
    for name, expected in vars(in_one).items():
        np.testing.assert_array_equal(getattr(in_parts, name), expected, err_msg=name)


def test_costs_do_not_depend_on_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for rounding of sums in double precision."""
    compared = Comparison.of([filmed(walk_m(3)).first_frames(300)], RIG, 1 / FPS)

    def costs() -> list[np.ndarray]:
        (fine,) = fine_costs.fine_costs(compared, 1)
        return [*compared.costs().cost.values(), *fine.cost.values()]

    in_one = costs()
    assert np.ptp(in_one[0], axis=1).max() > 1
    for module in (lag_costs, fine_costs):
        monkeypatch.setattr(module, "AT_ONCE", 7)
    for found, expected in zip(costs(), in_one, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
