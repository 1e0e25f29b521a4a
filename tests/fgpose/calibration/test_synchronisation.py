from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from fgpose.calibration.synchronisation import synchronise
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.synthetic import embedded_motion, find_studio, ring_rig
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.crowd.walkers import walkers
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film

H36M = load_skeleton("h36m_17")


@cache
def filmed(clip: str, seconds: float, *, still: bool = False) -> WalkScene:
    """By four cameras of 30 and 25 Hz, with a bias of 20 to 40 mm, that begin up to two seconds apart."""
    motion_m, fps = embedded_motion(clip)
    motion_m = motion_m[: round(seconds * fps)]
    motion_m = motion_m - [*motion_m[:, 0, :2].mean(axis=0), 0.0]
    if still:
        motion_m = np.repeat(motion_m[:1], len(motion_m), axis=0)
    motion = CrowdMotion(H36M, motion_m[None], fps)
    return film(motion, ring_rig(4), 1, SimulatedNetwork(in_3d=False), SimulatedClocks((30.0, 25.0), 2.0, 40.0, 145.0))


def later(people: PeopleObservations, camera: str, by_s: float) -> PeopleObservations:
    """The clock of a camera set."""
    images = [replace(each, time_s=each.time_s + by_s) if each.camera == camera else each for each in people.images]
    return PeopleObservations(people.skeleton, people.camera_names, tuple(sorted(images, key=lambda each: each.time_s)))


# A puncher stays on the spot; over obstacles somebody walks straight on, and is seen for eight seconds.
@pytest.mark.parametrize(
    ("clip", "seconds"), [pytest.param("cmu_02_05", 15.0, marks=pytest.mark.slow), ("cmu_03_03_b", 8.0)]
)
def test_starts_are_found_to_a_fraction_of_an_image(clip: str, seconds: float) -> None:
    scene = filmed(clip, seconds)
    found = synchronise(scene.observations, scene.rig.with_time_offsets(np.full(4, 7.0)))
    assert found.rig.names == scene.rig.names
    assert not found.left_out
    errors_s = found.rig.time_offsets_s - (scene.rig.time_offsets_s - scene.rig.time_offsets_s[0])
    assert errors_s[0] == 0
    assert found.sigma_s[0] == 0
    # A quarter of an image; sigmas are 3 to 5 ms.
    assert np.abs(errors_s).max() < 10e-3
    assert (np.abs(errors_s[1:]) < 3 * found.sigma_s[1:]).all()


@pytest.mark.slow
def test_poses_stay_and_minutes_do_not_matter() -> None:
    scene = filmed("cmu_03_03_b", 8.0)
    rig = scene.rig
    found = synchronise(later(scene.observations, "ring_2", 300.0), rig)
    before = synchronise(scene.observations, rig)
    # Other samples are compared; a third of the smallest sigma.
    np.testing.assert_allclose(found.rig.time_offsets_s - before.rig.time_offsets_s, [0.0, 0.0, -300.0, 0.0], atol=1e-3)
    for camera, given in zip(found.rig.cameras, rig.cameras, strict=True):
        np.testing.assert_array_equal(camera.world_T_camera, given.world_T_camera)
        np.testing.assert_array_equal(camera.K, given.K)


@pytest.mark.slow
def test_a_camera_that_filmed_something_else_is_left_out() -> None:
    scene, other = filmed("cmu_02_05", 15.0), filmed("cmu_03_03_b", 8.0)
    images = [each for each in scene.observations.images if each.camera != "ring_3"]
    images += [each for each in other.observations.images if each.camera == "ring_3"]
    people = PeopleObservations(H36M, scene.rig.names, tuple(sorted(images, key=lambda each: each.time_s)))
    found = synchronise(people, scene.rig)
    assert found.left_out == ("ring_3",)
    assert found.rig.names == ("ring_0", "ring_1", "ring_2")
    assert "cut the recordings" in found.findings[0].remedy


def walked(*, seed: int, seconds: float, people: int = 1) -> WalkScene:
    studio = find_studio("ring_4")
    motion = walkers(studio.floor_m, seconds, seed, "walks", people, "test")
    network = SimulatedNetwork(real=("openpose",), in_3d=False)
    return film(motion, studio.rig, seed, network, SimulatedClocks(max_start_s=5.0))


def changed(people: PeopleObservations, change: Callable[[Detections], Detections]) -> PeopleObservations:
    images = sorted(map(change, people.images), key=lambda each: each.time_s)
    return PeopleObservations(people.skeleton, people.camera_names, tuple(images))


