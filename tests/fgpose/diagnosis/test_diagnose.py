"""The diagnosis of recordings, of results, and of what they carry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.cli import main
from fgpose.diagnosis import Code, Severity
from fgpose.diagnosis.camera_checks import few_cameras
from fgpose.diagnosis.diagnose import INPUT_CHECKS
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.steps import Steps
from fgpose.io.trajectories import load_origin
from fgpose_benchmarks.synthetic import Scene
from fgpose_benchmarks.synthetic.rig import look_at
from tests.fgpose.diagnosis.damaged import SKELETON, motion_m
from tests.wrong_rigs import turned


def test_nothing_is_found_where_nothing_is_wrong(walking_scene: Scene) -> None:
    diagnosis = fgpose.diagnose(walking_scene.observations, walking_scene.rig)
    assert diagnosis.worst in (None, Severity.NOTE)
    assert set(diagnosis.not_judged) == {"frame rate", "clocks and poses over time", "lenses"}  # it is short


def test_each_check_is_a_step(walking_scene: Scene) -> None:
    told: list[tuple[int, int]] = []
    fgpose.diagnose(
        walking_scene.observations, walking_scene.rig, progress=lambda done, total: told.append((done, total))
    )
    n = sum(map(len, INPUT_CHECKS.values()))
    assert told == [(k + 1, n) for k in range(n)]


def test_a_step_may_be_made_of_several() -> None:
    told: list[tuple[int, int]] = []
    steps = Steps(lambda done, total: told.append((done, total)))
    steps.expect(3)
    steps.one()
    steps.part(2, 5)
    steps.part(3, 10)  # something was found, so that there is more to be done
    steps.one()
    steps.one()
    assert told == [(1, 3), (3, 8), (4, 13), (12, 13), (13, 13)]


def walk_before(others_deg: tuple[float, ...], truth_m: np.ndarray) -> FinishedRecording:
    """Cameras at four metres from the origin, by their angles from the first of them."""
    angles = np.deg2rad([0.0, *others_deg])
    places_m = [np.array([4 * np.cos(angle), 4 * np.sin(angle), 1.0]) for angle in angles]
    K = np.array([[1400.0, 0, 960], [0, 1400.0, 540], [0, 0, 1]])
    cameras = (
        fgpose.Camera(f"cam{c}", (1920, 1080), K, look_at(at_m, np.array([0, 0, 1.0])), np.zeros(0))
        for c, at_m in enumerate(places_m)
    )
    rig = fgpose.CameraRig(tuple(cameras))
    status = np.full(truth_m.shape[:2], fgpose.Status.OBSERVED)
    walk = fgpose.Trajectory(SKELETON, np.arange(len(truth_m)) / 30, truth_m, status, camera_names=rig.names)
    return FinishedRecording("walk", {0: walk}, rig)


@pytest.mark.parametrize(
    ("others_deg", "severity"), [((5,), Severity.DOUBTFUL), ((60,), Severity.NOTE), ((4, 8, 12), Severity.DOUBTFUL)]
)
def test_cameras_side_by_side_are_doubtful(others_deg: tuple[float, ...], severity: Severity) -> None:
    (finding,) = few_cameras(walk_before(others_deg, motion_m()))
    assert (finding.code, finding.severity) == (Code.FEW_CAMERAS, severity)
    if severity is Severity.DOUBTFUL:
        # People who walk about are not at the origin.
        assert finding.numbers["apart_deg"] == pytest.approx(others_deg[-1], abs=2)


def test_who_comes_near_to_cameras_side_by_side_goes_away_again() -> None:
    truth_m = motion_m()
    truth_m[: round(0.6 * len(truth_m))] += np.array([2.0, 0.0, 0.0])  # there they are 24 degrees apart
    (finding,) = few_cameras(walk_before((12,), truth_m))
    assert finding.severity is Severity.DOUBTFUL
    assert finding.numbers["share"] == pytest.approx(0.4, abs=0.05)


def test_what_cannot_be_judged_is_said(walking_scene: Scene) -> None:
    two = walking_scene.rig.names[:2]
    seen, rig = walking_scene.observations.subset(two), walking_scene.rig.subset(two)
    diagnosis = fgpose.diagnose(seen, rig)
    assert diagnosis.not_judged
    assert not set(diagnosis.judged) & set(diagnosis.not_judged)


def test_a_short_recording_tells_nothing_of_what_changes(walking_scene: Scene) -> None:
    short = walking_scene.observations.frames(slice(0, 60))
    said = fgpose.diagnose(short, walking_scene.rig).not_judged
    assert said == {
        "frame rate": "no wrist or ankle is seen to move for long enough",
        "clocks and poses over time": "it lasts less than 8 s",
        "lenses": "it lasts less than 18 s",
    }


def test_few_frames_are_why_nothing_is_judged(walking_scene: Scene) -> None:
    """The cameras agree, and all limbs are seen."""
    one = fgpose.diagnose(walking_scene.observations.first_frames(1), walking_scene.rig).not_judged
    assert {one["clocks and poses over time"], one["skeleton"], one["unit"]} == {"it has one frame"}
    four = fgpose.diagnose(walking_scene.observations.first_frames(4), walking_scene.rig).not_judged
    assert {four["skeleton"], four["unit"]} == {"it has 4 frames"}


@pytest.mark.slow
def test_a_short_recording_advises_no_refinement_that_is_refused(walking_scene: Scene) -> None:
    rig = walking_scene.rig.subset(walking_scene.rig.names[:3])
    short, name = walking_scene.observations.subset(rig.names).frames(slice(0, 60)), rig.names[1]
    moved = turned(rig, 1, 0.0, right_m=0.4)  # further than a bump
    found = [each for each in fgpose.diagnose(short, moved).findings if each.camera == name]
    assert found
    assert not any("--refine-calibration" in each.remedy for each in found)


def test_a_result_is_looked_at_too(walking_scene: Scene) -> None:
    smoothed = fgpose.smooth(walking_scene.observations, walking_scene.rig)
    assert "result" in fgpose.diagnose(walking_scene.observations, walking_scene.rig, smoothed).judged


@pytest.fixture
def damaged(walking_scene: Scene, tmp_path: Path) -> list[str]:
    """Arguments of a second whose left and right were exchanged in all views."""
    seen = walking_scene.observations.frames(slice(0, 30))
    mirror = seen.skeleton.mirror
    exchanged = replace(seen, points2d_px=seen.points2d_px[:, :, mirror], points3d_m=None, covariance3d_m2=None)
    fgpose.save_rig(walking_scene.rig, tmp_path / "rig.toml")
    fgpose.files.save_observations(exchanged, tmp_path / "walk.npz")
    return [str(tmp_path / "walk.npz"), "--rig", str(tmp_path / "rig.toml"), "--skeleton", seen.skeleton.name]


def test_smooth_says_it_and_its_file_carries_it(
    damaged: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["smooth", *damaged, "-o", str(tmp_path / "out"), "--formats", "parquet"]) == 0
    printed = capsys.readouterr().out
    assert "THIS RESULT IS PROBABLY WRONG" in printed.splitlines()[-1]
    origin = load_origin(tmp_path / "out" / "walk.parquet")
    assert origin is not None
    assert Severity.WRONG in [finding.severity for finding in origin.findings]
    assert all(f"[{finding.code}]" in printed for finding in origin.findings)


def test_a_result_is_not_lost_where_the_diagnosis_fails(
    damaged: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr("fgpose.pipeline.diagnosed.diagnose", fail)
    assert main(["smooth", *damaged, "-o", str(tmp_path / "out"), "--formats", "parquet"]) == 0
    assert "Not judged: anything (the diagnosis itself has failed" in capsys.readouterr().out
    assert (tmp_path / "out" / "walk.parquet").exists()


def test_strict_ends_with_three(damaged: list[str], tmp_path: Path) -> None:
    assert main(["smooth", *damaged, "-o", str(tmp_path / "out"), "--formats", "parquet", "--strict"]) == 3
    assert (tmp_path / "out" / "walk.parquet").exists()


def test_nothing_determined_is_an_error_and_no_file(
    walking_scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen = walking_scene.observations
    # Pixels of images four times as large lie outside what any two cameras could see at one place.
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[:, 1:], confidence[:, 1:] = np.nan, 0.0
    alone = fgpose.Observations(
        seen.skeleton, seen.time_s, points2d_px, confidence, camera_names=walking_scene.rig.names
    )
    fgpose.files.save_observations(alone, tmp_path / "walk.npz")
    fgpose.save_rig(walking_scene.rig, tmp_path / "rig.toml")
    arguments = ["--rig", str(tmp_path / "rig.toml"), "--skeleton", seen.skeleton.name]
    out = ["-o", str(tmp_path / "out"), "--formats", "parquet"]
    assert main(["smooth", str(tmp_path / "walk.npz"), *arguments, *out]) == 2
    assert "no joint is determined in any frame" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))
    assert Code.NEVER_SEEN in [finding.code for finding in fgpose.diagnose(alone, walking_scene.rig).findings]
