"""What the graph makes of joints that two cameras would know alone."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.covariances.filter_response import FilterResponse
from fgpose.estimation.covariances.joints_alone import Directions, InGraph

PRECISION = 1e4
UP = np.array([0.0, 0.0, 1.0])
STEADY = np.array([[0.4, 0.6, 0.7]])
NOISE, MOTION = np.array([[1.5, 1.2, 0.9]]), np.array([[0.3, 0.25, 0.2]])
EVEN = np.ones((1, 2))


def directions(apart_deg: float) -> Directions:
    """Of two level cameras, whose rays cross at this angle, midway between them the x axis."""
    by_axis = np.zeros((1, 2, 3, 3))
    for angle_rad in np.radians([-apart_deg / 2, apart_deg / 2]):
        sideways = np.array([-np.sin(angle_rad), np.cos(angle_rad), 0.0])
        by_axis[0] += PRECISION * np.stack([np.outer(sideways, sideways), np.outer(UP, UP)])
    return Directions.of(by_axis)


def times_alone(share: float) -> InGraph:
    """A joint at 45 degrees, with so many times the covariance that it would have alone."""
    found = directions(45)
    return InGraph.of(found, STEADY, found.matrices(share * STEADY / found.information))


def response() -> FilterResponse:
    return FilterResponse(NOISE[..., None], MOTION, STEADY)


def test_two_cameras_at_45_degrees_know_a_joint_least_along_the_line_midway() -> None:
    found = directions(45)
    np.testing.assert_allclose(np.abs(found.units[0, :, 0]), [1, 0, 0], atol=1e-9)
    expected = 2 * np.array([np.sin(np.pi / 8) ** 2, np.cos(np.pi / 8) ** 2, 1])
    np.testing.assert_allclose(found.information[0] / PRECISION, expected)
    np.testing.assert_allclose(found.matrices(found.information), found.by_axis.sum(axis=1), atol=1e-9 * PRECISION)


def test_alone_the_joint_has_the_covariance_of_the_filters() -> None:
    """Each direction has its own, and errors that are larger horizontally count in the horizontal ones."""
    found = times_alone(1.0)
    of_noise_m2 = NOISE * STEADY / found.directions.information
    even_m2 = found.noise_m2(NOISE, EVEN, np.zeros(1))
    np.testing.assert_allclose(even_m2, found.directions.matrices(of_noise_m2), rtol=1e-6, atol=1e-15)
    horizontal_m2 = found.noise_m2(NOISE, np.array([[2.0, 1.0]]), np.zeros(1))
    expected_m2 = found.directions.matrices(of_noise_m2 * [2, 2, 1])
    np.testing.assert_allclose(horizontal_m2, expected_m2, rtol=1e-6, atol=1e-15)
    of_motion_m2 = found.directions.matrices(MOTION * STEADY / found.directions.information)
    np.testing.assert_allclose(found.motion_m2(response()), of_motion_m2, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(found.excess_m2, 0, atol=1e-15)


def test_bones_average_errors_but_not_those_that_joints_share() -> None:
    alone, averaged = times_alone(1.0), times_alone(0.25)
    noise_m2 = alone.noise_m2(NOISE, EVEN, np.zeros(1))
    for shared, left in ((0.0, 0.25), (0.5, 0.625), (1.0, 1.0)):
        found_m2 = averaged.noise_m2(NOISE, EVEN, np.array([shared]))
        np.testing.assert_allclose(found_m2, left * noise_m2, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(
        averaged.motion_m2(response()), 0.25 * alone.motion_m2(response()), rtol=1e-6, atol=1e-15
    )
    np.testing.assert_allclose(averaged.excess_m2, 0, atol=1e-15)


def test_what_a_hidden_joint_has_more_is_of_motion() -> None:
    alone, hidden = times_alone(1.0), times_alone(4.0)
    noise_m2, of_hidden_m2 = (each.noise_m2(NOISE, EVEN, np.full(1, 0.5)) for each in (alone, hidden))
    np.testing.assert_allclose(of_hidden_m2, noise_m2, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(hidden.motion_m2(response()), alone.motion_m2(response()), rtol=1e-6, atol=1e-15)
    of_alone_m2 = alone.directions.matrices(STEADY / alone.directions.information)
    np.testing.assert_allclose(hidden.excess_m2, 3 * of_alone_m2, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("apart_deg", [90.0, 90.0001])
def test_directions_that_tell_as_much_as_each_other_may_be_exchanged(apart_deg: float) -> None:
    """At 90 degrees any two horizontal directions are eigenvectors, at a little more only one pair."""
    linear_m2 = 1e-5 * np.array([[[4.0, 1.0, 0.5], [1.0, 2.0, 0.0], [0.5, 0.0, 1.0]]])
    steady, noise = np.full((1, 3), 0.5), np.full((1, 3), 1.2)
    found = [
        InGraph.of(directions(apart), steady, linear_m2).noise_m2(noise, np.array([[2.0, 1.0]]), np.full(1, 0.5))
        for apart in (apart_deg, 89.9999)
    ]
    np.testing.assert_allclose(*found, rtol=1e-4)
