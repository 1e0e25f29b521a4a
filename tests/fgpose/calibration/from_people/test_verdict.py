from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from adjusted_rigs import adjusted, moved, rig_errors

from fgpose.calibration.from_people.calibrated import CalibrationFinding, CameraSigmas, Grade
from fgpose.calibration.from_people.rig.focal_check import FocalCheck
from fgpose.calibration.from_people.verdict.coverage import Coverage
from fgpose.calibration.from_people.verdict.inputs import VerdictInputs, gather
from fgpose.calibration.from_people.verdict.moved_cameras import MovedCamera, MovedMidway
from fgpose.calibration.from_people.verdict.verdict import (
    findings,
    focal_undetermined,
    focal_wrong,
    halves_disagree,
    mirrors,
    nobody_checks,
    nobody_upright,
    poorly_covered,
    recording_too_short,
    start_uncertain,
    twisted,
    uncertain,
    worst_camera,
)
from fgpose.calibration.from_people.world.metric import to_metric

NAMES = ("a", "b", "c")
STILL = np.zeros((3, 3, 6))  # nothing moves
NO_CAMERA = np.zeros(4, dtype=bool)
NOBODY = np.zeros(3, dtype=bool)


def each(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)


def well_covered() -> Coverage:
    return Coverage(
        common_share=0.5,
        area_m2=8.0,
        box_m=np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 1.8]]),
        near_m=np.full(3, 2.5),
        far_m=np.full(3, 6.0),
        image_share=np.full(3, 0.6),
        along_m=np.full(3, 1.2),
        across_m=np.full(3, 0.8),
        seen_s=np.full(3, 25.0),
    )


def good() -> VerdictInputs:
    sigmas = CameraSigmas(
        np.full(3, 0.03), np.full(3, 0.5), np.zeros(3), np.full(3, 0.002), scale=0.01, vertical_deg=0.5, floor_m=0.01
    )
    certain = np.ones(3, dtype=bool)
    return VerdictInputs(
        camera_names=NAMES,
        sigmas=sigmas,
        distance_m=np.full(3, 4.0),
        third_view_mrad=np.full(3, 7.0),
        cross_check_deg=np.full(3, 8.0),
        halves_deg=np.full(3, 0.8),
        halves_m=np.full(3, 0.05),
        coverage=well_covered(),
        estimated_lenses=(),
        start_certain=certain,
        mirrored=~certain,
        handedness=0.9,
        upright=0.95,
        camera_tilt_deg=15.0,
        duration_s=28.0,
    )


def test_nothing_speaks_against_a_good_calibration() -> None:
    assert findings(good()) == ()


def test_the_gravest_comes_first() -> None:
    inputs = replace(good(), duration_s=1.0, mirrored=np.array([False, True, False]))
    assert [finding.grade for finding in findings(inputs)] == [Grade.FAILED, Grade.COARSE]


@pytest.mark.parametrize(
    ("change", "camera", "grade", "words"),
    [
        ({"third_view_mrad": each(7, 16, 7)}, "b", Grade.FAILED, "16 mrad"),
        ({"cross_check_deg": each(7, 8, 40)}, "c", Grade.FAILED, "40 degrees"),
        ({"halves_deg": each(10, 1, 1)}, "a", Grade.FAILED, "10.0 degrees"),
        ({"halves_m": each(0.1, 0.3, 0.1)}, "b", Grade.COARSE, "8%"),
        ({"start_certain": np.array([True, False, True])}, "b", Grade.COARSE, "start is not certain"),
        ({"handedness": -0.8}, "", Grade.FAILED, "inside out"),
        ({"upright": 0.2}, "", Grade.COARSE, "20%"),
        ({"camera_tilt_deg": 85.0}, "", Grade.COARSE, "85 degrees"),
        ({"duration_s": 1.0}, "", Grade.COARSE, "1.0 s"),
        ({"moved": MovedCamera(1, 15.0, 20.0, 85.0, 6.0)}, "b", Grade.COARSE, "from 15.0 to 20.0 s it sees"),
        ({"moved": MovedCamera(None, 15.0, 20.0, 85.0, 6.0)}, "", Grade.COARSE, "some camera sees"),
        ({"of_scale": (CalibrationFinding("", Grade.COARSE, "a wrong stature", ""),)}, "", Grade.COARSE, "stature"),
    ],
)
def test_each_of_the_grounds_has_its_finding(change: dict, camera: str, grade: Grade, words: str) -> None:
    (finding,) = findings(replace(good(), **change))
    assert (finding.camera, finding.grade) == (camera, grade)
    assert words in finding.reason
    assert finding.remedy or change.keys() == {"of_scale"}


def test_a_camera_that_is_worse_than_the_others_stands_out() -> None:
    assert not worst_camera(NAMES, each(1, 1, 8))  # 8 mrad are usual, if the others are good by chance
    assert not worst_camera(NAMES, each(7, 7, 9))
    (finding,) = worst_camera(NAMES, each(3, 3, 12))
    assert (finding.camera, finding.grade) == ("c", Grade.FAILED)
    (finding,) = worst_camera(NAMES, each(7, 7, 12))
    assert (finding.camera, finding.grade) == ("c", Grade.COARSE)


