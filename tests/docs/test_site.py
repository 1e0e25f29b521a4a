"""What the documentation says of the code is so: names, messages, extras; and the site is checked as it should be."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import tomllib
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path

import pytest

from fgpose import parameters
from fgpose.cli.app import _PLACES
from tests.public_names import public_names

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@cache
def texts_of_the_code() -> tuple[str, ...]:
    """Every text in fgpose; where it holds a value, there is a line break."""
    texts = []
    for path in (ROOT / "fgpose").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [str(part.value) if isinstance(part, ast.Constant) else "\n" for part in node.values]
                texts.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return tuple(texts)


def messages() -> list[str]:
    """The parts of the messages in the tables of the page, between dots."""
    page = (DOCS / "help" / "troubleshooting.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| ([^|]*) \|", page, re.MULTILINE)
    quoted = [message for cell in cells for message in re.findall(r"`([^`]+)`", cell)]
    return [part.strip() for message in quoted for part in message.split("...") if len(part.strip()) > 10]


def test_every_public_name_is_in_the_reference() -> None:
    """Under one of its names; the sections of the configuration are on its page."""
    reference = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    names = public_names()
    on_pages = re.findall(r":: (fgpose[\w.]+)$", reference, re.MULTILINE)
    documented = {id(names[name]) for name in on_pages if name in names}
    sections = {id(kind) for kind in vars(parameters).values() if is_dataclass(kind)}
    assert {name for name, exported in names.items() if id(exported) not in documented | sections} == set()


def test_the_messages_of_the_troubleshooting_are_those_of_the_code() -> None:
    texts = "\0".join(texts_of_the_code())
    assert len(messages()) > 50
    assert [message for message in messages() if message not in texts] == []


def test_every_extra_is_explained() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (DOCS / "start" / "installation.md").read_text(encoding="utf-8")
    explained = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert sorted(explained) == sorted(project["optional-dependencies"])


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs"])
def test_rows_of_tables_have_as_many_cells_as_their_heads(page: str) -> None:
    """A page shows no cell that its head does not have."""
    path = ROOT / page
    for each in path.rglob("*.md") if path.is_dir() else [path]:
        for table in re.findall(r"(?:^\|.*\n)+", each.read_text(encoding="utf-8"), re.MULTILINE):
            rows = table.splitlines()
            n_bars = [len(re.findall(r"(?<!\\)\|", row)) for row in rows]
            assert [row for row, n in zip(rows, n_bars, strict=True) if n != n_bars[0]] == [], each


def test_every_command_has_its_help_on_a_page() -> None:
    page = (DOCS / "reference" / "command_line.md").read_text(encoding="utf-8")
    shown = re.findall(r"^## (\S+)\n\n```\{command-help\} (\S+)$", page, re.MULTILINE)
    assert all(heading == command for heading, command in shown)
    assert {*_PLACES, "benchmark"} == {command for _, command in shown}


def test_links_of_the_readme_lead_to_files() -> None:
    for target in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert "://" in target or (ROOT / target).exists(), target


@pytest.mark.slow
@pytest.mark.parametrize("name", ["graph", "occlusion", "clocks", "uncertainty", "notebook"])
def test_a_picture_can_be_drawn_again(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one of the calibration takes a quarter of a minute; `make pictures` draws it too."""
    monkeypatch.syspath_prepend(str(DOCS / "pictures"))
    runpy.run_path(str(DOCS / "pictures" / f"{name}.py"))["main"](tmp_path)
    sys.modules.pop("drawing", None)
    assert (tmp_path / f"{name}.svg").stat().st_size > 10_000


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    main = runpy.run_path(str(DOCS / "check_site.py"))["problems_of"]
    (tmp_path / "a.html").write_text('<h1 id="top">A</h1><a href="b.html#there">b</a><a href="#top">up</a>')
    (tmp_path / "b.html").write_text('<p id="there">B</p><a href="https://example.org/">out</a>')
    assert main(tmp_path) == []
    (tmp_path / "b.html").write_text('<a href="c.html">c</a><script src="https://example.org/x.js"></script>')
    assert main(tmp_path) == [
        "a.html: b.html#there leads to no anchor",
        "b.html: loads https://example.org/x.js",
        "b.html: c.html leads to no file",
    ]
