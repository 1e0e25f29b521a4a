"""People who sit: bones as long as before, feet on the floor, hips on the seat, and each on a seat of their own."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import CrowdMotion, CrowdPlan, Furniture, Seat, crowd_motion, motion_from_npz
from fgpose_benchmarks.synthetic.body_motion import ANKLE_M, Poses, above_legs, gait_of, positions_of, work_of
from fgpose_benchmarks.synthetic.crowd.sitting import seated
from fgpose_benchmarks.synthetic.snapping import stretches
from tests.conftest import MOCAP

FPS = 25.0
SEATS = tuple(Seat((x_m, 1.6), -np.pi / 2) for x_m in (-2.1, -1.4, -0.7))
HIPS_M = SEATS[0].hips_m


@pytest.fixture(scope="module")
def motion() -> CrowdMotion:
    """Four people for 16 s: one goes out and comes back, the others sit down."""
    gait, work = (motion_from_npz(MOCAP / f"{clip}.npz") for clip in ("cmu_02_01_short", "cmu_02_05"))
    plan = CrowdPlan(returning_share=0.25)
    return crowd_motion(4, 400, FPS, [gait], [work], 3, plan, (Furniture((0.1, -0.5, 0.0), (1.3, 0.3, 0.75)),), SEATS)


@pytest.fixture(scope="module")
def clip() -> np.ndarray:
    """Every tenth frame of somebody who punches, bent knees and turned hips and all."""
    return motion_from_npz(MOCAP / "cmu_02_05.npz")[0][::10]


def sat(clip_m: np.ndarray, skeleton: Skeleton, share: float) -> tuple[Poses, Poses, np.ndarray]:
    """The poses of the clip, the same bent, and the joints of the bent ones."""
    poses = work_of((clip_m, FPS), skeleton).poses
    lengths_m = skeleton.bone_lengths(clip_m)[0]
    bent = seated(poses, np.full(len(clip_m), share), HIPS_M, lengths_m, skeleton)
    n = len(clip_m)
    return poses, bent, positions_of(bent, lengths_m, np.zeros((n, 2)), np.zeros(n), skeleton)


def of_both(positions_m: np.ndarray, joint: str, skeleton: Skeleton) -> np.ndarray:
    return positions_m[..., [skeleton.index(f"{side}_{joint}") for side in ("left", "right")], :]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_bones_are_as_long_as_in_the_clip(clip: np.ndarray, skeleton: Skeleton, share: float) -> None:
    # The clip is stored in single precision: 1e-7 of a bone of 0.5 m.
    expected_m = np.broadcast_to(skeleton.bone_lengths(clip)[0], (len(clip), len(skeleton.bones)))
    np.testing.assert_allclose(skeleton.bone_lengths(sat(clip, skeleton, share)[2]), expected_m, atol=1e-7)


def test_who_sits_has_the_feet_on_the_floor_and_the_hips_at_the_height_of_the_seat(
    clip: np.ndarray, skeleton: Skeleton
) -> None:
    poses, bent, positions_m = sat(clip, skeleton, 1.0)
    ankles_m, knees_m, hips_m = (of_both(positions_m, joint, skeleton) for joint in ("ankle", "knee", "hip"))
    # Sums of a few bones, in floating point.
    np.testing.assert_allclose(ankles_m[..., 2], ANKLE_M, atol=1e-12)
    np.testing.assert_allclose(ankles_m.mean(axis=1)[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(hips_m[..., 2], HIPS_M, atol=1e-12)
    np.testing.assert_allclose(knees_m[..., :2], ankles_m[..., :2], atol=1e-12)
    assert (hips_m[..., 0] < -0.3).all(), "behind the feet"
    thigh = (knees_m - hips_m) / np.linalg.norm(knees_m - hips_m, axis=-1, keepdims=True)
    # Shanks of 0.38 to 0.48 m on a seat of 0.44 m: the thighs are level within 15 degrees.
    assert np.abs(np.degrees(np.arcsin(thigh[..., 2]))).max() < 15
    upper = above_legs(skeleton)[:, 0] > 0
    np.testing.assert_allclose(bent.direction[:, upper], poses.direction[:, upper], atol=1e-12)


def test_who_stands_is_left_as_he_is(clip: np.ndarray, skeleton: Skeleton) -> None:
    poses, bent, _ = sat(clip, skeleton, 0.0)
    np.testing.assert_allclose(bent.direction, poses.direction, atol=1e-12)
    np.testing.assert_allclose(bent.root, poses.root, atol=1e-12)


def test_feet_stay_on_the_floor_on_the_way(clip: np.ndarray, skeleton: Skeleton) -> None:
    standing = gait_of(motion_from_npz(MOCAP / "cmu_02_01_short.npz"), skeleton).standing
    poses = Poses(np.repeat(standing.direction, 41, axis=0), np.repeat(standing.root, 41, axis=0))
    lengths_m, still = skeleton.bone_lengths(clip)[0], np.zeros((41, 2))
    bent = seated(poses, np.linspace(0, 1, 41), HIPS_M, lengths_m, skeleton)
    ankles_m = of_both(positions_of(bent, lengths_m, still, still[:, 0], skeleton), "ankle", skeleton)
    # The feet of the mean of a walk are not quite below the body, and 2 cm higher or lower than those of who stands.
    assert np.abs(ankles_m[..., 2] - ANKLE_M).max() < 0.04
    assert np.abs(np.diff(ankles_m.mean(axis=1), axis=0)).max() < 0.002


def test_neighbours_sit_beside_one_another_for_seconds_and_get_up(motion: CrowdMotion) -> None:
    pelvis_m = motion.truth_m[:, :, motion.skeleton.index("pelvis")]
    on_seat = np.array([np.linalg.norm(pelvis_m[..., :2] - seat.middle_m, axis=-1) < 0.15 for seat in SEATS])
    on_seat &= pelvis_m[..., 2] < HIPS_M + 0.02
    longest_s = [[max((b - a for a, b in stretches(each)), default=0) / FPS for each in seat] for seat in on_seat]
    owners = np.argmax(longest_s, axis=1)
    assert len(set(owners.tolist())) == 3, "to each their own"
    # Who comes late stays for the shortest time, 6.5 s with sitting down and getting up.
    assert np.max(longest_s, axis=1).min() > 2.5
    assert np.sum(np.array(longest_s) > 0) == 3
    together = on_seat.any(axis=1).sum(axis=0) == 3
    assert together.sum() / FPS > 1
    places_m = np.sort(pelvis_m[owners][:, together, 0], axis=0)
    gaps_m = np.diff(places_m, axis=0)
    assert ((gaps_m > 0.6) & (gaps_m < 0.8)).all()
    kinds = {(event.kind, event.people[0]) for event in motion.events if event.kind in ("sits", "rises")}
    assert kinds == {(kind, person) for kind in ("sits", "rises") for person in owners.tolist()}
    for person in owners.tolist():
        (rises,) = (e.frame for e in motion.events if e.kind == "rises" and e.people == (person,))
        assert pelvis_m[person, rises, 2] > 0.75, "stands"
        assert np.isnan(pelvis_m[person, -1, 2]) or pelvis_m[person, -1, 2] > 0.75
    assert motion.furniture[1:] == tuple(seat.box for seat in SEATS)


def test_sitting_down_is_smooth(motion: CrowdMotion) -> None:
    pelvis_m = motion.truth_m[:, :, motion.skeleton.index("pelvis")]
    begin, end = (
        {event.people[0]: event.frame for event in motion.events if event.kind == kind} for kind in ("sits", "rises")
    )
    for person in begin:
        sits = slice(begin[person] + 5, end[person] - 5)
        velocity_mps = np.diff(pelvis_m[person, sits], axis=0) * FPS
        assert 0.3 < np.linalg.norm(velocity_mps, axis=-1).max() < 1.2
        # 0.6 m in about 1.3 s; the recorded walk has 6 m/s^2 at the pelvis.
        assert np.linalg.norm(np.diff(velocity_mps, axis=0), axis=-1).max() * FPS < 6


def test_nobody_is_in_the_seat_of_somebody_else(motion: CrowdMotion) -> None:
    ends_m = motion.truth_m[:, :, np.array(motion.skeleton.bones)]
    along = np.linspace(0.0, 1.0, 20)[:, None, None]
    points_m = ends_m[:, :, :, :1] + along[:, 0] * (ends_m[:, :, :, 1:] - ends_m[:, :, :, :1])
    pelvis_m = motion.truth_m[:, :, motion.skeleton.index("pelvis"), :2]
    for seat in SEATS:
        owner = int(np.nanargmin(np.nanmin(np.linalg.norm(pelvis_m - seat.middle_m, axis=-1), axis=1)))
        # Half the breadth of a leg around the seat.
        low_m, high_m = np.array(seat.box.low_m) - 0.05, np.array(seat.box.high_m) + 0.05
        inside = np.all((points_m > low_m) & (points_m < high_m), axis=-1).any(axis=(1, 2, 3))
        assert not np.delete(inside, owner).any()


def test_a_seat_is_a_box_behind_the_feet() -> None:
    seat = Seat((1.0, 2.0), np.pi / 2, 0.5)
    np.testing.assert_allclose(seat.middle_m, (1.0, 1.6))
    np.testing.assert_allclose(seat.box.low_m, (0.8, 1.4, 0.0))
    np.testing.assert_allclose(seat.box.high_m, (1.2, 1.8, 0.5))


def test_legs_that_do_not_fit_are_refused(clip: np.ndarray, skeleton: Skeleton) -> None:
    poses = work_of((clip, FPS), skeleton).poses
    with pytest.raises(ValueError, match=r"hips at 1\.20 m are too high or too low for thighs of 0\.\d\d m"):
        seated(poses, np.ones(len(clip)), 1.2, skeleton.bone_lengths(clip)[0], skeleton)
