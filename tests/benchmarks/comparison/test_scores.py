from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from jaxtyping import Float

from fgpose_benchmarks.accuracy.variants import find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, Method, MethodResult
from fgpose_benchmarks.comparison.scores import COVERAGE_LEVELS, Score, load_scores, save_scores, score


def nothing(recording: BenchmarkRecording) -> MethodResult:
    raise AssertionError


METHOD = Method("some method", "ours", nothing)


@pytest.fixture(scope="module")
def recording() -> BenchmarkRecording:
    return record(find_variant("occluded"), "cmu_02_05", 200)


def scored(
    recording: BenchmarkRecording, error_m: np.ndarray, covariance_m2: np.ndarray | None = None, **more
) -> Score:
    return score(recording, MethodResult(recording.truth_m + error_m, covariance_m2, 0.5, **more), METHOD)


def errors(recording: BenchmarkRecording, sigma_m: Float[np.ndarray, " axis"]) -> np.ndarray:
    return sigma_m * np.random.default_rng(1).standard_normal(recording.truth_m.shape)


def test_the_truth_has_no_error(recording):
    perfect = scored(recording, np.zeros(3))
    assert perfect.mpjpe_mm == perfect.relative_mpjpe_mm == perfect.p95_mm == perfect.missing_share == 0
    assert perfect.acceleration_mm_per_frame2 == 0
    assert perfect.pck_150mm == 1
    assert perfect.bone_spread_mm < 0.01  # the clips' bones are rigid to a thousandth of a millimetre
    assert (perfect.variant, perfect.clip, perfect.method, perfect.group) == ("occluded", "cmu_02_05", *named())
    assert perfect.ms_per_frame == pytest.approx(2.5)  # 0.5 s for 200 frames


def named() -> tuple[str, str]:
    return METHOD.name, METHOD.group


def test_a_shift_is_an_absolute_error_only(recording):
    shifted = scored(recording, np.array([0.03, 0.04, 0.0]))
    assert shifted.mpjpe_mm == pytest.approx(50.0)
    assert shifted.median_mm == pytest.approx(50.0)
    assert shifted.joint_mm == pytest.approx((50.0,) * 17)
    assert shifted.relative_mpjpe_mm == pytest.approx(0.0, abs=1e-9)
    assert shifted.acceleration_mm_per_frame2 == pytest.approx(0.0, abs=1e-9)
    assert shifted.pck_150mm == 1.0


def test_the_tail_of_the_errors(recording):
    error_m = np.zeros_like(recording.truth_m)
    error_m[:20, :, 2] = 0.2  # a tenth of the frames
    tailed = scored(recording, error_m)
    assert tailed.mpjpe_mm == pytest.approx(20.0)
    assert tailed.median_mm == 0
    assert tailed.p95_mm == pytest.approx(200.0)
    assert tailed.pck_150mm == pytest.approx(0.9)


def test_a_joint_that_jumps_to_and_fro(recording):
    error_m = np.zeros_like(recording.truth_m)
    error_m[::2, :, 0] = 0.01
    # Second differences of 0, 1, 0, 1, ... cm are 2 cm.
    assert scored(recording, error_m).acceleration_mm_per_frame2 == pytest.approx(20.0)


def test_bones_that_grow_and_shrink(recording):
    scale = 1.0 + 0.1 * (-1.0) ** np.arange(200)[:, None, None]
    pulsing = scored(recording, (scale - 1.0) * recording.truth_m)
    lengths_m = recording.observations.skeleton.bone_lengths(recording.truth_m).mean(axis=0)
    # A length that is 10 % too long and too short in turn has an SD of 10 %; 0.01 mm: the clip's own spread.
    assert pulsing.bone_spread_mm == pytest.approx(100 * lengths_m.mean(), abs=0.01)


def test_missing_joints_are_wrong_but_no_error(recording):
    error_m = np.zeros_like(recording.truth_m)
    error_m[:50, 3] = np.nan
    gappy = scored(recording, error_m)
    assert gappy.mpjpe_mm == 0
    assert gappy.missing_share == pytest.approx(50 / (200 * 17))
    assert gappy.pck_150mm == pytest.approx(1 - gappy.missing_share)
    nobody = scored(recording, np.full(3, np.nan))
    assert nobody.missing_share == 1
    assert nobody.pck_150mm == 0
    assert np.isnan([nobody.mpjpe_mm, nobody.median_mm, nobody.p95_mm, *nobody.joint_mm]).all()


def test_an_honest_covariance(recording):
    sigma_m = np.array([0.01, 0.02, 0.05])
    covariance_m2 = np.broadcast_to(np.diag(sigma_m**2), (200, 17, 3, 3)).copy()
    honest = scored(recording, errors(recording, sigma_m), covariance_m2)
    # 3,400 independent points: the mean of chi2(3)/3 has an SD of 0.014, a share of 0.5 one of 0.009.
    assert honest.nees == pytest.approx(1.0, abs=0.06)
    assert honest.coverage == pytest.approx(COVERAGE_LEVELS, abs=0.035)
    boastful = scored(recording, errors(recording, sigma_m), covariance_m2 / 9)
    assert boastful.nees == pytest.approx(9 * honest.nees)
    assert boastful.coverage < honest.coverage


def test_hidden_joints_are_those_that_half_of_the_cameras_cannot_see(recording):
    hidden = (recording.occluded | ~recording.observations.seen).sum(axis=1) >= 2
    assert 0.02 < hidden.mean() < 0.5
    covariance_m2 = np.broadcast_to(1e-4 * np.eye(3), (200, 17, 3, 3)).copy()
    far_where_hidden_m = np.where(hidden[..., None], 1.0, 0.0) * np.ones(3)
    result = scored(recording, far_where_hidden_m, covariance_m2)
    assert result.coverage_occluded == (0.0, 0.0, 0.0)
    assert result.coverage == pytest.approx((1 - hidden.mean(),) * 3)


def test_without_a_covariance_there_is_no_coverage(recording):
    plain = scored(recording, np.zeros(3))
    assert np.isnan([plain.nees, *plain.coverage, *plain.coverage_occluded, plain.offset_error_frames]).all()


def test_the_worst_time_offset_counts(recording):
    true_s = np.array([0.0, 0.01, -0.02, 0.0])
    late = replace(recording, true_offsets_s=true_s)
    result = scored(late, np.zeros(3), offsets_s=true_s + np.array([0.0, 0.002, -0.004, 0.0]))
    assert result.offset_error_frames == pytest.approx(0.2)


def test_a_result_of_another_shape_is_refused(recording):
    result = MethodResult(recording.truth_m[:-1], None, 0.1)
    with pytest.raises(ValueError, match=r"some method gave \(199, 17, 3\) for cmu_02_05 \(occluded\)"):
        score(recording, result, METHOD)


def test_scores_survive_the_disk(recording, tmp_path):
    path = tmp_path / "scores.json"
    scores = [scored(recording, errors(recording, np.full(3, 0.01))), scored(recording, np.full(3, np.nan))]
    save_scores(scores, path)
    assert "NaN" not in path.read_text(encoding="utf-8")
    for before, after in zip(scores, load_scores(path, Score), strict=True):
        for name, value in asdict(before).items():
            np.testing.assert_equal(getattr(after, name), value, name)


@pytest.mark.parametrize("text", ["no json", "{}x", '[{"variant": "clean"}]', "[1]"])
def test_another_file_is_refused(text, tmp_path):
    path = tmp_path / "scores.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"scores\.json: not a list of scores"):
        load_scores(path, Score)
