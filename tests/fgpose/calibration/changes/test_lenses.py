"""Whether a recording shows that a lens is not that of the calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.calibration.changes.lenses import Lens
from fgpose.calibration.changes.lenses import _Pair as Pair
from fgpose.calibration.changes.lenses import _Seen as Seen
from fgpose.geometry.camera import Camera, CameraRig
from tests.fgpose.calibration.changes.changing import filmed, walk_m

DOWN = np.diag([1.0, -1.0, -1.0])


def on_the_ceiling() -> CameraRig:
    """Four that look straight down, from 5 m."""
    K = np.array([[700.0, 0, 800], [0, 700, 600], [0, 0, 1]])
    places = [(1.5, 1.2), (-1.5, 1.2), (1.5, -1.2), (-1.5, -1.2)]
    return CameraRig(
        tuple(
            Camera.from_world_to_camera(f"down_{x:+}_{y:+}", (1600, 1200), K, DOWN, -DOWN @ np.array([x, y, 5.0]))
            for x, y in places
        )
    )


def test_parallel_cameras_agree_as_well_with_any_focal_length() -> None:
    """It only scales depths: what rays miss each other by stays the same in pixels, also at the edges of the images."""
    rig = on_the_ceiling()
    points_m = np.random.default_rng(0).uniform((-2, -2, 0.0), (2, 2, 1.8), (40, 10, 3))
    noise_px = np.random.default_rng(1).normal(0.0, 4.0, (40, 4, 10, 2))
    undistorted_px = rig.project(points_m) + noise_px
    seen = []
    for c in (0, 1):
        camera = rig.cameras[c]
        rays = np.concatenate([(undistorted_px[:, c] - camera.K[:2, 2]) / 700, np.ones((40, 10, 1))], axis=-1)
        direction = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ DOWN
        seen.append(Seen(camera, direction, np.tile(DOWN.T, (40, 1, 1))))
    baseline_m = np.tile(rig.positions_m[1] - rig.positions_m[0], (40, 1, 1))
    across = seen[0].view.across(baseline_m), seen[1].view.across(baseline_m)
    pair = Pair((0, 1), baseline_m, np.ones((40, 10)), 0.005, across, np.zeros(40))
    still = pair.angles(seen[0].view, seen[1].view)
    for value in (-0.4, 0.4):
        other = pair.angles(*(each.through(Lens.FOCAL_LENGTH, value) for each in seen))
        # To first order in the errors, which are half a percent of a focal length.
        np.testing.assert_allclose(other, still, atol=0.02 * np.abs(still).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [421, 423])
def test_cameras_on_a_ceiling_have_the_lenses_that_they_have(seed: int) -> None:
    """The focal lengths of all were said to be 0.67 times as long."""
    rig = on_the_ceiling()
    seen = replace(filmed(walk_m(seed, 16.0), rig, seed), points3d_m=None)
    assert not [each for each in fgpose.diagnose(seen, rig).findings if each.code == "wrong-lens"]
