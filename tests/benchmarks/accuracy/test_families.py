"""Each family goes wrong in the way that its name says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.accuracy.families import VARIANTS, Variant, family_of
from fgpose_benchmarks.accuracy.methods import ORACLE, OURS, PER_FRAME, methods_for
from fgpose_benchmarks.accuracy.variants import TEST_CLIPS, TUNING_CLIPS, find_variant, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import NO_NOISE, DetectionNoise, Occlusion
from fgpose_benchmarks.synthetic.real_errors import HIDDEN_M, real_blocks

CLIP = "cmu_02_05"
SKELETON = load_skeleton("h36m_17")
OTHERS = [variant for variant in VARIANTS if variant.family != "standard"]


def true_px(recording: BenchmarkRecording) -> np.ndarray:
    return recording.rig.project(recording.truth_m)


def error_px(recording: BenchmarkRecording) -> np.ndarray:
    return recording.observations.points2d_px - true_px(recording)


def error_m(recording: BenchmarkRecording) -> np.ndarray:
    """In the image, at the depth of the joint."""
    cameras = recording.rig.cameras
    depth_m = np.stack([camera.to_camera_frame(recording.truth_m)[..., 2] for camera in cameras], axis=1)
    return error_px(recording) * depth_m[..., None] / cameras[0].K[0, 0]


def chance_to_rate_higher(better: np.ndarray, worse: np.ndarray) -> float:
    """Of one of the first over one of the second, over quantiles: 0.5 tells nothing, 1 is an oracle."""
    grid = np.linspace(0.005, 0.995, 100)
    return float(np.mean(np.quantile(better, grid)[:, None] > np.quantile(worse, grid)))


def informed(recording: BenchmarkRecording, joints: list[int]) -> float:
    confidence, seen = recording.observations.confidence[..., joints], recording.observations.seen[..., joints]
    occluded = recording.occluded[..., joints]
    return chance_to_rate_higher(confidence[seen & ~occluded], confidence[seen & occluded])


def test_every_other_family_is_there_with_four_cameras_and_with_two():
    assert {variant.family for variant in OTHERS} == {
        "lasting",
        "snapping",
        "real",
        "confidence",
        "noise",
        "fast",
        "network",
    }
    for four, two in zip(OTHERS[::2], OTHERS[1::2], strict=True):
        assert replace(two, name=four.name, description=four.description, n_cameras=4) == four
        assert (two.name, two.n_cameras) == (f"{four.name}_2_cameras", 2)
    assert family_of("snapping_2_cameras") == "snapping"
    assert family_of("S9 Greeting") is None


@pytest.mark.parametrize("name", ["snapping", "real", "biased_60hz"])
def test_two_cameras_see_what_the_first_two_of_four_do(name: str):
    four, two = (record(find_variant(each), CLIP, 40) for each in (name, f"{name}_2_cameras"))
    np.testing.assert_array_equal(two.observations.points2d_px, four.observations.points2d_px[:, :2])
    np.testing.assert_array_equal(two.observations.confidence, four.observations.confidence[:, :2])
    np.testing.assert_array_equal(two.occluded, four.occluded[:, :2])


@pytest.mark.parametrize("clip", TUNING_CLIPS)
def test_lasting_hallucinations_last_half_a_second_to_three(clip: str):
    recording = record(find_variant("lasting"), clip)
    changes = np.flatnonzero((recording.occluded[1:] != recording.occluded[:-1]).any(axis=(1, 2))) + 1
    assert len(changes) >= 1
    lasted_s = np.diff(changes, prepend=0) / recording.fps
    # What is hidden changes between frames, at up to one frame from where the occluders do.
    assert lasted_s.min() >= 0.5 - 1 / recording.fps
    assert lasted_s.max() <= 3.0 + 1 / recording.fps


def test_lasting_hallucinations_stay_where_they_are():
    def still(name: str) -> float:
        """Correlation with the error half a second later, of joints hidden at both times."""
        recording = record(replace(find_variant(name), noise=NO_NOISE), CLIP, 400)
        later = round(0.5 * recording.fps)
        error = error_px(recording)
        both = recording.occluded[:-later] & recording.occluded[later:]
        pair = error[:-later][both].ravel(), error[later:][both].ravel()
        known = np.isfinite(pair).all(axis=0)
        return float(np.corrcoef(pair[0][known], pair[1][known])[0, 1])

    # exp(-0.5 / 1.5) = 0.72 and exp(-0.5 / 0.3) = 0.19; about 100 independent hallucinations, 2 sigma.
    assert still("lasting") == pytest.approx(0.72, abs=0.2)
    assert still("occluded") < 0.4


def snapping(share: float, noise: DetectionNoise) -> Variant:
    return replace(find_variant("snapping"), noise=noise, occlusion=Occlusion(snap_share=share))


def test_a_snapped_detection_is_at_the_mirrored_joint():
    recording = record(snapping(1.0, NO_NOISE), CLIP, 100)
    at_px = true_px(recording)
    assert recording.observations.points3d_m is not None
    for left, right in SKELETON.left_right:
        for joint, other in ((left, right), (right, left)):
            hidden = recording.occluded[..., joint]
            np.testing.assert_allclose(
                recording.observations.points2d_px[hidden, joint], at_px[hidden, other], atol=1e-6
            )
            other_m = np.repeat(recording.truth_m[:, None, other], recording.rig.n_cameras, axis=1)
            np.testing.assert_allclose(recording.observations.points3d_m[hidden, joint], other_m[hidden], atol=1e-9)


def test_a_snapped_joint_of_the_trunk_is_at_the_nearest_that_was_visible():
    recording = record(snapping(1.0, NO_NOISE), CLIP, 100)
    at_px = true_px(recording)
    checked = 0
    for joint in (SKELETON.index(name) for name in ("pelvis", "spine", "thorax", "neck_base", "head")):
        hidden = recording.occluded[..., joint]
        begins = hidden & ~np.vstack([np.zeros((1, hidden.shape[1]), bool), hidden[:-1]])
        for frame, camera in np.argwhere(begins):
            visible = np.flatnonzero(~recording.occluded[frame, camera])
            away_px = np.linalg.norm(at_px[frame, camera, visible] - at_px[frame, camera, joint], axis=-1)
            nearest = at_px[frame, camera, visible[np.argmin(away_px)]]
            np.testing.assert_allclose(recording.observations.points2d_px[frame, camera, joint], nearest, atol=1e-6)
            checked += 1
    assert checked > 5


def test_a_share_of_the_stretches_snaps_with_the_noise_and_confidence_of_visible_joints():
    recording = record(snapping(0.5, DetectionNoise()), CLIP, 400)
    at_px = true_px(recording)
    away_px = recording.observations.points2d_px - at_px[:, :, [SKELETON.mirrored((j, j))[0] for j in range(17)]]
    mirrored = [joint for pair in SKELETON.left_right for joint in pair]
    near = np.linalg.norm(away_px, axis=-1) < 20.0  # four sigma
    of_limbs = np.zeros(17, bool)
    of_limbs[mirrored] = True
    snapped = near & recording.occluded & of_limbs
    share = snapped.sum() / (recording.occluded & of_limbs).sum()
    # About 100 stretches of different length: 0.5 to 0.1 or so, and a few hallucinations that happen to be near.
    assert share == pytest.approx(0.5, abs=0.2)
    # 3 and 4 px make 5 in each coordinate; the cut at 20 px takes 0.03 % away.
    assert away_px[snapped].std() == pytest.approx(5.0, rel=0.15)
    confidence = recording.observations.confidence
    visible = recording.observations.seen & ~recording.occluded
    assert chance_to_rate_higher(confidence[visible], confidence[snapped]) == pytest.approx(0.5, abs=0.08)


@pytest.mark.slow
def test_real_errors_are_rows_of_the_blocks():
    """All joints of a view together, as the detector had them."""
    recording = record(find_variant("real_occluded"), TEST_CLIPS[0])
    mirror = [SKELETON.mirrored((joint, joint))[0] for joint in range(17)]
    blocks = [block.error_m for block in real_blocks()[0] if block.source in find_variant("real_occluded").real]
    rows = np.concatenate(blocks + [block[:, mirror] * (-1, 1) for block in blocks])
    inside = recording.observations.seen
    for view in range(4):
        found = []
        for frame_m, known in zip(error_m(recording)[:, view], inside[:, view], strict=True):
            # Of a view without a detection nothing is known; joints outside the image are missing. The others must be
            # those of one row, to rounding.
            if not known.any():
                continue
            apart_m = np.abs(rows[:, known] - frame_m[known]).max(axis=(1, 2))
            assert np.nanmin(apart_m) < 1e-9
            found.append(int(np.nanargmin(apart_m)))
        # At 60 instead of 50 Hz the next frame is one or two further, forwards or backwards, unless a block ends.
        assert np.mean(np.isin(np.abs(np.diff(found)), (1, 2))) > 0.95


@pytest.mark.parametrize("name", [pytest.param("real", marks=pytest.mark.slow), "real_occluded"])
def test_real_errors_have_the_size_of_the_blocks(name: str):
    blocks = [block for block in real_blocks()[0] if block.source in find_variant(name).real]
    of_blocks_m = np.linalg.norm(np.concatenate([block.error_m for block in blocks]), axis=-1)
    recordings = [record(find_variant(name), clip) for clip in (*TUNING_CLIPS, *TEST_CLIPS)]
    sizes_m = np.concatenate([np.linalg.norm(error_m(recording), axis=-1).ravel() for recording in recordings])
    # Nine clips of 5 s or less, four views: some 100 blocks, but each clip has one source of two or three.
    assert np.nanmedian(sizes_m) == pytest.approx(np.nanmedian(of_blocks_m), rel=0.2)
    assert np.nanmean(sizes_m > HIDDEN_M) == pytest.approx(np.nanmean(of_blocks_m > HIDDEN_M), rel=0.5)


def test_real_errors_beyond_a_limit_count_as_hidden():
    recording = record(find_variant("real_occluded"), TEST_CLIPS[0])
    seen, size_m = recording.observations.seen, np.linalg.norm(error_m(recording), axis=-1)
    np.testing.assert_array_equal(recording.occluded[seen], size_m[seen] > HIDDEN_M)
    # Far from the edge of the image a joint is missing only where the detector missed it.
    inside = np.all(np.abs(true_px(recording) - 500) < 440, axis=-1)
    assert recording.occluded[inside & ~seen].all()


def test_no_two_views_have_the_same_real_errors():
    errors = error_m(record(find_variant("real"), CLIP))
    for one in range(4):
        for other in range(one):
            assert np.nanmedian(np.abs(errors[:, one] - errors[:, other])) > 1e-3


def test_a_silent_confidence_tells_neither_occlusion_nor_error():
    silent, telling = (record(find_variant(name), CLIP, 400) for name in ("silent_confidence", "occluded"))
    every = list(range(17))
    assert informed(telling, every) > 0.75
    # About 100 independent hallucinations with a time constant of 0.15 s: 0.5 to 0.03, two sigma.
    assert informed(silent, every) == pytest.approx(0.5, abs=0.06)
    seen = silent.observations.seen
    size_px = np.linalg.norm(error_px(silent), axis=-1)
    assert abs(np.corrcoef(silent.observations.confidence[seen], size_px[seen])[0, 1]) < 0.06
    np.testing.assert_array_equal(silent.observations.points2d_px, telling.observations.points2d_px)


def test_a_misleading_confidence_is_turned_round_for_one_joint():
    misleading, telling = (record(find_variant(name), CLIP, 400) for name in ("misleading_confidence", "occluded"))
    wrist = SKELETON.index("right_wrist")
    others = [joint for joint in range(17) if joint != wrist]
    assert informed(telling, [wrist]) > 0.75
    assert informed(misleading, [wrist]) < 0.25
    np.testing.assert_array_equal(
        misleading.observations.confidence[..., others], telling.observations.confidence[..., others]
    )


def test_a_bias_is_constant_and_of_the_stated_size():
    noise = replace(NO_NOISE, min_bias_m=0.02, max_bias_m=0.04)
    variant = replace(find_variant("biased_60hz"), noise=noise, occlusion=find_variant("clean").occlusion)
    bias_m = error_m(record(variant, CLIP, 60))
    assert np.nanmax(np.ptp(bias_m, axis=0)) < 1e-9  # rounding
    length_m = np.linalg.norm(bias_m[0], axis=-1)
    assert np.all((length_m > 0.02) & (length_m < 0.04))
    # Of each joint and view its own, uniform: from 68 lengths the mean is known to 0.7 mm, 3 sigma.
    assert length_m.mean() == pytest.approx(0.03, abs=0.0021)
    assert np.abs(bias_m[0].mean(axis=(0, 1))).max() < 0.01
    biased, plain = (
        record(replace(v, fps=60.0), CLIP) for v in (find_variant("biased_60hz"), find_variant("occluded"))
    )
    both = biased.observations.seen & plain.observations.seen
    np.testing.assert_allclose(
        (error_m(biased) - error_m(plain))[both], np.broadcast_to(bias_m[0], error_m(plain).shape)[both], atol=1e-9
    )


@pytest.mark.parametrize(("name", "every", "of_50"), [("precise_120hz", 12, 5), ("biased_60hz", 6, 5)])
def test_a_higher_rate_shows_the_same_motion(name: str, every: int, of_50: int):
    fast, clean = record(find_variant(name), CLIP), record(find_variant("clean"), CLIP)
    n_common = min(len(fast.truth_m[::every]), len(clean.truth_m[::of_50]))
    assert n_common == 50
    np.testing.assert_allclose(fast.truth_m[::every], clean.truth_m[::of_50], atol=1e-9)
    np.testing.assert_allclose(np.diff(fast.observations.frame_time_s), of_50 / every / 50.0)
    # No step of the interpolated motion is far from its neighbours: within the largest acceleration of the clip.
    largest_mps2 = np.abs(np.diff(clean.truth_m, 2, axis=0)).max() * 50.0**2
    assert np.abs(np.diff(fast.truth_m, 2, axis=0)).max() * fast.fps**2 < 2 * largest_mps2


@pytest.mark.parametrize(
    ("name", "sigma_px", "lag_s", "correlation"),
    # exp(-0.4 / 0.4) after 12 frames; nothing after one frame.
    [("precise_120hz", 2.0, 1 / 120.0, 0.0), ("coarse_30hz", 12.0, 0.4, np.exp(-1))],
)
def test_noise_is_as_stated(name: str, sigma_px: float, lag_s: float, correlation: float):
    variant = find_variant(name)
    recording = record(replace(variant, occlusion=find_variant("clean").occlusion), CLIP, 600)
    error = error_px(recording)
    assert recording.sigma_px == sigma_px
    # 136 coordinates over 12 s, or 15 time constants each: 2,000 independent numbers, 1.6 %, 3 sigma. Outliers aside.
    assert np.nanmedian(np.abs(error)) / 0.6745 == pytest.approx(sigma_px, rel=0.05)
    kept = np.clip(error, -4 * sigma_px, 4 * sigma_px)
    lag = round(lag_s * recording.fps)
    assert np.nanmean(kept[lag:] * kept[:-lag]) / np.nanvar(kept) == pytest.approx(correlation, abs=0.06)


@pytest.mark.parametrize("variant", OTHERS, ids=lambda variant: variant.name)
def test_the_oracle_of_every_family_gets_what_is_not_hidden(variant: Variant):
    recording = record(variant, TEST_CLIPS[-1], 30)
    known = recording.oracle_observations
    assert known is not None
    assert recording.occluded.any() or variant.family == "fast"
    np.testing.assert_array_equal(known.seen, recording.observations.seen & ~recording.occluded)
    size_px = np.linalg.norm((known.points2d_px - recording.true_rig.project(recording.truth_m))[known.seen], axis=-1)
    assert recording.sigma_px is not None
    # The median of a Rayleigh distribution is 1.18 sigma. Those of real errors and of lengths of biases are not normal;
    # 30 frames of correlated noise are few.
    assert np.median(size_px) == pytest.approx(1.18 * recording.sigma_px, rel=0.3)
    if variant.family not in ("real", "noise"):
        assert np.mean(size_px > 6 * recording.sigma_px) < 0.02  # the outliers


def test_the_other_families_run_few_methods():
    every = [*PER_FRAME, *OURS, ORACLE]
    assert methods_for(find_variant("lost"), every) == every
    few = ["MSAC by confidence", "fgpose online, lag 0.2 s", "fgpose batch", "oracle"]
    for variant in OTHERS:
        assert [method.name for method in methods_for(variant, every)] == few


@pytest.mark.slow
@pytest.mark.parametrize("variant", OTHERS[::2], ids=lambda variant: variant.name)
def test_batch_and_oracle_run_on_every_family(variant: Variant):
    recording = record(variant, CLIP, 30)
    for method in methods_for(variant, [*OURS[4:5], ORACLE]):
        apart_m = np.linalg.norm(method.solve(recording).positions_m - recording.truth_m, axis=-1)
        # The worst family has hallucinations of half a metre.
        assert np.nanmean(apart_m) < 0.15


def test_a_fast_recording_is_the_clip_played_faster():
    recording, clip = record(find_variant("fast_4x_30hz"), CLIP, 60), record(find_variant("clean"), CLIP, 240)
    # Every image is 1/30 s after the one before, in which the clip goes on by 4/30 s: 6 2/3 of its frames of 1/50 s.
    assert recording.fps == 30.0
    assert len(recording.truth_m) == 36
    np.testing.assert_allclose(recording.truth_m[::3], clip.truth_m[::20], atol=1e-9)


def test_fast_recordings_are_as_fast_as_their_name_says():
    for variant in (variant for variant in OTHERS if variant.family == "fast"):
        assert variant.name.startswith(f"fast_{variant.speed:g}x_{variant.fps:g}hz")
        assert 2 <= variant.speed <= 4
        assert variant.fps is not None
        assert 25 <= variant.fps <= 60


@pytest.mark.parametrize("name", ["network", "network_other_focal"])
def test_a_network_always_answers_and_states_no_confidence(name: str):
    recording = record(find_variant(name), CLIP, 60)
    seen = recording.observations
    assert seen.seen[recording.occluded].mean() > 0.95  # but for what is out of the image
    assert set(np.unique(seen.confidence)) <= {0.0, 0.5}
    assert seen.points3d_m is not None
    # Each joint lies on the ray of its pixel: the two are one observation.
    projected_px = np.stack([c.project(seen.points3d_m[:, k]) for k, c in enumerate(recording.rig.cameras)], axis=1)
    np.testing.assert_allclose(projected_px[seen.seen], seen.points2d_px[seen.seen], atol=1e-6)


def test_all_views_of_a_network_share_the_error_of_the_stature():
    """Without other errors all views put the person farther away by the same share."""
    shares = []
    for clip in TUNING_CLIPS:
        recording = record(replace(find_variant("network"), noise=NO_NOISE, occlusion=Occlusion(n_views=0)), clip, 10)
        points_m, truth_m = recording.observations.points3d_m, recording.truth_m
        assert points_m is not None
        distances = (
            np.linalg.norm(m - recording.rig.positions_m[:, None], axis=-1) for m in (points_m, truth_m[:, None])
        )
        seen_m, true_m = distances
        share = np.nanmedian(seen_m / true_m, axis=(0, 2)) - 1
        np.testing.assert_allclose(share, share[0], atol=1e-3)
        shares.append(share[0])
    # SD 4.5 %; of four draws the root mean square lies within a factor of three, 99 %.
    assert 0.015 < np.sqrt(np.mean(np.square(shares))) < 0.09
