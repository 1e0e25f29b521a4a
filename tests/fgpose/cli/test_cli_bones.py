"""--bones of smooth and track: the bone lengths of an earlier result of the same person."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fgpose
from fgpose.cli import main
from fgpose.io.skeletons import load_skeleton

pytestmark = pytest.mark.usefixtures("without_search_for_faults")
COMMANDS = ("smooth", "track")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten frames of a real recording, and what an earlier run made of them."""
    folder = tmp_path_factory.mktemp("recording")
    rig, observations = fgpose.files.load_recording("balance_openpose")
    fgpose.save_rig(rig, folder / "Calib.toml")
    fgpose.files.save_observations(observations.frames(slice(0, 10)), folder / "walk.npz")
    result = fgpose.smooth(observations.frames(slice(20, 30)), rig)
    assert result.bone_lengths_m is not None
    fgpose.save_trajectory(result, folder / "earlier.npz")
    fgpose.save_trajectory(replace(result, bone_lengths_m=0.6 * result.bone_lengths_m), folder / "child.npz")
    fgpose.save_trajectory(result, folder / "markers.trc")
    fgpose.files.save_people({0: result, 1: result}, folder / "people.parquet")
    coco = load_skeleton("coco_17")
    arrays = result.time_s, result.positions_m[:, : coco.n_joints], result.status[:, : coco.n_joints]
    of_others = fgpose.Trajectory(coco, *arrays, bone_lengths_m=np.full(coco.n_lengths, 0.3))
    fgpose.save_trajectory(of_others, folder / "coco.npz")
    return folder


@pytest.fixture
def arguments(folder: Path, tmp_path: Path) -> list[str]:
    source = [str(folder / "walk.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b"]
    return [*source, "-o", str(tmp_path / "out"), "--formats", "npz"]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_result_begins_with_bones_that_are_known(
    command: str, folder: Path, arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, *arguments, "--bones", str(folder / "earlier.npz")]) == 0
    printed = capsys.readouterr()
    assert "other-bones" not in printed.out + printed.err
    given = fgpose.load_trajectory(folder / "earlier.npz").bones
    assert given is not None
    for path in (tmp_path / "out").glob("*.npz"):
        found = fgpose.load_trajectory(path)
        assert found.bone_length_sigma_m is not None
        known = found.bone_length_sigma_m < 1  # online, a bone that is never complete is not estimated
        # Ten frames tell hardly more, and are weighed without what lasts of their errors, but stated with it.
        assert (found.bone_length_sigma_m[known] <= 1.05 * given.sigma_m[known]).all()


@pytest.mark.filterwarnings("ignore:the bones that were given are somebody else's")
@pytest.mark.parametrize("command", COMMANDS)
def test_bones_of_somebody_else_are_said(
    command: str, folder: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, *arguments, "--bones", str(folder / "child.npz")]) == 0
    assert "mm as seen" in (printed := capsys.readouterr().out)
    assert "[other-bones]" in printed


@pytest.mark.parametrize(
    ("file", "more", "message"),
    [
        ("markers.trc", (), "markers.trc: it has no bone lengths; parquet and npz files of smooth and track have them"),
        ("coco.npz", (), "coco.npz: its bones are of skeleton coco_17, the recording has body_25b"),
        ("people.parquet", (), "people.parquet: one trajectory is needed, the file holds those of people 0, 1"),
        ("earlier.npz", ("--people", "all"), "earlier.npz: whose bones are these? There are several people"),
        ("none.npz", (), "none.npz"),
    ],
)
def test_what_has_no_bones_of_one_person_is_one_error(
    file: str, more: tuple[str, ...], message: str, folder: Path, arguments: list[str], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert main(["smooth", *arguments, *more, "--bones", str(folder / file)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert message in lines[-1]
    assert not [*(tmp_path / "out").glob("*")]


def test_a_result_does_not_replace_the_bones_that_it_is_made_from(
    folder: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    replaces = [*arguments[:-4], "-o", str(folder), "--name", "earlier", "--formats", "npz"]
    assert main(["smooth", *replaces, "--bones", str(folder / "earlier.npz")]) == 2
    assert "would replace an input" in capsys.readouterr().err
