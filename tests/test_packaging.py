"""What goes with the code when it is published: changelog, citation, classifiers, the image for a container."""

from __future__ import annotations

import datetime
import re
import sys
import tomllib
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import fgpose
from fgpose.cli.app import _parse

ROOT = Path(__file__).parents[1]
# Of Keep a Changelog 1.1.0.
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
PIN = re.compile(r"(?P<name>[\w.-]+)==(?P<version>[^\s;]+)(?: ; [^#]*?)?(?: +--hash=sha256:[0-9a-f]{64})+")


def project(folder: Path = ROOT) -> dict:
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_newest_version_of_the_changelog_is_that_of_the_package() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    assert headings[0] == "[Unreleased]"
    released = [re.fullmatch(r"\[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)", heading) for heading in headings[1:]]
    assert all(released), headings
    versions = [match[1] for match in released if match]
    assert versions[0] == fgpose.__version__
    assert versions == sorted(versions, key=lambda version: [int(part) for part in version.split(".")], reverse=True)
    assert [datetime.date.fromisoformat(match[2]) for match in released if match]
    assert set(re.findall(r"^### (.*)$", text, re.MULTILINE)) <= KINDS


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    # What the schema of the Citation File Format 1.2.0 requires.
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == fgpose.__version__
    assert citation["license"] == project()["license"]
    (reference,) = citation["references"]
    assert {"type", "title", "authors"} <= set(reference)
    readme = (ROOT / "README.md").read_text(encoding="utf-8").replace("\n", " ")
    assert reference["title"] in readme
    assert all(author["family-names"] in readme for author in reference["authors"])


def test_the_benchmarks_go_with_this_version() -> None:
    benchmarks = project(ROOT / "benchmarks")
    assert benchmarks["version"] == fgpose.__version__
    assert f"fgpose=={fgpose.__version__}" in benchmarks["dependencies"]


def test_the_classifiers_name_the_versions_of_the_matrix() -> None:
    named = re.findall(r"Python :: (3\.\d+)", " ".join(project()["classifiers"]))
    (matrix,) = re.findall(r"^MATRIX := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert [f"python{version}" for version in named] == matrix.split()
    assert project()["requires-python"] == f">={named[0]}"
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in named


def test_a_pin_with_hashes_meets_each_requirement() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = [*settings["project"]["optional-dependencies"].values(), *settings["dependency-groups"].values()]
    wanted = [line for group in groups for line in group if isinstance(line, str)]
    wanted += settings["project"]["dependencies"] + settings["build-system"]["requires"]
    wanted += [line for line in project(ROOT / "benchmarks")["dependencies"] if not line.startswith("fgpose")]
    pinned = (ROOT / "constraints.txt").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    pins = {canonicalize_name(pin["name"]): pin["version"] for pin in map(PIN.fullmatch, pinned) if pin}
    assert len(pinned) >= len(pins) > 100
    for requirement in map(Requirement, wanted):
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)]), requirement
    assert [line for line in pinned if not PIN.fullmatch(line)] == []


def test_the_image_copies_what_exists_and_starts_a_command_that_parses() -> None:
    lines = (ROOT / "Containerfile").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines() if line[0] == "!"}
    for line in lines:
        if line.startswith("COPY") and "--from" not in line:
            *sources, _ = line.split()[1:]
            assert set(sources) <= kept, line
            assert all((ROOT / source).exists() for source in sources), line
    (command,) = [line.removeprefix("CMD ") for line in lines if line.startswith("CMD ")]
    _parse(yaml.safe_load(command))
    extras = re.findall(r'"fgpose\[([a-z,]+)\] @', "\n".join(lines))
    assert extras
    assert all(set(names.split(",")) <= set(project()["optional-dependencies"]) for names in extras)


def test_the_image_asks_the_status_page_that_there_is() -> None:
    from fgpose.live.page import status_page

    (path,) = re.findall(r"127\.0\.0\.1:8099(/[\w.]+)", (ROOT / "Containerfile").read_text(encoding="utf-8"))
    assert path == status_page._STATE
