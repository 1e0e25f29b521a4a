"""Stamps of drifting clocks, and arrivals with jitter, in simulated time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import linprog

from fgpose.live.cameras.clock_model import ClockKind, ClockModel, Stamp
from fgpose.live.cameras.lower_envelope import envelope_line

FPS = 30.0
LATENCY_S = 0.15
# Every one has delays of up to 200 ms beyond the fastest image.
JITTERS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "uniform": lambda rng, n: rng.uniform(0, 0.2, n),
    "exponential": lambda rng, n: np.minimum(rng.exponential(0.05, n), 0.2),
    "triangular": lambda rng, n: rng.triangular(0, 0.1, 0.2, n),
    "bursts": lambda rng, n: np.where(np.arange(n) // 30 % 5 == 0, rng.uniform(0, 0.1, n), rng.uniform(0.1, 0.2, n)),
}


def stamps_and_arrivals(jitter: str, duration_s: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Capture, stamp and arrival of all images, and the drift of up to 200 ppm."""
    rng = np.random.default_rng(seed)
    drift = rng.choice([-200e-6, 200e-6, rng.uniform(-200e-6, 200e-6)])
    captured_s = 1.7e9 + np.arange(int(duration_s * FPS)) / FPS
    stamps_s = rng.uniform(0, 1e6) + (captured_s - captured_s[0]) / (1 + drift)
    return captured_s, stamps_s, captured_s + LATENCY_S + JITTERS[jitter](rng, len(captured_s)), drift


def learned(model: ClockModel, stamps_s: np.ndarray, arrivals_s: np.ndarray) -> np.ndarray:
    return np.array([model.captured_s(Stamp(s), a) for s, a in zip(stamps_s, arrivals_s, strict=True)])


# Of n evenly distributed delays the least is 200 ms / n above the limit: 0.02 ms after five minutes. Of triangular ones
# it is 200 ms / sqrt(2 n): 0.7 ms after twenty. The drift doubles that at the end of the window, and a seed may
# have half as much again.
DURATIONS_S = {"uniform": 300, "exponential": 300, "bursts": 300, "triangular": 1260}
WITHIN_S = {"uniform": 2e-3, "exponential": 2e-3, "bursts": 2e-3, "triangular": 3e-3}


def check_learned(jitter: str, seed: int) -> None:
    captured_s, stamps_s, arrivals_s, drift = stamps_and_arrivals(jitter, DURATIONS_S[jitter], seed)
    model = ClockModel(LATENCY_S)
    errors_s = learned(model, stamps_s, arrivals_s) - captured_s
    assert np.abs(errors_s[-600:]).max() < WITHIN_S[jitter], seed
    assert model.drift == pytest.approx(drift, abs=10e-6)  # 2 ms in 200 s
    assert model.sigma_s is not None
    assert np.abs(errors_s[-1]) < 3 * model.sigma_s


@pytest.mark.parametrize("jitter", ["uniform", "exponential", "bursts"])
def test_offset_and_drift_are_learned_to_2_ms(jitter: str) -> None:
    check_learned(jitter, seed=1)


@pytest.mark.slow
@pytest.mark.parametrize("jitter", JITTERS)
def test_offset_and_drift_are_learned_with_other_seeds(jitter: str) -> None:
    for seed in range(10, 13):
        check_learned(jitter, seed)


def test_sigma_tells_how_good_it_is_from_the_first_seconds_on() -> None:
    ratios = []
    for seed in range(20):
        captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("uniform", 5, seed)
        model = ClockModel(LATENCY_S)
        error_s = learned(model, stamps_s, arrivals_s)[-1] - captured_s[-1]
        assert model.sigma_s is not None
        ratios.append(abs(error_s) / model.sigma_s)
    # 200 ms / 150 images, and the tenth lowest is ten times as far away as the lowest: a cautious sigma.
    assert np.mean(np.array(ratios) < 1) > 0.68
    assert np.max(ratios) < 3


def test_the_line_is_that_of_the_linear_programme() -> None:
    rng = np.random.default_rng(3)
    for n in (2, 3, 50, 300):
        x = np.sort(rng.uniform(0, 600, n))
        y = 0.3 + 2e-4 * x + rng.exponential(0.05, n)
        slope, height = envelope_line(np.stack([x, y], axis=1), float(x.mean()), n / 0.05, 0.0, 1.0)
        constraints = np.stack([np.ones(n), x - x.mean()], axis=1)
        solution = linprog([-1.0, 0.0], constraints, y, bounds=[(None, None)] * 2).x
        # With a prior of 1 s/s only the points count; the solver's tolerance is 1e-7.
        np.testing.assert_allclose([height, slope], solution, atol=1e-6)


