"""What is done with each block of code in the documentation, by its language. Sybil finds the blocks.

A block is run, unless a comment before it says why not: ``<!-- not run: needs a camera -->``. Then it is checked as far
as can be: its commands are parsed by the program's own parser, its Python is compiled.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

from sybil import Document, Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.myst import CodeBlockParser

from fgpose.cli import main
from fgpose.cli.app import _parse
from fgpose.config import config_from_dict
from fgpose.extensions import Group
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.skeletons import load_skeleton
from fgpose.live.cameras.rig_file import load_live_rig
from fgpose.robot.cell import load_cell
from fgpose.study import load_study
from fgpose_benchmarks.synthetic import ring_rig

ROOT = Path(__file__).parents[2]
_NOT_RUN = re.compile(r"<!-- not run: (?P<reason>[^>]+) -->\s*\Z")
_FENCE = re.compile(r"^(?P<fence>`{3,}|:{3,})(?P<info>[^`\n]*)$", re.MULTILINE)
# Blocks that are no code, and directives of the site.
_NO_CODE = re.compile(r"text|\{.*\}.*|")
_run_python = PythonEvaluator()


def reason_not_to_run(example: Example) -> str:
    """Why the block is only checked; empty if it is run."""
    match = _NOT_RUN.search(example.document.text[: example.region.start])
    return match["reason"].strip() if match else ""


def commands(block: str) -> Iterator[list[str]]:
    """The commands of a block, each as its words; comments are left out, a backslash joins lines."""
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


def run_bash(example: Example) -> None:
    is_run = not reason_not_to_run(example)
    for words in commands(example.parsed):
        check_command(words, is_run=is_run)


def check_command(words: list[str], *, is_run: bool) -> None:
    """Run a command of fgpose, or check it; others are checked against what they name."""
    program, *arguments = words
    if program == "fgpose":
        if is_run:
            assert main(arguments) == 0, shlex.join(words)
        else:
            _parse(arguments)
    elif program == "make":
        makefile = (ROOT / "Makefile").read_text()
        targets = [word for word in arguments if "=" not in word]
        assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in targets), words
    elif program == "pip":
        check_pip(arguments)
    elif program.endswith("python"):
        assert arguments[0] == "-m" or (ROOT / arguments[0]).is_file(), words
    elif program == "docker" and not is_run:
        if arguments[0] == "run":
            _parse(arguments[arguments.index("fgpose") + 1 :])
    elif program == "dask" and not is_run:
        assert arguments[0] in ("scheduler", "worker"), words
    else:
        raise AssertionError(f"nobody checks {shlex.join(words)}: say why it is not run")


def check_pip(arguments: list[str]) -> None:
    """That the extras exist, or the wheel that replaces another."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert arguments[0] in ("install", "uninstall"), arguments
    if arguments[-1] in ("onnxruntime", "onnxruntime-gpu"):
        return
    match = re.fullmatch(r"fgpose(?:\[(?P<extras>[a-z0-9,]+)\])?", arguments[-1])
    assert match, arguments
    assert set((match["extras"] or "").split(",")) - {""} <= set(project["optional-dependencies"]), arguments


def run_python(example: Example) -> None:
    if reason_not_to_run(example):
        compile(str(example.parsed), example.path, "exec")
    else:
        _run_python(example)


def check_toml(example: Example) -> None:
    """It is what its tables say: a configuration, a study, the cameras of a live system, the cell of a robot, a
    skeleton, or entry points of a package."""
    table = tomllib.loads(example.parsed)
    if "links" in table or "zones" in table:
        Path("cell.toml").write_text(example.parsed)
        load_cell("cell.toml")
    elif "joints" in table:
        Path("skeleton.toml").write_text(example.parsed)
        load_skeleton("skeleton.toml")
    elif "data" in table:
        Path("study.toml").write_text(example.parsed)
        load_study("study.toml")
    elif "cameras" in table:
        cameras = ring_rig(max(2, len(table["cameras"]))).cameras[: len(table["cameras"])]
        named = [replace(camera, name=name) for camera, name in zip(cameras, table["cameras"], strict=True)]
        save_rig(CameraRig(tuple(named)), table["live"]["calibration"])
        Path("live.toml").write_text(example.parsed)
        assert load_live_rig("live.toml").rig.names == tuple(table["cameras"])
    elif "project" in table:
        assert set(table["project"]["entry-points"]) <= set(get_args(Group))
    else:
        config_from_dict(table)


SYBIL = Sybil(
    parsers=[
        CodeBlockParser("bash", run_bash),
        CodeBlockParser("python", run_python),
        CodeBlockParser("toml", check_toml),
    ]
)


def languages(text: str) -> list[str]:
    """Of all fences that begin a block of code."""
    found, is_open = [], False
    for match in _FENCE.finditer(text):
        if match["fence"].startswith(":"):
            continue
        if not is_open:
            found.append(match["info"].strip())
        is_open = not is_open
    return [language for language in found if not _NO_CODE.fullmatch(language)]


def parsed(path: Path) -> Document:
    return SYBIL.parse(path)
