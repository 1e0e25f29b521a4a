"""The Markov chain of visible and hidden: against brute force, and learned from what it has been."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.linalg
from jaxtyping import Float

from fgpose.config import VisibilityConfig
from fgpose.estimation.visibility.visibility_chain import Chain, Stays

CHAIN = VisibilityConfig(visible_s=0.7, hidden_s=0.2)
USUAL = 0.7 / 0.9
STEPS_S = np.array([0.02, 0.02, 0.5, 1e-6, 0.1, 0.02, 3.0, 0.04])


def rates(visible_s: float, hidden_s: float) -> Float[np.ndarray, "2 2"]:
    """Of leaving visible and hidden, per second."""
    return np.array([[-1 / visible_s, 1 / visible_s], [1 / hidden_s, -1 / hidden_s]])


RATES = rates(CHAIN.visible_s, CHAIN.hidden_s)


def log_odds() -> Float[np.ndarray, "frame camera joint"]:
    """Of a short chain in each of two cameras and three joints, from hardly anything to nearly certain."""
    return np.random.default_rng(0).normal(0.0, 3.0, (len(STEPS_S), 2, 3))


def test_what_is_predicted_is_the_exponential_of_the_rates() -> None:
    before = np.array([0.0, 0.1, USUAL, 1.0])
    for step_s in (1e-6, 0.02, 0.3, 10.0):
        expected = np.stack([before, 1 - before], axis=-1) @ scipy.linalg.expm(RATES * step_s)
        np.testing.assert_allclose(Chain(CHAIN).predicted(before, step_s), expected[:, 0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(Chain(CHAIN).predicted(before, np.inf), USUAL)


def test_what_is_updated_is_the_theorem_of_bayes() -> None:
    before, of_visible, of_hidden = np.array([0.0, 0.2, 0.9, 1.0]), 0.03, 2.0
    joint = before * of_visible, (1 - before) * of_hidden
    updated = Chain(CHAIN).updated(before, np.full(4, np.log(of_visible / of_hidden)))
    np.testing.assert_allclose(updated, joint[0] / (joint[0] + joint[1]), rtol=1e-12)


def posterior(odds: np.ndarray) -> np.ndarray:
    chain = Chain(CHAIN)
    return chain.smoothed(chain.filtered(odds, STEPS_S), odds, STEPS_S)


def test_the_posterior_is_that_of_all_sequences_of_states() -> None:
    odds = log_odds()
    by_state = np.exp(np.stack([odds, np.zeros_like(odds)]))
    usual = np.array([USUAL, 1 - USUAL])
    of_visible, of_all = np.zeros_like(odds), np.zeros(odds.shape[1:])
    for states in itertools.product((0, 1), repeat=len(odds)):
        probability = usual[states[0]] * by_state[states[0], 0]
        for t in range(1, len(odds)):
            move = scipy.linalg.expm(RATES * STEPS_S[t])[states[t - 1], states[t]]
            probability = probability * move * by_state[states[t], t]
        of_all += probability
        of_visible[np.array(states) == 0] += probability
    np.testing.assert_allclose(posterior(odds), of_visible / of_all, rtol=1e-10)


def test_the_last_frame_of_the_posterior_is_what_the_filter_knows() -> None:
    odds, chain = log_odds(), Chain(CHAIN)
    probability = np.full(odds.shape[1:], chain.usual)
    for of_frame, step_s in zip(odds, STEPS_S.tolist(), strict=True):
        probability = chain.updated(chain.predicted(probability, step_s), of_frame)
    np.testing.assert_allclose(posterior(odds)[-1], probability, rtol=1e-12)


def test_odds_without_bound_stay_probabilities() -> None:
    odds = 1e4 * np.sign(log_odds())
    probability = posterior(odds)
    np.testing.assert_array_equal(probability > 0.5, odds > 0)
    assert ((probability >= 0) & (probability <= 1)).all()


def drawn(visible_s: float, hidden_s: float, step_s: float, n_frames: int) -> Float[np.ndarray, "frame camera joint"]:
    """1 where visible, 0 where hidden: states of four cameras and ten joints."""
    rng, leave = np.random.default_rng(0), scipy.linalg.expm(rates(visible_s, hidden_s) * step_s)
    states = np.ones((n_frames, 4, 10))
    for before, state in itertools.pairwise(states):
        state[:] = rng.random(before.shape) < np.where(before == 1, leave[0, 0], leave[1, 0])
    return states


def stays_of(states: np.ndarray, step_s: float) -> Stays:
    return Stays.of(states, np.full(len(states), step_s), np.ones(states.shape, dtype=bool))


def probabilities(chain: Chain, step_s: float) -> list[float]:
    return chain.predicted(np.array([1.0, 0.0]), step_s).tolist()


@pytest.mark.parametrize(("visible_s", "hidden_s"), [(2.0, 1.0), (0.5, 0.1), (5.0, 0.3)])
def test_a_chain_learns_how_long_joints_stay(visible_s: float, hidden_s: float) -> None:
    """20 s at 50 Hz of forty joints, beside 30 s of another kind that are the prior."""
    learned = Chain(CHAIN, stays_of(drawn(visible_s, hidden_s, 0.02, 1000), 0.02))
    expected = Chain(VisibilityConfig(visible_s=visible_s, hidden_s=hidden_s))
    # At least 120 transitions: 9 %, and the prior pulls as much.
    np.testing.assert_allclose(probabilities(learned, 0.02)[1], probabilities(expected, 0.02)[1], rtol=0.2)
    np.testing.assert_allclose(1 - probabilities(learned, 0.02)[0], 1 - probabilities(expected, 0.02)[0], rtol=0.2)
    assert learned.usual == pytest.approx(expected.usual, abs=0.03)


def test_without_anything_seen_a_chain_is_the_usual_one() -> None:
    nothing = Stays.of(drawn(1.0, 1.0, 0.02, 50), np.full(50, 0.02), np.zeros((50, 4, 10), dtype=bool))
    assert nothing == Stays()
    for step_s in (0.01, 1.0):
        np.testing.assert_allclose(probabilities(Chain(CHAIN, nothing), step_s), probabilities(Chain(CHAIN), step_s))


def test_half_a_change_of_the_probability_is_half_a_transition() -> None:
    """Two joints by hand, with steps of 0.1 and 0.2 s; the second is not detected in the third frame, and much later
    both have changed."""
    probability = np.array([[[1.0, 0.0]], [[0.5, 0.2]], [[0.75, 1.0]], [[0.0, 0.0]]])
    detected = np.array([[[True, True]], [[True, True]], [[True, False]], [[True, True]]])
    stays = Stays.of(probability, np.array([np.inf, 0.1, 0.2, 3600.0]), detected)
    expected = Stays(visible_s=0.1 + 0.1, hidden_s=0.1 + 0.1, to_hidden=0.5, to_visible=0.25 + 0.2)
    assert stays == pytest.approx(expected)


def test_an_hour_without_occlusion_is_forgotten() -> None:
    """What is usual after it is what was usual after ten minutes."""
    stays, usual = Stays(), dict[int, float]()
    for frame in range(36_000):
        stays = stays.then(Stays(visible_s=68 * 0.1), 0.1)
        usual[frame] = stays.visible_s
    assert usual[35_999] == pytest.approx(usual[5_999], rel=1e-4)
