"""Smoothness over time: constant velocity, random walk, and a velocity that fades while no camera sees the joint."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose_factors.noise import noise_model


class State(NamedTuple):
    """A position and a velocity that are variables of the graph, and their time."""

    position: int
    """Key of a Point3, m."""
    velocity: int
    """Key of a Point3, m/s."""
    time_s: float


class Motion(NamedTuple):
    """The values of a state, of one point or of many."""

    position_m: Float[np.ndarray, "*points 3"]
    velocity_mps: Float[np.ndarray, "*points 3"]
    time_s: float


def constant_velocity_factor(before: State, after: State, acceleration_density: float) -> gtsam.WnoaMotionFactorPoint3:
    """White noise on acceleration (WNOA) between two states, exact for any time step; native.

    Args:
        before, after: the states; after is later.
        acceleration_density: power spectral density, m^2/s^3.

    Raises:
        ValueError: time does not increase.
    """
    if not after.time_s > before.time_s:
        raise ValueError(f"time must increase from one state to the next: {before.time_s} s, then {after.time_s} s")
    density = np.full(3, acceleration_density)
    return gtsam.WnoaMotionFactorPoint3(gtsam.StateData(*before), gtsam.StateData(*after), density)


def random_walk_factor(before: int, after: int, step_s: float, velocity_density: float) -> gtsam.BetweenFactorPoint3:
    """White noise on velocity: the displacement has variance density x step. Native.

    Args:
        before, after: position keys.
        step_s: positive time between them.
        velocity_density: power spectral density, m^2/s.

    Raises:
        ValueError: the step is not positive.
    """
    if not step_s > 0:
        raise ValueError(f"time must increase from one state to the next, got a step of {step_s} s")
    return gtsam.BetweenFactorPoint3(
        before, after, np.zeros(3), noise_model(3, float(np.sqrt(velocity_density * step_s)))
    )


def fading_velocity_factor(
    velocity: int, reference: int | None, step_s: float, acceleration_density: float, fade_s: float
) -> gtsam.NonlinearFactor:
    """Draws the velocity of an unseen joint towards that of a reference joint, or to zero. Native.

    Args:
        velocity: key of the velocity, m/s.
        reference: key of the velocity that it fades to; None for standing still.
        step_s: time that this measurement stands for, seconds.
        acceleration_density: of the motion factors beside it, m^2/s^3.
        fade_s: time constant, seconds.
    """
    noise = noise_model(3, float(fading_velocity_sigma_mps(step_s, acceleration_density, fade_s)))
    if reference is None:
        return gtsam.PriorFactorPoint3(velocity, np.zeros(3), noise)
    return gtsam.BetweenFactorPoint3(reference, velocity, np.zeros(3), noise)


def fading_velocity_sigma_mps(
    step_s: float | Float[np.ndarray, "*factors"],
    acceleration_density: float | Float[np.ndarray, "*factors"],
    fade_s: float,
) -> float | Float[np.ndarray, "*factors"]:
    """Standard deviation of the pseudo-measurement "velocity difference = 0", m/s.

    With spectral density r it turns white-noise acceleration of density q into a velocity that fades with time constant
    sqrt(r / q) (the stationary Kalman-Bucy gain), hence r = q fade^2 and a variance of r / step for one measurement a
    step. The stationary velocity variance is then q fade.

    Args:
        step_s, acceleration_density, fade_s: as in fading_velocity_factor.
    """
    return fade_s * np.sqrt(acceleration_density / step_s)


def interpolate_position(before: Motion, after: Motion, time_s: float) -> Float[np.ndarray, "*points 3"]:
    """Position between two constant-velocity states, m: the posterior mean, which is the cubic Hermite polynomial.

    Args:
        before, after: the values of the two states.
        time_s: between their times.

    Raises:
        ValueError: the time lies outside the two states.
    """
    if not before.time_s <= time_s <= after.time_s or not before.time_s < after.time_s:
        raise ValueError(f"{time_s} s does not lie between {before.time_s} s and {after.time_s} s")
    step_s = after.time_s - before.time_s
    u = (time_s - before.time_s) / step_s
    return (
        (1 + 2 * u) * (1 - u) ** 2 * before.position_m
        + u * (1 - u) ** 2 * step_s * before.velocity_mps
        + u**2 * (3 - 2 * u) * after.position_m
        - u**2 * (1 - u) * step_s * after.velocity_mps
    )


def interpolated_factor(
    factor: gtsam.NoiseModelFactor, before: State, after: State, at: State, acceleration_density: float
) -> gtsam.WnoaInterpFactorPoint3:
    """Puts a factor at a time between two constant-velocity states, for a camera with its own clock. Native.

    Args:
        factor: on the key ``at.position``, with Gaussian noise.
        before, after: the two states.
        at: the interpolated state, which is no variable of the graph.
        acceleration_density: of the motion factor between the states, m^2/s^3. The uncertainty of the interpolation
            is added to the factor's noise.

    Raises:
        ValueError: the factor's noise is robust (GTSAM 4.3 would drop it and crash the process when linearising), or
            the time lies outside the two states.
    """
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        raise ValueError("an interpolated factor takes Gaussian noise only: GTSAM drops a robust model and crashes")
    if not before.time_s <= at.time_s <= after.time_s:
        raise ValueError(f"{at.time_s} s does not lie between {before.time_s} s and {after.time_s} s")
    states = {gtsam.StateData(*before), gtsam.StateData(*after)}
    return gtsam.WnoaInterpFactorPoint3(factor, states, {gtsam.StateData(*at)}, np.full(3, acceleration_density))
