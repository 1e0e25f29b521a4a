from __future__ import annotations

import numpy as np
import pytest

from fgpose_benchmarks.comparison.runner import _digest
from fgpose_benchmarks.people.variants import (
    TEST_CLIPS,
    TUNING_CLIPS,
    VARIANTS,
    VERSION,
    find_variant,
    record,
    recordings,
)

SHORT_S = 1.0
# Mean pixel and confidence, and the number of joints, of the first second of a clip. When these change, VERSION must.
_FROZEN = {
    "2_people_3_cameras": (716.740073, 0.76203740, 3162),
    "4_people_5_cameras_low": (699.547144, 0.74445082, 9809),
    "4_people_3_cameras_furniture": (715.417372, 0.74664316, 6171),
    "4_people_5_cameras_unsynchronised": (707.138897, 0.74326791, 8500),
    "4_people_5_cameras_low_sitting": (693.109638, 0.72371599, 9214),
}


def test_the_variants_are_those_that_are_asked_for():
    names = [variant.name for variant in VARIANTS]
    assert len(set(names)) == len(names)
    for name in ("4_people_5_cameras", "6_people_3_cameras", "6_people_3_cameras_low", "8_people_8_cameras"):
        assert find_variant(name).name == name
    assert {variant.n_people for variant in VARIANTS} >= {2, 4, 8}
    assert {variant.n_cameras for variant in VARIANTS} == {3, 5, 8}
    # Low cameras are at the height of a head or a chest.
    assert {1.3 < variant.height_m < 1.6 for variant in VARIANTS if variant.group == "low cameras"} == {True}


def test_what_is_tuned_on_is_not_what_is_stated():
    assert not set(TUNING_CLIPS) & set(TEST_CLIPS)
    tuning, test = (record(VARIANTS[0], clip, SHORT_S).scene.motion for clip in (TUNING_CLIPS[0], TEST_CLIPS[0]))
    assert not np.allclose(tuning.truth_m, test.truth_m, equal_nan=True)


def test_a_recording_is_the_same_each_time():
    once, again = (next(recordings(VARIANTS[:1], TUNING_CLIPS[:1], SHORT_S)) for _ in range(2))
    assert _digest(once) == _digest(again)
    assert _digest(record(VARIANTS[0], TUNING_CLIPS[1], SHORT_S)) != _digest(once)


@pytest.mark.parametrize("name", _FROZEN)
def test_recordings_are_those_of_this_version(name: str):
    assert VERSION == 1
    images = record(find_variant(name), TUNING_CLIPS[0], SHORT_S).observations.images
    confidence = np.concatenate([image.confidence.ravel() for image in images])
    mean_px = np.nanmean(np.concatenate([image.points2d_px.ravel() for image in images]))
    # Rounding differs between machines (and with it the spline of the motion), draws of noise do not.
    found = np.array([mean_px, confidence.mean(), len(confidence)])
    np.testing.assert_allclose(found, _FROZEN[name], rtol=1e-5)


def test_people_sit_in_the_middle_of_the_recordings_with_seats():
    """And one of them goes out. All sit at the same time for a while."""
    motion = record(find_variant("4_people_5_cameras_low_sitting"), TEST_CLIPS[0]).scene.motion
    low = motion.truth_m[:, :, motion.skeleton.index("pelvis"), 2] < 0.56
    # At 50 Hz; who comes late sits for the shortest time.
    assert sorted((low.sum(axis=1) > 2.5 * 50).tolist()) == [False, True, True, True]
    assert (low.sum(axis=0) >= 2).sum() > 7 * 50
    assert (low.sum(axis=0) == 3).sum() > 2 * 50
    assert {"enters", "leaves", "returns", "sits", "rises"} <= {event.kind for event in motion.events}


def test_only_the_cameras_differ_where_only_they_are_named():
    high, low, mixed = (
        record(find_variant(f"4_people_5_cameras{name}"), TUNING_CLIPS[0], SHORT_S)
        for name in ("", "_low", "_unsynchronised")
    )
    np.testing.assert_array_equal(high.scene.motion.truth_m, low.scene.motion.truth_m)
    np.testing.assert_array_equal(high.scene.motion.truth_m, mixed.scene.motion.truth_m)
    heights_m = [{round(float(c.position_m[2]), 6) for c in each.rig.cameras} for each in (high, low)]
    assert heights_m == [{2.7}, {1.45}]
    steps_s = [np.diff(mixed.observations.times_s(name)).mean() for name in mixed.rig.names[:2]]
    np.testing.assert_allclose(steps_s, [1 / 25, 1 / 30])
    assert high.frames.time_s.ndim == 1
    assert mixed.frames.time_s.ndim == 2


def test_the_images_of_a_frame_are_those_of_about_its_time():
    mixed = record(find_variant("4_people_5_cameras_unsynchronised"), TUNING_CLIPS[0], SHORT_S)
    frames = list(mixed.images())
    assert sum(len(images) for _, images in frames) == len(mixed.observations.images)
    # Frames are 1/30 s apart, images at most 0.6 of that from theirs; their mean is the frame's time.
    assert max(abs(image.time_s - time_s) for time_s, images in frames for image in images) < 1.2 / 30
    assert sorted(mixed.truth) == [0, 1, 2, 3]
    np.testing.assert_allclose(mixed.truth[0].time_s, [time_s for time_s, _ in frames])


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match="no variant '5_people'; there is 2_people_3_cameras, "):
        find_variant("5_people")
    with pytest.raises(ValueError, match="no clip 'cmu'; there is tuning_1, "):
        record(VARIANTS[0], "cmu")
