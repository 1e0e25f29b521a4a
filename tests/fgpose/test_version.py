"""The version is that of the installed package."""

from __future__ import annotations

import tomllib
from pathlib import Path

import fgpose


def test_the_version_is_that_of_the_project() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    assert fgpose.__version__ == project["project"]["version"]
