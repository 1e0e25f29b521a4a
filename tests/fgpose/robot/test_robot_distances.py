"""Distances of people from links: known ones, closing speeds, and faults that stay until they are reset."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.live.frame import CameraState, LiveFrame, LivePerson
from fgpose.live.link_distance import LinkDistance
from fgpose.live.tracking.observed import Volume
from fgpose.robot.body import RADIUS_M, Body
from fgpose.robot.cell import Capsule, Cell, Limits, Link
from fgpose.robot.distances import DistanceMonitor
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from tests.fgpose.live.live_frames import live_frame, live_person, standing_m

NOW_S = 1000.0
POST = Link("post", (Capsule((0.0, 0.0, 0.5), (0.0, 0.0, 1.2), 0.1),), is_fixed=True)
ARM = Link("arm", (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), 0.05),))
CELL = Cell((POST, ARM), volume=Volume((-1.0, -1.0, 0.2), (1.0, 1.0, 1.8)))


def pose(x_m: float, y_m: float, z_m: float) -> np.ndarray:
    world_T_link = np.eye(4)
    world_T_link[:3, 3] = x_m, y_m, z_m
    return world_T_link


POSES = {"arm": pose(0.0, 0.8, 0.8)}


class Monitor(DistanceMonitor):
    """With the cameras of the rig in every frame, and results by link."""

    def __init__(self, rig: CameraRig, skeleton: Skeleton, cell: Cell = CELL) -> None:
        super().__init__(cell, rig, skeleton)
        self.skeleton, self.cameras = skeleton, rig.names

    def frame(self, *people: LivePerson, time_s: float = NOW_S, lost: tuple[str, ...] = ()) -> LiveFrame:
        return live_frame(self.skeleton, people, time_s, cameras=self.cameras, lost=lost)

    def seen(
        self, *people: LivePerson, age_s: float = 0.0, time_s: float = NOW_S, lost: tuple[str, ...] = ()
    ) -> dict[str, LinkDistance]:
        self.publish(self.frame(*people, time_s=time_s, lost=lost))
        return self.links(time_s + age_s)

    def links(self, now_s: float = NOW_S, poses: dict[str, np.ndarray] = POSES) -> dict[str, LinkDistance]:
        return {distance.link: distance for distance in self.measure(poses, now_s)}


@pytest.fixture
def monitor(rig: CameraRig, skeleton: Skeleton) -> Monitor:
    return Monitor(rig, skeleton)


def test_the_nearest_part_of_the_body_is_named(monitor: Monitor, skeleton: Skeleton) -> None:
    joints_m = standing_m(skeleton, (1.5, 0.0))
    joints_m[skeleton.index("left_wrist")] = 0.7, 0.0, 1.0
    joints_m[skeleton.index("left_elbow")] = 1.0, 0.0, 1.0
    post = monitor.seen(live_person(standing_m(skeleton, (5.0, 5.0)), 4), live_person(joints_m, 7))["post"]
    # Exact: 0.7 m from the axis of the post, less both radii.
    assert post.distance_m == pytest.approx(0.7 - 0.1 - RADIUS_M["hand"], abs=1e-9)
    assert (post.person, post.part, post.joint) == (7, "left hand", "left_wrist")
    assert post.fault is None
    assert post.observed_share == 1.0


def test_overlap_is_negative(monitor: Monitor, skeleton: Skeleton) -> None:
    post = monitor.seen(live_person(standing_m(skeleton)))["post"]
    # The axis of the trunk is that of the post.
    assert post.distance_m == pytest.approx(-0.1 - RADIUS_M["trunk"], abs=1e-6)


def test_people_walk_and_reach_in_the_age_of_the_data(monitor: Monitor, skeleton: Skeleton) -> None:
    standing = live_person(standing_m(skeleton, (1.5, 0.0)))
    fresh, old = monitor.seen(standing)["post"], monitor.seen(standing, age_s=0.25)["post"]
    assert (fresh.part, old.part) == ("left hand", "left hand")
    assert fresh.distance_m - old.distance_m == pytest.approx(2.0 * 0.25)
    assert old.expected_m == pytest.approx(fresh.expected_m)
    assert old.age_s == pytest.approx(0.25)


def test_legs_move_with_the_speed_of_walking(rig: CameraRig, skeleton: Skeleton) -> None:
    sill = Link("sill", (Capsule((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1),), is_fixed=True)
    monitor = Monitor(rig, skeleton, Cell((sill,), Limits(min_observed_share=0.5)))
    standing = live_person(standing_m(skeleton, (0.0, 1.0)))
    fresh, old = monitor.seen(standing)["sill"], monitor.seen(standing, age_s=0.25)["sill"]
    assert (fresh.joint, old.joint) == ("left_ankle", "left_ankle")
    assert fresh.distance_m - old.distance_m == pytest.approx(1.6 * 0.25)


def test_a_quantile_of_the_uncertainty_is_allowed_for(monitor: Monitor, skeleton: Skeleton) -> None:
    joints_m = standing_m(skeleton, (1.5, 0.0))
    certain, uncertain = (monitor.seen(live_person(joints_m, sigma_m=sigma_m))["post"] for sigma_m in (0.0, 0.05))
    # The hand is a sphere: 2.326 sigma at 99 %. The trunk behind it, with 2.576 sigma, stays farther away.
    assert certain.distance_m - uncertain.distance_m == pytest.approx(2.326 * 0.05, abs=1e-4)
    assert uncertain.expected_m == pytest.approx(certain.expected_m)


def test_links_move_with_their_poses(monitor: Monitor, skeleton: Skeleton) -> None:
    monitor.seen(live_person(standing_m(skeleton, (1.5, 0.8))))
    near, far = (monitor.links(poses={"arm": pose(x_m, 0.8, 0.85)})["arm"] for x_m in (0.5, 0.2))
    assert near.distance_m == pytest.approx(0.75 - 0.05 - RADIUS_M["hand"], abs=1e-9)
    assert far.distance_m - near.distance_m == pytest.approx(0.3, abs=1e-9)


def test_nobody_is_infinitely_far(monitor: Monitor) -> None:
    post = monitor.seen()["post"]
    assert (post.distance_m, post.person, post.fault) == (math.inf, None, None)


def walk(monitor: Monitor, skeleton: Skeleton, numbers: list[int]) -> list[float]:
    """Closing speeds of somebody who walks to the post with 1.2 m/s and is called by these numbers."""
    found = []
    for image, number in enumerate(numbers):
        time_s = NOW_S + image / 30
        joints_m = standing_m(skeleton, (3.0 - 1.2 * image / 30, 0.0))
        found.append(monitor.seen(live_person(joints_m, number), time_s=time_s)["post"].closing_m_s)
    return found


def test_the_closing_speed_does_not_depend_on_numbers(monitor: Monitor, skeleton: Skeleton) -> None:
    speeds_m_s = walk(monitor, skeleton, [1, 1, 1, 1, 1, 9, 9, 3, 3, 3])
    assert all(math.isnan(speed) for speed in speeds_m_s[:3])
    # Straight towards the post, with exact poses.
    np.testing.assert_allclose(speeds_m_s[3:], 1.2, atol=1e-6)


def test_two_people_who_exchange_numbers_do_not_jump(monitor: Monitor, skeleton: Skeleton) -> None:
    found = []
    for image in range(8):
        numbers = (1, 2) if image < 6 else (2, 1)
        walking = live_person(standing_m(skeleton, (2.0 - 0.03 * image, 0.0)), numbers[0])
        away = live_person(standing_m(skeleton, (-4.0 - 0.03 * image, 0.0)), numbers[1])
        found.append(monitor.seen(walking, away, time_s=NOW_S + image / 30)["post"])
    assert found[-1].person == 2
    assert found[-1].closing_m_s == pytest.approx(0.9, abs=1e-6)


def test_somebody_new_has_no_closing_speed(monitor: Monitor, skeleton: Skeleton) -> None:
    walk(monitor, skeleton, [1] * 10)
    new = live_person(standing_m(skeleton, (-1.0, 0.0)), 2)
    assert math.isnan(monitor.seen(new, time_s=NOW_S + 10 / 30)["post"].closing_m_s)


def test_a_link_that_approaches_closes_in(monitor: Monitor, skeleton: Skeleton) -> None:
    standing = live_person(standing_m(skeleton, (1.5, 0.8)))
    found = []
    for image in range(8):
        monitor.publish(monitor.frame(standing, time_s=NOW_S + image / 30))
        found.append(monitor.links(NOW_S + image / 30, {"arm": pose(0.01 * image, 0.8, 0.85)})["arm"])
    assert found[-1].closing_m_s == pytest.approx(0.3, abs=1e-6)


def test_another_frame_of_the_same_time_takes_the_place_of_the_first(monitor: Monitor, skeleton: Skeleton) -> None:
    """A tracker that has failed knows nobody, at the time of its newest image; then it has found two."""
    one, two = (live_person(standing_m(skeleton, (x_m, 0.0)), number) for number, x_m in ((1, 2.0), (2, 1.0)))
    monitor.seen(one)
    assert monitor.seen()["post"].person is None
    found = monitor.seen(one, two)["post"]
    assert found.person == 2
    assert math.isnan(found.closing_m_s)


def test_no_frame_is_a_fault_until_reset(monitor: Monitor) -> None:
    first = monitor.links()["post"]
    assert first.distance_m == -math.inf
    assert first.fault is not None
    assert first.fault.reason == "no image has come yet"
    assert monitor.seen(time_s=NOW_S + 1)["post"].fault == first.fault
    monitor.reset()
    assert monitor.links(NOW_S + 1)["post"].fault is None


def test_no_image_is_a_fault_too(monitor: Monitor) -> None:
    monitor.reset()
    monitor.publish(monitor.frame(time_s=np.nan))
    distance = monitor.links()["post"]
    assert distance.distance_m == -math.inf
    assert distance.fault is not None
    assert distance.fault.reason == "no image has come yet"


def test_silence_is_a_fault_that_stays(monitor: Monitor, skeleton: Skeleton) -> None:
    standing = live_person(standing_m(skeleton, (1.5, 0.0)))
    assert monitor.seen(standing, age_s=0.49)["post"].fault is None
    late = monitor.links(NOW_S + 0.7)["post"]
    assert late.fault is not None
    assert late.fault.reason == "the data are 0.70 s old"
    assert late.fault.since_s == NOW_S + 0.7
    # The distance goes on shrinking, and the first reason stays when the data are fresh again.
    assert monitor.links(NOW_S + 1.7)["post"].distance_m == pytest.approx(late.distance_m - 2.0)
    assert monitor.seen(standing, time_s=NOW_S + 2)["post"].fault == late.fault
    monitor.reset()
    assert monitor.links(NOW_S + 2)["post"].fault is None
    # Its cause being there, it is there at once.
    assert monitor.links(NOW_S + 3)["post"].fault is not None


def test_data_from_the_future_are_a_fault(monitor: Monitor, skeleton: Skeleton) -> None:
    ahead = monitor.seen(live_person(standing_m(skeleton, (1.5, 0.0))), age_s=-0.3)["post"]
    assert ahead.fault is not None
    assert "0.30 s ahead" in ahead.fault.reason
    assert ahead.distance_m < ahead.expected_m + 1e-9


def test_lost_cameras_are_a_fault_of_what_they_leave_unobserved(monitor: Monitor) -> None:
    two_left = monitor.seen(lost=("ring_0", "ring_1"))
    assert two_left["post"].fault is None
    one_left = monitor.seen(lost=("ring_0", "ring_1", "ring_3"))["post"]
    assert one_left.observed_share == 0.0
    assert one_left.fault is not None
    assert one_left.fault.reason == (
        "two cameras observe only 0% of its surroundings (ring_0 lost, ring_1 lost, ring_3 lost)"
    )
    assert monitor.seen()["post"].fault == one_left.fault


def test_who_came_while_cameras_were_lost_is_not_found_at_once(monitor: Monitor) -> None:
    lost = ("ring_0", "ring_1", "ring_3")
    monitor.seen()
    monitor.seen(time_s=NOW_S + 1, lost=lost)
    monitor.reset()
    back = monitor.seen(time_s=NOW_S + 2)["post"].fault
    assert back is not None
    assert "(ring_0 ok again, ring_1 ok again, ring_3 ok again)" in back.reason
    for after_s, is_fault in ((2.9, True), (3.1, False)):
        monitor.reset()
        assert (monitor.seen(time_s=NOW_S + after_s)["post"].fault is not None) == is_fault


@pytest.mark.parametrize("state", [state for state in CameraState if state is not CameraState.OK])
def test_only_cameras_that_are_ok_observe(monitor: Monitor, state: CameraState) -> None:
    frame = monitor.frame()
    cameras = tuple(replace(camera, state=state) for camera in frame.cameras[1:])
    monitor.publish(replace(frame, cameras=(frame.cameras[0], *cameras)))
    fault = monitor.links()["post"].fault
    assert fault is not None
    assert f"ring_1 {state.value}" in fault.reason


def test_a_missing_joint_nearby_is_a_fault(monitor: Monitor, skeleton: Skeleton) -> None:
    joints_m = standing_m(skeleton, (1.0, 0.0))
    joints_m[skeleton.index("left_wrist")] = np.nan
    assert monitor.seen(live_person(joints_m + 9.0))["post"].fault is None
    post = monitor.seen(live_person(joints_m, 3))["post"]
    assert post.fault is not None
    assert post.fault.reason == "person 3 has no estimate of left_wrist"
    assert math.isfinite(post.distance_m)


def test_a_joint_that_no_capsule_needs_may_be_missing(monitor: Monitor, skeleton: Skeleton) -> None:
    joints_m = standing_m(skeleton, (1.0, 0.0))
    joints_m[skeleton.index("thorax")] = np.nan
    assert monitor.seen(live_person(joints_m))["post"].fault is None


def test_somebody_without_any_joint_may_be_anywhere(monitor: Monitor, skeleton: Skeleton) -> None:
    nowhere = live_person(np.full((skeleton.n_joints, 3), np.nan))
    post = monitor.seen(live_person(standing_m(skeleton, (3.0, 0.0))), nowhere)["post"]
    assert post.distance_m == -math.inf
    assert post.fault is not None


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({}, "it has no pose"),
        ({"arm": np.full((4, 4), np.nan)}, "its pose is not a rigid transform"),
        ({"arm": np.eye(3)}, "its pose is not a rigid transform"),
        ({"arm": 2 * np.eye(4)}, "its pose is not a rigid transform"),
    ],
)
def test_a_link_without_a_usable_pose_has_a_fault(
    monitor: Monitor, skeleton: Skeleton, wrong: dict[str, np.ndarray], reason: str
) -> None:
    monitor.publish(monitor.frame(live_person(standing_m(skeleton, (3.0, 0.0)))))
    links = monitor.links(poses=wrong)
    assert links["arm"].distance_m == -math.inf
    assert links["arm"].fault is not None
    assert links["arm"].fault.reason == reason
    assert links["post"].fault is None


def test_a_link_outside_the_volume_is_not_observed(monitor: Monitor) -> None:
    monitor.publish(monitor.frame())
    assert monitor.links(poses={"arm": pose(0.0, 20.0, 1.0)})["arm"].fault is not None


def test_a_zone_that_the_rig_does_not_observe_is_refused(rig: CameraRig, skeleton: Skeleton) -> None:
    far = replace(POST, capsules=(Capsule((30.0, 0.0, 0.0), (30.0, 0.0, 1.0), 0.1),))
    with pytest.raises(
        ValueError, match=r"zones.post: with all cameras ok, two of them observe 0% of its surroundings"
    ):
        DistanceMonitor(Cell((far,)), rig, skeleton)


def test_without_a_volume_what_the_rig_observes_counts(rig: CameraRig, skeleton: Skeleton) -> None:
    monitor = Monitor(rig, skeleton, Cell((POST,), Limits(surroundings_m=3.0)))
    assert monitor.seen()["post"].observed_share == 1.0
    assert 0.0 < monitor.seen(lost=("ring_0",))["post"].observed_share < 1.0


def test_a_skeleton_needs_the_joints_of_a_body(rig: CameraRig) -> None:
    stick = Skeleton("stick", ("pelvis", "head"), ((0, 1),), (0,))
    with pytest.raises(ValueError, match="skeleton stick has no joint 'left_shoulder'"):
        DistanceMonitor(CELL, rig, stick)
    with pytest.raises(ValueError, match="no part of the body is called tail; known: trunk"):
        Body.of(stick, {"tail": 0.1})


def test_a_body_has_no_gap(skeleton: Skeleton) -> None:
    body = Body.of(skeleton)
    ends_m = body.ends_m(standing_m(skeleton))
    # Every joint, and points across the chest and the belly, lie within a capsule.
    inside_m = np.concatenate(
        [standing_m(skeleton), [[x, 0.0, z] for x in np.linspace(-0.2, 0.2, 9) for z in (1.0, 1.2, 1.4)]]
    )
    step_m = ends_m[:, 1] - ends_m[:, 0]
    length2_m2 = np.maximum(np.sum(step_m**2, axis=-1), 1e-12)
    along = np.clip(np.sum((inside_m[:, None] - ends_m[:, 0]) * step_m, axis=-1) / length2_m2, 0.0, 1.0)
    distance_m = np.linalg.norm(inside_m[:, None] - ends_m[:, 0] - along[..., None] * step_m, axis=-1)
    assert (distance_m <= body.radius_m).any(axis=1).all()


def test_the_program_of_the_documentation(
    rig: CameraRig, skeleton: Skeleton, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a cell of that page; without a frame there is a fault."""
    page = (Path(__file__).parents[3] / "docs" / "live_distances.md").read_text(encoding="utf-8")
    program, cell = (page.partition(f"```{kind}\n")[2].partition("```")[0] for kind in ("python", "toml"))
    (tmp_path / "cell.toml").write_text(cell, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    slowed: list[bool] = []
    given = {"rig": rig, "skeleton": skeleton, "time": time, "world_T_forearm": np.eye(4)}
    exec(program, given | {"slow_down": lambda: slowed.append(True)})
    assert slowed == [True, True]


def test_an_arm_that_no_two_cameras_see_may_have_reached(monitor: Monitor, skeleton: Skeleton) -> None:
    person = live_person(standing_m(skeleton, (1.5, 0.0)))
    before = monitor.seen(person)["post"]
    status = person.status.copy()
    status[[skeleton.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]] = (
        Status.PREDICTED
    )
    after = monitor.seen(replace(person, status=status), time_s=NOW_S + 0.5)["post"]
    assert after.expected_m == pytest.approx(before.expected_m)
    assert after.fault is None
    # At 2 m/s for half a second, the nearest hand; with the other parts of the body it was nearer already.
    assert before.distance_m - 1.0 <= after.distance_m < before.distance_m - 0.5
    assert "hand" in after.part or "lower arm" in after.part
