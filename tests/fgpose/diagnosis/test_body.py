"""Units, axes, skeletons and sides, by the body itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.body.joint_names import in_words, in_words_by_part, limb_of
from fgpose.diagnosis.body.proportions import stature_m, strangeness
from fgpose.diagnosis.body.sides import exchanged_limbs, mirrored_body
from fgpose.diagnosis.body.skeletons import wrong_skeleton
from fgpose.diagnosis.body.tempo import slow_motion, velocities_kept_s
from fgpose.diagnosis.body.world import wrong_unit, wrong_up
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpAxis
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.calibration.real import webcam
from fgpose_benchmarks.synthetic import walking
from tests.fgpose.diagnosis.damaged import SKELETON, motion_m, posed, recorded, room, with_points

SIDES = (("left", "right"), ("right",))
NEIGHBOURS = (("elbow", "wrist"), ("shoulder", "elbow"), ("hip", "knee"), ("knee", "ankle"))
FAST = {(("shoulder", "elbow"), 2, 4), (("hip", "knee"), 2, 2), (("elbow", "wrist"), 1, 2), (("knee", "ankle"), 1, 4)}
Y_DOWN = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
CHECKS = (wrong_skeleton, wrong_unit, wrong_up, mirrored_body)


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(4, seed=3)


def scaled(rig: CameraRig, factor: float) -> CameraRig:
    """With all distances multiplied."""

    def pose(given: np.ndarray) -> np.ndarray:
        given[:3, 3] *= factor
        return given

    return posed(rig, pose)


def lying(truth_m: np.ndarray) -> np.ndarray:
    """On the floor."""
    around = truth_m - np.array([0.0, 0.0, 0.9])
    return np.stack([around[..., 2], around[..., 1], 0.4 - around[..., 0]], axis=-1)


@pytest.mark.parametrize("name", ["balance_openpose", "balance_blazepose"])
def test_nothing_is_told_of_real_recordings(name: str) -> None:
    rig, seen = fgpose.files.load_recording(name)
    examined = Examined.of(seen, rig)
    assert [finding for check in CHECKS for finding in check(examined)] == []


@pytest.mark.parametrize(
    ("posture", "n_cameras"),
    [
        pytest.param(lambda truth: truth, 2, id="stands-2"),
        pytest.param(lambda truth: truth, 4, id="stands-4", marks=pytest.mark.slow),
        pytest.param(lying, 2, id="lies-2", marks=pytest.mark.slow),
        pytest.param(lying, 4, id="lies-4"),
        pytest.param(lambda truth: 0.5 * truth, 2, id="child-2", marks=pytest.mark.slow),
        pytest.param(lambda truth: 0.5 * truth, 4, id="child-4"),
    ],
)
def test_nothing_is_told_of_right_ones(n_cameras: int, posture) -> None:
    rig = room(n_cameras, seed=7)
    examined = Examined.of(recorded(rig, posture(motion_m("cmu_02_10", 90)), seed=7), rig)
    # That somebody lies all the time is said: it may be the world that lies.
    assert [each for check in CHECKS for each in check(examined) if each.severity is not Severity.NOTE] == []


@pytest.mark.parametrize(
    ("factor", "words", "remedy"),
    [
        (1000.0, "millimetres read as metres", "--unit mm"),
        (100.0, "centimetres read as metres", "--unit cm"),
        (0.1, "centimetres read as millimetres", "--unit cm"),
        (1 / 25.4, "inches read as millimetres", "--unit inch"),
        (0.001 / 0.054, "squares of a board of about 5", "--unit 0.05"),
        (1 / 0.03, "squares of a board of about 3", "--unit 0.03"),
    ],
)
def test_a_unit_is_found_by_the_size_of_the_body(seen, rig, factor: float, words: str, remedy: str) -> None:
    (finding,) = wrong_unit(Examined.of(seen, scaled(rig, factor)))
    assert (finding.code, finding.severity) == (Code.UNIT, Severity.WRONG)
    assert words in finding.reason
    assert remedy in finding.remedy
    # The person of the motion capture is 1.65 m by these proportions; 1.70 m is taken.
    assert finding.numbers["factor"] == pytest.approx(1 / factor, rel=0.1)


@pytest.mark.parametrize(
    ("factor", "severity", "words"), [(0.7, Severity.NOTE, "a child, or"), (1.35, Severity.DOUBTFUL, "so tall, or")]
)
def test_a_scale_that_is_off_by_a_third_is_said(seen, rig, factor: float, severity: Severity, words: str) -> None:
    """Children are so small; hardly anybody is so tall."""
    (finding,) = wrong_unit(Examined.of(seen, scaled(rig, factor)))
    assert finding.severity is severity
    assert words in finding.reason


def test_a_scale_that_fits_somebody_is_right(seen, rig) -> None:
    assert wrong_unit(Examined.of(seen, scaled(rig, 0.92))) == []


def test_arms_and_trunk_tell_no_stature(seen, rig) -> None:
    """Of somebody in a wheelchair, whose forearms are those of a child of 1.2 m."""
    legs = [SKELETON.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")]
    points_px = seen.points2d_px.copy()
    points_px[:, :, legs] = np.nan
    assert wrong_unit(Examined.of(with_points(seen, points_px), scaled(rig, 0.85))) == []


def test_a_unit_is_found_by_one_arm() -> None:
    rig = room(2, seed=3)
    seen, arm = recorded(rig, seed=3), [SKELETON.index(f"left_{joint}") for joint in ("shoulder", "elbow", "wrist")]
    points_px = np.full_like(seen.points2d_px, np.nan)
    points_px[:, :, arm] = seen.points2d_px[:, :, arm]
    shown = with_points(seen, points_px)
    assert wrong_unit(Examined.of(shown, rig)) == []
    (finding,) = wrong_unit(Examined.of(shown, scaled(rig, 1000.0)))
    assert "millimetres read as metres" in finding.reason


@pytest.mark.parametrize(
    ("up", "words"), [("z", "--world-up z was given, but the body stands along -y"), ("+y", "not along +y")]
)
def test_a_world_whose_y_points_down(seen, rig, up: UpAxis, words: str) -> None:
    (finding,) = wrong_up(Examined.of(seen, posed(rig, lambda pose: Y_DOWN @ pose), world_up=up))
    assert (finding.code, finding.severity) == (Code.WORLD_UP, Severity.WRONG)
    assert words in finding.reason
    assert "--world-up -y" in finding.remedy


def test_another_axis_than_z_given_where_z_is_up(seen, rig) -> None:
    (finding,) = wrong_up(Examined.of(seen, rig, world_up="+x"))
    assert finding.reason == "--world-up +x was given, but the body stands along +z of the world, not along +x"
    assert wrong_up(Examined.of(seen, rig, world_up="z")) == []


def test_a_world_that_is_the_frame_of_a_camera(seen, rig) -> None:
    first = np.linalg.inv(rig.cameras[0].world_T_camera)
    (finding,) = wrong_up(Examined.of(seen, posed(rig, lambda pose: first @ pose)))
    assert finding.severity is Severity.NOTE
    assert "--world-up" in finding.remedy
    assert "-y" in finding.reason


@pytest.mark.parametrize(("tilt_deg", "severities"), [(17.0, [Severity.DOUBTFUL]), (4.0, [])])
def test_a_given_axis_from_which_the_world_is_tilted(rig, tilt_deg: float, severities: list[Severity]) -> None:
    """As that of a camera which looks down, where its -y is said to be up."""
    tilt = np.eye(4)
    tilt[:3, :3] = cv2.Rodrigues(np.deg2rad([tilt_deg, 0.0, 0.0]))[0]
    walker = recorded(rig, walking(150, 30.0), seed=3)
    found = wrong_up(Examined.of(walker, posed(rig, lambda pose: tilt @ Y_DOWN @ pose), world_up="-y"))
    assert [each.severity for each in found] == severities
    assert all(
        "--world-up -y was given, but the world is tilted by 17 degrees from -y" in each.reason for each in found
    )


def test_left_and_right_exchanged_in_all_views(seen, rig) -> None:
    swapped = with_points(seen, seen.points2d_px[:, :, SKELETON.mirror])
    (finding,) = mirrored_body(Examined.of(swapped, rig))
    assert (finding.code, finding.severity) == (Code.EXCHANGED_SIDES, Severity.WRONG)


def test_no_order_is_told_of_a_body_without_legs(seen, rig) -> None:
    points_px = seen.points2d_px.copy()
    points_px[
        :, :, [SKELETON.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")]
    ] = np.nan
    assert wrong_skeleton(Examined.of(with_points(seen, points_px), rig)) == []


@pytest.mark.parametrize("n_cameras", [pytest.param(2, marks=pytest.mark.slow), 4])
@pytest.mark.parametrize(
    ("limbs", "joints"), [("arms", ("shoulder", "elbow", "wrist")), ("legs", ("hip", "knee", "ankle"))]
)
def test_arms_or_legs_exchanged_in_all_views(n_cameras: int, limbs: str, joints: tuple[str, ...]) -> None:
    rig = room(n_cameras, seed=3)
    seen = recorded(rig, motion_m("cmu_02_10", 90), seed=3)
    order = np.arange(SKELETON.n_joints)
    own = [SKELETON.index(f"{side}_{joint}") for joint in joints for side in ("left", "right")]
    order[own] = SKELETON.mirror[own]
    examined = Examined.of(with_points(seen, seen.points2d_px[:, :, order]), rig)
    (finding,) = mirrored_body(examined)
    assert (finding.code, finding.severity) == (Code.EXCHANGED_SIDES, Severity.WRONG)
    assert f"left and right {limbs} are exchanged" in finding.reason
    assert wrong_skeleton(examined) == []


@pytest.mark.parametrize(
    ("n_cameras", "camera"),
    [(2, 0), pytest.param(2, 1, marks=pytest.mark.slow), pytest.param(4, 1, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize(
    ("limbs", "joints"), [("arms", ("shoulder", "elbow", "wrist")), ("legs", ("hip", "knee", "ankle"))]
)
def test_arms_or_legs_exchanged_in_one_view(n_cameras: int, camera: int, limbs: str, joints: tuple[str, ...]) -> None:
    rig = room(n_cameras, seed=3)
    seen = recorded(rig, motion_m("cmu_02_10", 60), seed=3)
    assert exchanged_limbs(Examined.of(seen, rig)) == []
    own = [SKELETON.index(f"{side}_{joint}") for joint in joints for side in ("left", "right")]
    points_px = seen.points2d_px.copy()
    points_px[:, camera, own] = points_px[:, camera, SKELETON.mirror[own]]
    examined = Examined.of(with_points(seen, points_px), rig)
    assert disagreements(examined) == []
    (finding,) = exchanged_limbs(examined)
    assert (finding.code, finding.severity) == (Code.EXCHANGED_SIDES, Severity.WRONG)
    assert f"Left and right {limbs} are exchanged in {rig.names[camera]} throughout" in finding.reason
    assert (finding.camera, finding.joint) == (rig.names[camera], limbs)


@pytest.mark.parametrize(
    ("given", "n_cameras"),
    [
        ("coco_17", 2),
        ("h36m_17_lt", 4),
        pytest.param("coco_17", 4, marks=pytest.mark.slow),
        pytest.param("h36m_17_lt", 2, marks=pytest.mark.slow),
    ],
)
def test_a_skeleton_of_as_many_joints(n_cameras: int, given: str) -> None:
    rig = room(n_cameras, seed=3)
    seen = recorded(rig, motion_m("cmu_02_10", 90), seed=3)
    misread = replace(seen, skeleton=load_skeleton(given), points3d_m=None, covariance3d_m2=None)
    (finding,) = wrong_skeleton(Examined.of(misread, rig))
    assert (finding.code, finding.severity) == (Code.WRONG_SKELETON, Severity.WRONG)
    assert "probably of h36m_17," in finding.reason
    assert finding.remedy == "Give --skeleton h36m_17."


def test_of_few_frames_it_is_not_said_that_no_skeleton_fits(rig) -> None:
    few = recorded(rig, motion_m("cmu_02_10", 90), seed=3).frames(np.arange(90) % 15 == 0)
    misread = replace(few, skeleton=load_skeleton("h36m_17_lt"), points3d_m=None, covariance3d_m2=None)
    (finding,) = wrong_skeleton(Examined.of(misread, rig))
    assert "6 frames are too few to tell whose they are" in finding.reason
    assert finding.remedy.startswith("Give more frames, --skeleton ")
    assert "h36m_17, where" in finding.remedy


def test_joints_in_an_order_that_no_skeleton_has(seen, rig) -> None:
    order = np.random.default_rng(1).permutation(SKELETON.n_joints)
    shuffled = replace(with_points(seen, seen.points2d_px[:, :, order]), confidence=seen.confidence[:, :, order])
    (finding,) = wrong_skeleton(Examined.of(shuffled, rig))
    assert finding.code is Code.WRONG_SKELETON
    assert "another one" in finding.reason


@pytest.mark.parametrize(("shift", "words"), [(1, "the one before it"), (-1, "the one behind it")])
def test_joints_that_are_counted_from_another_one(seen, rig, shift: int, words: str) -> None:
    points_px, confidence = (np.roll(each, shift, axis=2) for each in (seen.points2d_px, seen.confidence))
    (finding,) = wrong_skeleton(Examined.of(replace(with_points(seen, points_px), confidence=confidence), rig))
    assert f"each is probably {words} in its list" in finding.reason


# One of both sides, one of one side; with two cameras and with more.
SOME_FAST = [
    pytest.param(
        sides, exchanged, n_cameras, marks=[] if (exchanged, len(sides), n_cameras) in FAST else pytest.mark.slow
    )
    for sides, exchanged, n_cameras in product(SIDES, NEIGHBOURS, (2, 4))
]


@pytest.mark.parametrize(("sides", "exchanged", "n_cameras"), SOME_FAST)
def test_neighbouring_joints_exchanged_in_all_views(
    n_cameras: int, exchanged: tuple[str, str], sides: tuple[str, ...]
) -> None:
    rig = room(n_cameras, seed=3)
    seen = recorded(rig, motion_m("cmu_02_10", 90), seed=3)
    order = np.arange(SKELETON.n_joints)
    for side in sides:
        a, b = (SKELETON.index(f"{side}_{joint}") for joint in exchanged)
        order[[a, b]] = b, a
    swapped = with_points(seen, seen.points2d_px[:, :, order])
    (finding,) = wrong_skeleton(Examined.of(swapped, rig))
    assert (finding.code, finding.severity) == (Code.WRONG_SKELETON, Severity.WRONG)
    named, probably = (
        in_words(f"{side}_{joint}" for joint in joints for side in sides) for joints in (exchanged, exchanged[::-1])
    )
    assert f"{named} are probably {probably}" in finding.reason


@pytest.mark.parametrize("n_cameras", [pytest.param(3, marks=pytest.mark.slow), 4])
def test_hips_and_knees_that_a_desk_hides_are_in_no_other_order(n_cameras: int) -> None:
    """Two of four real webcams guess them; with hips and knees exchanged they are a little more like a body."""
    rig, seen = webcam()
    names = rig.names[:n_cameras]
    examined = Examined.of(seen.subset(names), rig.subset(names))
    assert stature_m(examined.body_m, seen.skeleton) > 0  # they are judged
    assert wrong_skeleton(examined) == []


def test_real_motion_has_the_proportions_of_a_body() -> None:
    truth_m = motion_m("cmu_01_04_a")
    # The subject's bones are those of a person of 1.65 m; single segments differ by some per cent between people.
    assert stature_m(truth_m, SKELETON) == pytest.approx(1.65, abs=0.05)
    assert strangeness(truth_m, SKELETON) < 0.2
    truth_m[:, [SKELETON.index(f"{side}_knee") for side in ("left", "right")]] = np.nan
    assert np.isnan(stature_m(truth_m, SKELETON))  # arms and trunk alone are no measure


@pytest.mark.parametrize(
    "missing",
    [pytest.param(("left_wrist",), marks=pytest.mark.slow), ("left_knee", "right_knee"), ("left_wrist", "left_elbow")],
)
def test_no_other_order_is_told_where_joints_are_missing(seen, rig, missing: tuple[str, ...]) -> None:
    joints = [SKELETON.index(name) for name in missing]
    points_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points_px[:, :, joints], confidence[:, :, joints] = np.nan, 0.0
    without = replace(with_points(seen, points_px), confidence=confidence)
    assert wrong_skeleton(Examined.of(without, rig)) == []


def test_many_joints_of_a_hand_are_counted() -> None:
    skeleton = fgpose.load_skeleton("coco_wholebody_133")
    hand = [joint for joint, part in zip(skeleton.joints, skeleton.part_names, strict=True) if part == "left_hand"]
    knees = ["left_knee", "right_knee"]
    assert in_words_by_part(skeleton, ["left_wrist", *hand]) == "left wrist and 21 joints of the left hand"
    assert in_words_by_part(skeleton, [*knees, *hand[:2]]) == "knees, left hand root and left thumb cmc"
    more = in_words_by_part(skeleton, [*hand, "left_wrist", *knees], 2)
    assert more == "21 joints of the left hand and left wrist and 2 more"


def test_joints_in_words() -> None:
    assert in_words(["left_knee", "right_knee", "left_wrist"]) == "knees and left wrist"
    assert limb_of("left_thumb") == limb_of("left_elbow") == "left_arm"
    assert limb_of("right_eye") == limb_of("nose") == "head"
    assert limb_of("left_knee") == "left_leg"
    assert limb_of("pelvis") == "pelvis"


def test_a_body_whose_bones_change_is_not_one_of_another_skeleton(rig) -> None:
    """In another order, and each joint 10 cm off on its own: no order of them makes a body."""
    order = np.random.default_rng(1).permutation(SKELETON.n_joints)
    truth_m = motion_m()[:, order]
    (finding,) = wrong_skeleton(Examined.of(recorded(rig, truth_m), rig))
    assert finding.code is Code.WRONG_SKELETON
    errors_m = np.random.default_rng(0).normal(scale=0.1, size=truth_m.shape)
    (finding,) = wrong_skeleton(Examined.of(recorded(rig, truth_m + errors_m), rig))
    assert finding.code is Code.NO_AGREEMENT


@pytest.mark.parametrize(("factor", "severity"), [(1.0, None), (4.0, Severity.NOTE), (30.0, Severity.WRONG)])
def test_limbs_that_turn_round_too_slowly(
    seen: Observations, rig: CameraRig, factor: float, severity: Severity | None
) -> None:
    """Numbers of frames as seconds, at 30 Hz; slow motion of four times."""
    found = slow_motion(Examined.of(replace(seen, time_s=factor * seen.frame_time_s), rig))
    assert [(each.code, each.severity) for each in found] == ([] if severity is None else [(Code.FRAME_RATE, severity)])


@pytest.mark.parametrize("name", ["balance_openpose", pytest.param("balance_blazepose", marks=pytest.mark.slow)])
def test_the_tempo_of_real_detections(name: str) -> None:
    rig, balance = fgpose.files.load_recording(name)
    # 0.16 and 0.17 s: as in motion capture, the noise of networks notwithstanding.
    assert 0.1 < velocities_kept_s(Examined.of(balance, rig)) < 0.3


def test_the_tempo_of_somebody_who_stands_still_is_not_judged(rig: CameraRig) -> None:
    still = np.repeat(motion_m()[:1], 150, axis=0)
    with pytest.raises(NotJudgedError, match="no wrist or ankle is seen to move"):
        slow_motion(Examined.of(recorded(rig, still), rig))
