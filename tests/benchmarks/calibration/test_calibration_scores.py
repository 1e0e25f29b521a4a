"""Scores of rigs that differ from the true one by something known, and what the report makes of scores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fgpose.calibration.from_people.calibrate import Parts
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, CameraSigmas, Grade
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose_benchmarks.calibration.figures import FIGURES, group_of
from fgpose_benchmarks.calibration.methods import ABLATIONS, METHODS, CalibrationChain
from fgpose_benchmarks.calibration.recording import CalibrationResult, KnownRigRecording
from fgpose_benchmarks.calibration.report import write_report
from fgpose_benchmarks.calibration.scores import MOST_SIGMAS, CalibrationScore, score_calibration
from fgpose_benchmarks.calibration.variants import find_variant, record
from fgpose_benchmarks.comparison.scores import load_scores, save_scores
from fgpose_benchmarks.synthetic import SimulatedClocks
from tests.wrong_rigs import in_another_world, turned

OURS = METHODS[-1]
SHORT = replace(find_variant("walk_ring_4"), duration_s=2.0)


@pytest.fixture(scope="module")
def recording() -> KnownRigRecording:
    return record(SHORT, "test_1")


@pytest.fixture(scope="module")
def apart() -> KnownRigRecording:
    return record(replace(SHORT, clocks=SimulatedClocks(max_start_s=1.0)), "test_1")


def stated(n_cameras: int, position_m: float = 0.02, direction_deg: float = 0.3) -> CameraSigmas:
    each = np.ones(n_cameras)
    return CameraSigmas(position_m * each, direction_deg * each, 0 * each, 0.001 * each, 0.01, 0.5, 0.01)


def result(rig: CameraRig | None, sigmas: CameraSigmas | None = None) -> CalibrationResult:
    return CalibrationResult(rig, "good", (), sigmas, True, 1.5)


def elsewhere(rig: CameraRig, scale: float = 1.0, tilt_deg: float = 0.0) -> CameraRig:
    """Turned about the vertical and moved over the floor; then larger, and tilted about x."""
    R = Rotation.from_euler("zx", [0.7, np.deg2rad(tilt_deg)]).as_matrix()
    return in_another_world(rig, scale, R, scale * R @ [1.0, -2.0, 0.0])


def test_the_true_rig_in_its_own_world_is_perfect(recording: KnownRigRecording):
    scored = score_calibration(recording, result(elsewhere(recording.rig), stated(4)), OURS)
    assert max(scored.position_mm) < 1e-6
    assert max(scored.rotation_deg) < 1e-5
    assert scored.induced_mm < 0.01  # undistortion ends at 1e-4 px
    assert (scored.scale_percent, scored.vertical_deg, scored.floor_mm) == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)
    # The smoother's minimum is the same, in whatever world; it stops at steps of its tolerance.
    assert (scored.ratio, scored.metric_ratio) == pytest.approx((1.0, 1.0), abs=0.01)
    assert (scored.focal_percent, scored.start_frames, scored.right_peak) == ((), (), ())
    assert max(*scored.position_sigmas, *scored.direction_sigmas) < 1e-3
    assert scored.is_right
    assert not scored.has_failed


def test_a_wrong_size_shows_in_what_is_metric_alone(recording: KnownRigRecording):
    scored = score_calibration(recording, result(elsewhere(recording.rig, 1.1, 2.0)), OURS)
    assert scored.scale_percent == pytest.approx(10.0)
    assert scored.vertical_deg == pytest.approx(2.0)
    assert scored.ratio == pytest.approx(1.0, abs=0.02)  # 5 mm more or less in process noise and priors
    assert scored.metric_ratio > 1.3  # a tenth of the metre around the middle of a body, beside 20 mm
    assert max(scored.position_mm) < 1e-6
    assert scored.position_sigmas == ()


@pytest.mark.slow
def test_a_turned_camera_is_a_failure_beyond_five_degrees(recording: KnownRigRecording):
    right, between, failed = (
        score_calibration(recording, result(turned(recording.rig, 1, angle), stated(4)), OURS)
        for angle in (1.0, 3.0, 6.0)
    )
    assert [max(scored.rotation_deg) for scored in (right, between, failed)] == pytest.approx([1.0, 3.0, 6.0])
    assert [scored.is_right for scored in (right, between, failed)] == [True, False, False]
    assert [scored.has_failed for scored in (right, between, failed)] == [False, False, True]
    # 0.75 to 1 of the degree is left after the alignment; 0.3 degrees were stated.
    assert 0.7 / 0.3 < right.direction_sigmas[1] < 1.0 / 0.3
    assert failed.induced_mm > right.induced_mm > 0.5
    assert failed.ratio > 1.0


def test_starts_count_in_frames_of_the_slowest_camera(apart: KnownRigRecording):
    off_s = np.array([0.0, 0.01, -0.02, 0.4])
    rig = apart.rig.with_time_offsets(apart.rig.time_offsets_s + off_s + 5.0)
    scored = score_calibration(apart, result(rig, stated(4)), OURS)
    assert scored.start_frames == pytest.approx((0.3, -0.6, 12.0))
    assert scored.right_peak == (1.0, 1.0, 0.0)
    assert scored.has_failed
    assert np.isnan(scored.ratio)
    assert scored.start_sigmas == pytest.approx((10.0, 20.0, MOST_SIGMAS))
    true = score_calibration(apart, result(apart.rig), OURS)
    assert true.ratio == pytest.approx(1.0, abs=0.01)


def test_a_camera_that_is_left_out_has_no_start(apart: KnownRigRecording):
    scored = score_calibration(apart, result(apart.rig.subset(("cam_1", "cam_2", "cam_4")), stated(3)), OURS)
    assert scored.right_peak == (1.0, 1.0, 0.0)
    assert len(scored.position_mm) == 3
    assert scored.n_cameras == 4
    assert scored.ratio == pytest.approx(1.0, abs=0.05)  # of three cameras on both sides


def test_focal_lengths_count_where_they_were_unknown():
    recording = record(replace(find_variant("shared_equal_4"), duration_s=1.0), "test_1")
    cameras = tuple(replace(camera, K=np.diag([1.02, 1.02, 1.0]) @ camera.K) for camera in recording.rig.cameras)
    sigmas = replace(stated(4), focal=np.full(4, 0.01))
    scored = score_calibration(recording, result(CameraRig(cameras), sigmas), OURS)
    assert scored.focal_percent == pytest.approx((2.0,) * 4)
    assert scored.focal_sigmas == pytest.approx((2.0,) * 4)


def calibrated(rig: CameraRig, recording: KnownRigRecording, *findings: CalibrationFinding) -> CalibratedFromPeople:
    residual_px = np.zeros(recording.told.confidence.shape)
    joints_m = recording.joints_m
    return CalibratedFromPeople(rig, stated(4), recording.told, joints_m, residual_px, findings, "stature 1.78 m")


def test_the_chain_is_given_what_a_user_gives(recording: KnownRigRecording):
    seen: dict[str, object] = {}

    def stand_in(people: PeopleObservations, intrinsics: CameraRig, **given: object) -> CalibratedFromPeople:
        seen.update(given, people=people, intrinsics=intrinsics)
        return calibrated(
            recording.rig, recording, CalibrationFinding("cam_2", Grade.COARSE, "seen on one line", "walk across")
        )

    found = CalibrationChain(Parts(bias=False), stand_in)(recording)
    assert seen == {
        "people": recording.people,
        "intrinsics": recording.intrinsics,
        "focal": "known",
        "stature_m": recording.given.stature_m,
        "distances": (),
        "synchronised": True,
        "parts": Parts(bias=False),
    }
    assert (found.rig, found.outcome, found.reasons) == (recording.rig, "coarse", ("cam_2: seen on one line",))
    assert score_calibration(recording, found, OURS).is_right


def test_a_chain_that_refuses_has_failed(recording: KnownRigRecording):
    def stand_in(*_: object, **__: object) -> CalibratedFromPeople:
        raise ValueError("one camera")

    found = CalibrationChain(calibrate=stand_in)(recording)
    scored = score_calibration(recording, found, OURS)
    assert (scored.outcome, scored.reasons, scored.position_mm) == ("failed", ("one camera",), ())
    assert scored.has_failed
    assert np.isnan(scored.induced_mm)


def test_methods_and_ablations_are_named_once():
    for methods in (METHODS, ABLATIONS):
        names = [method.name for method in methods]
        assert len(set(names)) == len(names)


PERFECT = CalibrationScore(
    variant="walk_ring_4",
    clip="test_1",
    method="fgpose",
    group="ours",
    outcome="good",
    reasons=(),
    n_cameras=4,
    position_mm=(10.0, 20.0, 30.0, 40.0),
    rotation_deg=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
    induced_mm=4.0,
    smoothed_mm=20.0,
    ratio=1.02,
    metric_ratio=1.1,
    scale_percent=-1.0,
    vertical_deg=0.4,
    floor_mm=-8.0,
    focal_percent=(),
    start_frames=(),
    right_peak=(),
    position_sigmas=(0.5, 1.0, 1.5, 2.5),
    direction_sigmas=(0.5, 0.5, 0.5, 0.5),
    focal_sigmas=(),
    start_sigmas=(),
    time_s=30.0,
)


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def row(path: Path, start: str) -> list[str]:
    return [
        cell.strip() for cell in next(each for each in lines(path) if each.startswith(f"| {start}")).split("|")[1:-1]
    ]


def test_figures_are_met_or_not(tmp_path: Path):
    worse = replace(PERFECT, clip="test_2", position_mm=(70.0,) * 4, scale_percent=2.0)
    path = write_report([PERFECT, worse], tmp_path, "fgpose benchmark calibrate")
    assert row(path, "1. position of a camera, mm: median")[1:] == ["≤ 30", "55.0", "**no**", "2"]
    assert row(path, "1. rotation between cameras, degrees: median")[1:] == ["≤ 0.7", "0.35", "yes", "2"]
    # Signs do not cancel: the median of 1 and 2.
    assert row(path, "3. scale from stature, %: median")[1:] == ["≤ 1.5", "1.50", "yes", "2"]
    # Nothing was measured of it.
    assert row(path, "4. shared focal length, %: median")[1:] == ["≤ 1.5", "–", "–", "0"]
    # Seven of eight, twice.
    assert row(path, "6. errors within two stated sigmas, %")[1:] == ["≥ 90", "87.5", "**no**", "2"]
    assert row(path, "position ")[1:] == ["8", "50.0", "75.0"]
    assert row(path, "walk ring 4 | fgpose")[2:5] == ["55 / 70", "0.35 / 0.60", "4.0 / 4.0"]
    assert "    fgpose benchmark calibrate" in lines(path)


def test_failures_that_are_called_good_are_named(tmp_path: Path):
    unnoticed = replace(PERFECT, variant="spot_ring_4", rotation_deg=(0.1, 12.0))
    noticed = replace(unnoticed, clip="test_2", outcome="failed", reasons=("rig: one place",))
    alarm = replace(PERFECT, clip="test_3", outcome="coarse", reasons=("cam_1: few frames",))
    path = write_report([PERFECT, unnoticed, noticed, alarm], tmp_path, "")
    assert row(path, "6. failures flagged, %")[2] == "50.0"
    assert row(path, "6. false alarms, %")[2] == "50.0"
    assert row(path, "right: ")[1:] == ["1", "1", "0"]
    assert row(path, "failed: ")[1:] == ["1", "0", "1"]
    named = [line for line in lines(path) if line.startswith("- spot ring 4, ") or line.startswith("- walk ring 4, ")]
    assert named == [
        "- spot ring 4, test_1, fgpose: 12.0 degrees, good",
        "- walk ring 4, test_3, fgpose: 0.6 degrees, coarse: cam_1: few frames",
    ]


def test_wrong_starts_count_by_camera_and_by_recording(tmp_path: Path):
    right = replace(PERFECT, variant="starts_ring_4", start_frames=(0.1, -0.2, 0.05), right_peak=(1.0, 1.0, 1.0))
    wrong = replace(right, clip="test_2", start_frames=(0.1, 16.0, 0.1), right_peak=(1.0, 0.0, 1.0), outcome="failed")
    path = write_report([right, wrong], tmp_path, "")
    assert row(path, "5. starts at the right peak, %")[2:] == ["83.3", "**no**", "2"]
    assert row(path, "5. recordings with others flagged, %")[2] == "100.0"
    assert row(path, "5. right starts, frames: worst")[2] == "0.20"
    assert "5 of 6" in row(path, "starts ring 4 | fgpose")


def test_baselines_have_lines_but_no_verdict(tmp_path: Path):
    baseline = replace(PERFECT, method="Procrustes of 3D", group="baseline", outcome="unjudged", scale_percent=np.nan)
    path = write_report([baseline, PERFECT], tmp_path, "")
    assert row(path, "walk ring 4 | Procrustes of 3D")[0] == "walk ring 4"
    assert row(path, "1. position of a camera, mm: median")[4] == "1"
    with pytest.raises(ValueError, match="there are no scores"):
        write_report([], tmp_path, "")


def test_every_figure_of_the_list_is_there():
    assert [figure.number for figure in FIGURES] == sorted(figure.number for figure in FIGURES)
    assert {figure.number for figure in FIGURES} == set(range(1, 9))
    assert group_of("walk_ring_4") == "walk"
    assert group_of("none") is None


def test_scores_survive_the_disk(tmp_path: Path):
    before = [PERFECT, replace(PERFECT, clip="test_2", reasons=("why",), ratio=np.nan)]
    save_scores(before, tmp_path / "scores.json")
    after = load_scores(tmp_path / "scores.json", CalibrationScore)
    assert after[0] == PERFECT
    assert after[1].reasons == ("why",)
    assert np.isnan(after[1].ratio)
