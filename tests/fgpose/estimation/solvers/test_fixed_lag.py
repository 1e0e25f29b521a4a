"""The sliding window of iSAM2 against a plain Kalman filter and smoother."""

from __future__ import annotations

import itertools
import re
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import gtsam
import numpy as np
import pytest

from fgpose.estimation.keys import position_key, velocity_key
from fgpose.estimation.solvers.fixed_lag import Changes, FixedLagSmoother
from fgpose.skeleton import MAX_JOINTS
from fgpose_factors import State, constant_velocity_factor, noise_model, random_walk_factor

STEP_S, DENSITY, SIGMA_M = 0.02, 20.0, 0.02


def frame_of(
    number: int, measured_m: np.ndarray, step_s: float = STEP_S, sigma_m: float = SIGMA_M
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, list[int]]:
    """One joint, measured directly: a linear problem, so that the filter is exact."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    position, velocity = position_key(0, number), velocity_key(0, number)
    graph.add(gtsam.PriorFactorPoint3(position, measured_m, noise_model(3, sigma_m)))
    if number == 0:
        graph.add(gtsam.PriorFactorPoint3(velocity, np.zeros(3), noise_model(3, 1.0)))
    else:
        before = State(position_key(0, number - 1), velocity_key(0, number - 1), (number - 1) * step_s)
        graph.add(constant_velocity_factor(before, State(position, velocity, number * step_s), DENSITY))
    values.insert(position, measured_m)
    values.insert(velocity, np.zeros(3))
    return graph, values, [position, velocity]


def kalman_filter(
    measured_m: np.ndarray, step_s: float = STEP_S, sigma_m: float = SIGMA_M
) -> tuple[np.ndarray, np.ndarray]:
    """Filtered positions and the variance of the last one, per axis, by the textbook recursion."""
    F = np.array([[1.0, step_s], [0.0, 1.0]])
    Q = DENSITY * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    P, state = np.diag([sigma_m**2, 1.0]), np.stack([measured_m[0], np.zeros(3)])
    filtered = [state[0]]
    for measurement in measured_m[1:]:
        state, P = F @ state, F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + sigma_m**2)
        state = state + np.outer(gain, measurement - state[0])
        P = P - np.outer(gain, P[0])
        filtered.append(state[0])
    return np.array(filtered), P


# 3 frames are more than the two variables of a frame can label in order, so the order must be restored now and then.
@pytest.mark.parametrize("lag", [1, 3, 12])
def test_the_newest_estimate_is_that_of_a_kalman_filter(lag: int) -> None:
    rng = np.random.default_rng(0)
    measured_m = np.cumsum(rng.normal(0, 0.02, (60, 3)), axis=0)
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    filtered_m, variance = kalman_filter(measured_m)
    for number, measurement in enumerate(measured_m):
        smoother.add(*frame_of(number, measurement))
        if number >= lag:
            smoother.drop_oldest()
        # 1e-6 m: GTSAM back-substitutes only where the change exceeds its wildfire threshold.
        np.testing.assert_allclose(smoother.points([position_key(0, number)])[0], filtered_m[number], atol=1e-6)
    covariance_m2 = smoother.covariances([position_key(0, 59)])[0]
    np.testing.assert_allclose(covariance_m2, variance[0, 0] * np.eye(3), rtol=1e-6, atol=1e-12)


def test_frames_without_variables_and_separate_frames() -> None:
    smoother = FixedLagSmoother(relinearize_m=0.01)
    for number in range(6):
        if number % 2:
            smoother.add(gtsam.NonlinearFactorGraph(), gtsam.Values(), [])
        else:
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            graph.add(gtsam.PriorFactorPoint3(position_key(0, number), np.ones(3), noise_model(3, 0.1)))
            values.insert(position_key(0, number), np.zeros(3))
            smoother.add(graph, values, [position_key(0, number)])
    for _ in range(5):
        smoother.drop_oldest()
    assert smoother.covariances([]).shape == (0, 3, 3)


def random_stream(seed: int) -> Iterator[tuple[gtsam.NonlinearFactorGraph, gtsam.Values, list[int]]]:
    """Joints that come and go, some tied to each other, and that jump, so that old frames are linearised again."""
    rng = np.random.default_rng(seed)
    n_joints, with_velocity = int(rng.integers(1, 6)), bool(rng.random() < 0.5)
    presence, present = rng.uniform(0.3, 1.0), np.zeros(n_joints, dtype=bool)
    centre_m = rng.normal(0, 1, (n_joints, 3))
    for number in range(int(rng.integers(15, 45))):
        before = present
        present = np.where(rng.random(n_joints) < 0.2, rng.random(n_joints) < presence, before)
        graph, values, keys = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        measured_m = centre_m + rng.normal(0, rng.choice([0.01, 0.5]), (n_joints, 3))
        for joint in np.flatnonzero(present).tolist():
            position, velocity = position_key(joint, number), velocity_key(joint, number)
            values.insert(position, measured_m[joint])
            keys.append(position)
            if rng.random() < 0.7 or not before[joint]:
                graph.add(gtsam.PriorFactorPoint3(position, measured_m[joint], noise_model(3, SIGMA_M)))
            if with_velocity:
                values.insert(velocity, np.zeros(3))
                keys.append(velocity)
                graph.add(gtsam.PriorFactorPoint3(velocity, np.zeros(3), noise_model(3, 3.0)))
            if before[joint] and with_velocity:
                start = State(position_key(joint, number - 1), velocity_key(joint, number - 1), (number - 1) * STEP_S)
                graph.add(constant_velocity_factor(start, State(position, velocity, number * STEP_S), DENSITY))
            elif before[joint]:
                graph.add(random_walk_factor(position_key(joint, number - 1), position, STEP_S, 1.0))
        for start, end in itertools.pairwise(np.flatnonzero(present).tolist()):
            if rng.random() < 0.8:
                keys_of_bone = position_key(start, number), position_key(end, number)
                graph.add(gtsam.RangeFactor3(*keys_of_bone, 0.5, noise_model(1, 0.01)))
        yield graph, values, keys


def check_order(smoother: FixedLagSmoother) -> None:
    """No clique of the Bayes tree is conditioned on a frame earlier than its own, and its own are in order."""
    if smoother._isam.empty():
        return
    for label in re.findall(r'label="(.*)"', smoother._isam.dot()):
        own, given = (
            [int(number) // MAX_JOINTS for number in re.findall(r"\d+", part)] for part in (label + ":").split(":")[:2]
        )
        assert own == sorted(own)
        assert own[-1] <= min(given, default=own[-1])


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(30, 200), marks=pytest.mark.slow)])
def test_the_bayes_tree_is_always_in_the_order_of_time(seeds: range) -> None:
    """What marginalizeLeaves needs, in random streams; most windows hold more frames than a frame has variables."""
    rng = np.random.default_rng(seeds.start)
    for seed in seeds:
        smoother, lag = FixedLagSmoother(relinearize_m=float(rng.choice([0.003, 0.03, 0.3]))), int(rng.integers(1, 25))
        for number, (graph, values, keys) in enumerate(random_stream(seed)):
            smoother.add(graph, values, keys)
            check_order(smoother)
            if number >= lag:
                smoother.drop_oldest()
            assert np.isfinite(smoother.points(keys)).all()
        check_order(smoother)
        assert smoother.repairs == 0


def without_links(
    graph: gtsam.NonlinearFactorGraph, keys: list[int]
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.NonlinearFactorGraph]:
    """The factors of a frame with these keys alone, and those to the frame before."""
    own, links = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    for factor in (graph.at(index) for index in range(graph.size())):
        (own if set(factor.keys()) <= set(keys) else links).add(factor)
    return own, links


@pytest.mark.parametrize("at", [0, 2, 5])
def test_replaced_factors_count_no_more(at: int) -> None:
    """A measurement that is first wrong by a metre and then put right: as if it had been right from the start."""
    measured_m = np.cumsum(np.random.default_rng(0).normal(0, 0.02, (12, 3)), axis=0)
    right, mended = smoothers = [FixedLagSmoother(relinearize_m=1e-3) for _ in range(2)]
    for number, measurement in enumerate(measured_m):
        for smoother in smoothers:
            wrong_m = float(smoother is mended and number == 6 + at)
            graph, values, keys = frame_of(number, measurement + wrong_m)
            own, links = without_links(graph, keys)
            smoother.add(own, values, keys, links)
            if number >= 6:
                smoother.drop_oldest()
    graph, _, keys = frame_of(6 + at, measured_m[6 + at])
    mended.replace({at: (keys, without_links(graph, keys)[0])})
    keys = [position_key(0, number) for number in range(6, 12)]
    np.testing.assert_allclose(mended.points(keys), right.points(keys), atol=1e-6)
    np.testing.assert_allclose(mended.covariances(keys), right.covariances(keys), rtol=1e-6, atol=1e-12)
    for smoother in smoothers:
        for _ in range(5):
            smoother.drop_oldest()
    np.testing.assert_allclose(mended.points(keys[-1:]), right.points(keys[-1:]), atol=1e-6)


def test_a_new_frame_and_changes_together_are_as_one_after_the_other() -> None:
    """The frame before last is measured anew each time; once nothing else happens, as when a person is away."""
    rng = np.random.default_rng(0)
    apart, together = smoothers = [FixedLagSmoother(relinearize_m=1e-3) for _ in range(2)]
    for number, measurement in enumerate(np.cumsum(rng.normal(0, 0.02, (20, 3)), axis=0)):
        graph, values, keys = frame_of(number, measurement)
        own, links = without_links(graph, keys)
        at = min(number, 6) - 2
        changes: dict[int, tuple[list[int], gtsam.NonlinearFactorGraph]] = {}
        if at >= 0:
            again, _, before = frame_of(number - 2, measurement + rng.normal(0, 0.02, 3))
            changes = {at: (before, without_links(again, before)[0])}
        if number == 19:
            own, values, keys, links = gtsam.NonlinearFactorGraph(), gtsam.Values(), [], None
        apart.replace(changes)
        apart.add(own, values, keys, links)
        together.add(own, values, keys, links, changes)
        check_order(together)
        newest = [position_key(0, min(number, 18))]
        np.testing.assert_allclose(together.points(newest), apart.points(newest), atol=1e-9)
        if number >= 6:
            for smoother in smoothers:
                smoother.drop_oldest()
    keys = [position_key(0, number) for number in range(14, 19)]
    np.testing.assert_allclose(together.points(keys), apart.points(keys), atol=1e-9)
    np.testing.assert_allclose(together.covariances(keys), apart.covariances(keys), rtol=1e-6, atol=1e-12)


def test_what_joins_other_variables_stays() -> None:
    """The measurement of one of two joints is replaced; that of the other and the bone between them are not."""
    graph, values, keys = gtsam.NonlinearFactorGraph(), gtsam.Values(), [position_key(joint, 0) for joint in range(2)]
    for key, start_m in zip(keys, ([0.0, 0.0, 0.0], [0.3, 0.0, 0.0]), strict=True):
        graph.add(gtsam.PriorFactorPoint3(key, np.array(start_m), noise_model(3, 0.01)))
        values.insert(key, np.array(start_m))
    graph.add(gtsam.RangeFactor3(keys[0], keys[1], 0.3, noise_model(1, 1e-4)))
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    smoother.add(graph, values, keys)
    moved = gtsam.NonlinearFactorGraph()
    moved.add(gtsam.PriorFactorPoint3(keys[0], np.array([0.02, 0.0, 0.0]), noise_model(3, 0.01)))
    smoother.replace({0: (keys[:1], moved)})
    # Both measurements count alike and the bone hardly gives: each joint moves by half of it.
    np.testing.assert_allclose(smoother.points(keys), [[0.01, 0, 0], [0.31, 0, 0]], atol=1e-5)
    smoother.replace({0: (keys, gtsam.NonlinearFactorGraph(graph))})
    np.testing.assert_allclose(smoother.points(keys), [[0.0, 0, 0], [0.3, 0, 0]], atol=1e-9)


def test_replacing_works_on_after_a_failure() -> None:
    """All factors have other slots then."""
    measured_m = np.cumsum(np.random.default_rng(0).normal(0, 0.02, (12, 3)), axis=0)
    right, mended = smoothers = [FixedLagSmoother(relinearize_m=1e-3) for _ in range(2)]
    for number, measurement in enumerate(measured_m):
        for smoother in smoothers:
            graph, values, keys = frame_of(number, measurement + float(smoother is mended and number == 8))
            own, links = without_links(graph, keys)
            smoother.add(own, values, keys, links)
            if number >= 6:
                smoother.drop_oldest()
    mended._isam = FailingOnce(mended._isam, "calculateEstimatePoint3")  # pyrefly: ignore[bad-assignment]
    mended.points([position_key(0, 11)])
    assert mended.repairs == 1
    graph, _, keys = frame_of(8, measured_m[8])
    mended.replace({2: (keys, without_links(graph, keys)[0])})
    keys = [position_key(0, number) for number in range(6, 12)]
    np.testing.assert_allclose(mended.points(keys), right.points(keys), atol=1e-6)
    assert mended.repairs == 1


def test_after_a_recovery_a_frozen_factor_is_replaced_too() -> None:
    """It looks like what was marginalised."""
    start_m, key, smoother = np.zeros(3), position_key(0, 0), FixedLagSmoother(relinearize_m=1e-3)
    values = gtsam.Values()
    values.insert(key, start_m)

    def frozen(position_m: np.ndarray) -> gtsam.NonlinearFactorGraph:
        graph, prior = gtsam.NonlinearFactorGraph(), gtsam.PriorFactorPoint3(key, position_m, noise_model(3, 0.01))
        graph.add(gtsam.LinearContainerFactor(prior.linearize(values), values))
        return graph

    smoother.add(frozen(start_m), values, [key])
    smoother._recover()
    smoother.replace({0: ([key], frozen(np.array([0.1, 0.0, 0.0])))})
    np.testing.assert_allclose(smoother.points([key])[0], [0.1, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(smoother.covariances([key])[0], 1e-4 * np.eye(3), rtol=1e-6, atol=1e-12)


def measured_again(rng: np.random.Generator, window: Sequence[list[int]]) -> Changes:
    """Other measurements of some of the variables of some frames."""
    changes: dict[int, tuple[list[int], gtsam.NonlinearFactorGraph]] = {}
    for at, keys in enumerate(window):
        if rng.random() < 0.3:
            among, factors = [key for key in keys if rng.random() < 0.7], gtsam.NonlinearFactorGraph()
            for key in among:
                factors.add(gtsam.PriorFactorPoint3(key, rng.normal(0, 0.5, 3), noise_model(3, 0.1)))
            changes[at] = among, factors
    return changes


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(15), range(15, 40)])
def test_the_order_survives_replacements(seeds: range) -> None:
    """In random streams, frames get other measurements, and the newest further joints as well."""
    rng = np.random.default_rng(1 + seeds.start)
    for seed in seeds:
        smoother, lag = FixedLagSmoother(relinearize_m=float(rng.choice([0.003, 0.3]))), int(rng.integers(1, 25))
        window: deque[list[int]] = deque()
        for number, (graph, values, keys) in enumerate(random_stream(seed)):
            own, links = without_links(graph, keys)
            smoother.add(own, values, keys, links, measured_again(rng, window) if rng.random() < 0.5 else None)
            check_order(smoother)
            window.append(keys)
            if number >= lag:
                smoother.drop_oldest()
                window.popleft()
            at = len(window) - 1 if rng.random() < 0.5 else int(rng.integers(len(window)))
            factors, entering = gtsam.NonlinearFactorGraph(), gtsam.Values()
            new = [position_key(9, number)] if at == len(window) - 1 and rng.random() < 0.5 else []
            for key in new:
                entering.insert(key, np.zeros(3))
            for key in [*window[at], *new]:
                factors.add(gtsam.PriorFactorPoint3(key, rng.normal(0, 0.5, 3), noise_model(3, 0.1)))
            window[at] = [*window[at], *new]
            smoother.replace({at: (window[at], factors)}, entering, new)
            check_order(smoother)
            assert np.isfinite(smoother.points(window[at])).all()
        assert smoother.repairs == 0


class FailingOnce:
    """An iSAM2 one method of which fails."""

    def __init__(self, isam: gtsam.ISAM2, method: str) -> None:
        self._isam, self._method = isam, method

    def __getattr__(self, name: str) -> Any:
        if name == self._method:
            raise RuntimeError("Indeterminate linear system detected")
        return getattr(self._isam, name)


@pytest.mark.parametrize(
    "method", ["update", "predictUpdateInfo", "marginalizeLeaves", "calculateEstimatePoint3", "jointMarginalCovariance"]
)
def test_it_goes_on_when_gtsam_fails(method: str) -> None:
    measured_m = 1.0 + np.random.default_rng(0).normal(0, SIGMA_M, (40, 3))
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    for number, measurement in enumerate(measured_m):
        if number == 15:
            smoother._isam = FailingOnce(smoother._isam, method)  # pyrefly: ignore[bad-assignment]
        smoother.add(*frame_of(number, measurement))
        if number >= 5:
            smoother.drop_oldest()
        position = position_key(0, number)
        # 3 sigma of a measurement; far less once the filter knows more again.
        assert np.linalg.norm(smoother.points([position])[0] - 1.0) < 3 * SIGMA_M * np.sqrt(3)
        assert (np.linalg.eigvalsh(smoother.covariances([position])[0]) > 0).all()
    assert smoother.repairs >= 1
    filtered_m, variance = kalman_filter(measured_m)
    # What was known before the failure was lost; 24 frames later it no longer counts (1 mm of 8 mm).
    last = [position_key(0, 39)]
    np.testing.assert_allclose(smoother.points(last)[0], filtered_m[-1], atol=1e-3)
    np.testing.assert_allclose(smoother.covariances(last)[0], variance[0, 0] * np.eye(3), rtol=0.02, atol=1e-9)


def test_it_goes_on_after_factors_without_a_solution() -> None:
    """A distance of zero: GTSAM's Jacobian is NaN, in this frame and whenever it is eliminated again."""
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    for number in range(6):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        keys = [position_key(joint, number) for joint in range(2)]
        for joint, key in enumerate(keys):
            point_m = np.array([0.0 if number == 2 else 0.5 * joint, 0.0, 1.0])
            values.insert(key, point_m)
            graph.add(gtsam.PriorFactorPoint3(key, point_m, noise_model(3, SIGMA_M)))
            if number:
                graph.add(random_walk_factor(position_key(joint, number - 1), key, STEP_S, 1.0))
        graph.add(gtsam.RangeFactor3(keys[0], keys[1], 0.5, noise_model(1, 0.005)))
        smoother.add(graph, values, keys)
        points_m = smoother.points(keys)
        assert np.isfinite(points_m).all()
        assert (smoother.repairs > 0) == (number >= 2)
    newest_m = smoother.points([position_key(joint, 5) for joint in range(2)])
    np.testing.assert_allclose(newest_m, [[0, 0, 1], [0.5, 0, 1]], atol=0.02)


