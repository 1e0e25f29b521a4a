"""What is said of the axis that is up where somebody gives it."""

from __future__ import annotations

from pathlib import Path

import pytest
from finished_walk import finished_walk

from fgpose.cli import main
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.io.keypoints import save_observations
from fgpose.io.origin import Origin
from fgpose.io.studies.results import write_rows
from fgpose.io.trajectories import save_trajectory
from fgpose.report import FinishedRecording
from fgpose.report.quality import quality
from fgpose.report.results import load_finished
from fgpose.report.study_results import load_study
from fgpose.skeleton import Skeleton

GIVEN_Y = "--world-up y was given, but the body stands along +z of the world, not along +y"
FOUND = Finding(Code.WORLD_UP, Severity.NOTE, "the body stands along +x of the world, so +x is taken to be up", "", 0.3)
pytestmark = pytest.mark.usefixtures("without_search_for_faults")


@pytest.mark.filterwarnings("ignore:.*world-up y was given:UserWarning")
@pytest.mark.parametrize("with_keypoints", [True, False])
def test_only_the_axis_that_is_given_is_judged(
    with_keypoints: bool, rig: CameraRig, skeleton: Skeleton, tmp_path: Path
) -> None:
    walk = finished_walk(rig, skeleton)
    result = tmp_path / "walk.parquet"
    save_trajectory(walk.main, result, "z", Origin((), rig, findings=(FOUND,)))
    save_observations(walk.observations[0], tmp_path / "seen.npz")
    keypoints = tmp_path / "seen.npz" if with_keypoints else None
    for up, expected in (("y", [GIVEN_Y]), ("z", []), ("auto", [FOUND.reason])):
        found = quality(load_finished(result, keypoints=keypoints, world_up=up)).suspicions
        assert [each.reason for each in found if each.code is Code.WORLD_UP] == expected, up


def study(folder: Path, recording: FinishedRecording, world_up: str) -> None:
    """As fgpose study leaves it: one recording, done."""
    save_trajectory(recording.main, folder / "recordings" / "S01" / "A" / "walk" / "motion.parquet")
    metadata = {"fgpose.study": "walks", "fgpose.world_up": world_up}
    write_rows([{"recording": "S01/A/walk", "status": "done"}], folder / "quality.parquet", metadata)


@pytest.mark.filterwarnings("ignore:.*world-up x was given:UserWarning")
def test_pages_of_a_study_have_its_axis_up(rig: CameraRig, skeleton: Skeleton, tmp_path: Path) -> None:
    pytest.importorskip("bokeh")
    study(tmp_path, finished_walk(rig, skeleton), "x")
    load_study(tmp_path)
    page = (tmp_path / "recordings" / "S01" / "A" / "walk" / "report.html").read_text()
    assert "turned by the rotation (0 1 0, 0 0 1, 1 0 0) so that z is up" in page


def test_a_study_says_itself_what_is_up(
    rig: CameraRig, skeleton: Skeleton, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("bokeh")
    study(tmp_path, finished_walk(rig, skeleton), "up")
    assert main(["report", str(tmp_path), "--world-up", "z"]) == 2
    assert "a study says what is up in its file (steps.world_up)" in capsys.readouterr().err
    with pytest.raises(ValueError, match=r"quality\.parquet: the axis that points up is none of auto, x, .*: 'up'"):
        load_study(tmp_path)