def test_a_camera_that_nobody_can_judge_is_coarse() -> None:
    (finding,) = worst_camera(NAMES, each(np.nan, 5, 5))
    assert (finding.camera, finding.grade) == ("a", Grade.COARSE)


def test_two_grades_of_a_twist() -> None:
    graded = {finding.camera: finding.grade for finding in twisted(NAMES, each(10, 18, 50), each(1, 1, 1))}
    assert graded == {"b": Grade.COARSE, "c": Grade.FAILED}
    assert not twisted(NAMES, each(np.nan, np.nan, np.nan), each(1, 1, 1))  # no 3D


def test_a_camera_whose_3d_contradicts_a_direction_that_is_not_certain_is_failed() -> None:
    """A screen in its view, with the walker as another camera sees them: 21 and 1.8 degrees, 30 degrees off."""
    (finding,) = twisted(NAMES, each(21, 2, 2), each(1.8, 1.7, 1.9))
    assert (finding.camera, finding.grade) == ("a", Grade.FAILED)
    assert "screen" in finding.remedy
    (finding,) = twisted(NAMES, each(21, 2, 2), each(1.4, 1.7, 1.9))
    assert finding.grade is Grade.COARSE


def test_rotation_and_place_are_one_finding_a_camera() -> None:
    (finding,) = halves_disagree(NAMES, each(4, 0, 0), each(0.2, 0, 0))
    assert finding.grade is Grade.FAILED
    assert "place" in finding.reason
    (finding,) = uncertain(NAMES, each(0.3, 5, 0.3), each(0.01, 0.04, 0.01))
    assert (finding.camera, finding.grade) == ("b", Grade.FAILED)


def test_a_focal_length_is_not_blamed_for_a_camera_that_was_moved() -> None:
    check = FocalCheck(each(0.1, 0.0, 0.0), np.full(3, 0.005), STILL)
    inputs = replace(good(), focal_check=check)
    assert any("focal length" in finding.reason for finding in findings(inputs))
    (finding,) = findings(replace(inputs, midway=MovedMidway(1.5, 0.1, 0.3, 0.02)))
    assert "about the middle" in finding.reason
    assert "100 mm and 1.5 degrees" in finding.reason


def test_a_focal_length_needs_depth() -> None:
    estimated, ratio = ((0,), (1,)), each(1.2, 2.5, 1.2)
    (finding,) = focal_undetermined(NAMES, estimated, each(0.02, 0.02, 0.0), ratio)
    assert finding.camera == "a"
    assert "walk towards it" in finding.remedy
    (finding,) = focal_undetermined(NAMES, estimated, each(0.2, 0.01, 0.0), ratio)
    assert finding.grade is Grade.FAILED
    assert "not determined" in finding.reason
    # One of the cameras that share a lens has seen it.
    assert not focal_undetermined(NAMES, ((0, 1),), each(0.02, 0.02, 0.0), ratio)


def test_a_focal_length_that_is_known_needs_no_depth_and_a_lens_is_named_once() -> None:
    near = each(1.48, 1.3, 1.2)
    assert not focal_undetermined(NAMES, ((0, 1, 2),), np.full(3, 0.005), near)
    (finding,) = focal_undetermined(NAMES, ((0, 1, 2),), np.full(3, 0.02), near)
    assert not finding.camera
    assert "1.48 times" in finding.reason


def test_how_a_camera_saw_the_walk() -> None:
    coverage = replace(
        well_covered(), along_m=each(0.1, 1.0, 1.0), across_m=each(0.05, 0.05, 1.0), image_share=each(0.1, 0.5, 0.1)
    )
    found = {finding.camera: finding.reason for finding in poorly_covered(NAMES, coverage, NOBODY)}
    assert "one place" in found["a"]
    assert "one line" in found["b"]
    assert "10% of its image" in found["c"]
    unseen = replace(well_covered(), seen_s=each(0, 20, 20), along_m=each(np.nan, 1, 1))
    assert [f.reason for f in poorly_covered(NAMES, unseen, NOBODY)] == ["it saw the person for 0.0 s only"]


def test_a_line_does_not_matter_where_the_camera_is_certain() -> None:
    line, place = replace(well_covered(), across_m=np.zeros(3)), replace(well_covered(), along_m=np.zeros(3))
    assert not poorly_covered(NAMES, line, ~NOBODY)
    assert poorly_covered(NAMES, place, ~NOBODY)
    inputs = replace(good(), coverage=line)
    assert not findings(inputs)
    sigmas = replace(inputs.sigmas, direction_deg=each(0.5, 0.5, 1.2))
    (finding,) = findings(replace(inputs, sigmas=sigmas))
    assert (finding.camera, finding.reason) == ("c", "it saw the person on one line only")