@pytest.mark.parametrize("far", [1e12, 1e141, np.inf])
def test_a_point_beyond_the_earth_is_no_solution(far: float) -> None:
    key, smoother = position_key(0, 0), FixedLagSmoother(relinearize_m=1e-3)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(key, np.ones(3))
    graph.add(gtsam.PriorFactorPoint3(key, np.array([far, 0.0, 0.0]), noise_model(3, SIGMA_M)))
    smoother.add(graph, values, [key])
    np.testing.assert_array_equal(smoother.points([key]), [[1.0, 1.0, 1.0]])  # starts again from the first guess
    assert smoother.repairs > 0


def test_it_goes_on_when_also_the_first_guess_is_beyond_the_earth() -> None:
    """After a pause of months, a person who walked on would be there: it starts again from guesses without failing."""
    smoother = FixedLagSmoother(relinearize_m=1e-3)
    for number in range(6):
        smoother.add(*frame_of(number, np.full(3, 1e12 if 1 < number < 4 else 0.5)))
        assert np.isfinite(smoother.points([position_key(0, number)])).all()
        assert np.isfinite(smoother.covariances([position_key(0, number)])).all()
        if number >= 3:
            smoother.drop_oldest()


def test_what_cholesky_refuses_is_solved_by_qr() -> None:
    """500 Hz, and detections good to 1 m: nothing is lost, neither when it begins nor when it ends."""
    step_s, sigma_m, lag = 0.002, 1.0, 10
    measured_m = np.random.default_rng(0).normal(0, sigma_m, (60, 3))
    filtered_m, variance = kalman_filter(measured_m, step_s, sigma_m)
    smoother = FixedLagSmoother(relinearize_m=10.0)
    for number, measurement in enumerate(measured_m):
        smoother.add(*frame_of(number, measurement, step_s, sigma_m))
        if number >= lag:
            smoother.drop_oldest()
        np.testing.assert_allclose(smoother.points([position_key(0, number)])[0], filtered_m[number], atol=1e-5)
    assert 0 < smoother.repairs < 20
    covariance_m2 = smoother.covariances([position_key(0, 59)])[0]
    np.testing.assert_allclose(covariance_m2, variance[0, 0] * np.eye(3), rtol=1e-6, atol=1e-12)


