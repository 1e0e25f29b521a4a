from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.image_checks.on_other_side import RunningOtherSide, on_other_side
from fgpose.estimation.evidence.image_checks.sides import limbs
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, ring_rig, simulate, walking

LEG = ("hip", "knee", "ankle")
DOUBLED = {0: slice(20, 60), 1: slice(40, 80)}
"""Frames of two cameras in which the right leg is put on the left one; from 40 to 60 both say the same."""


def with_one_leg(observations: Observations, doubled: dict[int, slice]) -> Observations:
    """With the right leg detected on the left one in these frames of cameras, within 1 px."""
    points_px, rng = observations.points2d_px.copy(), np.random.default_rng(0)
    for camera, frames in doubled.items():
        for joint in LEG:
            left, right = (observations.skeleton.index(f"{side}_{joint}") for side in ("left", "right"))
            of_left_px = points_px[frames, camera, left]
            points_px[frames, camera, right] = of_left_px + rng.normal(0.0, 1.0, of_left_px.shape)
    return replace(observations, points2d_px=points_px)


@pytest.fixture(scope="module")
def walk(walking_scene: Scene) -> Scene:
    """Three seconds in a ring of four cameras, without depths."""
    truth_m = walking(90, 30.0, walking_scene.observations.skeleton)
    scene = simulate(truth_m, walking_scene.observations.skeleton, ring_rig(), 30.0, DetectionNoise(), NO_OCCLUSION, 0)
    return replace(scene, observations=replace(scene.observations, points3d_m=None, covariance3d_m2=None))


def is_doubled(scene: Scene) -> np.ndarray:
    """The detections that are of the other leg, and clearly apart from where they should be."""
    off_px = np.linalg.norm(
        with_one_leg(scene.observations, DOUBLED).points2d_px - scene.observations.points2d_px, axis=-1
    )
    return off_px > 40.0


def test_a_walker_whose_legs_cross_has_none(walk: Scene):
    found = on_other_side(walk.observations, walk.rig)
    # Of limbs that cover each other, gross errors of another view make some.
    assert found.mean() < 4e-3


@pytest.mark.parametrize("n_cameras", [3, 4])
def test_a_leg_that_is_put_on_the_other_one_in_several_views_is_found(walk: Scene, n_cameras: int):
    names = walk.rig.names[:n_cameras]
    seen, rig = with_one_leg(walk.observations, DOUBLED).subset(names), walk.rig.subset(names)
    found, doubled = on_other_side(seen, rig), is_doubled(walk)[:, :n_cameras]
    if n_cameras == 3:  # where two of three show one leg, there are no others that agree
        doubled[40:60], found[40:60] = False, False
    assert doubled.sum() > 60
    assert (found & doubled).sum() > 0.9 * doubled.sum()
    right = np.ones_like(doubled)
    for camera, frames in DOUBLED.items():
        right[frames, camera] = False
    assert (found & right).mean() < 4e-3


def test_the_pose_is_that_of_the_other_views(walk: Scene):
    """Two views that show one leg agree as well as the two that show both."""
    smoothed = fgpose.smooth(with_one_leg(walk.observations, DOUBLED), walk.rig)
    plain = fgpose.smooth(walk.observations, walk.rig)
    legs = [walk.observations.skeleton.index(f"right_{joint}") for joint in LEG]
    off_m, usual_m = (
        np.linalg.norm(each.positions_m - walk.truth_m, axis=-1)[20:80, legs] for each in (smoothed, plain)
    )
    assert off_m.max() < 0.1, "the other leg is 0.2 m away and more"
    # With two of four views less is known.
    assert np.median(off_m) < 2 * np.median(usual_m)
    assert smoothed.visibility is not None
    assert np.nanmedian(smoothed.visibility[:, :, legs][is_doubled(walk)[:, :, legs]]) == 0.0, "shown as left out"


def test_online_the_same_image_by_image(walk: Scene):
    seen, found = with_one_leg(walk.observations, DOUBLED), []
    running = RunningOtherSide.none(seen.n_cameras, seen.skeleton)
    for number, frame in enumerate(seen):
        expected_m = walk.truth_m[max(number - 1, 0)]
        of_frame, running = running.after(frame, limbs(frame, walk.rig), expected_m, walk.rig)
        found.append(of_frame)
    doubled, batch = is_doubled(walk), on_other_side(seen, walk.rig)
    # What the next images tell is not known yet.
    assert (np.array(found) & doubled).sum() > 0.8 * (batch & doubled).sum()
    assert (np.array(found) & ~batch).mean() < 4e-3


def test_two_cameras_cannot_tell(walk: Scene):
    names = walk.rig.names[:2]
    seen, rig = with_one_leg(walk.observations, DOUBLED).subset(names), walk.rig.subset(names)
    assert not on_other_side(seen, rig).any()
    frame = seen.frames(slice(50, 51))
    assert not RunningOtherSide.none(2, seen.skeleton).after(frame, limbs(frame, rig), walk.truth_m[49], rig)[0].any()


def test_online_somebody_who_is_not_expected_yet_is_judged(walk: Scene):
    seen, nowhere_m = with_one_leg(walk.observations, DOUBLED).frames(slice(30, 32)), np.full((17, 3), np.nan)
    first, second = seen
    of_first, running = RunningOtherSide.none(4, seen.skeleton).after(
        first, limbs(first, walk.rig), nowhere_m, walk.rig
    )
    of_second, _ = running.after(second, limbs(second, walk.rig), nowhere_m, walk.rig)
    assert not of_first.any(), "one image may be noise"
    np.testing.assert_array_equal(of_second, on_other_side(seen, walk.rig)[1])
    assert of_second[0].any()


def test_feet_follow_their_leg():
    """Real keypoints with toes and heels."""
    rig, observations = fgpose.files.load_recording("balance_blazepose")
    skeleton, names = observations.skeleton, (*LEG, "heel", "foot_index")
    points_px = observations.points2d_px.copy()
    left, right = ([skeleton.index(f"{side}_{name}") for name in names] for side in ("left", "right"))
    points_px[20:60, 1][:, right] = points_px[20:60, 1][:, left]
    found = on_other_side(replace(observations, points2d_px=points_px), rig)
    assert found[20:60, 1][:, right].all()
    assert found.sum() == 40 * len(names), "nothing else"
