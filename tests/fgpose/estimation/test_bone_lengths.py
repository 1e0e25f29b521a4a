from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.bone_lengths import RunningLengths
from fgpose.skeleton import Skeleton

NAN = np.nan
STEP_S = 0.02
ALL = np.ones(5, dtype=bool)


@pytest.fixture
def body() -> Skeleton:
    """Two mirrored bones, and one of the midline."""
    return Skeleton("body", ("l0", "l1", "r0", "r1", "m"), ((0, 1), (2, 3), (0, 4)), (0,), ((0, 2), (1, 3)))


def pose(left_m: float, right_m: float, middle_m: float = 0.5) -> np.ndarray:
    positions_m = np.zeros((5, 3))
    positions_m[1, 0], positions_m[3, 1], positions_m[4, 2] = left_m, right_m, middle_m
    return positions_m


def test_nothing_is_known_before_the_first_sample(body):
    assert np.isnan(RunningLengths(body).median_m()).all()


def test_left_and_right_make_one_median(body):
    lengths = RunningLengths(body)
    for left_m, right_m in ((0.30, 0.32), (0.31, 0.40), (0.29, 0.33)):
        lengths.add(STEP_S, pose(left_m, right_m), ALL)
    # of 0.29, 0.30, 0.31 | 0.32, 0.33, 0.40: the lower of the middle two, in bins of 1 mm
    assert lengths.median_m()[0] == pytest.approx(0.31, abs=1e-3)
    assert lengths.median_m()[1] == pytest.approx(0.50, abs=1e-3)


def test_the_median_and_its_sigma_are_those_of_the_samples(body):
    rng = np.random.default_rng(0)
    samples_m = 0.4 + 0.02 * rng.normal(size=(500, 2))
    lengths = RunningLengths(body)
    for left_m, right_m in samples_m:
        lengths.add(STEP_S, pose(left_m, right_m), ALL)
    assert lengths.median_m()[0] == pytest.approx(np.median(samples_m), abs=1e-3)  # a bin
    # sqrt(pi / 2) sigma / sqrt(n), 2 x 0.15 s / 0.02 s = 15 samples counting as one; the quartiles of 1000 samples are
    # good to 5 %, and a bin is added
    expected_m = np.sqrt(np.pi / 2) * 0.021 / np.sqrt(1000 / 15)
    assert lengths.sigma_m()[0] == pytest.approx(expected_m, rel=0.1)


def test_sigma_does_not_depend_on_the_frame_rate(body):
    """Errors of detections are correlated in time: twice as many frames in the same time tell no more."""
    rng = np.random.default_rng(0)
    errors_m = np.repeat(0.02 * rng.normal(size=40), 20)
    slow, fast = RunningLengths(body), RunningLengths(body)
    for number, error_m in enumerate(errors_m):
        fast.add(0.01, pose(0.4 + error_m, 0.4 - error_m), ALL)
        if number % 2 == 0:
            slow.add(0.02, pose(0.4 + error_m, 0.4 - error_m), ALL)
    np.testing.assert_allclose(fast.sigma_m(), slow.sigma_m(), rtol=1e-6)


def test_sigma_falls_as_samples_come_and_a_tenth_of_outliers_hardly_matters(body):
    rng = np.random.default_rng(0)
    lengths, sigmas_m = RunningLengths(body), []
    for number in range(400):
        length_m = 0.3 + 0.01 * rng.normal() + (0.5 if number % 10 == 0 else 0.0)
        lengths.add(STEP_S, pose(length_m, length_m), ALL)
        if number in (20, 100, 399):
            sigmas_m.append(float(lengths.sigma_m()[0]))
    assert sigmas_m[0] > sigmas_m[1] > sigmas_m[2]
    # a tenth of outliers on one side is the quantile 0.5 / 0.9 of the rest: 0.14 sigma
    assert lengths.median_m()[0] == pytest.approx(0.3, abs=0.003)


def test_what_is_not_trusted_missing_or_absurd_is_no_sample(body):
    lengths = RunningLengths(body)
    lengths.add(STEP_S, pose(0.3, 0.3), np.array([True, False, True, True, False]))
    lengths.add(STEP_S, pose(NAN, 0.3), ALL)
    lengths.add(STEP_S, pose(25.0, 0.3, 30.0), ALL)
    # one sample of the right bone each time; of the midline only the second frame's
    assert lengths.median_m()[0] == pytest.approx(0.3, abs=1e-3)
    assert lengths.median_m()[1] == pytest.approx(0.5, abs=1e-3)


def test_memory_does_not_grow(body):
    lengths = RunningLengths(body)
    for _ in range(200):
        lengths.add(STEP_S, pose(0.3, 0.31), ALL)
    assert np.isfinite(lengths.sigma_m()).all()
    assert sum(array.nbytes for array in vars(lengths).values() if isinstance(array, np.ndarray)) < 50_000
