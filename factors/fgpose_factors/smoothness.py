"""Smoothness over time: constant velocity, random walk, and a velocity that fades while nobody sees the joint."""

from __future__ import annotations

import gtsam
import numpy as np

from fgpose_factors.noise import noise_model


def constant_velocity_factor(
    before: tuple[int, int, float], after: tuple[int, int, float], acceleration_density: float
) -> gtsam.WnoaMotionFactorPoint3:
    """White noise on acceleration (WNOA) between two states, exact for any time step; native.

    Args:
        before, after: position key, velocity key and time in seconds of each state; after is later.
        acceleration_density: power spectral density, m^2/s^3.

    Raises:
        ValueError: time does not increase.
    """
    if not after[2] > before[2]:
        raise ValueError(f"time must increase from one state to the next: {before[2]} s, then {after[2]} s")
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
    """Draws the velocity of a joint that nobody sees towards that of a reference joint, or to zero. Native.

    A pseudo-measurement "velocity difference = 0" with spectral density r turns white-noise acceleration of density q
    into a velocity that fades with time constant sqrt(r / q) (the stationary Kalman-Bucy gain), hence r = q fade^2 and
    a variance of r / step for one measurement a step. The stationary velocity variance is then q fade.

    Args:
        velocity: key of the velocity, m/s.
        reference: key of the velocity that it fades to; None for standing still.
        step_s: time that this measurement stands for, seconds.
        acceleration_density: of the motion factors beside it, m^2/s^3.
        fade_s: time constant, seconds.
    """
    noise = noise_model(3, float(fade_s * np.sqrt(acceleration_density / step_s)))
    if reference is None:
        return gtsam.PriorFactorPoint3(velocity, np.zeros(3), noise)
    return gtsam.BetweenFactorPoint3(reference, velocity, np.zeros(3), noise)


def interpolate_position(
    before: tuple[np.ndarray, np.ndarray, float], after: tuple[np.ndarray, np.ndarray, float], time_s: float
) -> np.ndarray:
    """Position between two constant-velocity states: the posterior mean, which is the cubic Hermite polynomial.

    Args:
        before, after: position (..., 3) m, velocity (..., 3) m/s and time s of each state.
        time_s: between the two times.

    Raises:
        ValueError: the time lies outside the two states.
    """
    if not before[2] <= time_s <= after[2] or not before[2] < after[2]:
        raise ValueError(f"{time_s} s does not lie between {before[2]} s and {after[2]} s")
    step_s = after[2] - before[2]
    u = (time_s - before[2]) / step_s
    return (
        (1 + 2 * u) * (1 - u) ** 2 * before[0]
        + u * (1 - u) ** 2 * step_s * before[1]
        + u**2 * (3 - 2 * u) * after[0]
        - u**2 * (1 - u) * step_s * after[1]
    )


def interpolated_factor(
    factor: gtsam.NoiseModelFactor,
    before: tuple[int, int, float],
    after: tuple[int, int, float],
    at: tuple[int, int, float],
    acceleration_density: float,
) -> gtsam.WnoaInterpFactorPoint3:
    """Puts a factor at a time between two constant-velocity states, for a camera with its own clock. Native.

    Args:
        factor: on the position key ``at[0]``, with Gaussian noise.
        before, after: position key, velocity key and time of the two states.
        at: position key, velocity key and time of the interpolated state, which is no variable of the graph.
        acceleration_density: of the motion factor between the states, m^2/s^3. The uncertainty of the interpolation
            is added to the factor's noise.

    Raises:
        ValueError: the factor's noise is robust (GTSAM 4.3 would drop it and crash the process when linearising), or
            the time lies outside the two states.
    """
    if isinstance(factor.noiseModel(), gtsam.noiseModel.Robust):
        raise ValueError("an interpolated factor takes Gaussian noise only: GTSAM drops a robust model and crashes")
    if not before[2] <= at[2] <= after[2]:
        raise ValueError(f"{at[2]} s does not lie between {before[2]} s and {after[2]} s")
    states = {gtsam.StateData(*before), gtsam.StateData(*after)}
    return gtsam.WnoaInterpFactorPoint3(factor, states, {gtsam.StateData(*at)}, np.full(3, acceleration_density))
