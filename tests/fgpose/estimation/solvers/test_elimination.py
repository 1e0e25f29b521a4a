"""Cameras and joints in one system, the joints eliminated: against the whole system, and next to a camera."""

from __future__ import annotations

import numpy as np

from fgpose.estimation.solvers.elimination import eliminate_joints

CAMERAS, JOINTS = 3, 4


def test_the_step_is_that_of_the_whole_system() -> None:
    rng = np.random.default_rng(0)
    residual_px = rng.normal(size=(1, CAMERAS, JOINTS, 2))
    by_joint, by_camera = rng.normal(size=(1, CAMERAS, JOINTS, 2, 3)), rng.normal(size=(1, CAMERAS, JOINTS, 2, 1))
    weights = rng.uniform(0.5, 2.0, size=(1, CAMERAS, JOINTS))
    reduced = eliminate_joints(residual_px, by_joint, by_camera, weights, damping=0.1)
    step = np.linalg.solve(reduced.information + np.eye(CAMERAS), -reduced.gradient)

    n = CAMERAS + 3 * JOINTS
    whole, gradient = np.diag(np.r_[np.ones(CAMERAS), np.full(3 * JOINTS, 0.1)]), np.zeros(n)
    for c, j in np.ndindex(CAMERAS, JOINTS):
        jacobian = np.zeros((2, n))
        jacobian[:, [c]] = by_camera[0, c, j]
        jacobian[:, CAMERAS + 3 * j : CAMERAS + 3 * j + 3] = by_joint[0, c, j]
        whole += weights[0, c, j] * jacobian.T @ jacobian
        gradient += weights[0, c, j] * jacobian.T @ residual_px[0, c, j]
    # The least information of a joint, 1e-9 beside a damping of 0.1, is all that differs.
    np.testing.assert_allclose(step, np.linalg.solve(whole, -gradient)[:CAMERAS], rtol=1e-7)


def test_a_joint_next_to_a_camera_that_no_other_sees_contributes_nothing() -> None:
    """Its information, 1e8 / m^2 in one direction, leaves 1e-8 of rounding errors in the others (seen in a soak)."""
    by_joint = np.full((1, 1, 1, 2, 3), 1e4)
    of_camera, weights = np.ones((1, 1, 1, 2, 1)), np.ones((1, 1, 1))
    reduced = eliminate_joints(np.ones((1, 1, 1, 2)), by_joint, of_camera, weights)
    # Two residuals with information 1 each on the camera, which the joint explains. An inverse with a condition of 1e12
    # is good to about 1e-4.
    np.testing.assert_allclose(reduced.information, 0.0, atol=1e-4)
    np.testing.assert_allclose(reduced.gradient, 0.0, atol=1e-4)
