from __future__ import annotations

import math

import numpy as np
import pytest

from fgpose_benchmarks.comparison.scores import Score
from fgpose_benchmarks.comparison.summary import (
    FEWEST_RECORDINGS,
    Summary,
    best,
    best_other,
    methods_of,
    paired_ratio,
    summarise,
    variants_of,
)
from tests.benchmarks.comparison.made_up_scores import made_up, over_clips

NAN = math.nan


def of_errors(errors_mm: list[float], method: str = "fgpose batch", group: str = "ours") -> Summary:
    return summarise(over_clips(errors_mm, method=method, group=group))["occluded", method]


def test_means_are_over_recordings():
    summary = of_errors([10.0, 20.0, 60.0])
    interval = summary.interval("mpjpe_mm")
    assert summary.mean("mpjpe_mm") == pytest.approx(30.0)
    assert interval.value == pytest.approx(30.0)
    assert interval.low < 30.0 < interval.high
    assert interval.n_recordings == 3


def test_no_interval_goes_beyond_the_recordings():
    # Student's t of one degree of freedom asks for more than two recordings can say: all there is, from end to end.
    interval = of_errors([10.0, 20.0]).interval("mpjpe_mm")
    assert (interval.low, interval.high) == pytest.approx((10.0, 20.0))
    assert interval.half_width == pytest.approx(5.0)


def test_few_recordings_give_their_range_and_more_give_less():
    errors_mm = [10.0, 12.0, 13.0, 16.0, 19.0, 22.0, 23.0, 30.0]
    few = of_errors(errors_mm[: FEWEST_RECORDINGS - 1]).interval("mpjpe_mm")
    assert (few.low, few.high) == pytest.approx((10.0, 16.0))
    many = of_errors(errors_mm).interval("mpjpe_mm")
    # The mean plus and minus Student's t of 7 degrees of freedom standard errors: bootstrap and t differ by little.
    half_mm = 2.36 * np.std(errors_mm, ddof=1) / math.sqrt(8)
    assert many.half_width == pytest.approx(half_mm, rel=0.1)


def test_one_recording_has_no_interval():
    interval = of_errors([12.0]).interval("mpjpe_mm")
    assert interval.value == 12.0
    assert math.isnan(interval.low)
    assert math.isnan(interval.high)


def test_equal_recordings_have_an_interval_without_width():
    interval = of_errors([12.0, 12.0, 12.0]).interval("mpjpe_mm")
    assert (interval.low, interval.high) == pytest.approx((12.0, 12.0))


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(1)
    n_trials, hits = 300, 0
    for _ in range(n_trials):
        interval = of_errors(rng.normal(40.0, 8.0, 12).tolist()).interval("mpjpe_mm")
        hits += interval.low <= 40.0 <= interval.high
    # Three standard deviations of a binomial share of 300 trials at 95 %.
    assert hits / n_trials == pytest.approx(0.95, abs=3 * math.sqrt(0.95 * 0.05 / n_trials))


def test_an_interval_is_the_same_every_time():
    errors_mm = [11.0, 13.0, 17.0, 19.0, 23.0]
    assert of_errors(errors_mm).interval("mpjpe_mm") == of_errors(errors_mm).interval("mpjpe_mm")


def test_recordings_without_the_number_are_left_out_and_counted():
    interval = of_errors([10.0, NAN, 30.0]).interval("mpjpe_mm")
    assert interval.value == pytest.approx(20.0)
    assert interval.n_recordings == 2
    nothing = of_errors([NAN, NAN]).interval("mpjpe_mm")
    assert math.isnan(nothing.value)
    assert nothing.n_recordings == 0


def test_an_infinite_error_is_not_hidden():
    assert of_errors([10.0, math.inf, 30.0]).interval("mpjpe_mm").value == math.inf


def test_fields_with_several_numbers_go_by_index():
    scores = [made_up(clip="a", coverage=(0.4, 0.8, 0.9)), made_up(clip="b", coverage=(0.6, 0.9, 1.0))]
    summary = summarise(scores)["occluded", "fgpose batch"]
    assert summary.mean("coverage", 1) == pytest.approx(0.85)
    assert math.isnan(summary.mean("coverage", 3))


