from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.monocular.flips import correct_flips, flip_probability
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, ring_rig, simulate, walking

RECORDINGS = ["balance_blazepose", "balance_openpose"]
Recording = tuple[CameraRig, Observations]


def with_sides_exchanged(observations: Observations, views: np.ndarray) -> Observations:
    """What a network would have given that takes left for right in these views."""
    mirror = np.arange(observations.skeleton.n_joints)
    for left, right in observations.skeleton.left_right:
        mirror[left], mirror[right] = right, left

    def exchanged(values: Any) -> Any:
        if values is None:
            return None
        values = values.copy()
        values[views] = values[views][:, mirror]
        return values

    return replace(
        observations,
        points2d_px=exchanged(observations.points2d_px),
        confidence=exchanged(observations.confidence),
        points3d_m=exchanged(observations.points3d_m),
        covariance3d_m2=exchanged(observations.covariance3d_m2),
    )


def random_flips(n_frames: int, n_cameras: int, seed: int, at_once: int = 1) -> np.ndarray:
    """Flips that begin at random, last ten frames on average, many only one; never more cameras at once than given."""
    rng = np.random.default_rng(seed)
    views, state = np.zeros((n_frames, n_cameras), dtype=bool), np.zeros(n_cameras, dtype=bool)
    for frame in range(n_frames):
        state &= rng.random(n_cameras) > 0.1
        for camera in rng.permutation(n_cameras):
            state[camera] |= rng.random() < 0.03 and state.sum() < at_once
        views[frame] = state
    return views


def assert_equal(corrected: Observations, original: Observations) -> None:
    for name in ("points2d_px", "confidence", "points3d_m", "covariance3d_m2"):
        expected = getattr(original, name)
        if expected is not None:
            np.testing.assert_array_equal(getattr(corrected, name), expected, err_msg=name)


@pytest.fixture(params=RECORDINGS)
def recording(request: pytest.FixtureRequest) -> Recording:
    return fgpose.files.load_recording(request.param)


@pytest.fixture
def blazepose() -> Recording:
    return fgpose.files.load_recording("balance_blazepose")


def pair_of(recording: Recording, first: int, second: int) -> Recording:
    rig, observations = recording
    names = (rig.names[first], rig.names[second])
    return rig.subset(names), observations.subset(names)


def test_a_recording_without_flips_stays_as_it_is(recording):
    rig, observations = recording
    corrected = correct_flips(observations, rig)
    assert not corrected.flipped.any()
    assert not corrected.uncertain.any()
    assert_equal(corrected.observations, observations)
    assert flip_probability(observations, rig).max() < 1e-3


