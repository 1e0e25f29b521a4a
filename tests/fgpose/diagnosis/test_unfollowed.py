"""What is wrong of a camera in which nobody is followed, among several people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.association.chosen_person import PersonRegion, unfollowed
from fgpose.association.recording import associate
from fgpose.correspondences import NOBODY
from fgpose.finding import Code, Severity
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.pipeline import Source
from fgpose_benchmarks.synthetic import SimulatedClocks, SimulatedNetwork, WalkScene, film, ring_rig, walkers

SHOWS_BYSTANDERS = Path(__file__).parents[2] / "data" / "balance_openpose" / "people.npz"


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


@pytest.mark.slow
def test_what_is_wrong_of_a_camera_is_told_of_people_too() -> None:
    found = fgpose.diagnose(seen(lambda points_px: points_px / 2), two_walkers().rig).findings
    assert found[0].code is Code.IMAGE_SIZE
    assert "keypoints of ring_1 are of images of another size" in found[0].reason
    assert Code.BLIND_CAMERA not in {each.code for each in found}


@pytest.mark.slow
def test_cameras_that_are_exchanged_show_the_same_person() -> None:
    """Each sees somebody else most: another one of the two must be tried."""
    scene, other = two_walkers(), {"ring_0": "ring_1", "ring_1": "ring_0"}
    images = (replace(each, camera=other.get(each.camera, each.camera)) for each in scene.observations.images)
    exchanged = PeopleObservations(scene.observations.skeleton, scene.observations.camera_names, tuple(images))
    found = fgpose.diagnose(exchanged, scene.rig).findings
    assert found[0].code is Code.EXCHANGED_CAMERAS
    assert "ring_0 and ring_1 are exchanged" in found[0].reason
    assert Code.OTHER_PERSON not in {each.code for each in found}


def test_a_camera_that_hangs_shows_nobody_in_the_wrong_place() -> None:
    """Its rays to where people were founded tracks of nobody, and the people got new numbers."""
    scene, last = two_walkers(), dict[str, Detections]()

    def hung(image: Detections) -> Detections:
        if image.camera == "ring_1" and image.time_s > 2.0:
            return last["ring_1"].at(image.time_s)
        last[image.camera] = image
        return image

    images = tuple(hung(image) for image in scene.observations.images)
    association = associate(PeopleObservations(scene.observations.skeleton, scene.rig.names, images), scene.rig)
    assert len(association.people) == 2
    assert {event.what for event in association.events} == {"confirmed"}
    after = int(np.searchsorted(association.frames.frame_time_s, 2.1))
    for seen in association.people.values():
        assert (seen.in_frames(len(association.frames.image)).detection[after:, 1] == NOBODY).all()
    (finding,) = [each for each in fgpose.diagnose(association, scene.rig).findings if each.severity is Severity.WRONG]
    assert (finding.code, finding.camera) == (Code.FROZEN_CAMERA, "ring_1")
    assert finding.from_s == pytest.approx(2.0, abs=0.1)
    assert finding.to_s == pytest.approx(6.0, abs=0.1)


@pytest.mark.slow
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


def balancing(camera: int, change: Callable[[np.ndarray, fgpose.CameraRig], np.ndarray]) -> Source[PeopleObservations]:
    """Real detections of a man and of by-standers, with other keypoints of one camera."""
    rig, seen = fgpose.files.load_recording("balance_openpose")
    with np.load(SHOWS_BYSTANDERS) as file:
        people = file["people"].astype(float)
    points_px, confidence = people[..., :2], np.nan_to_num(people[..., 2])
    points_px[:, camera] = change(points_px[:, camera], rig)
    time_s = np.arange(len(people)) / 60
    return Source(rig, PeopleObservations.of_frames(seen.skeleton, rig.names, time_s, points_px, confidence))


@pytest.mark.parametrize(
    "person", [0, pytest.param(PersonRegion.parse("cam_01:300,100,500,1800"), marks=pytest.mark.slow)]
)
def test_what_is_wrong_is_told_of_one_among_bystanders(person: int | PersonRegion) -> None:
    one = balancing(2, lambda points_px, rig: points_px / 2).one(person).first_frames(60)
    found = fgpose.diagnose(one.observations, one.rig, with_unfollowed=one.with_unfollowed).findings
    assert found[0].code is Code.IMAGE_SIZE
    assert "keypoints of cam_03 are of images of another size" in found[0].reason
    assert Code.BLIND_CAMERA not in {each.code for each in found}
    two = one.subset(("cam_03", "cam_01"))
    assert two.with_unfollowed is not None
    assert two.with_unfollowed.camera_names == two.observations.camera_names


def test_who_fits_for_a_part_of_the_time_is_not_followed() -> None:
    """In a mirrored image the man fits while he is in the middle: a quarter of the time."""

    def mirrored(points_px: np.ndarray, rig: fgpose.CameraRig) -> np.ndarray:
        return np.stack([rig.cameras[1].size_px[0] - 1 - points_px[..., 0], points_px[..., 1]], axis=-1)

    source = balancing(1, mirrored)
    assert unfollowed(associate(source.observations, source.rig)) == [1]
    right = balancing(1, lambda points_px, rig: points_px)
    assert right.one().with_unfollowed is None