def mirrored(image: Detections) -> Detections:
    """A picture of cam_2 as front cameras show it: the network takes left for right."""
    if image.camera != "cam_2":
        return image
    mirror, width_px = H36M.mirror, find_studio("ring_4").rig.cameras[1].size_px[0]
    points_px = image.points2d_px[:, mirror] * [-1.0, 1.0] + [width_px - 1.0, 0.0]
    return replace(image, points2d_px=points_px, confidence=image.confidence[:, mirror])


def slow(image: Detections) -> Detections:
    return image.at(image.time_s * 25 / 30) if image.camera == "cam_2" else image


def exchanged(image: Detections) -> Detections:
    return replace(image, camera={"cam_2": "cam_3", "cam_3": "cam_2"}.get(image.camera, image.camera))


def test_where_nothing_is_certain_the_calibration_is_doubted_too() -> None:
    """Of two cameras that are exchanged in it; it was the motion that repeats itself."""
    scene = walked(seed=1, seconds=20.0)
    first, second, *others = scene.rig.cameras
    exchanged_rig = CameraRig((replace(second, name=first.name), replace(first, name=second.name), *others))
    with pytest.raises(ValueError, match=r"ambiguous .* is the calibration of other cameras \(exchanged\?\)"):
        synchronise(scene.observations, exchanged_rig)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (mirrored, "its picture seems to be mirrored"),
        (slow, "its frame rate seems to be 0.833 of what its times say"),
        (exchanged, "its images seem to be those of cam_3"),
    ],
)
def test_why_a_camera_fits_at_no_moment(change: Callable[[Detections], Detections], words: str) -> None:
    """To walk about again would not help."""
    scene = walked(seed=1, seconds=20.0)
    found = synchronise(changed(scene.observations, change), scene.rig)
    finding = next(each for each in found.findings if each.camera == "cam_2")
    assert words in finding.reason
    assert "walk" not in finding.remedy


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [8.0, 0.0])
def test_a_camera_that_was_turned_is_told_from_one_that_filmed_somebody_else(turn_deg: float) -> None:
    scene, other = walked(seed=1, seconds=20.0), walked(seed=51, seconds=20.0)
    people, rig = scene.observations, scene.rig
    if turn_deg:
        turn = gtsam.Pose3(gtsam.Rot3.Pitch(np.deg2rad(turn_deg)), np.zeros(3)).matrix()
        turned = [replace(each, world_T_camera=each.world_T_camera @ turn) for each in rig.cameras[1:2]]
        rig = CameraRig((rig.cameras[0], *turned, *rig.cameras[2:]))
    else:
        images = [each for each in people.images if each.camera != "cam_2"]
        images += [each for each in other.observations.images if each.camera == "cam_2"]
        people = PeopleObservations(H36M, rig.names, tuple(sorted(images, key=lambda each: each.time_s)))
    finding = next(each for each in synchronise(people, rig).findings if each.camera == "cam_2")
    assert ("moved or turned since its calibration" in finding.reason) == bool(turn_deg)
    assert ("walk" in finding.remedy) == (not turn_deg)


# Of the first, by motion alone three cameras show two persons; of the second only all together tell who is who.
@pytest.mark.parametrize("seed", [6, pytest.param(0, marks=pytest.mark.slow)])
def test_cameras_that_see_two_people_follow_the_same(seed: int) -> None:
    scene = walked(seed=seed, seconds=12.0, people=2)
    found = synchronise(scene.observations, scene.rig)
    assert not found.left_out
    errors_s = found.rig.time_offsets_s - (scene.rig.time_offsets_s - scene.rig.time_offsets_s[0])
    # Sigmas are 6 to 12 ms; somebody else at another moment would be seconds off.
    assert (np.abs(errors_s[1:]) < 3 * found.sigma_s[1:]).all()


def test_nobody_who_moves_gives_no_start() -> None:
    scene = filmed("cmu_02_05", 15.0, still=True)
    with pytest.raises(ValueError, match=r"not found when the cameras began: .*ring_0.*hardly moves"):
        synchronise(scene.observations, scene.rig)


def test_cameras_that_differ_are_named() -> None:
    scene = filmed("cmu_02_05", 15.0)
    with pytest.raises(ValueError, match="ring_3"):
        synchronise(scene.observations, scene.rig.subset(("ring_0", "ring_1", "ring_2")))
