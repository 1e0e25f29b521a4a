"""What changes in time, found in recordings in which it is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import gtsam
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.find_changes import find_changes
from fgpose.calibration.changes.lenses import Lens
from fgpose.diagnosis.changes.other_lenses import other_lenses
from fgpose.geometry.intrinsics import stretched
from fgpose_benchmarks.calibration.real import webcam
from tests.fgpose.calibration.changes.changing import (
    FPS,
    RIG,
    bumped,
    exchanged,
    filmed,
    late,
    left_out,
    lost,
    moved_rig,
    slower,
    walk_m,
)
from tests.wrong_rigs import turned

FOUR, THREE, TWO = RIG.names, RIG.names[:3], RIG.names[1:3]
# Two cameras are the hardest to tell apart, and the fewest to compute; three are the fewest of which one is named.
OF_TWO_OR_FOUR = pytest.mark.parametrize("names", [pytest.param(FOUR, marks=pytest.mark.slow), TWO])
TURN = 420  # 14 s of 24


def changes(seen: fgpose.Observations, names: tuple[str, ...], rig: fgpose.CameraRig = RIG) -> tuple[Change, ...]:
    return find_changes([seen.subset(names)], rig.subset(names)).changes


@pytest.mark.parametrize("names", [FOUR, TWO])
def test_nothing_changes(names: tuple[str, ...]) -> None:
    assert changes(filmed(walk_m(3)), names) == ()


def test_it_says_how_far_it_is_and_that_what_is_found_takes_more() -> None:
    told: list[tuple[int, int]] = []
    seen = lost(filmed(walk_m(3)), 2, TURN, 6)
    find_changes([seen.subset(THREE)], RIG.subset(THREE), lambda done, total: told.append((done, total)))
    done, totals = zip(*told, strict=True)
    assert list(done) == sorted(done)
    assert all(each <= total for each, total in told)
    assert len(set(totals)) == 2  # nothing is found beside the one change


@pytest.mark.parametrize(
    "names", [pytest.param(FOUR, marks=pytest.mark.slow), THREE, pytest.param(TWO, marks=pytest.mark.slow)]
)
def test_lost_frames(names: tuple[str, ...]) -> None:
    (found,) = changes(lost(filmed(walk_m(3)), 2, TURN, 6), names)
    assert found.kind is Kind.JUMP
    assert names[found.camera] == "ring_2"
    # They are whole ones; a second is what is promised.
    assert found.offset_s == pytest.approx(6 / FPS)
    assert found.at_s == pytest.approx(TURN / FPS, abs=1.0)


@pytest.mark.parametrize("names", [pytest.param(THREE, marks=pytest.mark.slow), TWO])
def test_nothing_tells_when_frames_were_lost_while_nobody_moves(names: tuple[str, ...]) -> None:
    truth_m = walk_m(3).copy()
    truth_m[TURN - 60 : TURN + 60] = truth_m[TURN - 60]
    truth_m[TURN + 60 :] += truth_m[TURN + 59] - truth_m[TURN + 60]
    (found,) = changes(lost(filmed(truth_m), 2, TURN, 6), names)
    assert found.between_s is not None
    begin_s, end_s = found.between_s
    # Four seconds of standing still, and blocks of one second.
    assert begin_s <= TURN / FPS <= end_s
    assert 2.0 <= end_s - begin_s <= 8.0
    (walking,) = changes(lost(filmed(walk_m(3)), 2, TURN, 6), names)
    assert walking.between_s is not None
    assert walking.between_s[0] <= TURN / FPS <= walking.between_s[1] <= walking.between_s[0] + 4.0


@pytest.mark.parametrize("frames", [4.0, pytest.param(4.7, marks=pytest.mark.slow), 5.5])
def test_a_clock_that_jumps_by_any_number_of_frames_is_within_what_is_stated(frames: float) -> None:
    """Lost images are whole ones; a camera that connects again is late by anything."""
    truth_m, at = walk_m(3), TURN
    later_m = CubicSpline(np.arange(len(truth_m)), truth_m)(np.arange(len(truth_m)) + frames)
    (found,) = changes(exchanged(filmed(truth_m), 2, filmed(later_m), slice(at, -6)), THREE)
    assert (found.kind, THREE[found.camera]) == (Kind.JUMP, "ring_2")
    assert abs(found.offset_s - frames / FPS) < 2 * found.sigma
    # Half an image, where a whole number stands for another one.
    assert found.sigma < 0.5 / FPS


@pytest.mark.slow
def test_a_sigma_is_no_less_than_lags_are_told_apart_by() -> None:
    """Exact detections are the hardest: costs bend within less than the step of the images."""
    truth_m, errors = walk_m(3, 12.0), []
    for frames in (3.1, 3.4, 3.6, 3.9):
        later_m = CubicSpline(np.arange(len(truth_m)), truth_m)(np.arange(len(truth_m)) + frames)
        points2d_px = RIG.project(truth_m)
        points2d_px[:, 1] = RIG.project(later_m)[:, 1]
        seen = replace(filmed(truth_m), points2d_px=points2d_px, confidence=np.ones(points2d_px.shape[:-1]))
        (found,) = changes(seen, FOUR)
        errors.append((found.offset_s - frames / FPS) / found.sigma)
    assert np.abs(errors).max() < 2


@pytest.mark.slow
def test_frames_lost_twice() -> None:
    twice = changes(lost(lost(filmed(walk_m(3)), 2, 480, 3), 2, 240, 4), FOUR)
    assert [(each.kind, each.camera) for each in twice] == [(Kind.JUMP, 2)] * 2
    assert [round(each.offset_s * FPS) for each in twice] == [4, 3]
    assert [each.at_s for each in twice] == pytest.approx([8.0, 16.0], abs=1.0)


@pytest.mark.parametrize("names", [THREE, pytest.param(TWO, marks=pytest.mark.slow)])
def test_a_file_numbered_from_one(names: tuple[str, ...]) -> None:
    (found,) = changes(late(filmed(walk_m(11)), 2, 1), names)
    assert found.kind is Kind.OFFSET
    # Of two cameras it cannot be told which began later. 0.12 and 0.31 frames beside it were measured.
    sign = -1 if names[found.camera] == "ring_2" else 1
    assert found.offset_s == pytest.approx(sign / FPS, abs=0.4 / FPS if names == TWO else 0.2 / FPS)
    if names == THREE:
        assert found.camera == 2


@pytest.mark.parametrize("names", [pytest.param(THREE, marks=pytest.mark.slow), TWO])
def test_another_rate(names: tuple[str, ...]) -> None:
    truth_m = walk_m(3)
    (found,) = changes(slower(filmed(truth_m), 2, 1.01, truth_m), names)
    assert found.kind is Kind.RATE
    # Half a frame at the end of 24 s.
    sign = 1 if names[found.camera] == "ring_2" else -1
    assert found.rate == pytest.approx(sign * 0.01, abs=7e-4)


@pytest.mark.slow  # One of three cameras that is bumped by two degrees: test_changed_rig.
@pytest.mark.parametrize("degrees", [0.7, 2.0])
@pytest.mark.parametrize("names", [FOUR, THREE])
def test_a_bumped_camera(degrees: float, names: tuple[str, ...]) -> None:
    truth_m = walk_m(3)
    (found,) = changes(bumped(filmed(truth_m), 1, degrees, TURN, truth_m), names)
    assert (found.kind, names[found.camera]) == (Kind.BUMP, "ring_1")
    assert found.at_s == pytest.approx(TURN / FPS, abs=1.0)
    # Turns and shifts of a camera 5 m away are nearly the same: 22 mm are 0.25 degrees.
    assert found.rotation_deg == pytest.approx(degrees, abs=0.4)
    turn, shift_m = _move_of(moved_rig(1, degrees), 1)
    # Before anything is seen the sigmas are 2 degrees and 5 cm about and along each axis.
    assert np.linalg.norm(found.rotation - turn) < 2 * found.sigma < np.deg2rad(2.0)
    assert np.linalg.norm(found.translation_m - shift_m) < 2 * found.translation_sigma_m < 2 * np.sqrt(3) * 0.05


def _move_of(rig: fgpose.CameraRig, c: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector, radians, and shift, in the frame of the camera as it was."""
    move = np.linalg.inv(RIG.cameras[c].world_T_camera) @ rig.cameras[c].world_T_camera
    return gtsam.Rot3.Logmap(gtsam.Rot3(move[:3, :3])), move[:3, 3]


