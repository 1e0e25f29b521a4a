"""Studies of videos, and of cameras without a calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from calibrated_walks import calibrated

from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade
from fgpose.calibration.synchronisation import Synchronised
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.trajectories import load_trajectory
from fgpose.people_observations import PeopleObservations
from fgpose.report import load_finished
from fgpose.study import Plan, job, load_study, process

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

pytestmark = pytest.mark.usefixtures("without_search_for_faults")
STUDY = """
output = "results"
[data]
videos = "{subject}/{trial}"
calibration = "Calib.toml"
[steps]
angles = false
formats = []
"""
PARAMETERS = '[parameters.monocular]\ndevice = "cuda"\n'
DETECT = '[detect]\ndevice = "cpu"\n'


@pytest.fixture
def video_study(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """One recording of twenty images of three cameras."""
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("fgpose.study.job._network", lambda settings, device, base: squares_network)
    squares.write_all(tmp_path / "data" / "S01" / "walk")
    save_rig(squares.rig, tmp_path / "data" / "Calib.toml")
    file = tmp_path / "data" / "study.toml"
    file.write_text(STUDY)
    return file


@pytest.mark.parametrize(("keys", "opened_on"), [("", "auto"), (PARAMETERS, "cuda"), (PARAMETERS + DETECT, "cpu")])
def test_the_device_of_the_parameters_unless_one_is_given(
    keys: str, opened_on: str, tmp_path: Path, squares_network: SquaresNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = []

    def opened(*_: object, device: str, **__: object) -> SquaresNetwork:
        devices.append(device)
        return squares_network

    monkeypatch.setattr("fgpose.study.job.open_network", opened)
    job._network.cache_clear()
    file = tmp_path / "study.toml"
    file.write_text(STUDY + keys)
    job.network(load_study(file))
    job._network.cache_clear()
    assert devices == [opened_on]


def test_videos_are_detected_once(video_study: Path, squares: SquaresScene, squares_network: SquaresNetwork) -> None:
    study = load_study(video_study)
    (recording,) = Plan(study)
    outcome = process(study, recording)
    assert (outcome.status, outcome.ran) == ("done", ("detect", "estimate", "judge")), outcome.reason
    trajectory = load_trajectory(recording.folder(study.output) / "motion.parquet")
    true_m = np.stack([squares.positions_m(time_s)[0] for time_s in trajectory.time_s.tolist()])
    # Squares are found to half a pixel, 7 mm at 4 m and 300 px.
    assert np.nanmax(np.linalg.norm(trajectory.positions_m - true_m, axis=-1)) < 0.05
    n_images = len(squares_network.seen)
    assert n_images == 60
    video_study.write_text(STUDY + "[parameters.motion]\nmax_unseen_s = 2.0\n")
    assert process(load_study(video_study), recording).ran == ("estimate", "judge")
    assert len(squares_network.seen) == n_images


def test_the_motion_names_its_videos(video_study: Path, squares: SquaresScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of cameras that were calibrated from people, with the verdict."""
    coarse = CalibrationFinding("", Grade.COARSE, "few people", "walk longer")

    def chain(people: PeopleObservations, intrinsics: CameraRig, **given: Any) -> CalibratedFromPeople:
        return calibrated(people, squares.rig, (coarse,))

    monkeypatch.setattr("fgpose.study.steps.calibrate_from_people", chain)
    video_study.write_text(STUDY.replace("angles = false", 'angles = false\ncalibrate = "people"'))
    study = load_study(video_study)
    (recording,) = Plan(study)
    outcome = process(study, recording)
    assert outcome.status == "done", outcome.reason
    finished = load_finished(recording.folder(study.output) / "motion.parquet")
    assert [each.reason for each in finished.findings] == ["few people"]
    assert finished.offset_sigma_s.keys() == set(squares.rig.names[1:])
    assert finished.videos == recording.source
    width, height = squares.rig.cameras[0].size_px
    described = finished.made_from[f"Video {squares.rig.names[0]}"]
    assert f"{width} × {height} px, 20 Hz" in described
    assert finished.observations


def test_videos_that_were_started_by_hand(
    video_study: Path, squares: SquaresScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The starts in the calibration are those of another recording."""
    begins_s: list[float] = []

    def found(people: PeopleObservations, rig: CameraRig) -> Synchronised:
        begins_s.extend(float(people.times_s(name)[0]) for name in rig.names)
        return Synchronised(rig.with_time_offsets(squares.rig.time_offsets_s), np.array([0.0, 2e-3, 2e-3]), ())

    monkeypatch.setattr("fgpose.study.steps.synchronise", found)
    save_rig(squares.rig.with_time_offsets(np.array([0.0, 3.0, -2.0])), video_study.parent / "Calib.toml")
    video_study.write_text(STUDY.replace("angles = false", "angles = false\nsynchronise = true"))
    study = load_study(video_study)
    (recording,) = Plan(study)
    outcome = process(study, recording)
    assert outcome.ran == ("detect", "synchronise", "estimate", "judge"), outcome.reason
    assert begins_s == [0.0, 0.0, 0.0]
    finished = load_finished(recording.folder(study.output) / "motion.parquet")
    assert finished.offset_sigma_s == {squares.rig.names[1]: 2e-3, squares.rig.names[2]: 2e-3}
    assert finished.main.n_frames == 20


def test_a_truncated_video_fails(video_study: Path) -> None:
    video = next((video_study.parent / "S01" / "walk").iterdir())
    video.write_bytes(video.read_bytes()[:200])
    study = load_study(video_study)
    (recording,) = Plan(study)
    outcome = process(study, recording)
    assert outcome.status == "failed"
    assert video.name in outcome.reason


def test_a_calibration_from_people_that_fails_says_why(edited: Callable[[str, str], Path]) -> None:
    file = edited("[steps]", '[steps]\ncalibrate = "people"')
    study = load_study(file)
    recording = next(iter(Plan(study)))
    assert recording.calibration is None
    outcome = process(study, recording)
    assert outcome.status == "failed"
    assert "too short to find when the video begins" in outcome.reason