def test_few_images_do_not_make_a_drift() -> None:
    _, stamps_s, arrivals_s, _ = stamps_and_arrivals("uniform", 3, seed=0)
    model = ClockModel()
    learned(model, stamps_s, arrivals_s)
    assert abs(model.drift) < 300e-6  # three times what crystals are specified to


@pytest.mark.parametrize("jump_s", [3.0, -3.0, 1e6, -1e6])
def test_a_jump_is_noticed_at_once_and_learned_within_a_second(jump_s: float) -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 60, seed=2)
    stamps_s[1200:] += jump_s
    model = ClockModel(LATENCY_S)
    learned(model, stamps_s[:1200], arrivals_s[:1200])
    assert model.n_jumps == 0
    model.captured_s(Stamp(stamps_s[1200]), arrivals_s[1200])
    assert model.n_jumps == 1
    assert model.jump_s == pytest.approx(jump_s, abs=0.2)  # the jitter of one image
    errors_s = learned(model, stamps_s[1201:], arrivals_s[1201:]) - captured_s[1201:]
    assert model.n_jumps == 1
    # 30 exponential delays of 50 ms: the least is 1.7 ms on average, more than 10 in one of 400 cases.
    assert np.abs(errors_s[30:60]).max() < 10e-3


def test_a_clock_that_is_set_back_a_little_is_known_two_seconds_later() -> None:
    """Until then its images may be out of order: their times are those of the old clock, too old."""
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 60, seed=2)
    stamps_s[1200:] -= 0.5
    model = ClockModel(LATENCY_S)
    errors_s = learned(model, stamps_s, arrivals_s) - captured_s
    assert model.n_jumps == 1
    assert model.jump_s == pytest.approx(-0.5, abs=0.2)  # the jitter of one image
    np.testing.assert_allclose(errors_s[1200:1258], -0.5, atol=10e-3)
    assert np.abs(errors_s[1300:]).max() < 10e-3  # as after any jump


def test_images_that_overtake_each_other_keep_their_times() -> None:
    """Each comes up to half a second late, some come twice: none looks newer than it is."""
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 60, seed=5)
    shuffled = captured_s > captured_s[0] + 30
    rng = np.random.default_rng(0)
    arrivals_s = arrivals_s + np.where(shuffled, rng.uniform(0, 0.5, len(arrivals_s)), 0.0)
    comes = np.append(np.arange(len(arrivals_s)), np.flatnonzero(shuffled)[::5])
    again_s = np.append(arrivals_s, arrivals_s[shuffled][::5] + 0.3)
    comes = comes[np.argsort(again_s)]
    model = ClockModel(LATENCY_S)
    times_s = learned(model, stamps_s[comes], np.sort(again_s))
    assert model.n_jumps == 0
    assert (times_s - captured_s[comes])[300:].max() < 10e-3


@pytest.mark.parametrize("is_one_clock", [True, False])
@pytest.mark.parametrize("back_s", [0.3, 0.4])
def test_a_camera_whose_time_was_set_back_a_little_keeps_its_delays(back_s: float, is_one_clock: bool) -> None:
    """Its images would be believed to come later, which is as likely as any of its times."""
    captured_s, _, arrivals_s, _ = stamps_and_arrivals("exponential", 60, seed=2)
    wall_s = captured_s - np.where(np.arange(len(captured_s)) // 600 == 1, back_s, 0.0)  # for 20 s
    model, told = ClockModel(), []
    times_s = np.empty_like(captured_s)
    for k, (own_s, wall, arrived_s) in enumerate(zip(captured_s, wall_s, arrivals_s, strict=True)):
        times_s[k] = model.captured_s(Stamp(wall if is_one_clock else own_s - 1e6, wall), arrived_s)
        told.append((model.time_sigma_s, model.unproven_s))
    errors_s = times_s - captured_s
    known = 600 + (90 if is_one_clock else 30)  # two seconds until it is known that no image overtook another, and one
    np.testing.assert_allclose(errors_s[:600], 0.0, atol=1e-9)
    # The least of 30 exponential delays of 50 ms, as after any jump.
    np.testing.assert_allclose(errors_s[known:1200], 0.0, atol=10e-3)
    assert told[1100][0] >= 0.1  # nothing proves it
    assert told[1100][1] == pytest.approx(back_s, abs=10e-3)
    np.testing.assert_allclose(errors_s[1230:], 0.0, atol=1e-9)  # it is right again
    assert told[-1] == (0.01, 0.0)


@pytest.mark.parametrize("after_s", [0.1, 0.5, 1.5])
def test_a_clock_that_is_set_from_1970_before_it_is_settled_has_jumped(after_s: float) -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 20, seed=3)
    before = captured_s < captured_s[0] + after_s
    stamps_s = np.where(before, captured_s - captured_s[0], captured_s)
    model = ClockModel(LATENCY_S)
    times_s = learned(model, stamps_s, arrivals_s)
    assert model.n_jumps == 1
    assert np.abs((times_s - captured_s)[~before][60:]).max() < 10e-3  # as after any jump
    assert (times_s <= arrivals_s).all()