@pytest.mark.slow
def test_a_camera_that_was_moved_before() -> None:
    (found,) = changes(filmed(walk_m(3)), THREE, moved_rig(2, 1.0))
    assert (found.kind, found.camera) == (Kind.MOVED, 2)


def zoomed_rig(cameras: tuple[int, ...]) -> fgpose.CameraRig:
    """Whose calibration was made with a lens that was 1.25 times as long."""
    own = list(RIG.cameras)
    for c in cameras:
        own[c] = replace(own[c], K=own[c].K * np.array([[1.25, 1.0, 1.0], [1.0, 1.25, 1.0], [1.0, 1.0, 1.0]]))
    return fgpose.CameraRig(tuple(own))


@OF_TWO_OR_FOUR
def test_another_focal_length_of_all(names: tuple[str, ...]) -> None:
    """Two cameras agree with it nearly as well: it looked like a camera that was moved."""
    seen, rig = filmed(walk_m(3)), zoomed_rig((0, 1, 2, 3))
    found = find_changes([seen.subset(names)], rig.subset(names))
    assert found.changes == ()
    (lens,) = found.lenses
    assert len(lens.cameras) == len(names)
    # A hundredth moves a body 2 m from the middle by 2 cm.
    assert lens.factor == pytest.approx(0.8, abs=0.02)


