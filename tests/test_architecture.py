"""The import rules of the design, kept by reading the source: layers, cycles, and which file may use which library."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"fgpose": ROOT / "fgpose", "fgpose_factors": ROOT / "factors" / "fgpose_factors"}

# From the bottom up. A module imports its own layer and those below it, never one above.
LAYERS = (
    {"skeleton", "camera", "observations", "config", "trajectory"},
    {
        "triangulation",
        "fusion",
        "keys",
        "tracks",
        "delays",
        "evidence",
        "weights",
        "persistence",
        "process_noise",
        "residuals",
    },
    {"graph"},
    {"optimizer", "block_tridiagonal", "chain_terms", "uncertainty", "bone_lengths", "fixed_lag"},
    {"graph_problem", "stretch"},
    {"chain", "window"},
    {"refinement", "smoother", "estimator", "rig_refinement", "time_offsets"},
    {"self_calibration"},
    {"camera_faults"},
    {"pipeline"},
    {"cli"},
)
SOLVERS = {
    "refinement",
    "rig_refinement",
    "smoother",
    "estimator",
    "window",
    "graph_problem",
    "fixed_lag",
}
FILES = {"fgpose.io", "fgpose.config", "fgpose.benchmark"}
STAGE_1 = {"fgpose.monocular"}
# Modules (and all below them) that may import a library.
ALLOWED = {
    "gtsam": {"fgpose_factors", *(f"fgpose.{name}" for name in ("camera", "keys", "graph", *SOLVERS))},
    "rerun": {"fgpose.viewer"},
    **dict.fromkeys(("onnxruntime", "onnx", "tflite"), STAGE_1),
    "tyro": {"fgpose.cli"},
    **dict.fromkeys(("json", "tomllib", "tomli_w", "pyarrow", "ezc3d", "xml", "csv"), FILES),
}


def parsed() -> dict[str, ast.Module]:
    """Syntax tree of every module by its dotted name; a package goes by its own."""
    trees = {}
    for package, folder in SOURCES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = (package, *path.relative_to(folder).with_suffix("").parts)
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    return trees


TREES = parsed()


def imports_of(tree: ast.Module) -> set[str]:
    """Dotted names that a module imports, anywhere in it; a submodule rather than the package it is taken from."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module, "imports are absolute"
            assert node.level == 0, "imports are absolute"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= (inner & TREES.keys()) | ({node.module} if inner - TREES.keys() else set())
    return names


IMPORTS = {name: imports_of(tree) for name, tree in TREES.items()}


def within(name: str, packages: set[str]) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def layer(name: str) -> int | None:
    package, _, rest = name.partition(".")
    top = rest.partition(".")[0]
    return next((number for number, names in enumerate(LAYERS) if package == "fgpose" and top in names), None)


def within_any(names: set[str], packages: set[str]) -> bool:
    return any(within(name, packages) for name in names)


def test_the_factors_know_nothing_of_fgpose() -> None:
    wrong = [name for name in IMPORTS if within(name, {"fgpose_factors"}) and within_any(IMPORTS[name], {"fgpose"})]
    assert not wrong


@pytest.mark.parametrize("library", ALLOWED)
def test_a_library_is_imported_only_where_it_belongs(library: str) -> None:
    users = {name for name, imported in IMPORTS.items() if within_any(imported, {library})}
    assert not [name for name in users if not within(name, ALLOWED[library])]


def test_nothing_imports_a_layer_above_it() -> None:
    upward = [
        f"{name} imports {imported}"
        for name, names in IMPORTS.items()
        for imported in names
        if (above := layer(imported)) is not None and (own := layer(name)) is not None and above > own
    ]
    assert not upward


def test_only_the_top_knows_the_pipeline_and_the_command_line() -> None:
    tops = {"fgpose.pipeline", "fgpose.cli"}
    users = {name for name, names in IMPORTS.items() if within_any(names, tops)}
    assert not [name for name in users if not within(name, {*tops, "fgpose.__main__"}) and name != "fgpose"]


def test_there_are_no_import_cycles() -> None:
    # static_order raises CycleError, which names the cycle.
    order = TopologicalSorter({name: names & TREES.keys() for name, names in IMPORTS.items()}).static_order()
    assert set(order) == set(TREES)


def test_the_library_never_prints() -> None:
    printing = {
        name
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    }
    assert not [name for name in printing if not within(name, {"fgpose.cli"})]


def test_importing_fgpose_stays_light() -> None:
    heavy = ("rerun", "onnxruntime", "onnx", "tflite", "tyro", "pyarrow", "cv2", "ezc3d")
    command = f"import sys, fgpose; print(*[name for name in {heavy} if name in sys.modules])"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "factors")))}
    found = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, env=environment, cwd=ROOT
    )
    assert found.stdout.strip() == ""


def test_the_rules_see_what_they_are_about() -> None:
    # Guards against a rule that holds because nothing is found.
    assert "gtsam" in IMPORTS["fgpose.camera"]
    assert "fgpose.camera" in IMPORTS["fgpose.observations"]
    assert layer("fgpose.smoother") == 6
    assert layer("fgpose_factors.noise") is None
