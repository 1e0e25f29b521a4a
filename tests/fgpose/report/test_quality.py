"""Numbers and suspicions of results: none where nothing is wrong, the right one where a fault is planted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from finished_walk import FPS, SPREAD_PX, changed, finished_walk

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.diagnosis.gravity_checks import flights
from fgpose.diagnosis.solution_checks import large_errors
from fgpose.finding import Severity
from fgpose.geometry.camera import CameraRig
from fgpose.report import FinishedRecording, quality
from fgpose.report.study_report import outliers, robust_z
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Status, Trajectory


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    return finished_walk(rig, skeleton)


def test_numbers_of_a_result(walk: FinishedRecording) -> None:
    judged = quality(walk)
    assert judged.suspicions == ()
    assert (judged.n_people, judged.n_cameras, judged.n_joints, judged.n_frames) == (1, 4, 17, 300)
    assert judged.rate_hz == pytest.approx(FPS)
    assert (judged.seen_share, judged.predicted_share, judged.views) == (1.0, 0.0, 4.0)
    # Lengths of normal vectors: median 1.1774, 90 % 2.146 of the spread; 20,000 of them scatter by less than 2 %.
    assert judged.reprojection_px == pytest.approx(1.1774 * SPREAD_PX, rel=0.02)
    assert judged.reprojection_q90_px == pytest.approx(2.146 * SPREAD_PX, rel=0.02)
    assert judged.sigma_mm == pytest.approx(10.0)
    assert judged.converged is True
    assert judged.numbers["n_suspicions"] == 0
    assert "suspicions" not in judged.numbers


def test_somebody_who_has_no_frame_is_refused(walk: FinishedRecording) -> None:
    person = walk.people[0]
    names = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")
    nothing = replace(
        person, **{name: getattr(person, name)[:0] for name in names if getattr(person, name) is not None}
    )
    with pytest.raises(ValueError, match="person 3 has no frame"):
        replace(walk, people={0: person, 3: nothing}, observations={})


@pytest.mark.parametrize(
    ("frames", "gap_frames"),
    [
        (slice(100, 130), 30),
        (slice(0, 20), 20),
        (slice(260, None), 40),
        (slice(None), 300),
        (slice(0), 0),
    ],
    ids=["between", "at the beginning", "at the end", "never seen", "always seen"],
)
def test_the_longest_time_for_which_a_joint_was_not_seen(
    walk: FinishedRecording, frames: slice, gap_frames: int
) -> None:
    status = walk.main.status.copy()
    status[frames, 4] = Status.PREDICTED
    assert quality(changed(walk, status=status)).longest_gap_s == pytest.approx(gap_frames / FPS)


def test_before_somebody_comes_nobody_is_unseen(walk: FinishedRecording) -> None:
    status, positions_m = walk.main.status.copy(), walk.main.positions_m.copy()
    for nobody in (slice(0, 50), slice(200, 210)):
        status[nobody], positions_m[nobody] = Status.UNOBSERVABLE, np.nan
    judged = quality(changed(walk, status=status, positions_m=positions_m))
    assert judged.longest_gap_s == pytest.approx(10 / FPS)


def test_what_is_not_known_is_nan(walk: FinishedRecording) -> None:
    bare = Trajectory(walk.main.skeleton, walk.main.time_s, walk.main.positions_m, walk.main.status)
    judged = quality(FinishedRecording("bare", {0: bare}))
    unknown = (judged.reprojection_px, judged.sigma_mm, judged.views, judged.hallucinated_share)
    assert np.isnan(unknown).all()
    assert judged.converged is None
    assert judged.suspicions == ()


def other_camera(walk: FinishedRecording) -> FinishedRecording:
    residual_px = np.array(walk.main.residual_px)
    residual_px[:, 2] *= 2.5
    return changed(walk, residual_px=residual_px)


def late_camera(walk: FinishedRecording) -> FinishedRecording:
    assert walk.rig is not None
    seen = walk.observations[0]
    points_px = seen.points2d_px.copy()
    projected_px = walk.rig.project(walk.main.positions_m)[:, 1]
    # Taken one frame later than it says, it shows where the joints are then.
    points_px[:-1, 1] += projected_px[1:] - projected_px[:-1]
    return replace(walk, observations={0: replace(seen, points2d_px=points_px)})


def unknown_clock(walk: FinishedRecording) -> FinishedRecording:
    return replace(walk, offset_sigma_s={"ring_1": 0.02})


def blind_camera(walk: FinishedRecording) -> FinishedRecording:
    residual_px = np.array(walk.main.residual_px)
    residual_px[60:, 3] = np.nan
    return changed(walk, residual_px=residual_px)


def hallucinating_camera(walk: FinishedRecording) -> FinishedRecording:
    visibility = np.array(walk.main.visibility)
    visibility[:60, 0] = 0.1
    return changed(walk, visibility=visibility)


def swapping_camera(walk: FinishedRecording) -> FinishedRecording:
    assert walk.rig is not None
    residual_px = np.array(walk.main.residual_px)
    left, right = np.array(walk.main.skeleton.left_right).T
    apart_px = np.linalg.norm(
        np.diff(walk.rig.project(walk.main.positions_m)[:30, 3][:, [left, right]], axis=1), axis=-1
    )
    residual_px[:30, 3, left] = residual_px[:30, 3, right] = apart_px[:, 0]
    return changed(walk, residual_px=residual_px)


def gap(walk: FinishedRecording) -> FinishedRecording:
    status, covariance_m2 = walk.main.status.copy(), np.array(walk.main.covariance_m2)
    wrist = walk.main.skeleton.index("left_wrist")
    status[100:130, wrist] = Status.PREDICTED
    covariance_m2[100:130, wrist] *= 25
    return changed(walk, status=status, covariance_m2=covariance_m2)


def two_gaps(walk: FinishedRecording) -> FinishedRecording:
    once = gap(walk)
    status, covariance_m2 = once.main.status.copy(), np.array(once.main.covariance_m2)
    wrist = walk.main.skeleton.index("left_wrist")
    status[20:45, wrist] = Status.PREDICTED
    covariance_m2[20:45, wrist] *= 25
    return changed(walk, status=status, covariance_m2=covariance_m2)


def nothing_known(walk: FinishedRecording) -> FinishedRecording:
    status, positions_m = walk.main.status.copy(), walk.main.positions_m.copy()
    wrist = walk.main.skeleton.index("left_wrist")
    status[:40, wrist], positions_m[:40, wrist] = Status.UNOBSERVABLE, np.nan
    return changed(walk, status=status, positions_m=positions_m)


def contradiction(walk: FinishedRecording) -> FinishedRecording:
    visibility = np.array(walk.main.visibility)
    visibility[150:155, :3] = 0.1
    return changed(walk, visibility=visibility)


def disbelieved_wrist(walk: FinishedRecording) -> FinishedRecording:
    wrist = walk.main.skeleton.index("left_wrist")
    visibility, covariance_m2 = np.array(walk.main.visibility), np.array(walk.main.covariance_m2)
    visibility[100:130, :3, wrist] = 0.1
    covariance_m2[100:130, wrist] *= 25
    return changed(walk, visibility=visibility, covariance_m2=covariance_m2)


def coat(walk: FinishedRecording) -> FinishedRecording:
    assert walk.rig is not None
    knee = walk.main.skeleton.index("left_knee")
    visibility, seen = np.array(walk.main.visibility), walk.observations[0]
    visibility[::3, 2, knee] = visibility[1::3, 2, knee] = 0.1
    points_px = seen.points2d_px.copy()
    points_px[:, 2, knee, 1] += 0.08 * walk.rig.px_per_m(walk.main.positions_m)[:, 2, knee]
    return changed(replace(walk, observations={0: replace(seen, points2d_px=points_px)}), visibility=visibility)


def drifting_camera(walk: FinishedRecording) -> FinishedRecording:
    assert walk.rig is not None
    seen = walk.observations[0]
    points_px = seen.points2d_px.copy()
    velocity_px_s = np.gradient(walk.rig.project(walk.main.positions_m)[:, 1], walk.main.time_s, axis=0)
    # On time in the middle, and 10 ms later with every second.
    lag_s = 0.01 * (walk.main.time_s - walk.main.time_s.mean())
    points_px[:, 1] += lag_s[:, None, None] * velocity_px_s
    return replace(walk, observations={0: replace(seen, points2d_px=points_px)})


def other_calibration(walk: FinishedRecording) -> FinishedRecording:
    return changed(walk, residual_px=np.array(walk.main.residual_px) + 20.0)


def noisy_detections(walk: FinishedRecording) -> FinishedRecording:
    return changed(walk, residual_px=np.array(walk.main.residual_px) * 5)  # 5 * 18 mm


def jumping(walk: FinishedRecording, fall_mps2: float) -> FinishedRecording:
    """Two jumps of half a second, standing upright."""
    since_s = (walk.main.time_s[:, None] - (3.0, 7.0)).clip(-0.25, 0.25)
    height_m = (fall_mps2 / 2 * (0.25**2 - since_s**2)).sum(axis=1)
    positions_m = walk.main.positions_m[0] + height_m[:, None, None] * (0.0, 0.0, 1.0)
    return changed(replace(walk, observations={}), positions_m=positions_m)


def fast_clock(walk: FinishedRecording) -> FinishedRecording:
    return jumping(walk, 1.2**2 * 9.81)


def swapped_ankles(walk: FinishedRecording) -> FinishedRecording:
    assert walk.rig is not None
    residual_px = np.array(walk.main.residual_px)
    ankles = [walk.main.skeleton.index(f"{side}_ankle") for side in ("left", "right")]
    apart_px = np.linalg.norm(np.diff(walk.rig.project(walk.main.positions_m)[:, 3, ankles], axis=1), axis=-1)
    residual_px[:150, 3, ankles] = apart_px[:150]
    return changed(walk, residual_px=residual_px)


def sprint(walk: FinishedRecording) -> FinishedRecording:
    phase_s = (walk.main.time_s - 5) % 0.5
    way_m = np.where(walk.main.time_s > 5, 14.0 * np.minimum(phase_s, 0.5 - phase_s), 0.0)  # to and fro between cameras
    return changed(walk, positions_m=walk.main.positions_m + way_m[:, None, None] * (0.0, 1.0, 0.0))


def turned(walk: FinishedRecording) -> FinishedRecording:
    positions_m = walk.main.positions_m.copy()
    positions_m[150:160] = positions_m[150:160][:, walk.main.skeleton.mirror]
    return changed(walk, positions_m=positions_m)


def stopped(walk: FinishedRecording) -> FinishedRecording:
    return changed(walk, convergence=Convergence(False, 50, 100.0, 10.0))


def far_away(walk: FinishedRecording) -> FinishedRecording:
    positions_m = (
        walk.main.positions_m + np.where(np.arange(300) < 150, 0.0, 0.05 * np.arange(-150, 150))[:, None, None]
    )
    return changed(walk, positions_m=positions_m)


def same_confidence(walk: FinishedRecording) -> FinishedRecording:
    seen = walk.observations[0]
    return replace(walk, observations={0: replace(seen, confidence=np.where(seen.seen, 0.5, 0.0))})


def dropped_frames(walk: FinishedRecording) -> FinishedRecording:
    time_s = walk.main.time_s.copy()
    time_s[200:] += 0.5
    return changed(replace(walk, observations={}), time_s=time_s)


def two_cameras(walk: FinishedRecording) -> FinishedRecording:
    names = walk.camera_names[:2]
    kept = {name: np.array(getattr(walk.main, name))[:, :2] for name in ("residual_px", "visibility")}
    return changed(replace(walk, observations={}), camera_names=names, **kept)


def coarse(walk: FinishedRecording) -> FinishedRecording:
    finding = CalibrationFinding(
        "ring_3", Grade.COARSE, "the focal length is not determined", "walk towards the camera"
    )
    return replace(walk, findings=(finding,))


def passer_by(walk: FinishedRecording) -> FinishedRecording:
    whole = walk.main
    part: dict[str, Any] = {name: np.array(getattr(whole, name))[:15] for name in _OVER_TIME}
    return replace(walk, people={0: whole, 4: replace(whole, **part)})


_OVER_TIME = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")


# What else the same checks, or checks with tests of their own in tests/fgpose/diagnosis, say: slow.
OTHER_FAULTS = [
    (unknown_clock, "ring_1", "known to ± 20.0 ms only"),
    (swapped_ankles, "ring_3", "exchanges left and right of the ankles in"),
    (drifting_camera, "ring_1", "% more slowly than their times say"),
    (sprint, "", "nobody runs faster than 13 m/s"),
    (two_gaps, "left_wrist", "for 1.0 s from 3.3 s on, the longest of 2 times; its sigma grows to 5"),
    (nothing_known, "", "nothing determines left wrist in up to 13 %"),
    (turned, "", "left and right change places 2 times, first at 4.97 s"),
    (far_away, "", "outside of the volume that two cameras see"),
    (same_confidence, "", "all detections have the confidence 0.5"),
    (dropped_frames, "", "frames are missing at one moment"),
    (coarse, "ring_3", "calibration coarse, camera ring_3: the focal length is not determined"),
]


# The others are told by the result alone: what the cameras saw need not be searched for faults again.
OF_WHAT_WAS_SEEN = (late_camera, drifting_camera, coat, same_confidence)


@pytest.mark.parametrize(
    ("plant", "subject", "words"),
    [
        (other_camera, "ring_2", "disagrees with the others"),
        # Fast in test_a_late_camera_is_late_by_no_more_than_it_is.
        pytest.param(late_camera, "ring_1", "takes its images 1.0 frames", marks=pytest.mark.slow),
        (blind_camera, "ring_3", "sees 20 %"),
        (hallucinating_camera, "ring_0", "probably hallucinated"),
        (swapping_camera, "ring_3", "exchanges left and right of the body in 9.7 %"),
        (coat, "ring_2", "shows left knee elsewhere than the others do in 67 % of its detections, by 8 cm"),
        (other_calibration, "", "larger than 9"),
        (noisy_detections, "", "the detections are noisy, not the calibration"),
        (fast_clock, "", "the frame rate is 1.20 times the true one"),
        (contradiction, "", "contradict the motion of most joints in 5 frames, first at 5.00 s"),
        (disbelieved_wrist, "left_wrist", "for 1.0 s from 3.3 s on; its sigma grows to 5 times"),
        (
            gap,
            "left_wrist",
            "fewer than two cameras see it, as far as they are believed, for 1.0 s from 3.3 s on; its sigma grows to 5",
        ),
        (stopped, "", "has not converged after 50 iterations"),
        (two_cameras, "", "2 cameras: nothing contradicts"),
        (passer_by, "person 4", "is there for 0.5 s only"),
        *(pytest.param(*fault, marks=pytest.mark.slow, id=fault[0].__name__) for fault in OTHER_FAULTS),
    ],
)
def test_a_planted_fault_is_named(
    walk: FinishedRecording, plant: Callable[[FinishedRecording], FinishedRecording], subject: str, words: str
) -> None:
    found = quality(plant(walk if plant in OF_WHAT_WAS_SEEN else replace(walk, observations={}))).suspicions
    named = [suspicion for suspicion in found if suspicion.subject == subject and words in suspicion.reason]
    assert named, [suspicion.reason for suspicion in found]
    assert all(suspicion.remedy and 0 < suspicion.weight <= 1 for suspicion in found)
    assert [suspicion.weight for suspicion in found] == sorted((each.weight for each in found), reverse=True)


def test_cameras_that_the_same_helps_against_are_named_together(walk: FinishedRecording) -> None:
    findings = tuple(
        CalibrationFinding(camera, grade, f"its place is known to {share} % only", "walk through its whole view")
        for camera, grade, share in (("ring_1", Grade.COARSE, 3), ("ring_3", Grade.COARSE, 4), ("", Grade.FAILED, 9))
    )
    found = [(each.reason, each.remedy, each.camera) for each in quality(replace(walk, findings=findings)).suspicions]
    assert found == [
        ("calibration failed, all cameras: its place is known to 9 % only", "Walk through its whole view.", ""),
        (
            "calibration coarse, camera ring_1: its place is known to 3 % only; camera ring_3: its place is known to "
            "4 % only",
            "Walk through its whole view.",
            "",
        ),
    ]


def test_a_late_camera_is_late_by_no_more_than_it_is(walk: FinishedRecording) -> None:
    (reason,) = (each.reason for each in quality(late_camera(walk)).suspicions if each.subject == "ring_1")
    # The planted result did not follow the camera, so the lag is not shrunk: one frame is 33 ms.
    assert abs(float(reason.partition("frames (")[2].partition(" ")[0]) - 33.3) < 3


def test_a_late_camera_does_not_make_the_others_early(walk: FinishedRecording) -> None:
    """The result follows a late camera by its share of the four."""
    late = late_camera(walk)
    followed_m = walk.main.positions_m.copy()
    followed_m[:-1] += (walk.main.positions_m[1:] - walk.main.positions_m[:-1]) / 4
    accused = [each.subject for each in quality(changed(late, positions_m=followed_m)).suspicions]
    assert accused == ["ring_1"]


def test_a_jump_that_falls_as_things_do_is_not_suspicious(walk: FinishedRecording) -> None:
    assert len(flights(jumping(walk, 9.81).main)) == 2
    assert quality(jumping(walk, 9.81)).suspicions == ()
    # Half-way to 30 frames a second where there were 25.
    assert quality(jumping(walk, 1.08**2 * 9.81)).suspicions == ()


def test_who_stands_on_tiptoe_or_walks_on_a_stage_does_not_jump(walk: FinishedRecording) -> None:
    assert flights(walk.main) == []
    # 10 cm high, for half a second: as a jump would be, and as high as heels can be raised.
    assert flights(jumping(walk, 3.2).main) == []
    stage_m = walk.main.positions_m + np.where(walk.main.time_s > 5, 0.4, 0.0)[:, None, None] * (0.0, 0.0, 1.0)
    assert flights(changed(walk, positions_m=stage_m).main) == []


@pytest.mark.parametrize(
    ("plant", "severity", "is_of_calibration"),
    [
        (other_calibration, Severity.WRONG, True),
        (noisy_detections, Severity.NOTE, False),
    ],
)
def test_noise_is_no_wrong_calibration(
    walk: FinishedRecording,
    plant: Callable[[FinishedRecording], FinishedRecording],
    severity: Severity,
    is_of_calibration: bool,
) -> None:
    (found,) = large_errors(plant(walk))
    assert found.severity is severity
    assert ("alibrat" in found.remedy) == is_of_calibration


ARM = ("left_elbow", "left_wrist")


def hallucinated(walk: FinishedRecording, n_cameras: int, *joints: str) -> list[str]:
    """What is said of joints that so many of four cameras show in places of their own."""
    visibility = np.array(walk.main.visibility)
    visibility[:270, :n_cameras, [walk.main.skeleton.index(joint) for joint in joints]] = 0.1
    return [
        each.reason
        for each in quality(changed(replace(walk, observations={}), visibility=visibility)).suspicions
        if each.code == "misplaced-joint"
    ]


@pytest.mark.parametrize("n_cameras", [pytest.param(3, marks=pytest.mark.slow), 4])
def test_an_arm_on_which_no_cameras_agree_is_one_finding_of_the_joints(walk: FinishedRecording, n_cameras: int) -> None:
    (reason,) = hallucinated(walk, n_cameras, *ARM)
    assert reason.startswith(
        "no two cameras agree where left elbow and left wrist are: they contradict each other in 90"
    )


def test_joints_of_one_limb_in_one_camera_are_one_finding(walk: FinishedRecording) -> None:
    (reason,) = hallucinated(walk, 1, *ARM)
    assert "camera ring_0 shows left elbow and left wrist elsewhere than the others do in 90 %" in reason


def test_limbs_in_one_camera_are_one_finding(walk: FinishedRecording) -> None:
    (reason,) = hallucinated(walk, 1, *ARM, "right_knee", "head")
    assert "camera ring_0 shows right knee (90 %), head (90 %) and left elbow and left wrist (90 %) elsewhere" in reason


@pytest.mark.parametrize("axis", [0, 1])
def test_who_turns_a_cartwheel_or_rolls_exchanges_no_sides(walk: FinishedRecording, axis: int) -> None:
    """A turn in one and a half seconds, about an axis over the floor: the shoulders are above each other on the way."""
    turn_rad = np.clip((walk.main.time_s - 4) / 1.5, 0, 1) * 2 * np.pi
    a, b = (1, 2) if axis == 0 else (2, 0)
    standing_m = walk.main.positions_m[0] - walk.main.positions_m[0, 0]
    standing_m = (standing_m + standing_m[walk.main.skeleton.mirror] * (1, -1, 1)) / 2  # from right to left is along y
    offset_m = np.repeat(standing_m[None], walk.main.n_frames, axis=0)
    turned_m = offset_m.copy()
    turned_m[..., a] = np.cos(turn_rad)[:, None] * offset_m[..., a] - np.sin(turn_rad)[:, None] * offset_m[..., b]
    turned_m[..., b] = np.sin(turn_rad)[:, None] * offset_m[..., a] + np.cos(turn_rad)[:, None] * offset_m[..., b]
    cartwheel = changed(replace(walk, observations={}), positions_m=walk.main.positions_m[:, :1] + turned_m)
    assert not [each.reason for each in quality(cartwheel).suspicions if "change places" in each.reason]


def test_observations_of_another_recording_are_refused(walk: FinishedRecording) -> None:
    with pytest.raises(ValueError, match="observations of person 0 have frames, cameras, joints"):
        replace(walk, observations={0: walk.observations[0].frames(slice(0, 9))})
    with pytest.raises(ValueError, match="nobody"):
        FinishedRecording("empty", {})


def test_outliers_are_on_the_bad_side() -> None:
    rng = np.random.default_rng(1)
    columns = {"reprojection_px": rng.normal(5, 0.5, 40), "seen_share": rng.normal(0.95, 0.01, 40)}
    columns["reprojection_px"][3], columns["reprojection_px"][5], columns["seen_share"][7] = 20.0, 1.0, 0.4
    found = outliers(columns)
    assert (found[3].measure, found[7].measure) == ("reprojection_px", "seen_share")
    assert sorted(range(40), key=lambda n: -found[n].z)[:2] == [7, 3]
    assert found[5].z < 3.5  # far smaller than usual is no fault
    # Scale by the median absolute deviation: the outliers do not widen it.
    assert np.nanmedian(np.abs(robust_z(columns["reprojection_px"]))) == pytest.approx(1 / 1.4826, rel=1e-6)


def test_equal_or_few_recordings_have_no_outliers() -> None:
    assert all(outlier.z == 0 for outlier in outliers({"sigma_mm": np.full(6, 3.0)}))
    assert all(outlier.z == 0 for outlier in outliers({"sigma_mm": np.array([1.0, 2.0, 30.0])}))
    assert outliers({"sigma_mm": np.array([3.0, 3.0, 3.0, 3.0, 3.01])})[-1].z < 3.5