@pytest.mark.parametrize("at_once", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_random_flips_of_a_real_recording_are_all_found_and_corrected(recording, seed, at_once):
    rig, observations = recording
    views = random_flips(100, 4, seed, at_once)
    assert views.sum() > 20
    corrected = correct_flips(with_sides_exchanged(observations, views), rig)
    np.testing.assert_array_equal(corrected.flipped, views)
    assert not corrected.uncertain.any()
    assert_equal(corrected.observations, observations)


def test_one_camera_of_four_may_be_flipped_all_the_time(recording):
    rig, observations = recording
    for camera in range(4):
        views = np.zeros((100, 4), dtype=bool)
        views[:, camera] = True
        np.testing.assert_array_equal(correct_flips(with_sides_exchanged(observations, views), rig).flipped, views)


def test_one_frame_is_enough_when_the_others_see_the_limbs(blazepose):
    rig, observations = blazepose
    frame, views = observations.frames(slice(40, 41)), np.array([[False, False, True, False]])
    np.testing.assert_array_equal(correct_flips(with_sides_exchanged(frame, views), rig).flipped, views)


def test_covariances_are_exchanged_with_their_joints(blazepose):
    rig, observations = blazepose
    assert observations.points3d_m is not None
    sizes = np.random.default_rng(0).uniform(0.01, 0.02, observations.confidence.shape)
    with_covariance = replace(observations, covariance3d_m2=sizes[..., None, None] * np.eye(3))
    views = random_flips(100, 4, seed=5)
    corrected = correct_flips(with_sides_exchanged(with_covariance, views), rig)
    assert corrected.observations.covariance3d_m2 is not None
    assert_equal(corrected.observations, with_covariance)


@pytest.mark.slow
def test_the_smoothed_motion_is_unharmed(blazepose):
    rig, observations = blazepose
    observations = observations.frames(slice(0, 16))
    views = np.zeros((16, 4), dtype=bool)
    views[2:10, 1], views[6:14, 3], views[0:16:5, 0] = True, True, True
    spoilt = with_sides_exchanged(observations, views)
    reference_m = fgpose.smooth(observations, rig).positions_m

    def moved_m(seen: Observations) -> np.ndarray:
        return np.linalg.norm(fgpose.smooth(seen, rig).positions_m - reference_m, axis=-1)

    assert np.nanquantile(moved_m(spoilt), 0.95) > 0.02, "left as they are, the flips do harm"
    # The corrected observations are the original ones, so the same numbers come out.
    assert np.nanmax(moved_m(correct_flips(spoilt, rig).observations)) < 1e-9


@pytest.mark.parametrize("cameras", [(0, 1), (0, 2), (1, 3)])
def test_with_two_cameras_time_tells_which_one_is_flipped(recording, cameras):
    rig, observations = pair_of(recording, *cameras)
    views = np.zeros((100, 2), dtype=bool)
    views[20:45, 0], views[60:61, 1], views[70:80, 1] = True, True, True
    corrected = correct_flips(with_sides_exchanged(observations, views), rig)
    np.testing.assert_array_equal(corrected.flipped, views)
    assert_equal(corrected.observations, observations)


def test_two_cameras_that_contradict_each_other_throughout_are_both_uncertain(recording):
    rig, observations = pair_of(recording, 0, 2)
    views = np.zeros((100, 2), dtype=bool)
    views[:, 1] = True
    contradictory = with_sides_exchanged(observations, views)
    corrected = correct_flips(contradictory, rig)
    assert not corrected.flipped.any()
    assert corrected.uncertain.all()
    np.testing.assert_array_equal(corrected.observations.points2d_px, contradictory.points2d_px)
    # As likely as not: the least share of the confidence that is kept.
    np.testing.assert_allclose(corrected.observations.confidence, 0.1 * contradictory.confidence)


def test_two_against_two_throughout_are_uncertain_three_against_one_are_not(blazepose):
    rig, observations = blazepose
    views = np.zeros((100, 4), dtype=bool)
    views[:, :2] = True
    corrected = correct_flips(with_sides_exchanged(observations, views), rig)
    assert corrected.uncertain.all()
    assert not corrected.flipped.any()
    three = rig.names[1:]
    views = np.zeros((100, 3), dtype=bool)
    views[:, 0] = True
    corrected = correct_flips(with_sides_exchanged(observations.subset(three), views), rig.subset(three))
    np.testing.assert_array_equal(corrected.flipped, views)


def test_one_camera_alone_is_left_alone(blazepose):
    rig, observations = blazepose
    name = rig.names[:1]
    views = random_flips(100, 1, seed=0)
    alone = with_sides_exchanged(observations.subset(name), views)
    corrected = correct_flips(alone, rig.subset(name))
    assert not corrected.flipped.any()
    assert not corrected.uncertain.any()
    assert_equal(corrected.observations, alone)


def test_missing_joints_do_not_hide_the_flips(recording):
    rig, observations = recording
    views = random_flips(100, 4, seed=1)
    points2d_px = with_sides_exchanged(observations, views).points2d_px.copy()
    points2d_px[np.random.default_rng(0).random(points2d_px.shape[:3]) < 0.3] = np.nan
    gappy = replace(with_sides_exchanged(observations, views), points2d_px=points2d_px)
    corrected = correct_flips(gappy, rig)
    np.testing.assert_array_equal(corrected.flipped, views)
    assert corrected.observations.seen.sum() == gappy.seen.sum()


def test_a_blind_camera_is_not_flipped_and_the_others_are_found(recording):
    rig, observations = recording
    views = random_flips(100, 4, seed=2)
    points2d_px = with_sides_exchanged(observations, views).points2d_px.copy()
    points2d_px[:, 2], points2d_px[30:50, 0] = np.nan, np.nan
    corrected = correct_flips(replace(with_sides_exchanged(observations, views), points2d_px=points2d_px), rig)
    views[:, 2], views[30:50, 0] = False, False
    np.testing.assert_array_equal(corrected.flipped, views)
    assert not corrected.uncertain[:, 2].any()
    nobody = replace(observations, points2d_px=np.full_like(points2d_px, np.nan), points3d_m=None)
    assert not correct_flips(nobody, rig).flipped.any()


@pytest.mark.parametrize("cameras", [(0, 1, 2, 3), (0, 1), (0, 2)])
def test_a_walker_seen_from_all_sides_has_no_flips(walking_scene: Scene, rig, cameras):
    """Seen from the side, left and right coincide; legs cross; the detections are noisy, some grossly wrong."""
    names = tuple(rig.names[camera] for camera in cameras)
    corrected = correct_flips(walking_scene.observations.subset(names), rig.subset(names))
    assert not corrected.flipped.any()
    assert not corrected.uncertain.any()


def test_occlusion_is_not_mistaken_for_a_flip(mocap_scene: Scene, rig):
    """A real walk with three of the four views occluded and joints guessed behind the occluders."""
    corrected = correct_flips(mocap_scene.observations, rig)
    assert not corrected.flipped.any()
    views = random_flips(mocap_scene.observations.n_frames, 4, seed=3)
    corrected = correct_flips(with_sides_exchanged(mocap_scene.observations, views), rig)
    assert not (corrected.flipped & ~views).any()
    # Where a view shows but a joint or two, nothing can be told: of the rest all are found.
    assert (corrected.flipped & views).sum() > 0.95 * views.sum()


def test_several_cameras_of_a_large_rig_may_be_flipped_at_once(skeleton):
    rig = ring_rig(8)
    scene = simulate(walking(60, 30.0, skeleton), skeleton, rig, 30.0, DetectionNoise(), NO_OCCLUSION, seed=0)
    views = random_flips(60, 8, seed=4, at_once=3)
    assert (views.sum(axis=1) == 3).any(), "more at once than are tried at once"
    corrected = correct_flips(with_sides_exchanged(scene.observations, views), rig)
    np.testing.assert_array_equal(corrected.flipped, views)


def test_other_cameras_are_refused(blazepose):
    rig, observations = blazepose
    with pytest.raises(ValueError, match="no keypoints"):
        correct_flips(observations.subset(rig.names[:3]), rig)
