"""How rough motion is, from squared differences."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.covariances.roughness import NewestPose, RunningRoughness, roughness

N_JOINTS, NOISE_M2, MOTION_M2 = 17, 3e-4, 3e-4
STEP_S = 0.1  # of the frames, half the time after which one tells anything new


def differences_m(rng: np.random.Generator, times: float, n_frames: int) -> np.ndarray:
    """Of poses whose motion is so many times as rough as in the graph."""
    return np.sqrt((NOISE_M2 + times * MOTION_M2) / 3) * rng.standard_normal((n_frames, N_JOINTS, 3))


@pytest.mark.parametrize("times", [0.0, 0.3, 1.0, 4.0])
def test_it_is_found_though_a_twentieth_is_wrong(times: float) -> None:
    rng = np.random.default_rng(0)
    found_m2 = np.sum(differences_m(rng, times, 600) ** 2, axis=-1).ravel()
    found_m2[rng.random(len(found_m2)) < 0.05] = 1.0
    value = roughness(found_m2, np.full(len(found_m2), NOISE_M2), np.full(len(found_m2), MOTION_M2), 1e4)
    # The ninth decile of what is left is the 0.947 quantile: 7.7 of chi-squared instead of 6.25, a quarter more.
    assert value == pytest.approx(times, abs=0.05 + 0.25 * (1 + times))


def test_few_measurements_leave_it_as_in_the_graph() -> None:
    assert roughness(np.zeros(3), np.ones(3), np.ones(3), 3.0) == pytest.approx(1.0, abs=0.1)


def test_online_it_is_learned_from_how_far_poses_move() -> None:
    running, rng = RunningRoughness(), np.random.default_rng(0)
    known, unknown = np.arange(N_JOINTS) < 12, np.arange(N_JOINTS) >= 12
    wanted = []
    for frame, moved_m in enumerate(differences_m(rng, 0.2, 300)):
        noise_m2, motion_m2 = np.where(np.arange(N_JOINTS) == 0, np.nan, NOISE_M2), np.full(N_JOINTS, MOTION_M2)
        for position_m in (9.0, 0.0):  # the second with a later image
            if running.is_wanted(frame, frame * STEP_S):
                position_m = np.full((N_JOINTS, 3), position_m)
                running.note(frame, frame * STEP_S, NewestPose(position_m, noise_m2, motion_m2))
                wanted.append(frame)
        running.compare(frame, np.where(unknown[:, None], 5.0, moved_m), known)
    assert wanted == np.repeat(np.arange(12, 300, 2), 2).tolist()
    # 1,600 values: the ninth decile has a standard deviation of 4 % of the whole variance, and the prior counts as 50.
    assert running.value == pytest.approx(0.2, abs=0.2)


def test_frames_that_were_never_the_newest_tell_nothing() -> None:
    running = RunningRoughness()
    running.compare(0, np.zeros((N_JOINTS, 3)), np.ones(N_JOINTS, dtype=bool))
    assert running.value == 1.0