@pytest.mark.slow
def test_another_focal_length_of_one() -> None:
    found = find_changes([filmed(walk_m(3))], zoomed_rig((1,)))
    assert found.changes == ()
    (lens,) = found.lenses
    assert lens.cameras == (1,)
    assert lens.factor == pytest.approx(0.8, abs=0.02)


WIDE = np.array([-0.28, 0.09, 0.001, -0.001, -0.01])  # k1 k2 p1 p2 k3


def with_distortion(distortion: np.ndarray, kind: Literal["pinhole", "fisheye"] = "pinhole") -> fgpose.CameraRig:
    return fgpose.CameraRig(tuple(replace(each, distortion=distortion, lens=kind) for each in RIG.cameras))


@OF_TWO_OR_FOUR
@pytest.mark.parametrize(
    ("true", "given", "lens"),
    [
        (WIDE, np.zeros(0), Lens.DISTORTION),
        pytest.param(np.zeros(0), WIDE, Lens.NONE_LEFT, marks=pytest.mark.slow),
        pytest.param(WIDE, -WIDE, Lens.SIGN, marks=pytest.mark.slow),
        (WIDE, WIDE / 4, Lens.OTHER_DISTORTION),
    ],
)
def test_another_distortion_of_all(names: tuple[str, ...], true: np.ndarray, given: np.ndarray, lens: Lens) -> None:
    """They looked like cameras that were bumped, as somebody walks from the middle of the images to their borders."""
    seen, rig = filmed(walk_m(3), with_distortion(true)), with_distortion(given)
    found = find_changes([seen.subset(names)], rig.subset(names))
    assert found.changes == ()
    (other,) = found.lenses
    assert (other.lens, len(other.cameras)) == (lens, len(names))
    if lens in (Lens.DISTORTION, Lens.OTHER_DISTORTION):
        k1 = given[0] if len(given) else 0.0
        assert k1 + other.value == pytest.approx(-0.28, abs=0.06)  # k2 is that of usual lenses, not its own


def test_a_fisheye_lens_that_is_read_as_a_pinhole() -> None:
    coefficients = np.array([-0.03, 0.01, -0.004, 0.0005])
    seen = filmed(walk_m(3), with_distortion(coefficients, "fisheye"))
    found = find_changes([seen.subset(TWO)], with_distortion(coefficients).subset(TWO))
    assert found.changes == ()
    assert [(each.lens, each.cameras) for each in found.lenses] == [(Lens.FISHEYE, (0, 1))]


@pytest.mark.slow
def test_images_that_were_resized_in_one_direction() -> None:
    """In this ring, all of whose cameras see people as high in the image, it looks like a shift too."""
    rig = fgpose.CameraRig(tuple(stretched(each, 1.12, axis=1) for each in RIG.cameras)).subset(THREE)
    found = find_changes([filmed(walk_m(3)).subset(THREE)], rig)
    assert found.changes == ()
    (other,) = found.lenses
    assert other.or_else is not None
    by_kind = {each.lens: each for each in (other, other.or_else)}
    assert set(by_kind) == {Lens.HEIGHT, Lens.CENTRE_Y}
    assert other.cameras == (0, 1, 2)
    assert by_kind[Lens.HEIGHT].factor == pytest.approx(1 / 1.12, abs=0.02)
    (finding,) = other_lenses([other], THREE)
    assert "fy" in finding.remedy
    assert "cy" in finding.remedy


