from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.image_checks.flip_model import log_change, log_prior
from fgpose.estimation.evidence.image_checks.flips import correct_flips, flip_probability, flips
from fgpose.estimation.evidence.image_checks.running_flips import RunningFlips
from fgpose.estimation.evidence.image_checks.sides import exchanged_joints, limbs, sides_of
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, ring_rig, simulate, walking

RECORDINGS = ["balance_blazepose", "balance_openpose"]
Recording = tuple[CameraRig, Observations]


def with_sides_exchanged(observations: Observations, views: np.ndarray, joints: Sequence[str] = ()) -> Observations:
    """What a network would have given that takes left for right in these views, of all joints or of these."""
    mirror = np.arange(observations.skeleton.n_joints)
    for left, right in observations.skeleton.left_right:
        if not joints or observations.skeleton.joints[left] in joints:
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


def flipped_views(observations: Observations, rig: CameraRig) -> np.ndarray:
    """The views in which the sides of the whole body are found exchanged; in the others nothing is."""
    flipped = flips(observations, rig)
    own = observations.skeleton.mirror != np.arange(observations.skeleton.n_joints)
    np.testing.assert_array_equal(flipped, flipped.any(axis=-1, keepdims=True) & own)
    return np.asarray(flipped.any(axis=-1))


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
    corrected, flipped = correct_flips(observations, rig)
    assert not flipped.any()
    assert_equal(corrected, observations)
    assert flip_probability(observations, rig).max() < 1e-3


@pytest.mark.parametrize("at_once", [1, 2, 4])
@pytest.mark.parametrize("seed", range(4))
def test_random_flips_of_a_real_recording_are_all_found_and_corrected(recording, seed, at_once):
    rig, observations = recording
    views = random_flips(100, 4, seed, at_once)
    assert views.sum() > 20
    corrected, flipped = correct_flips(with_sides_exchanged(observations, views), rig)
    np.testing.assert_array_equal(flipped.any(axis=-1), views)
    assert_equal(corrected, observations)


def test_one_camera_of_four_may_be_flipped_all_the_time(recording):
    rig, observations = recording
    for camera in range(4):
        views = np.zeros((100, 4), dtype=bool)
        views[:, camera] = True
        np.testing.assert_array_equal(flipped_views(with_sides_exchanged(observations, views), rig), views)


def test_one_frame_is_enough_when_the_others_see_the_limbs(blazepose):
    rig, observations = blazepose
    frame, views = observations.frames(slice(40, 41)), np.array([[False, False, True, False]])
    np.testing.assert_array_equal(flipped_views(with_sides_exchanged(frame, views), rig), views)


def test_covariances_are_exchanged_with_their_joints(blazepose):
    rig, observations = blazepose
    assert observations.points3d_m is not None
    sizes = np.random.default_rng(0).uniform(0.01, 0.02, observations.confidence.shape)
    with_covariance = replace(observations, covariance3d_m2=sizes[..., None, None] * np.eye(3))
    views = random_flips(100, 4, seed=5)
    corrected, _ = correct_flips(with_sides_exchanged(with_covariance, views), rig)
    assert corrected.covariance3d_m2 is not None
    assert_equal(corrected, with_covariance)


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

    # The corrected observations are the original ones, so the same numbers come out.
    assert np.nanmax(moved_m(spoilt)) < 1e-9


@pytest.mark.parametrize("exchanged", [slice(0, 20), slice(40, 60)], ids=["at first", "in the middle"])
@pytest.mark.parametrize("cameras", [(0, 1, 2, 3), (0, 1, 2)])
def test_all_views_that_are_exchanged_at_once(exchanged: slice, cameras, recording):
    """No view contradicts another; but nobody changes sides from one image to the next."""
    rig, original = recording
    names = [rig.names[camera] for camera in cameras]
    rig, original = rig.subset(names), original.subset(names)
    views = np.zeros((original.n_frames, len(names)), dtype=bool)
    views[exchanged] = True
    found = flipped_views(with_sides_exchanged(original, views), rig)
    np.testing.assert_array_equal(found, views)


@pytest.mark.parametrize("cameras", [(0, 1), (0, 2), (1, 3)])
def test_with_two_cameras_time_tells_which_one_is_flipped(recording, cameras):
    rig, observations = pair_of(recording, *cameras)
    views = np.zeros((100, 2), dtype=bool)
    views[20:45, 0], views[60:61, 1], views[70:80, 1] = True, True, True
    corrected, flipped = correct_flips(with_sides_exchanged(observations, views), rig)
    np.testing.assert_array_equal(flipped.any(axis=-1), views)
    assert_equal(corrected, observations)


def test_two_cameras_that_contradict_each_other_throughout_are_left_as_they_are(recording):
    rig, observations = pair_of(recording, 0, 2)
    views = np.zeros((100, 2), dtype=bool)
    views[:, 1] = True
    contradictory = with_sides_exchanged(observations, views)
    corrected, flipped = correct_flips(contradictory, rig)
    assert not flipped.any()
    assert_equal(corrected, contradictory)


