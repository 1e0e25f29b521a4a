"""What is wrong of a camera in which none of several people is followed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

import fgpose
from fgpose.association.recording import associate
from fgpose.diagnosis.unfollowed import unfollowed
from fgpose.finding import Code
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.synthetic import SimulatedClocks, SimulatedNetwork, WalkScene, film, ring_rig, walkers


@cache
def two_walkers() -> WalkScene:
    rig = ring_rig(4, 4.5, 2.5, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    motion = walkers((5.0, 5.0), 6.0, 2, "walks", 2)
    return film(motion, rig, 2, SimulatedNetwork(in_3d=False), SimulatedClocks(fps=(15.0,), max_start_s=0.0))


def seen(change: Callable[[np.ndarray], np.ndarray]) -> PeopleObservations:
    """With other keypoints of ring_1."""
    scene = two_walkers().observations
    images = (
        replace(image, points2d_px=change(image.points2d_px)) if image.camera == "ring_1" else image
        for image in scene.images
    )
    return PeopleObservations(scene.skeleton, scene.camera_names, tuple(images))


def test_what_is_wrong_of_a_camera_is_told_of_people_too() -> None:
    found = fgpose.diagnose(seen(lambda points_px: points_px / 2), two_walkers().rig).findings
    assert found[0].code is Code.IMAGE_SIZE
    assert "keypoints of ring_1 are of images of another size" in found[0].reason
    assert Code.BLIND_CAMERA not in {each.code for each in found}


def test_cameras_in_which_people_are_followed_and_bystanders() -> None:
    """Who is before one camera only explains nothing."""
    rig = two_walkers().rig
    association = associate(two_walkers().observations, rig)
    assert unfollowed(association) == []
    stands_px = next(image for image in two_walkers().observations.images if image.n_people).points2d_px[:1]
    rng = np.random.default_rng(0)
    elsewhere = seen(lambda points_px: stands_px + rng.normal(0, 2, points_px.shape))
    assert unfollowed(associate(elsewhere, rig)) == [1]
    codes = {each.code for each in fgpose.diagnose(elsewhere, rig).findings}
    assert not codes & {Code.IMAGE_SIZE, Code.WRONG_LENS, Code.EXCHANGED_CAMERAS, Code.CAMERA_AXES}