def test_what_holds_for_all_cameras_is_said_once() -> None:
    (finding,) = poorly_covered(NAMES, replace(well_covered(), along_m=np.zeros(3)), NOBODY)
    assert (finding.camera, finding.reason) == ("", "every camera saw the person in one place only")


def test_a_focal_length_that_the_images_contradict() -> None:
    check = FocalCheck(change=each(0.4, -0.25, 0.15), sigma=each(0.02, 0.02, 0.02), moves=STILL)
    graded = {finding.camera: finding.grade for finding in focal_wrong(NAMES, check)}
    assert graded == {"a": Grade.FAILED, "b": Grade.FAILED}  # the third follows the first
    assert not focal_wrong(NAMES, None)
    assert len(findings(replace(good(), focal_check=check))) == 2
    (finding,) = focal_wrong(NAMES, FocalCheck(each(0.02, 0.0, -0.12), each(0.01, 0.01, 0.02), STILL))
    assert (finding.camera, finding.grade) == ("c", Grade.COARSE)
    # Who stays in one place tells nothing of focal lengths.
    assert not focal_wrong(NAMES, FocalCheck(each(0.8, 0.5, 0.1), each(0.06, 0.1, 0.08), STILL))


def test_two_cameras_are_coarse() -> None:
    (finding,) = nobody_checks(2)
    assert finding.grade is Grade.COARSE
    assert "third" in finding.remedy


def test_criteria_that_hold_say_nothing() -> None:
    assert not start_uncertain(NAMES, np.ones(3, dtype=bool))
    assert not mirrors(NAMES, np.zeros(3, dtype=bool), 0.0)
    assert not recording_too_short(30.0)
    assert not nobody_checks(3)
    assert not nobody_upright(0.9, 10.0)


def test_a_walker_gives_a_good_verdict() -> None:
    # The whole way from what an adjustment gives, at 20 mm of error; halves with as much.
    case = adjusted(seed=2)
    found = to_metric(case.walk, case.rig, case.joints_m, stature_m=1.7)
    rng = np.random.default_rng(0)
    first, second = (moved(found.rig, rig_errors(found.rig, 0.02, rng)) for _ in range(2))
    inputs = gather(
        case.walk,
        case.walk,
        found,
        four_sigmas(),
        (first, second),
        np.arange(len(case.truth_m)) % 2 == 0,
        (),
        ~NO_CAMERA,
    )
    assert findings(inputs) == ()
    assert inputs.duration_s == pytest.approx(30.0, abs=0.1)
    assert inputs.distance_m == pytest.approx(4.5, rel=0.2)
    assert inputs.camera_tilt_deg < 20  # the cameras look down by 10 degrees, all towards the middle
    assert np.isnan(inputs.cross_check_deg).all()  # no 3D


def test_a_camera_that_was_bumped_in_the_middle_fails() -> None:
    case = adjusted(seed=2)
    bumped = rig_errors(case.rig, 0.0, np.random.default_rng(0))
    bumped[1, 1] += np.deg2rad(6.0)
    found = to_metric(case.walk, moved(case.rig, bumped), case.joints_m, stature_m=1.7)
    inputs = gather(
        case.walk, case.walk, found, four_sigmas(), None, np.arange(len(case.truth_m)) % 2 == 0, (), ~NO_CAMERA
    )
    assert {(finding.camera, finding.grade) for finding in findings(inputs)} >= {("ring_1", Grade.FAILED)}
    assert np.isnan(inputs.halves_deg).all()


def four_sigmas() -> CameraSigmas:
    return CameraSigmas(
        np.full(4, 0.02), np.full(4, 0.3), np.zeros(4), np.zeros(4), scale=0.01, vertical_deg=0.5, floor_m=0.01
    )


def test_somebody_who_lies_is_not_the_vertical() -> None:
    case = adjusted(10.0, 3)
    lying = case.joints_m @ np.array(gtsam.Rot3.Rx(np.pi / 2).matrix()).T
    found = to_metric(case.walk, case.rig, lying, stature_m=1.7)
    inputs = gather(case.walk, case.walk, found, four_sigmas(), None, np.ones(len(lying), dtype=bool), (), ~NO_CAMERA)
    assert any("lies" in finding.reason for finding in findings(inputs))


def test_the_cause_comes_before_what_it_does() -> None:
    wrong = replace(
        good(),
        third_view_mrad=each(7, 40, 7),
        mirrored=np.array([False, True, False]),
        off_centre=np.array([True, False, False]),
        halves_deg=each(5, 0, 0),
    )
    found = findings(wrong)
    assert found[0].reason == "it sees the person mirrored"
    coarse = [finding for finding in found if finding.grade is Grade.COARSE]
    assert coarse[0].camera == "a"
    assert coarse[0].reason.endswith("as of images of another size")


def test_a_short_recording_is_said_once() -> None:
    short = replace(good(), duration_s=1.7, coverage=replace(well_covered(), seen_s=np.full(3, 1.7)))
    (finding,) = findings(short)
    assert finding.reason == "two cameras saw the person for 1.7 s only"