def test_of_two_against_two_throughout_none_is_chosen_of_three_against_one_the_one(blazepose):
    rig, observations = blazepose
    views = np.zeros((100, 4), dtype=bool)
    views[:, :2] = True
    flipped = flipped_views(with_sides_exchanged(observations, views), rig)
    assert not flipped.any()
    three = rig.names[1:]
    views = np.zeros((100, 3), dtype=bool)
    views[:, 0] = True
    flipped = flipped_views(with_sides_exchanged(observations.subset(three), views), rig.subset(three))
    np.testing.assert_array_equal(flipped, views)


def test_one_camera_alone_is_left_alone(blazepose):
    rig, observations = blazepose
    name = rig.names[:1]
    views = random_flips(100, 1, seed=0)
    alone = with_sides_exchanged(observations.subset(name), views)
    corrected, flipped = correct_flips(alone, rig.subset(name))
    assert not flipped.any()
    assert_equal(corrected, alone)


def test_missing_joints_do_not_hide_the_flips(recording):
    rig, observations = recording
    views = random_flips(100, 4, seed=1)
    points2d_px = with_sides_exchanged(observations, views).points2d_px.copy()
    points2d_px[np.random.default_rng(0).random(points2d_px.shape[:3]) < 0.3] = np.nan
    gappy = replace(with_sides_exchanged(observations, views), points2d_px=points2d_px)
    corrected, flipped = correct_flips(gappy, rig)
    flipped = flipped.any(axis=-1)
    assert not (flipped & ~views).any()
    # Where the sides that are left coincide in the image, nothing can be told, and nothing is wrong.
    assert (flipped & views).sum() > 0.9 * views.sum()
    assert corrected.seen.sum() == gappy.seen.sum()


def test_a_blind_camera_is_not_flipped_and_the_others_are_found(recording):
    rig, observations = recording
    views = random_flips(100, 4, seed=2)
    points2d_px = with_sides_exchanged(observations, views).points2d_px.copy()
    points2d_px[:, 2], points2d_px[30:50, 0] = np.nan, np.nan
    flipped = flipped_views(replace(with_sides_exchanged(observations, views), points2d_px=points2d_px), rig)
    views[:, 2], views[30:50, 0] = False, False
    np.testing.assert_array_equal(flipped, views)
    nobody = replace(observations, points2d_px=np.full_like(points2d_px, np.nan), points3d_m=None)
    assert not flipped_views(nobody, rig).any()


@pytest.mark.parametrize("cameras", [(0, 1, 2, 3), (0, 1), (0, 2)])
def test_a_walker_seen_from_all_sides_has_no_flips(walking_scene: Scene, rig, cameras):
    """Seen from the side, left and right coincide; legs cross; the detections are noisy, some grossly wrong."""
    names = tuple(rig.names[camera] for camera in cameras)
    flipped = flipped_views(walking_scene.observations.subset(names), rig.subset(names))
    assert not flipped.any()


def test_occlusion_is_not_mistaken_for_a_flip(mocap_scene: Scene, rig):
    """A real walk with three of the four views occluded and joints guessed behind the occluders."""
    flipped = flipped_views(mocap_scene.observations, rig)
    assert not flipped.any()
    views = random_flips(mocap_scene.observations.n_frames, 4, seed=3)
    flipped = flipped_views(with_sides_exchanged(mocap_scene.observations, views), rig)
    assert not (flipped & ~views).any()
    # Where a view shows but a joint or two, or the others do not confirm it, it is left as it is.
    assert (flipped & views).sum() > 0.8 * views.sum()


def test_several_cameras_of_a_large_rig_may_be_flipped_at_once(skeleton):
    rig = ring_rig(8)
    scene = simulate(walking(60, 30.0, skeleton), skeleton, rig, 30.0, DetectionNoise(), NO_OCCLUSION, seed=0)
    views = random_flips(60, 8, seed=4, at_once=3)
    assert (views.sum(axis=1) == 3).any(), "more at once than are tried at once"
    flipped = flipped_views(with_sides_exchanged(scene.observations, views), rig)
    np.testing.assert_array_equal(flipped, views)


def test_other_cameras_are_refused(blazepose):
    rig, observations = blazepose
    with pytest.raises(ValueError, match="no keypoints"):
        correct_flips(observations.subset(rig.names[:3]), rig)


def online(seen: Observations, rig: CameraRig, known_m: np.ndarray, one_by_one: bool) -> np.ndarray:
    """The views that are found flipped as their images come."""
    running = RunningFlips.none(seen.n_cameras, seen.skeleton)
    found = np.zeros((seen.n_frames, seen.n_cameras), dtype=bool)
    for number, frame in enumerate(seen):
        expected_m = known_m[max(number - 1, 0)]
        for camera in range(seen.n_cameras) if one_by_one else [slice(None)]:
            others = np.ones(frame.confidence.shape, dtype=bool)
            others[:, camera] = False
            image = frame.without(others)
            flipped, running = running.after(image, limbs(image, rig), expected_m, rig)
            found[number] |= flipped.any(axis=-1)
    return found


