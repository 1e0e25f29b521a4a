"""Crowds: people move as people do, hide each other as capsules do, and are detected as the settings say."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import (
    NO_CROWD_ERRORS,
    NO_NOISE,
    CameraTimes,
    CrowdErrors,
    CrowdMotion,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Furniture,
    Occlusion,
    crowd_motion,
    motion_from_npz,
    ring_rig,
    simulate_crowd,
    walking,
)
from fgpose_benchmarks.synthetic.crowd.bodies import FURNITURE, VISIBLE, Capsules, hidden_by
from fgpose_benchmarks.synthetic.crowd.errors import spells
from tests.conftest import MOCAP

FPS = 25.0
NORTH = np.array([0.0, 1.0, 0.0])  # from where the walker starts to the origin, metres
GUESSED_EXACTLY = Occlusion(hallucination_px=0.0, missing_share=0.0, confidence=0.5)


def room_rig(n_cameras: int = 3, height_m: float = 2.75) -> CameraRig:
    """Around a room of 6 x 6 m, looking at its middle; 88 degrees wide."""
    return ring_rig(n_cameras, 5.0, height_m, (0.0, 0.0, 0.9), focal_px=1000.0, size_px=(1920, 1080))


def small_crowd(seed: int, n_frames: int = 600, **settings: Any) -> CrowdMotion:
    gait, work = (motion_from_npz(MOCAP / f"{clip}.npz") for clip in ("cmu_02_01_short", "cmu_02_05"))
    return crowd_motion(4, n_frames, FPS, [gait], [work], seed, **settings)


@pytest.fixture(scope="module")
def motion() -> CrowdMotion:
    """Four people for 24 s; two of them go out and come back, one comes late, one leaves."""
    return small_crowd(seed=1)


@pytest.fixture(scope="module")
def standing(skeleton: Skeleton) -> CrowdMotion:
    """Two people frozen for 20 s, side by side as seen from the first camera."""
    one_m = np.repeat(walking(1, FPS, skeleton), 500, axis=0) + NORTH
    aside_m = np.array([-0.7, 0.7, 0.0])
    return CrowdMotion(skeleton, np.stack([one_m + aside_m, one_m - aside_m]), FPS)


@pytest.fixture(scope="module")
def one_camera() -> CameraRig:
    return room_rig(1)


def ground_m(motion: CrowdMotion) -> np.ndarray:
    return motion.truth_m[:, :, motion.skeleton.index("pelvis"), :2]


def perfect(motion: CrowdMotion, rig: CameraRig, **changes: Any) -> CrowdScene:
    errors = dataclasses.replace(NO_CROWD_ERRORS, **changes)
    return simulate_crowd(motion, rig, NO_NOISE, GUESSED_EXACTLY, errors, seed=0)


def test_the_same_seed_gives_the_same_scene(one_camera: CameraRig) -> None:
    motion = small_crowd(1, 50)
    np.testing.assert_array_equal(small_crowd(1, 50).truth_m, motion.truth_m)
    assert not np.array_equal(small_crowd(1, 50).truth_m, small_crowd(2, 50).truth_m)
    scenes = [
        simulate_crowd(motion, one_camera, DetectionNoise(), Occlusion(), CrowdErrors(), seed, CameraTimes((2.0,)))
        for seed in (0, 0, 1)
    ]
    same = [
        all(
            np.array_equal(a.points2d_px, b.points2d_px, equal_nan=True) and np.array_equal(a.confidence, b.confidence)
            for a, b in zip(scenes[0].observations.images, other.observations.images, strict=True)
        )
        for other in scenes[1:]
    ]
    assert same == [True, False]


def test_every_body_is_rigid_symmetric_and_of_its_own_size(motion: CrowdMotion) -> None:
    lengths_m = motion.skeleton.bone_lengths(motion.truth_m)
    np.testing.assert_allclose(np.nanmax(lengths_m, axis=1), np.nanmin(lengths_m, axis=1), atol=1e-12)
    of_person_m = np.nanmean(lengths_m, axis=1)
    for bone, length_m in zip(motion.skeleton.bones, of_person_m.T, strict=True):
        mirrored = motion.skeleton.mirrored(bone)
        at = [set(other) for other in motion.skeleton.bones].index(set(mirrored))
        np.testing.assert_allclose(length_m, of_person_m[:, at], atol=1e-12)
    shape = of_person_m / of_person_m.sum(axis=1, keepdims=True)
    for a in range(3):
        assert np.abs(of_person_m[a] / of_person_m[a + 1] - 1).max() > 0.01, "sizes differ"
        assert np.abs(shape[a] / shape[a + 1] - 1).max() > 0.005, "proportions differ"


def test_people_keep_their_distance(motion: CrowdMotion) -> None:
    apart_m = np.linalg.norm(ground_m(motion)[:, None] - ground_m(motion), axis=-1)
    apart_m[np.arange(4), np.arange(4)] = np.inf
    assert 0.45 <= np.nanmin(apart_m) < 1.0


def test_people_walk_on_the_floor_without_skating(motion: CrowdMotion) -> None:
    ankles_m = motion.truth_m[:, :, [motion.skeleton.index(f"{side}_ankle") for side in ("left", "right")]]
    speed_mps = np.linalg.norm(np.gradient(ground_m(motion), 1 / FPS, axis=1), axis=-1)
    ankle_mps = np.linalg.norm(np.gradient(ankles_m[..., :2], 1 / FPS, axis=1), axis=-1)
    lower_mps = np.where(ankles_m[..., 0, 2] < ankles_m[..., 1, 2], ankle_mps[..., 0], ankle_mps[..., 1])
    walks = speed_mps > 0.6
    assert 0.2 < walks[motion.is_there].mean() < 0.9, "people walk, and stop"
    # In the recorded walk the lower ankle moves at 0.08 m/s, the pelvis at 1.2; feet that ignored the way: 1.1 m/s.
    assert np.median(lower_mps[walks]) < 0.2 * np.median(speed_mps[walks])
    lowest_m = ankles_m[..., 2].min(axis=2)[motion.is_there]
    assert 0.05 < lowest_m.min() < lowest_m.max() < 0.2
    acceleration_mps2 = np.linalg.norm(np.diff(motion.truth_m, 2, axis=1) * FPS**2, axis=-1)
    # The recorded walk and work have 60 m/s^2 where a foot or a fist lands; a jump by 5 cm would be 31 m/s^2 at the
    # pelvis, where they have 6.
    assert np.nanmax(acceleration_mps2) < 80
    assert np.nanmax(acceleration_mps2[..., motion.skeleton.index("pelvis")]) < 12


def test_people_face_where_they_walk(motion: CrowdMotion) -> None:
    hips_m = [motion.truth_m[:, :, motion.skeleton.index(f"{side}_hip"), :2] for side in ("left", "right")]
    to_left_m, velocity_mps = hips_m[0] - hips_m[1], np.gradient(ground_m(motion), 1 / FPS, axis=1)
    walks = np.linalg.norm(velocity_mps, axis=-1) > 0.6
    forward, to_left = (v[walks] / np.linalg.norm(v[walks], axis=-1)[:, None] for v in (velocity_mps, to_left_m))
    sine = forward[:, 0] * to_left[:, 1] - forward[:, 1] * to_left[:, 0]
    assert np.quantile(sine, 0.05) > 0.8, "the left hip is on the left"


def test_who_leaves_is_nan_until_he_returns_through_a_door(motion: CrowdMotion) -> None:
    there = motion.is_there
    np.testing.assert_array_equal(np.isfinite(motion.truth_m).any(axis=(2, 3)), there)
    kinds = [event.kind for event in motion.events]
    assert [kinds.count(kind) for kind in ("enters", "leaves", "returns")] == [1, 3, 2]
    for event in motion.events:
        person, frame = event.people[0], event.frame
        if event.kind == "crossing":
            continue
        outside = frame if event.kind == "leaves" else frame - 1
        inside = frame - 1 if event.kind == "leaves" else frame
        assert there[person, inside]
        assert not there[person, outside]
        # A step of 1.4 m/s lasts 6 cm, and the body sways by as much.
        assert np.abs(ground_m(motion)[person, inside]).max() > 2.85
        if event.kind == "returns":
            gone = max(
                e.frame for e in motion.events if e.kind == "leaves" and e.people == (person,) and e.frame < frame
            )
            assert 0.8 * 5 <= (frame - gone) / FPS <= 1.2 * 5 + 1 / FPS
    assert np.nanmax(np.abs(ground_m(motion))) < 3.1


def test_people_cross_each_other_on_purpose(motion: CrowdMotion) -> None:
    crossings = [event for event in motion.events if event.kind == "crossing"]
    assert len(crossings) >= 3
    for event in crossings:
        a, b = (ground_m(motion)[person] for person in event.people)
        around = slice(event.frame - 3, event.frame + 4)
        apart_m = np.linalg.norm(a[around] - b[around], axis=-1)
        assert 0.45 <= apart_m.min() <= 0.8
        assert apart_m[3] == apart_m.min()
    without = small_crowd(seed=1, plan=CrowdPlan(crossing_share=0.0))
    assert len(crossings) > sum(event.kind == "crossing" for event in without.events)


def test_nobody_walks_through_furniture() -> None:
    table = Furniture((-1.0, -0.5, 0.0), (0.5, 0.5, 0.75))
    motion = small_crowd(2, 300, furniture=(table,))
    inside = np.all((ground_m(motion) > table.low_m[:2]) & (ground_m(motion) < table.high_m[:2]), axis=-1)
    assert not inside.any()
    assert motion.furniture == (table,)


def test_a_person_in_between_hides_and_one_behind_does_not(skeleton: Skeleton) -> None:
    body_m = walking(1, FPS, skeleton)[0] + NORTH  # faces along x, stands at the origin
    camera_m, capsules = np.array([0.0, -5.0, 1.0]), Capsules.of(skeleton)

    def hiders(*places_m: tuple[float, float]) -> np.ndarray:
        return hidden_by(
            camera_m, np.stack([body_m + np.array([*place_m, 0.0]) for place_m in places_m])[None], capsules
        )[0]

    far, near = hiders((0.0, 1.0), (0.0, 0.0))
    assert (far[[skeleton.index(joint) for joint in ("pelvis", "spine", "thorax", "neck_base")]] == 1).all()
    assert (near == VISIBLE).all()
    assert (hiders((0.0, 1.0), (1.0, 0.0)) == VISIBLE).all(), "side by side"
    three = hiders((0.0, 2.0), (0.0, 0.0), (0.0, 1.0))
    assert three[0, skeleton.index("spine")] == 1, "the nearest to the camera counts"
    gone_m = np.stack([body_m + NORTH, np.full_like(body_m, np.nan)])[None]
    assert (hidden_by(camera_m, gone_m, capsules) == VISIBLE).all()


def test_the_far_arm_is_behind_the_own_body(skeleton: Skeleton) -> None:
    """Seen from the right: it is hidden, the near arm and the joints within the trunk are not."""
    body_m = np.zeros((skeleton.n_joints, 3))
    heights_m = {"shoulder": (0.2, 1.4), "elbow": (0.22, 1.12), "wrist": (0.22, 1.12), "hip": (0.09, 0.9)}
    heights_m |= {"knee": (0.09, 0.5), "ankle": (0.09, 0.09)}
    for part, (aside_m, height_m) in heights_m.items():
        for side, sign in (("left", 1), ("right", -1)):
            body_m[skeleton.index(f"{side}_{part}"), 1:] = sign * aside_m, height_m
    body_m[[skeleton.index("left_wrist"), skeleton.index("right_wrist")], 0] = 0.25  # forearms point forward
    for joint, height_m in (("pelvis", 0.9), ("spine", 1.15), ("thorax", 1.4), ("neck_base", 1.5), ("head", 1.65)):
        body_m[skeleton.index(joint), 2] = height_m
    hidden = hidden_by(np.array([0.0, -5.0, 1.1]), body_m[None, None], Capsules.of(skeleton), own_body=True)[0, 0]
    names = {skeleton.joints[joint] for joint in np.flatnonzero(hidden == 0)}
    assert {"left_elbow", "left_shoulder", "left_knee", "left_ankle"} <= names
    assert not names & {"pelvis", "head", *(name for name in skeleton.joints if name.startswith("right"))}
    assert (hidden_by(np.array([0.0, -5.0, 1.1]), body_m[None, None], Capsules.of(skeleton)) == VISIBLE).all()


def test_capsules_agree_with_dense_samples_of_the_rays(motion: CrowdMotion) -> None:
    capsules, camera_m = Capsules.of(motion.skeleton), np.array([3.0, -3.5, 1.5])
    frames = np.flatnonzero(motion.is_there.all(axis=0))[::40]
    people_m = motion.truth_m[:, frames].swapaxes(0, 1)
    hider = hidden_by(camera_m, people_m, capsules)
    along = np.linspace(0.0, 1.0, 400)[:, None]
    n_hidden = 0
    for frame, person, joint in np.ndindex(hider.shape):
        ray_m = camera_m + along * (people_m[frame, person, joint] - camera_m)
        margins_m = np.full(4, np.inf)
        for other in {0, 1, 2, 3} - {person}:
            ends_m = people_m[frame, other][capsules.ends]
            axis_m = ends_m[:, 1] - ends_m[:, 0]
            share = np.einsum("sci,ci->sc", ray_m[:, None] - ends_m[:, 0], axis_m) / np.sum(axis_m**2, axis=-1)
            nearest_m = ends_m[:, 0] + np.clip(share, 0, 1)[..., None] * axis_m
            distance_m = np.linalg.norm(ray_m[:, None] - nearest_m, axis=-1)
            margins_m[other] = (distance_m - capsules.radius_m).min()
        # Samples are 2 cm apart: at 4 cm from the axis they miss it by at most 1.2 mm.
        if margins_m.min() > 0.002:
            assert hider[frame, person, joint] == VISIBLE
        elif margins_m.min() < -1e-6:
            assert margins_m[hider[frame, person, joint]] < 0.002
            n_hidden += 1
    assert n_hidden > 10


def test_furniture_agrees_with_dense_samples_of_the_rays(motion: CrowdMotion) -> None:
    table, camera_m = Furniture((-1.0, -1.5, 0.0), (1.0, 0.5, 0.75)), np.array([3.0, -3.5, 1.5])
    people_m = motion.truth_m[:, ::60].swapaxes(0, 1)
    hidden = hidden_by(camera_m, people_m, Capsules.of(motion.skeleton), (table,)) == FURNITURE
    without = hidden_by(camera_m, people_m, Capsules.of(motion.skeleton)) == VISIBLE
    ray_m = camera_m + np.linspace(0.0, 1.0, 2000)[:, None, None, None, None] * (people_m - camera_m)

    def hit(margin_m: float) -> np.ndarray:
        inside = (ray_m > np.array(table.low_m) - margin_m) & (ray_m < np.array(table.high_m) + margin_m)
        return np.asarray(inside.all(axis=-1).any(axis=0))

    # Samples are 4 mm apart: a ray through the box by more than that at a margin of 3 mm has one inside.
    assert not (hidden & ~hit(0.003)).any()
    assert not (hit(-0.001) & without & ~hidden).any()
    assert 0.02 < hidden[np.isfinite(people_m).all(axis=-1)].mean() < 0.6


def test_without_errors_everybody_is_where_he_is_at_the_time_of_the_camera(skeleton: Skeleton) -> None:
    """Uniform motion, of which every camera's time is known exactly; one camera's stamps are 50 ms early."""
    rig = room_rig().with_time_offsets(np.array([0.0, 0.05, 0.0]))
    velocities_mps = np.array([[0.5, -0.3, 0.0], [-0.4, 0.2, 0.05]])
    start_m = walking(1, FPS, skeleton) + np.array([[[-0.6, 1.5, 0.0]], [[0.6, -0.5, 0.0]]])

    def at(time_s: float) -> np.ndarray:
        return start_m + time_s * velocities_mps[:, None]

    truth_m = np.stack([at(t / FPS) for t in range(51)], axis=1)
    truth_m[1, 20:35] = np.nan
    times = CameraTimes((30.0, 25.0), random_phases=True)
    scene = simulate_crowd(
        CrowdMotion(skeleton, truth_m, FPS), rig, NO_NOISE, GUESSED_EXACTLY, NO_CROWD_ERRORS, 0, times
    )
    for image, who in zip(scene.observations.images, scene.who, strict=True):
        camera = rig.cameras[rig.names.index(image.camera)]
        seen_s = image.time_s + camera.time_offset_s
        there = {0} if 19 / FPS < seen_s < 35 / FPS else {0, 1}
        assert set(who.tolist()) == (there if seen_s <= 50 / FPS else set())
        # A spline through points on a line is that line, to rounding: 1e-12 m, or 1e-9 px.
        np.testing.assert_allclose(image.points2d_px, camera.project(at(seen_s)[who]), atol=1e-8)
        assert set(image.confidence.ravel().tolist()) <= {0.5, 1.0}
    firsts_s = [scene.observations.times_s(name)[0] for name in rig.names]
    for name, first_s, fps in zip(rig.names, firsts_s, (30.0, 25.0, 30.0), strict=True):
        time_s = scene.observations.times_s(name)
        assert 0 <= first_s < 1 / fps
        np.testing.assert_allclose(np.diff(time_s), 1 / fps, atol=1e-12)
        assert 2 - 1 / fps < time_s[-1] <= 2
    assert len(set(firsts_s)) == 3


def test_shares_of_missed_doubled_and_flipped_are_as_set(standing: CrowdMotion, one_camera: CameraRig) -> None:
    """Drawn anew in each of 599 images for each of two people: 4 sigma of the binomial distribution."""
    scene = perfect(
        standing,
        one_camera,
        **{"missed_share": 0.3, "missed_s": 0.0, "doubled_share": 0.2, "doubled_s": 0.0},
        **{"flipped_share": 0.1, "flipped_s": 0.0},
    )
    counts = np.array([np.bincount(who, minlength=2) for who in scene.who])
    n, n_found = counts.size, int((counts > 0).sum())
    assert n == 2 * 599
    assert counts.max() == 2
    assert (counts == 0).mean() == pytest.approx(0.3, abs=4 * np.sqrt(0.3 * 0.7 / n))
    assert (counts == 2).sum() / n_found == pytest.approx(0.2, abs=4 * np.sqrt(0.2 * 0.8 / n_found))
    flipped = np.concatenate(scene.flipped)
    assert flipped.mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.1 * 0.9 / len(flipped)))
    true_px = one_camera.cameras[0].project(standing.truth_m[:, 0])
    mirror = [standing.skeleton.mirrored((joint, joint))[0] for joint in range(17)]
    for image, who, is_flipped in zip(scene.observations.images, scene.who, scene.flipped, strict=True):
        expected_px = np.where(is_flipped[:, None, None], true_px[who][:, mirror], true_px[who])
        np.testing.assert_allclose(image.points2d_px, expected_px, atol=1e-8)


def test_doubles_have_noise_of_their_own(standing: CrowdMotion, one_camera: CameraRig) -> None:
    noise = dataclasses.replace(NO_NOISE, sigma_px=3.0)
    errors = dataclasses.replace(NO_CROWD_ERRORS, doubled_share=1.0)
    scene = simulate_crowd(standing, one_camera, noise, GUESSED_EXACTLY, errors, seed=0)
    pairs_px = np.array(
        [image.points2d_px[who == 0] for image, who in zip(scene.observations.images, scene.who, strict=True)]
    )
    error_px = pairs_px - one_camera.cameras[0].project(standing.truth_m[0, 0])
    assert error_px.shape == (599, 2, 17, 2)
    # 20,000 independent numbers: the SD is known to 0.5 %, the correlation to 0.007; 4 sigma.
    np.testing.assert_allclose(error_px.std(axis=(0, 2, 3)), 3.0, rtol=0.02)
    assert abs(np.mean(error_px[:, 0] * error_px[:, 1])) < 4 * 0.007 * 9


def test_false_people_are_as_many_as_set_and_stay_for_a_moment(standing: CrowdMotion, one_camera: CameraRig) -> None:
    settings = {"false_people": 0.4, "min_false_s": 0.1, "max_false_s": 0.5, "false_confidence": 0.3}
    scene = perfect(standing, one_camera, **settings)
    counts = np.array([(who < 0).sum() for who in scene.who])
    # In 20 s there are 0.4 x 20 / 0.3 = 27 of them, whose time varies by 0.12 s around 0.3 s; 4 sigma.
    assert counts.mean() == pytest.approx(0.4, abs=4 * 0.4 * np.sqrt((1 + 0.15) / 27))
    begins = np.flatnonzero(np.diff((counts > 0).astype(int), prepend=0) == 1)
    assert 8 < len(begins) < 50
    for image, who, joint_of in zip(scene.observations.images, scene.who, scene.joint_of, strict=True):
        assert (joint_of[who < 0] == -1).all()
        false_px = image.points2d_px[who < 0]
        assert np.isfinite(false_px).all()
        assert ((false_px >= 0) & (false_px < (1920, 1080))).all()
        assert image.confidence[who < 0].size == 0 or 0.02 <= image.confidence[who < 0].min() < 1
    stated = np.concatenate(
        [i.confidence[who < 0] for i, who in zip(scene.observations.images, scene.who, strict=True)]
    )
    assert stated.mean() == pytest.approx(0.3, abs=0.05)


def test_people_are_in_random_order(standing: CrowdMotion, one_camera: CameraRig) -> None:
    first = np.array([who[0] for who in perfect(standing, one_camera).who])
    n = len(first)
    assert first.mean() == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / n))
    changes = np.mean(first[1:] != first[:-1])
    assert changes == pytest.approx(0.5, abs=4 * np.sqrt(0.25 / n)), "from image to image"


def test_states_last_as_long_as_set() -> None:
    state = spells(np.random.default_rng(0), (6000, 20), 30.0, 0.2, 0.5)
    # 120,000 states, drawn anew every 15 images: 8000 independent draws; 4 sigma.
    assert state.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.2 * 0.8 / 8000))
    # Two images share a draw with probability exp(-1 / 15).
    same = np.mean((state[1:] - 0.2) * (state[:-1] - 0.2)) / state.var()
    assert same == pytest.approx(np.exp(-1 / 15), abs=0.02)
    assert spells(np.random.default_rng(0), (50, 2), 30.0, 1.0, 0.5).all()
    assert not spells(np.random.default_rng(0), (50, 2), 30.0, 0.0, 0.0).any()


def test_labels_agree_with_the_projected_truth(motion: CrowdMotion) -> None:
    """Without noise a joint lies on that of the person whose it is: mirrored where flipped, or where grabbed."""
    rig, skeleton = room_rig(height_m=1.5), motion.skeleton
    errors = CrowdErrors(grabbed_share=0.5, flipped_share=0.3, doubled_share=0.1)
    far_off = Occlusion(hallucination_px=400.0, missing_share=0.3)
    scene = simulate_crowd(motion, rig, NO_NOISE, far_off, errors, 0, CameraTimes((FPS / 3,)))
    mirror = np.array([skeleton.mirrored((joint, joint))[0] for joint in range(17)])
    n_grabbed = n_hallucinated = n_missing = 0
    labels = zip(scene.observations.images, scene.who, scene.joint_of, scene.hidden, scene.flipped, strict=True)
    for image, who, joint_of, hidden, flipped in labels:
        true_px = rig.cameras[rig.names.index(image.camera)].project(motion.truth_m[:, round(image.time_s * FPS)])
        for person, of, is_hidden, flip, px in zip(who, joint_of, hidden, flipped, image.points2d_px, strict=True):
            own = mirror if flip else np.arange(17)
            assert (of[np.isnan(px[:, 0])] == -1).all()
            if person < 0:
                continue
            grabbed, shown = (of >= 0) & (of != person), of == person
            assert not (grabbed & ~is_hidden).any()
            assert not (shown & is_hidden).any()
            np.testing.assert_allclose(px[shown], true_px[person, own[shown]], atol=1e-8)
            for joint in np.flatnonzero(grabbed):
                both_px = true_px[of[joint], [joint, mirror[joint]]]
                assert np.abs(px[joint] - both_px).max(axis=1).min() < 1e-8
            hallucinated = (of == -1) & np.isfinite(px[:, 0])
            assert not (hallucinated & ~is_hidden).any()
            n_grabbed, n_hallucinated = n_grabbed + grabbed.sum(), n_hallucinated + hallucinated.sum()
            n_missing += (is_hidden & np.isnan(px[:, 0])).sum()
    assert min(n_grabbed, n_hallucinated, n_missing) > 30


def test_hidden_people_are_not_detected(skeleton: Skeleton) -> None:
    """A person behind another, who hides all but a few joints: detected only while few joints suffice."""
    body_m = walking(1, FPS, skeleton) + NORTH
    rig = ring_rig(1, 5.0, 2.75, (0.0, 0.0, 1.0), size_px=(1920, 1080))
    away = (body_m[0].mean(axis=0) - rig.cameras[0].position_m) * (1.0, 1.0, 0.0)
    behind_m = body_m + 0.8 * away / np.linalg.norm(away)
    pair = CrowdMotion(skeleton, np.repeat(np.stack([behind_m, body_m]), 2, axis=1), FPS)
    hidden = hidden_by(rig.cameras[0].position_m, pair.truth_m[:, :1].swapaxes(0, 1), Capsules.of(skeleton))[0, 0] == 1
    n_visible = int((~hidden).sum())
    assert 2 < n_visible < 12
    for min_visible, found in ((n_visible, [0, 1]), (n_visible + 1, [1])):
        scene = perfect(pair, rig, min_visible_joints=min_visible)
        assert sorted(scene.who[0].tolist()) == found


def test_who_is_out_of_the_image_is_not_there(standing: CrowdMotion, one_camera: CameraRig) -> None:
    far = CrowdMotion(standing.skeleton, standing.truth_m[:, :2] + np.array([[[[0.0] * 3]], [[[4.0, -8.0, 0.0]]]]), FPS)
    assert [who.tolist() for who in perfect(far, one_camera).who] == [[0], [0]]


def test_hidden_joints_are_less_confident_and_off(motion: CrowdMotion) -> None:
    errors = dataclasses.replace(NO_CROWD_ERRORS, min_visible_joints=4)
    scene = simulate_crowd(
        motion, room_rig(height_m=1.5), DetectionNoise(), Occlusion(), errors, 0, CameraTimes((10.0,))
    )
    confidence = np.concatenate([image.confidence for image in scene.observations.images])
    hidden, seen = np.concatenate(scene.hidden), confidence > 0
    assert 0.02 < hidden.mean() < 0.3
    assert confidence[hidden & seen].mean() < confidence[~hidden & seen].mean() - 0.2
    assert (~seen[hidden]).mean() == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize(("n_cameras", "height_m"), [(3, 2.5), (5, 3.0), (8, 2.75), (3, 1.3), (5, 1.6)])
def test_a_ring_covers_the_room(motion: CrowdMotion, n_cameras: int, height_m: float) -> None:
    rig, there = room_rig(n_cameras, height_m), motion.is_there
    px = rig.project(motion.truth_m[there])
    inside = np.all((px >= 0) & (px < (1920, 1080)), axis=-1)
    assert inside.mean() > 0.98


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (lambda: CrowdErrors(missed_share=1.5), r"CrowdErrors\.missed_share must be in \[0, 1\], got 1\.5"),
        (lambda: CrowdErrors(doubled_s=-1.0), r"CrowdErrors\.doubled_s must be in \[0, inf\]"),
        (lambda: CrowdErrors(min_false_s=1.0), r"min_false_s must not exceed max_false_s"),
        (lambda: CameraTimes(()), "must be positive rates"),
        (lambda: CameraTimes((30.0, 0.0)), "must be positive rates"),
        (lambda: CrowdPlan(min_crossing_m=1.0), r"CrowdPlan\.min_crossing_m must not exceed max_crossing_m"),
        (lambda: CrowdPlan(room_x_m=1.0), "the room larger than 2 m"),
        (lambda: CrowdPlan(late_share=2.0), r"CrowdPlan\.late_share must be in"),
        (lambda: Furniture((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)), "lower corner below its upper one"),
    ],
)
def test_bad_settings_are_one_clear_error(settings: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        settings()


def test_a_bad_crowd_is_one_clear_error(
    skeleton: Skeleton, standing: CrowdMotion, monkeypatch: pytest.MonkeyPatch
) -> None:
    gait = motion_from_npz(MOCAP / "cmu_02_01_short.npz")
    with pytest.raises(ValueError, match="a crowd needs a person"):
        crowd_motion(2, 100, FPS, [gait], [], seed=0)
    with pytest.raises(ValueError, match=r"longer than 0\.96 s, got 0\.40 s"):
        crowd_motion(2, 100, FPS, [(gait[0][:20], 50.0)], [gait], seed=0)
    monkeypatch.setattr("fgpose_benchmarks.synthetic.crowd.routes._RESTARTS", 1)
    small = CrowdPlan(room_x_m=2.1, room_y_m=2.1, returning_share=0.0, leaving_share=0.0)
    with pytest.raises(ValueError, match=r"find no way around each other in 2\.1 x 2\.1 m"):
        crowd_motion(4, 100, FPS, [gait], [gait], seed=0, plan=small)
    with pytest.raises(ValueError, match=r"truth_m must be \(people, frames, 17, 3\), got \(4, 17, 3\)"):
        CrowdMotion(skeleton, np.zeros((4, 17, 3)), FPS)
    in_part_m = standing.truth_m[:, :3].copy()
    in_part_m[1, 2, 5] = np.nan
    with pytest.raises(ValueError, match="person 1, frame 2: some numbers are finite"):
        CrowdMotion(skeleton, in_part_m, FPS)
    with pytest.raises(ValueError, match="frame rate must be a positive number, got 0"):
        CrowdMotion(skeleton, standing.truth_m[:, :3], 0.0)