def test_what_arrives_late_is_no_jump() -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 60, seed=4)
    # For two seconds nothing comes, then all at once.
    stalled = (captured_s > captured_s[0] + 40) & (captured_s < captured_s[0] + 42)
    arrivals_s[stalled] = captured_s[stalled][-1] + 0.2
    model = ClockModel(LATENCY_S)
    errors_s = learned(model, stamps_s, arrivals_s) - captured_s
    assert model.n_jumps == 0
    # As after 40 s without a stall: the least of 1,200 delays is 0.04 ms, the drift adds 100 ppm of some seconds.
    assert np.abs(errors_s[stalled]).max() < 2e-3


def test_a_stream_that_begins_with_a_backlog_is_caught_up() -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 20, seed=5)
    arrivals_s[:60] = captured_s[60] + LATENCY_S  # the first two seconds come at once
    model = ClockModel(LATENCY_S)
    errors_s = learned(model, stamps_s, arrivals_s) - captured_s
    assert model.n_jumps == 0
    assert np.abs(errors_s[120:]).max() < 5e-3  # two seconds later; the least of 60 delays is 0.8 ms


def test_after_reconnecting_stamps_begin_anew_without_a_fault() -> None:
    _, stamps_s, arrivals_s, drift = stamps_and_arrivals("exponential", 300, seed=6)
    stamps_s[6000:] -= stamps_s[6000]
    model = ClockModel(LATENCY_S)
    learned(model, stamps_s[:6000], arrivals_s[:6000])
    model.restart()
    assert model.offset_s is None
    model.captured_s(Stamp(stamps_s[6000]), arrivals_s[6000])
    assert model.n_jumps == 0
    assert model.drift == pytest.approx(drift, abs=20e-6)  # known from before


def test_without_stamps_the_arrival_counts() -> None:
    model = ClockModel(0.1)
    assert model.captured_s(None, 100.0) == pytest.approx(99.9)
    assert model.offset_s is None
    assert model.sigma_s is None


def test_a_stamp_of_this_computer_is_taken_as_it_is() -> None:
    model = ClockModel(0.1)
    assert model.captured_s(Stamp(99.95, is_host_time=True), 100.0) == 99.95
    assert (model.offset_s, model.sigma_s) == (0.0, 0.0)


@pytest.mark.parametrize(("clock_error_s", "is_believed"), [(0.0, True), (-40.0, False), (40.0, False)])
def test_the_cameras_own_time_is_believed_if_it_agrees_with_the_arrivals(
    clock_error_s: float, is_believed: bool
) -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 30, seed=7)
    model = ClockModel()  # the latency is not known
    last_s = np.nan
    for captured, stamp_s, arrived_s in zip(captured_s, stamps_s, arrivals_s, strict=True):
        last_s = model.captured_s(Stamp(stamp_s, captured + clock_error_s), arrived_s)
    assert (last_s == captured_s[-1]) == is_believed
    if not is_believed:
        assert last_s == pytest.approx(captured_s[-1] + LATENCY_S, abs=2e-3)  # as good as without it


def test_a_camera_whose_time_is_set_is_noticed() -> None:
    captured_s, stamps_s, arrivals_s, _ = stamps_and_arrivals("exponential", 30, seed=8)
    model = ClockModel(LATENCY_S)
    last_s = np.nan
    for k, (captured, stamp_s, arrived_s) in enumerate(zip(captured_s, stamps_s, arrivals_s, strict=True)):
        last_s = model.captured_s(Stamp(stamp_s, captured + (60.0 if k >= 600 else 0.0)), arrived_s)
    assert model.n_jumps == 1
    assert model.jump_s == pytest.approx(60.0, abs=0.01)  # 200 ppm between two images
    assert last_s == pytest.approx(captured_s[-1], abs=2e-3)  # learned meanwhile