class Refusing:
    """ISAM2 that takes what it is given, and fails to eliminate it."""

    def __init__(self, isam: gtsam.ISAM2) -> None:
        self._isam = isam

    def update(self, *arguments: Any) -> None:
        self._isam.update(*arguments)
        raise RuntimeError("indeterminate")

    def __getattr__(self, name: str) -> object:
        return getattr(self._isam, name)


def test_where_cholesky_fails_again_the_factors_stay_where_they_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Factors are replaced by equal ones: that changes nothing, unless others are removed in their place."""
    isam2, measured_m = gtsam.ISAM2, np.random.default_rng(0).normal(0, SIGMA_M, (20, 3))
    filtered_m, _ = kalman_filter(measured_m, STEP_S, SIGMA_M)
    smoother, window = FixedLagSmoother(relinearize_m=1e-3), list[tuple[list[int], gtsam.NonlinearFactorGraph]]()
    for number, measurement in enumerate(measured_m):
        graph, values, keys = frame_of(number, measurement)
        own, links = without_links(graph, keys)
        smoother.add(own, values, keys, links)
        window.append((keys, own))
        if number >= 6:
            smoother.drop_oldest()
            del window[0]
    monkeypatch.setattr(
        gtsam, "ISAM2", lambda params: Refusing(isam2(params)) if params.getFactorization() != "QR" else isam2(params)
    )
    smoother._qr_frames = 1
    smoother._back_to_cholesky()
    assert smoother.repairs == 1
    smoother.replace(dict(enumerate(window)))
    np.testing.assert_allclose(smoother.points([position_key(0, 19)])[0], filtered_m[-1], atol=1e-9)
    smoother.drop_oldest()
    np.testing.assert_allclose(smoother.points([position_key(0, 19)])[0], filtered_m[-1], atol=1e-9)