@pytest.mark.parametrize("one_by_one", [False, True], ids=["frames", "images"])
@pytest.mark.parametrize("at_once", [1, 2])
def test_online_most_are_found_and_no_others(blazepose, at_once, one_by_one):
    rig, observations = blazepose
    known_m = fgpose.refine(observations, rig).positions_m
    assert not online(observations, rig, known_m, one_by_one).any()
    views = random_flips(100, 4, 0, at_once)
    found = online(with_sides_exchanged(observations, views), rig, known_m, one_by_one)
    # The first image after a change may not be sure yet: flips last ten frames, many only one.
    assert (found & views).sum() > 0.85 * views.sum()
    assert (found & ~views).sum() < 0.02 * views.size


def test_after_a_long_time_a_view_is_flipped_as_probably_as_in_the_first_frame():
    """A probability of having begun meanwhile that comes near 1 flipped everybody after a gap."""
    nothing_px, nothing = np.zeros((1, 1, 2, 2)), np.zeros((1, 1, 2))
    change = log_change(nothing_px, nothing, nothing_px, nothing, nothing, np.array([3600.0]), np.ones(1))
    first = np.exp(log_prior(np.array([[0], [1]])))
    np.testing.assert_allclose(np.exp(change[0]), [first, first], atol=1e-12)


def test_online_somebody_who_is_not_expected_yet_is_judged_by_all_views(blazepose):
    rig, observations = blazepose
    views = np.zeros((10, 4), dtype=bool)
    views[:, 2] = True
    nowhere_m = np.full((10, observations.skeleton.n_joints, 3), np.nan)
    seen = with_sides_exchanged(observations.frames(slice(40, 50)), views)
    np.testing.assert_array_equal(online(seen, rig, nowhere_m, one_by_one=False), views)


LEGS = ("left_hip", "left_knee", "left_ankle", "left_heel", "left_foot_index", "left_big_toe", "left_small_toe")
ARMS = ("left_shoulder", "left_elbow", "left_wrist", "left_pinky", "left_index", "left_thumb")


@pytest.mark.parametrize("joints", [LEGS, ARMS], ids=["legs", "arms"])
def test_legs_or_arms_alone_that_are_exchanged_are_found_and_corrected(recording, joints):
    rig, observations = recording
    views = random_flips(100, 4, seed=6)
    flipped = flips(with_sides_exchanged(observations, views, joints), rig)
    assert not (flipped.any(axis=-1) & ~views).any()
    # A quarter of the limbs' joints tells less: one view of a few frames may be left as it is.
    assert (flipped.any(axis=-1) & views).sum() > 0.85 * views.sum()
    own = [name in joints or name.replace("right", "left") in joints for name in observations.skeleton.joints]
    assert not flipped[:, :, ~np.array(own)].any()


def test_legs_that_are_exchanged_where_the_whole_body_is_not_take_no_face_with_them():
    skeleton = fgpose.files.load_skeleton("coco_17")
    whole_and_arms = exchanged_joints(np.array([True, True, False]), skeleton)
    assert {skeleton.joints[joint].split("_")[1] for joint in np.flatnonzero(whole_and_arms)} == {
        "hip",
        "knee",
        "ankle",
    }
    assert exchanged_joints(np.array([True, False, False]), skeleton)[skeleton.index("left_ear")]


def test_online_legs_alone(blazepose):
    rig, observations = blazepose
    known_m = fgpose.refine(observations, rig).positions_m
    views = random_flips(100, 4, seed=7)
    found = online(with_sides_exchanged(observations, views, LEGS), rig, known_m, one_by_one=False)
    # As of whole bodies, above.
    assert (found & views).sum() > 0.85 * views.sum()
    assert (found & ~views).sum() < 0.02 * views.size


def test_hands_and_feet_are_exchanged_with_their_limbs():
    skeleton = fgpose.files.load_skeleton("coco_wholebody_133")
    whole, arms, legs = (
        {skeleton.joints[joint] for joint in np.flatnonzero(sides.joints)} for sides in sides_of(skeleton)
    )
    assert {"left_wrist", "right_thumb_tip"} <= arms
    assert {"left_ankle", "right_heel"} <= legs
    assert {"left_eye", "right_jaw_1"} <= whole - arms - legs
    assert not arms & legs
    one_arm = fgpose.Skeleton(
        "arms",
        ("neck", "left_elbow", "left_wrist", "right_elbow", "right_wrist"),
        bones=[(0, 1), (1, 2), (0, 3), (3, 4)],
        root=[0],
        left_right=[(1, 3), (2, 4)],
        limbs=[(1, 2)],
    )
    assert len(sides_of(one_arm)) == 1, "what is all of the body is not judged twice"