def test_memory_is_bounded() -> None:
    model = ClockModel()
    for k in range(800):
        model.captured_s(Stamp(2.0 * k), 1e9 + 2.0 * k)
    assert model._segment is not None
    assert len(model._segment._buckets) <= 602
    assert len(model._segment._recent) <= 1


def test_how_far_all_times_of_a_camera_may_be_off() -> None:
    """Nothing by this computer's clock; else what is known of the offset, and of the delay of the fastest image."""
    host = ClockModel()
    host.captured_s(Stamp(5.0, is_host_time=True), 5.1)
    assert host.time_sigma_s == 0.0
    synchronised = ClockModel()
    synchronised.captured_s(Stamp(5.0, wall_s=100.0), 100.1)
    assert synchronised.time_sigma_s == synchronised.sigma_s == 0.01
    unknown, known, without = ClockModel(), ClockModel(latency_s=0.12), ClockModel()
    for number in range(300):
        for model in (unknown, known):
            model.captured_s(Stamp(number / 30), 1000.0 + number / 30 + 0.02 * (number % 7 > 0))
        without.captured_s(None, 1000.0 + number / 30)
    assert known.sigma_s is not None
    assert known.time_sigma_s == pytest.approx(np.hypot(0.01, known.sigma_s))
    assert unknown.time_sigma_s == pytest.approx(np.hypot(0.1, known.sigma_s))
    assert without.time_sigma_s == 0.1


def unproven_s(late_s: float, behind_s: float, latency_s: float = 0.0, clock: ClockKind = "auto") -> float | None:
    """Of images that come so late from a clock that is so much behind."""
    model = ClockModel(latency_s, clock)
    for k in range(60):
        taken_s = 1.7e9 + k / FPS
        model.captured_s(Stamp(taken_s - behind_s, taken_s - behind_s), taken_s + late_s)
    return model.unproven_s


def test_late_images_and_a_clock_that_is_behind_look_alike() -> None:
    """So the worse of both is possible; not where it is declared which of them it is."""
    for late_s, behind_s in ((0.6, 0.0), (0.0, 0.6), (0.3, 0.3)):
        assert unproven_s(late_s, behind_s) == pytest.approx(0.6, abs=1e-3)
        assert unproven_s(late_s, behind_s, clock="synchronised") == 0.0
        assert unproven_s(late_s, behind_s, latency_s=0.05, clock="own") == 0.0
        assert unproven_s(late_s, behind_s, clock="own") is None
    assert unproven_s(0.05, 0.0) == 0.0
    # Ahead of the images' arrival: the clock is wrong, and tells nothing of how late they are.
    assert unproven_s(0.1, -0.6) is None


def test_a_declared_clock_is_believed() -> None:
    late = ClockModel(clock="synchronised")
    taken_s = 1.7e9 + np.arange(60) / FPS
    said_s = [late.captured_s(Stamp(each_s, each_s), each_s + 2.0) for each_s in taken_s.tolist()]
    np.testing.assert_array_equal(said_s, taken_s)


def test_what_tells_how_late_images_come() -> None:
    for stamp, latency_s, expected in (
        (Stamp(5.0, is_host_time=True), 0.0, 0.0),
        (Stamp(5.0), 0.0, None),
        (Stamp(5.0), 0.12, 0.0),
        (None, 0.0, None),
        (None, 0.12, 0.0),
    ):
        model = ClockModel(latency_s)
        model.captured_s(stamp, 1000.0)
        assert model.unproven_s == expected


def test_a_clock_that_was_ahead_is_believed_half_a_minute_later() -> None:
    """Then it has been right for as long as any clock must be."""
    model, told = ClockModel(), []
    for k in range(100 * int(FPS)):
        taken_s = 1.7e9 + k / FPS
        stamp_s = taken_s + (0.2 if 20 < k / FPS < 23 else 0.0)
        model.captured_s(Stamp(stamp_s, stamp_s), taken_s + 0.03)
        told.append(model.unproven_s)
    known = np.array([each == 0.0 for each in told])
    assert known[: 20 * int(FPS)].all()
    assert not known[21 * int(FPS) : 52 * int(FPS)].any()
    assert known[55 * int(FPS) :].all()
