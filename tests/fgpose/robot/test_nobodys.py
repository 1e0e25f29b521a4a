"""Somebody near a link whom one camera alone shows is a fault, and not nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import CameraState, LivePerson
from fgpose.live.link_distance import DistanceFault
from fgpose.live.tracking.observed import Volume
from fgpose.people_observations import Detections
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distances import DistanceMonitor
from fgpose.skeleton import Skeleton
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m

NOW_S, STEP_S = 1000.0, 1 / 30
NEAR = Link("near", (Capsule((0.0, 0.0, 0.5), (0.0, 0.0, 1.2), 0.1),), is_fixed=True)
FAR = Link("far", (Capsule((0.0, 3.0, 0.5), (0.0, 3.0, 1.2), 0.1),), is_fixed=True)
CELL = Cell((NEAR, FAR), Limits(min_observed_share=0.01), Volume((-1.0, -1.0, 0.2), (1.0, 4.0, 1.8)))


def shown(rig: CameraRig, camera: str, joints_m: np.ndarray | None, time_s: float) -> Detections:
    """Somebody in an image; None: nobody."""
    if joints_m is None:
        return Detections(camera, time_s, np.zeros((0, 17, 2)), np.zeros((0, 17)))
    points_px = rig[camera].project(joints_m)
    return Detections(camera, time_s, points_px[None], np.full((1, len(points_px)), 0.9))


def faults(
    rig: CameraRig,
    skeleton: Skeleton,
    joints_m: np.ndarray,
    is_shown: list[bool],
    *,
    camera: str = "ring_0",
    state: CameraState = CameraState.OK,
    people: tuple[LivePerson, ...] = (),
) -> list[DistanceFault | None]:
    """Of both links, while images at 30 Hz show somebody, who is nobody's, or nobody."""
    monitor = DistanceMonitor(CELL, rig, skeleton)
    said: list[DistanceFault | None] = [None, None]
    for number, is_there in enumerate(is_shown):
        time_s = NOW_S + number * STEP_S
        frame = live_frame(skeleton, people, time_s, cameras=rig.names)
        cameras = tuple(replace(each, state=state) if each.name == camera else each for each in frame.cameras)
        nobodys = (shown(rig, camera, joints_m if is_there else None, time_s),)
        monitor.publish(replace(frame, cameras=cameras, nobodys=nobodys))
        said = [distance.fault for distance in monitor.measure({}, time_s + 0.02)]
    return said


def test_who_is_shown_by_one_camera_alone_is_a_fault_of_the_links_near_the_rays(
    rig: CameraRig, skeleton: Skeleton
) -> None:
    near, far = faults(rig, skeleton, standing_m(skeleton, (0.6, 0.0)), [True] * 20)
    assert near is not None
    assert near.reason == "ring_0: somebody near it for 0.5 s who is none of the people"
    # Of 0.5 s: fifteen steps after the first, less what rounding leaves of the times.
    assert near.since_s == pytest.approx(NOW_S + 15 * STEP_S + 0.02, abs=1.01 * STEP_S)
    assert far is None


def test_somebody_else_who_is_followed_changes_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    other = live_person(standing_m(skeleton, (-0.8, 0.0)))
    assert faults(rig, skeleton, standing_m(skeleton, (0.6, 0.0)), [True] * 20, people=(other,))[0] is not None


@pytest.mark.parametrize(
    ("is_shown", "is_fault"),
    [
        ([True] + [False] * 19, False),
        ([True] * 10 + [False] * 10, False),
        (([True] + [False] * 14) * 6, False),
        (([True] * 3 + [False] * 6) * 3, True),  # a detector that misses two of three images
    ],
)
def test_a_moment_is_none(rig: CameraRig, skeleton: Skeleton, is_shown: list[bool], is_fault: bool) -> None:
    assert (faults(rig, skeleton, standing_m(skeleton, (0.6, 0.0)), is_shown)[0] is not None) == is_fault


def test_a_camera_that_is_not_ok_tells_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    said = faults(rig, skeleton, standing_m(skeleton, (0.6, 0.0)), [True] * 20, state=CameraState.DOUBTFUL)
    assert said[0] is None


def test_who_is_far_behind_or_before_the_camera_is_not_near(rig: CameraRig, skeleton: Skeleton) -> None:
    """On the rays through the link; the size in the image tells."""
    to_link_m = np.array([0.0, 0.0, 0.9]) - rig["ring_0"].position_m
    middle_m = standing_m(skeleton) - [0.0, 0.0, 0.95]
    for share, is_near in ((0.3, False), (0.9, True), (1.2, True), (5.0, False)):
        at_m = rig["ring_0"].position_m + share * to_link_m
        near = faults(rig, skeleton, middle_m + at_m, [True] * 20)[0]
        assert (near is not None) == is_near, share


@pytest.mark.parametrize("kept", [("left_wrist", "left_elbow"), ("head",), ("left_hip", "left_knee", "left_ankle")])
def test_of_a_few_joints_the_whole_ray_counts(rig: CameraRig, skeleton: Skeleton, kept: tuple[str, ...]) -> None:
    joints_m = np.full((skeleton.n_joints, 3), np.nan)
    for joint in kept:
        joints_m[skeleton.index(joint)] = standing_m(skeleton, (0.6, 0.0))[skeleton.index(joint)]
    assert faults(rig, skeleton, joints_m, [True] * 20)[0] is not None


@pytest.mark.parametrize("camera", ["ring_0", "ring_1", "ring_2", "ring_3"])
def test_whoever_bends_in_whatever_way_is_near(rig: CameraRig, skeleton: Skeleton, camera: str) -> None:
    """A body that is turned about its middle at random, of a child or a tall man, two joints of which are wrong."""
    random = np.random.default_rng(3)
    middle_m = standing_m(skeleton) - [0.0, 0.0, 0.95]
    for size in (0.7, 1.2):
        for _ in range(8):
            turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
            joints_m = size * middle_m @ turn + [0.3, 0.0, 0.9]
            joints_m[random.integers(skeleton.n_joints, size=2)] += random.normal(scale=0.3, size=3)
            assert faults(rig, skeleton, joints_m, [True] * 20, camera=camera)[0] is not None
