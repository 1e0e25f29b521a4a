from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fgpose.geometry.up_axis import SIGNED_AXES, from_z_up, nearest_axis, up_vector, y_up, z_up, z_up_R_world

POINTS = np.random.default_rng(0).normal(size=(4, 5, 3))


@pytest.mark.parametrize("axis", SIGNED_AXES)
def test_every_axis_is_turned_up_exactly_and_back(axis: Any) -> None:
    rotation = z_up_R_world(axis)
    np.testing.assert_array_equal(rotation @ up_vector(axis), [0, 0, 1])
    np.testing.assert_array_equal(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) > 0  # no mirror
    np.testing.assert_array_equal(z_up(POINTS, axis), POINTS @ rotation.T)
    np.testing.assert_array_equal(from_z_up(z_up(POINTS, axis), axis), POINTS)
    assert nearest_axis(axis) == axis


def test_a_bare_axis_is_the_positive_one() -> None:
    pairs: Any = [("x", "+x"), ("y", "+y"), ("z", "+z")]
    for bare, signed in pairs:
        np.testing.assert_array_equal(z_up_R_world(bare), z_up_R_world(signed))
    np.testing.assert_array_equal(y_up(POINTS, "z"), POINTS[..., [1, 2, 0]])  # as Pose2Sim maps to OpenSim
    np.testing.assert_array_equal(y_up(POINTS, "y"), POINTS)


def test_a_tilted_world_is_levelled_by_the_shortest_rotation() -> None:
    tilt = np.deg2rad(12.0)
    up = (0.0, -float(np.cos(tilt)), float(np.sin(tilt)))
    rotation = z_up_R_world(up)
    # 1e-12: rounding.
    np.testing.assert_allclose(rotation @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    turned = rotation @ z_up_R_world("-y").T
    np.testing.assert_allclose(np.arccos((np.trace(turned) - 1) / 2), tilt, atol=1e-12)
    assert nearest_axis(up) == "-y"


@pytest.mark.parametrize("wrong", ["up", "", "+", "zz", (0.0, 0.0, 0.0), (1.0, np.nan, 0.0)])
def test_what_is_no_direction_is_refused(wrong: Any) -> None:
    with pytest.raises((ValueError, TypeError)):
        up_vector(wrong)
