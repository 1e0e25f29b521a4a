"""What is said of wrong arguments, and how long the help is."""

from __future__ import annotations

import re
from pkgutil import resolve_name

import pytest

from fgpose.cli import main
from fgpose.cli.app import _PLACES

NEEDED = ["--rig", "Calib.toml", "--skeleton", "coco_17"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["smoth", "x"], "there is no command smoth; did you mean smooth? fgpose --help lists all"),
        pytest.param(["zzz"], "there is no command zzz; fgpose --help lists all", marks=pytest.mark.slow),
        (["--verson"], "there is no option --verson; did you mean --version? fgpose --help lists all"),
        (["--frames", "3"], "a command comes before --frames; fgpose --help lists all"),
        (
            ["smooth", "x", *NEEDED, "--frame", "3", "--stric"],
            "there is no option --frame; did you mean --frames? there is no option --stric; did you mean --strict? "
            "fgpose smooth --help lists what there is",
        ),
        (
            ["smooth", "x", "--skelton", "coco_17"],
            "there is no option --skelton; did you mean --skeleton? fgpose smooth --help lists what there is",
        ),
        (
            ["smooth", "x"],
            "fgpose smooth needs --rig FILE; fgpose smooth --help lists what there is",
        ),
        (
            ["smooth", "--Rig", "x"],
            "there is no option --Rig; did you mean --rig? fgpose smooth --help lists what there is",
        ),
        (
            ["track", "--lag-s", "1", "x", *NEEDED],
            "there is no option --lag-s; did you mean --online.lag-s? fgpose track --help lists what there is",
        ),
        (
            ["track", "x", *NEEDED, "--online.lagg-s", "1"],
            "there is no option --online.lagg-s; did you mean --online.lag-s? fgpose track --help-all lists what there "
            "is",
        ),
        (["smooth", *NEEDED], "fgpose smooth needs KEYPOINTS; fgpose smooth --help lists what there is"),
        (["smooth", "--frames", "3", *NEEDED, "--fps"], "--fps: a value is missing"),
        (["overlay", "x"], "fgpose overlay needs VIDEOS; fgpose overlay --help lists what there is"),
        (["smooth", "x", "y", *NEEDED], "nothing is expected at y; fgpose smooth --help lists what there is"),
        (["smooth", "x", *NEEDED, "--fps", "fast"], "--fps fast: a number is needed"),
        (["smooth", "x", *NEEDED, "--frames", "1.5"], "--frames 1.5: a whole number is needed"),
        (["smooth", "x", *NEEDED, "--people", "two"], "--people two: choose auto, all or 1"),
        (
            ["smooth", "x", *NEEDED, "--motion.model", "constant_velocty"],
            "--motion.model constant_velocty (did you mean constant_velocity?): choose none, random_walk or "
            "constant_velocity",
        ),
        (["smooth", "x", "y", "z"], "nothing is expected at y z; fgpose smooth --help lists what there is"),
        (["smooth", "x", "--rig"], "--rig: a value is missing"),
        (["models", "pul"], "fgpose models pul is none of pull, list; did you mean pull?"),
        (["models", "pull"], "fgpose models pull needs NAME; fgpose models pull --help lists what there is"),
    ],
)
def test_one_line_says_what_is_wrong(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")  # in which the boxes break their lines
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2
    printed = capsys.readouterr()
    assert printed.err == f"fgpose: error: {message}\n"
    assert not printed.out


@pytest.mark.parametrize("command", ["smooth", "detect", "calibrate", "live"])
def test_help_breaks_its_lines_between_words(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    document = resolve_name(f"fgpose.cli.{_PLACES[command]}").__doc__
    assert " ".join(document.split()) in " ".join(printed.split())
    assert "None" not in printed
    assert "[{" not in printed


@pytest.mark.parametrize("command", ["smooth", "track", "refine", "run"])
def test_help_is_short_and_all_help_has_the_parameters(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    helps = []
    for option in ("--help", "--help-all"):
        with pytest.raises(SystemExit) as end:
            main([command, option])
        assert end.value.code == 0
        helps.append(capsys.readouterr().out)
    brief, whole = helps
    assert "--motion.fade-s" not in brief
    assert "--help-all" in brief
    # Two screens, and half of a third for what begins with videos.
    assert brief.count("\n") < (150 if command == "run" else 100)
    assert "--motion.fade-s" in whole
    assert "--rig" in whole


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"], ["--help-all"]])
def test_the_commands_are_listed_by_what_they_are_for_a_line_each(
    arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "78")  # of the documentation, narrower than a terminal
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 78
    assert not any("…" in line for line in lines)
    # A line that is too long may end without a sign.
    named = {words[1]: words[2] for line in lines if len(words := re.split(r"│ | {2,}| ?│$", line)) > 3}
    for name, place in _PLACES.items():
        summary = (resolve_name(f"fgpose.cli.{place}").__doc__ or "").partition("\n")[0]
        assert f"{named[name]}." == summary
    groups = [line for line in lines if line.startswith("╭")]
    assert groups[0].startswith("╭─ start here ─")
    at = {name: next(n for n, line in enumerate(lines) if line.startswith(f"│ {name} ")) for name in ("demo", "smooth")}
    assert lines.index(groups[0]) < at["demo"] < lines.index(groups[1]) < at["smooth"]
