"""What a study file says, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fgpose.cli import main
from fgpose.study import load_study
from fgpose.study.pattern import Pattern


def test_what_a_file_does_not_name_keeps_its_default(study_file: Path) -> None:
    study = load_study(study_file)
    assert study.name == "study"
    assert study.root == study_file.parent.resolve()
    assert study.output == study_file.parent / "results"
    assert study.data.keypoints == ("{subject}/{session}/{trial}.npz",)
    assert study.steps.calibrate == "given"
    assert study.resources.workers is None


def test_parameters_and_lists_are_read(edited: Callable[[str, str], Path]) -> None:
    study = load_study(
        edited("[steps]", '[resources]\nworkers = 3\n[parameters.motion]\nmax_unseen_s = 5\n[steps]\npeople = "1"')
    )
    assert study.parameters.motion.max_unseen_s == 5.0
    assert study.resources.workers == 3
    assert study.steps.formats == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("keypoints =", "keypoint =", "unknown key data.keypoint; did you mean data.keypoints?"),
        ("[steps]", "[step]", "unknown key step; did you mean steps?"),
        ("[steps]", '[steps]\ncalibrate = "refined"', "steps.calibrate must be one of given, refine, "),
        ("{trial}.npz", "{trail}.npz", "data.keypoints: unknown placeholder {trail}"),
        ("{trial}.npz", "{trial.npz", "is no pattern"),
        ("{subject}/{session}/{trial}.npz", "a.npz", "has none of {subject}, {session}, {trial}"),
        ("{subject}/{session}/{trial}.npz", "{subject}/A/walk.npz", "data.calibration: {session} is not in"),
        ('calibration = "{subject}/{session}/Calib.toml"', "", "data.calibration is missing"),
        ("h36m_17", "h36m_71", "h36m_71"),
        (
            "[steps]",
            "min_confidence = 70\n[steps]",
            "data.min_confidence: the least confidence must be between 0 and 1",
        ),
        ("[steps]", "min_confidence = -0.1\n[steps]", "data.min_confidence must be a positive number"),
        ("[steps]", 'unit = "parsec"\n[steps]', "data.unit: unit must be auto, "),
        (
            "[steps]",
            "[from_people]\nstature_m = 178\n[steps]",
            "from_people.stature_m: a stature is in metres: 1.78, not",
        ),
        ("[steps]", 'videos = "{trial}"\n[steps]', "a study begins from one of them"),
        ("[steps]", 'layout = "pose2sim"\n[steps]', "the layout pose2sim finds it by itself"),
        ("[steps]", '[detect]\ndevice = "gpu"\n[steps]', "detect.device must be one of auto, cpu, cuda, "),
        ("[steps]", "[resources]\nworkers = 0\n[steps]", "resources.workers must be a positive number"),
        ("[steps]", "[resources]\nworkers = true\n[steps]", "resources.workers must be a int"),
        ("[steps]", "[steps", "study.toml"),
    ],
)
def test_what_is_wrong_is_named(edited: Callable[[str, str], Path], old: str, new: str, message: str) -> None:
    file = edited(old, new)
    with pytest.raises(ValueError, match=r"study\.toml") as error:
        load_study(file)
    assert message in str(error.value)


def test_a_default_can_be_written(edited: Callable[[str, str], Path]) -> None:
    assert load_study(edited("[steps]", "min_confidence = 0\n[steps]")).data.min_confidence == 0.0


def test_the_template_is_a_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "mine.toml"
    assert main(["study", str(file), "--init"]) == 0
    assert load_study(file).data.skeleton == "body_25b"
    # Also what it leaves as a comment, but for what excludes something else.
    text = file.read_text().replace("# videos", "## videos").replace("# layout", "## layout")
    text = text.replace('calibrate = "given"', 'calibrate = "people"')
    file.write_text("\n".join(line.removeprefix("# ") if " = " in line else line for line in text.splitlines()[3:]))
    text = file.read_text()
    for section in ("detect", "from_people", "resources"):
        text = text.replace(f"# [{section}]", f"[{section}]")
    file.write_text(text)
    assert load_study(file).resources.workers == 8
    capsys.readouterr()
    assert main(["study", str(file), "--init"]) == 2
    assert "it is not replaced" in capsys.readouterr().err


def test_a_study_file_names_no_scheduler(study_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a scheduler sends is unpickled: a file from elsewhere would run code."""
    study_file.write_text(study_file.read_text() + '\n[resources]\nscheduler = "tcp://127.0.0.1:9"\n')
    assert main(["study", str(study_file)]) == 2
    said = capsys.readouterr().err
    assert "resources.scheduler: a study file cannot name a scheduler" in said
    assert "--scheduler" in said


def matches(pattern: str, root: Path) -> list[tuple[str, dict[str, str]]]:
    return [(path.relative_to(root).as_posix(), names) for path, names in Pattern(pattern).matches(root)]


def test_patterns_find_names_in_natural_order(tmp_path: Path) -> None:
    for name in ("S10_b/t1.npz", "S2_a/t2.npz", "S2_a/t10.npz", "S2_a/.hidden.npz", "other/t1.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = matches("S{subject}_{session}/t{trial}.npz", tmp_path)
    assert [path for path, _ in found] == ["S2_a/t2.npz", "S2_a/t10.npz", "S10_b/t1.npz"]
    assert found[0][1] == {"subject": "2", "session": "a", "trial": "2"}
    assert matches("S2_a/t{trial}.*", tmp_path)[0][1] == {"trial": "2"}
    assert not matches("S{subject}_{subject}/{trial}.npz", tmp_path)


def test_a_name_that_occurs_twice_must_be_the_same(tmp_path: Path) -> None:
    for name in ("S1/S1_walk", "S1/S2_walk"):
        (tmp_path / name).mkdir(parents=True)
    assert [path for path, _ in matches("{subject}/{subject}_{trial}", tmp_path)] == ["S1/S1_walk"]


def test_a_pattern_may_be_absolute(tmp_path: Path) -> None:
    (tmp_path / "a.npz").touch()
    assert [path for path, _ in Pattern(f"{tmp_path}/{{trial}}.npz").matches(Path("/nowhere"))] == [tmp_path / "a.npz"]