@pytest.mark.slow
def test_images_of_all_cameras_that_were_cut() -> None:
    """Each looked like a camera that was turned, or none agreed with any. Along y this ring sees people higher up."""
    shift_px = np.array([[0.0, 0.0, 50.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rig = fgpose.CameraRig(tuple(replace(each, K=each.K + shift_px) for each in RIG.cameras))
    found = find_changes([filmed(walk_m(3)).subset(THREE)], rig.subset(THREE))
    assert found.changes == ()
    assert found.agree
    (lens,) = found.lenses
    assert lens.lens is Lens.CENTRE_X
    assert lens.value * lens.focal_px == pytest.approx(-50, abs=4)  # a pixel is 5 mm at the body


@pytest.mark.parametrize("n_cameras", [2, pytest.param(3, marks=pytest.mark.slow), 4])
def test_nothing_is_told_of_real_webcams_that_somebody_stands_before(n_cameras: int) -> None:
    """What a network errs by in each view looks like cameras that were turned by 30 degrees about the body."""
    rig, seen = webcam()
    found = find_changes([seen.subset(rig.names[:n_cameras])], rig.subset(rig.names[:n_cameras]))
    assert found.changes == ()
    assert found.lenses == ()


@pytest.mark.slow
def test_a_camera_that_was_turned_about_its_axis() -> None:
    """Rays miss each other by 2 cm only, as they do of somebody who stands; who walks is seen from all sides."""
    (found,) = changes(filmed(walk_m(3)), THREE, turned(RIG, 1, 1.0, axis=(0.0, 0.0, 1.0)))
    assert (found.kind, found.camera) == (Kind.MOVED, 1)


@pytest.mark.parametrize("cut", [lambda seen: seen.frames(slice(0, 1)), lambda seen: seen.subset(FOUR[:1])])
def test_too_little_says_nothing(cut: Callable[[fgpose.Observations], fgpose.Observations]) -> None:
    part = cut(filmed(walk_m(3)))
    found = find_changes([part], RIG.subset(part.camera_names))
    assert found.changes == ()
    assert not found.compared


@pytest.mark.slow
def test_all_people_are_used() -> None:
    """Each in a half of the recording."""
    seen = lost(filmed(walk_m(3)), 2, TURN, 6)
    halves = [seen.frames(slice(0, 360)), seen.frames(slice(360, None))]
    (found,) = find_changes(halves, RIG).changes
    assert (found.kind, found.camera) == (Kind.JUMP, 2)
    assert np.isclose(found.at_s, TURN / FPS, atol=1.0)


@pytest.mark.parametrize("seed", [3, pytest.param(7, marks=pytest.mark.slow)])
def test_nothing_is_told_of_clocks_by_somebody_who_stands_quite_still(seed: int) -> None:
    """As in the static trial of a laboratory: what lasts of a network's errors fits best at some lag."""
    time_s = np.arange(300) / FPS
    sway_m = 0.005 * np.stack([np.sin(2 * time_s + 1), np.sin(2.6 * time_s), 0.2 * np.sin(time_s)], axis=-1)
    assert changes(filmed(walk_m(3)[200] + sway_m[:, None], seed=seed), FOUR) == ()


def test_a_reflection_that_one_camera_sees_now_and_then_is_no_bump() -> None:
    """Two innocent cameras were said to have been moved by 62 and 22 cm."""
    truth_m = walk_m(3)[:450]
    seen, behind_a_mirror = filmed(truth_m), filmed(truth_m * [1.0, -1.0, 1.0] + [0.0, 4.0, 0.0], seed=9)
    now_and_then = np.repeat(np.random.default_rng(0).random(30) < 0.5, 15)
    points2d_px = seen.points2d_px.copy()
    points2d_px[now_and_then, 0] = behind_a_mirror.points2d_px[now_and_then, 0]
    found = find_changes([replace(seen, points2d_px=points2d_px)], RIG)
    assert found.changes == ()
    assert found.lenses == ()


@pytest.mark.parametrize(
    ("share", "usual_length", "seed"), [(0.7, 2.0, 4), pytest.param(0.6, 3.0, 5, marks=pytest.mark.slow)]
)
def test_images_that_were_left_out_are_no_other_clock(share: float, usual_length: float, seed: int) -> None:
    """The moments at which images of two cameras are near each other differ from lag to lag."""
    assert find_changes([left_out(walk_m(seed), share, usual_length, seed)], RIG).changes == ()
