"""What one command has left is not replaced by another, nor by the same from another recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fgpose
from fgpose.cli import main
from fgpose.io.calibration import CalibrationOrigin, save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.made_by import made_by
from fgpose.io.origin import InputFile, Origin
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import save_people, save_trajectory
from fgpose.observations import Observations
from fgpose.pipeline import Outputs
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import open_recording
from fgpose_benchmarks.synthetic import ring_rig, walking

STICK = Skeleton("stick", ("hip", "knee"), bones=((0, 1),), root=(0,))
FORMATS = ("parquet", "npz", "trc", "c3d", "rrd")
SMOOTHED = Origin(step="smooth")


def trajectory() -> Trajectory:
    return Trajectory(STICK, np.arange(3) / 50, np.zeros((3, 2, 3)), np.full((3, 2), Status.OBSERVED))


def outputs(folder: Path, step: str, formats: tuple[str, ...] = FORMATS, **options: Any) -> Outputs:
    return Outputs(folder, "walk", formats, step=step, **options)  # pyrefly: ignore[bad-argument-type]


def write_result(path: Path, origin: Origin = SMOOTHED) -> None:
    if path.suffix == ".rrd":
        open_recording(path, ring_rig(), STICK, made_by=origin.step).close()
    else:
        path.parent.mkdir(exist_ok=True)
        save_trajectory(trajectory(), path, origin=origin)


@pytest.mark.parametrize("extension", FORMATS)
def test_every_format_says_which_command_made_it(tmp_path: Path, extension: str):
    path = tmp_path / f"walk.{extension}"
    write_result(path)
    assert made_by(path) == "smooth"
    outputs(tmp_path, "smooth").check(("smoothed",))
    with pytest.raises(ValueError, match=re.escape(f"{path} is there already, and fgpose smooth made it")) as error:
        outputs(tmp_path, "refine").check(("refined",))
    assert "give another name or folder, as --name walk_refine or -o FOLDER" in str(error.value)


def test_a_file_that_says_nothing_counts_as_those_beside_it(tmp_path: Path):
    (tmp_path / "walk.trc").write_text("somebody's own")
    with pytest.raises(ValueError, match=r"walk\.trc is there already, and it does not say what made it"):
        outputs(tmp_path, "smooth").check(("smoothed",))
    write_result(tmp_path / "walk.parquet")
    outputs(tmp_path, "smooth").check(("smoothed",))


def test_results_of_several_people_count_too(tmp_path: Path):
    save_people({0: trajectory(), 1: trajectory()}, tmp_path / "walk.trc", origin=SMOOTHED)
    with pytest.raises(ValueError, match=r"walk_person0\.trc is there already, and fgpose smooth made it"):
        outputs(tmp_path, "run", ("trc",)).check(("smoothed",))


def test_files_of_earlier_versions_say_the_command(tmp_path: Path):
    write_result(tmp_path / "walk.parquet", Origin(command="fgpose track seen.npz"))
    assert made_by(tmp_path / "walk.parquet") == "track"


@pytest.mark.parametrize("extension", ["parquet", "npz", "trc", "c3d"])
def test_a_result_of_another_recording_stays(tmp_path: Path, extension: str):
    seen, others = tmp_path / "a" / "pose of Jörg", tmp_path / "b" / "pose of Jörg"
    origin = Origin((InputFile("Keypoints", str(seen), 0),), step="smooth")
    write_result(tmp_path / "out" / f"walk.{extension}", origin)
    outputs(tmp_path / "out", "smooth", source=seen).check(("smoothed",))
    with pytest.raises(ValueError, match=r"made from another recording, .*a.pose of Jörg"):
        outputs(tmp_path / "out", "smooth", source=others).check(("smoothed",))
    # Where both have moved, they still belong together.
    (tmp_path / "out").rename(tmp_path / "moved")
    outputs(tmp_path / "moved", "smooth", source=seen).check(("smoothed",))


def test_one_name_is_of_one_recording(tmp_path: Path):
    """Other formats do not come to lie beside the table of another recording."""
    origin = Origin((InputFile("Keypoints", str(tmp_path / "a" / "pose"), 0),), step="smooth")
    write_result(tmp_path / "walk.parquet", origin)
    with pytest.raises(ValueError, match=r"walk\.parquet is there already, made from another recording"):
        outputs(tmp_path, "smooth", ("npz", "trc"), source=tmp_path / "b" / "pose").check(("smoothed",))
    outputs(tmp_path, "smooth", ("npz", "trc"), source=tmp_path / "a" / "pose").check(("smoothed",))


def test_a_path_that_no_line_can_hold_is_left_out(tmp_path: Path):
    for name in ("x" * 250, 'a "quoted" one', "two\nlines"):
        origin = Origin((InputFile("Keypoints", str(tmp_path / name), 0),), step="smooth")
        assert origin.maker(tmp_path) == "smooth"


@pytest.mark.parametrize("extension", [".toml", ".npz"])
def test_calibrations_say_it_too(tmp_path: Path, extension: str):
    path = tmp_path / f"rig{extension}"
    save_rig(ring_rig(), path)
    assert made_by(path) == ""
    save_rig(ring_rig(), path, origin=CalibrationOrigin(step="calibrate"))
    assert made_by(path) == "calibrate"
    assert fgpose.load_rig(path).names == ring_rig().names


@pytest.mark.parametrize("extension", [".npz", ".parquet"])
def test_keypoints_are_of_detect(tmp_path: Path, extension: str):
    path = tmp_path / f"walk{extension}"
    save_observations(Observations(STICK, np.arange(2.0), np.ones((2, 2, 2, 2))), path)
    assert made_by(path) == "detect"


def test_damaged_files_say_nothing(tmp_path: Path):
    for extension in (*FORMATS, "toml"):
        path = tmp_path / f"walk.{extension}"
        path.write_bytes(b"PK\3\4 PAR1 \xff")
        assert made_by(path) == ""


def _smoothed(folder: Path) -> list[str]:
    """The arguments of a command for a recording of which there is a smoothed result."""
    rig, observations = fgpose.files.load_recording("balance_openpose")
    fgpose.files.save_observations(observations.frames(slice(0, 5)), folder / "walk.npz")
    fgpose.save_rig(rig, folder / "Calib.toml")
    source = [str(folder / "walk.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b"]
    to = ["--output", str(folder / "out")]
    for _ in range(2):
        assert main(["smooth", *source, *to, "--formats", "parquet", "npz"]) == 0
    return [*source, *to]


@pytest.mark.usefixtures("without_search_for_faults")
def test_commands_do_not_replace_results_of_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    arguments = _smoothed(tmp_path)
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    monkeypatch.setattr("fgpose.pipeline.run_refine", _never)
    assert main(["refine", *arguments, "--name", "walk", "--formats", "npz"]) == 2
    assert "walk.npz is there already, and fgpose smooth made it: fgpose refine does not" in capsys.readouterr().err
    result = str(tmp_path / "out" / "walk.parquet")
    assert main(["angles", result, "-o", result]) == 2
    assert "walk.parquet would replace an input; choose another file with -o" in capsys.readouterr().err
    monkeypatch.undo()
    assert main(["refine", *arguments, "--formats", "npz"]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"walk.parquet", "walk.npz", "walk_refined.npz"}
    assert {path: path.read_bytes() for path in before} == before


def _never(*arguments: object, **options: object) -> None:
    raise AssertionError("work was done before the outputs were checked")


@pytest.mark.parametrize("arguments", [["calibrate", "pose"], ["synchronise", "pose", "--rig", "Calib.toml"]])
def test_calibrations_of_others_stay(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pose").mkdir()
    save_rig(ring_rig(), tmp_path / "Calib.toml")
    save_rig(ring_rig(), tmp_path / "mine.toml")
    assert main([*arguments, "--skeleton", "body_25b", "--output", "mine.toml"]) == 2
    assert "mine.toml is there already, and it does not say what made it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["board", "chessboard:9x6:25mm", "-o"], "mine.pdf"),
        (["skeletons", "coco_17", "--picture"], "mine.svg"),
    ],
)
def test_drawings_replace_only_drawings(
    arguments: list[str], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for _ in range(2):
        assert main([*arguments, str(tmp_path / "drawn" / name)]) == 0
    assert made_by(tmp_path / "drawn" / name) == arguments[0]
    (tmp_path / name).write_bytes(b"my own")
    assert main([*arguments, str(tmp_path / name)]) == 2
    assert f"{name} is there already, and it does not say what made it" in capsys.readouterr().err
    assert (tmp_path / name).read_bytes() == b"my own"


def test_reports_replace_only_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("bokeh")
    result = tmp_path / "walk.parquet"
    write_result(result)
    (tmp_path / "mine.html").write_text("<html>my own</html>")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for said in ("walk.parquet would replace an input", "mine.html is there already, and it does not say what made it"):
        assert main(["report", str(result), "-o", str(tmp_path / said.partition(" ")[0])]) == 2
        assert said in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    for _ in range(2):
        assert main(["report", str(result), "-o", str(tmp_path / "page")]) == 0
    assert made_by(tmp_path / "page") == "report"


def test_what_the_live_demonstration_advises_replaces_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("fgpose.cli.commands.demo.run_live_demo", lambda *arguments: None)
    assert main(["demo", "--live", "--output", str(tmp_path)]) == 0
    advised = next(line for line in capsys.readouterr().out.splitlines() if "smooth it: " in line)
    assert advised.endswith(f"-o {tmp_path} --name demo_live_smooth")
    write_result(tmp_path / "demo_live.rrd", Origin(step="live"))
    with pytest.raises(ValueError, match="fgpose live made it"):
        Outputs(tmp_path, "demo_live", ("rrd",), step="smooth").check(("smoothed",))


def _walk(path: Path) -> Path:
    positions_m = walking(4, 50.0)
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    save_trajectory(Trajectory(load_skeleton("h36m_17"), np.arange(4) / 50, positions_m, status), path)
    return path


@pytest.mark.parametrize("extension", [".parquet", ".mot", ".c3d", ".csv", ".bvh"])
def test_files_of_angles_are_those_of_a_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], extension: str
) -> None:
    """CSV and BVH have no place for what made them."""
    one, other = str(_walk(tmp_path / "one.parquet")), str(_walk(tmp_path / "other.parquet"))
    path = tmp_path / f"angles{extension}"
    says = extension not in (".csv", ".bvh")
    path.write_text("somebody's own")
    assert main(["angles", one, "-o", str(path)]) == 2
    said = capsys.readouterr().err
    assert f"{path} is there already, and it does not say what made it" in said
    assert "choose another file with -o, or remove it" in said
    assert path.read_text() == "somebody's own"
    path.unlink()
    assert main(["angles", one, "-o", str(path)]) == 0
    assert made_by(path) == ("angles" if says else "")
    assert main(["angles", one, "-o", str(path)]) == (0 if says else 2)
    assert main(["angles", other, "-o", str(path)]) == 2
    assert ("made from another recording" if says else "does not say") in capsys.readouterr().err


def test_a_table_of_angles_beside_a_file_that_says_nothing(tmp_path: Path) -> None:
    result, table, bvh = str(_walk(tmp_path / "one.parquet")), tmp_path / "angles.parquet", tmp_path / "angles.bvh"
    both = ["angles", result, "-o", str(table), "-o", str(bvh)]
    assert [main(both), main(both)] == [0, 0]
    elsewhere = tmp_path / "elsewhere.bvh"
    elsewhere.write_text("somebody's own")
    assert main(["angles", result, "-o", str(table), "-o", str(elsewhere)]) == 2
    assert elsewhere.read_text() == "somebody's own"


def test_angles_of_each_person_are_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = fgpose.load_trajectory(_walk(tmp_path / "one.parquet"))
    save_people({1: walk, 2: walk}, tmp_path / "two.parquet")
    (tmp_path / "walk_person2.mot").write_text("somebody's own")
    assert main(["angles", str(tmp_path / "two.parquet"), "-o", str(tmp_path / "walk.mot")]) == 2
    assert "walk_person2.mot is there already" in capsys.readouterr().err


def test_a_table_of_angles_of_older_versions_is_one(tmp_path: Path) -> None:
    walk = fgpose.load_trajectory(_walk(tmp_path / "one.parquet"))
    fgpose.files.save_kinematics(walk, tmp_path / "angles.parquet", "z")
    assert made_by(tmp_path / "angles.parquet") == "angles"