def test_a_ratio_is_that_of_the_means():
    ratio = paired_ratio(of_errors([10.0, 30.0]), of_errors([10.0, 90.0], "RANSAC", "per-frame"))
    # The mean of the ratios would be 0.67.
    assert ratio.value == pytest.approx(0.4)
    assert ratio.low < 0.4 < ratio.high


def test_hard_recordings_cancel_in_a_ratio():
    ratio = paired_ratio(of_errors([10.0, 40.0, 90.0]), of_errors([20.0, 80.0, 180.0], "RANSAC", "per-frame"))
    assert (ratio.low, ratio.value, ratio.high) == pytest.approx((0.5, 0.5, 0.5))


def test_a_ratio_is_over_the_recordings_of_both():
    other = of_errors([20.0, NAN, 50.0, 1000.0], "RANSAC", "per-frame")
    ratio = paired_ratio(of_errors([10.0, 500.0, 25.0]), other)
    assert ratio.value == pytest.approx(0.5)
    assert ratio.n_recordings == 2


def test_a_ratio_of_nothing_in_common_is_missing():
    ours = summarise([made_up(clip="a")])["occluded", "fgpose batch"]
    other = summarise([made_up(clip="b", method="DLT", group="per-frame")])["occluded", "DLT"]
    ratio = paired_ratio(ours, other)
    assert math.isnan(ratio.value)
    assert ratio.n_recordings == 0


def test_a_ratio_to_no_error_at_all_is_infinite():
    assert paired_ratio(of_errors([10.0, 20.0]), of_errors([0.0, 0.0], "oracle", "oracle")).value == math.inf


@pytest.fixture
def competition() -> list[Score]:
    return [
        *over_clips([50.0, 70.0], method="RANSAC", group="per-frame", p95_mm=90.0),
        *over_clips([40.0, 60.0], method="aniposelib", group="peer", p95_mm=140.0),
        *over_clips([45.0, 65.0], method="DLT + Butterworth", group="linear", p95_mm=120.0),
        *over_clips([20.0, 30.0], method="fgpose batch", group="ours", p95_mm=60.0),
        *over_clips([19.0, 29.0], method="oracle", group="oracle", p95_mm=50.0),
        *over_clips([10.0, 10.0], method="their file", group="file", p95_mm=20.0),
        made_up(variant="clean", clip="a", method="RANSAC", group="per-frame", mpjpe_mm=8.0),
    ]


def test_the_best_other_is_neither_ours_nor_told_the_truth(competition):
    summaries = summarise(competition)
    names = {number: best_other(summaries, "occluded", number) for number in ("mpjpe_mm", "p95_mm")}
    assert {number: other.method for number, other in names.items() if other} == {
        "mpjpe_mm": "aniposelib",
        "p95_mm": "RANSAC",
    }
    linear = best_other(summaries, "occluded", groups=("linear",))
    assert linear is not None
    assert linear.method == "DLT + Butterworth"


def test_there_may_be_no_best_other(competition):
    summaries = summarise(competition)
    assert best_other(summaries, "clean", groups=("peer",)) is None
    assert best_other(summaries, "industrial") is None
    assert best([of_errors([NAN])]) is None


def test_methods_stand_in_their_groups_and_variants_in_order_of_appearance(competition):
    summaries = summarise([*competition, made_up(method="new", group="unheard of")])
    assert variants_of(summaries) == ["occluded", "clean"]
    assert list(methods_of(summaries)) == [
        "RANSAC",
        "DLT + Butterworth",
        "aniposelib",
        "their file",
        "fgpose batch",
        "oracle",
        "new",
    ]


def test_contradictions_are_errors():
    with pytest.raises(ValueError, match=r"variant occluded, clip walk: two scores of the method fgpose batch"):
        summarise([made_up(), made_up(mpjpe_mm=41.0)])
    with pytest.raises(ValueError, match=r"fgpose batch is in two groups: ours and peer"):
        summarise([made_up(), made_up(clip="run", group="peer")])
    with pytest.raises(ValueError, match=r"no scores"):
        summarise([])
