"""The import rules of the design, kept by reading the source: layers, cycles, and which file may use which library."""

from __future__ import annotations

import ast
import functools
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {
    "fgpose": ROOT / "fgpose",
    "fgpose_factors": ROOT / "factors" / "fgpose_factors",
    "fgpose_benchmarks": ROOT / "benchmarks" / "fgpose_benchmarks",
}

# The house, from the top floor down. A module imports its own room and the floors below, never one above or beside it.
FLOORS = (
    {"people", "files", "deprecated"},
    {"cli"},
    {"robot"},
    {"live", "study"},
    {"pipeline"},
    {"overlay", "report", "notebook"},
    {"diagnosis"},
    {"tracking"},
    {"calibration"},
    {"estimation"},
    {"monocular", "viewer"},
    {"assessment"},
    {"io"},
    {"kinematics"},
    {"association"},
    {"geometry"},
    {
        "child_process",
        "plain_files",
        "config",
        "correspondences",
        "extensions",
        "finding",
        "freed_memory",
        "frozen",
        "observations",
        "parameters",
        "people_observations",
        "sampling",
        "skeleton",
        "skeletons",
        "trajectory",
    },
    {"shown"},
)
# What a user holds shows itself: the one module asks for the others, when a method is called.
DOORS = {"fgpose.shown": {"fgpose.notebook", "fgpose.geometry.camera"}}
# The same within the largest room.
ESTIMATION_FLOORS = (
    {"smoother", "estimator", "refinement", "residuals"},
    {"parts"},
    {"estimates", "settling"},
    {"online"},
    {"covariances"},
    {"solution", "solvers"},
    {"factors"},
    {"visibility"},
    {"frame_state"},
    {"segment"},
    {"evidence"},
    {"initial_guess", "keys", "noise", "process_noise", "windows"},
)
GTSAM = {"fgpose_factors", "fgpose.geometry", "fgpose.estimation", "fgpose.calibration"}
MESSAGES = {"fgpose.live.outputs"}
FILES = {"fgpose.io", "fgpose.config", "fgpose_benchmarks"}
WEIGHTS = {"fgpose.monocular.downloads"}
CLUSTER = {"fgpose.study.cluster"}
# Modules (and all below them) that may import a library.
ALLOWED = {
    "gtsam": GTSAM,
    "rerun": {"fgpose.viewer.rerun"},
    "onnxruntime": {"fgpose.monocular.networks"},
    **dict.fromkeys(("onnx", "tflite"), WEIGHTS),
    "av": {"fgpose.live.sources", "fgpose.monocular.sound", "fgpose.overlay.film"},
    "tyro": {"fgpose.cli", "fgpose_benchmarks.cli"},
    **dict.fromkeys(("distributed", "dask"), CLUSTER),
    "bokeh": {"fgpose.report"},
    "jinja2": {"fgpose.report"},
    "pandas": {"fgpose.notebook", "fgpose.shown"},
    "matplotlib": {"fgpose.notebook", "fgpose_benchmarks"},
    **dict.fromkeys(("pylsl", "mcap", "rosbags"), MESSAGES),
    "zmq": {"fgpose.live", "fgpose.robot.distance_server"},
    "msgpack": {"fgpose.io.live.packing"},
    "msgspec": {"fgpose.live", "fgpose.robot.distance_messages"},
    "waitress": {"fgpose.live.page.page_server"},
    "json": {*FILES, "fgpose.live", "fgpose.report"},
    **dict.fromkeys(("tomllib", "tomli_w", "pyarrow", "ezc3d", "xml", "yaml", "csv"), FILES),
}


# The sources are read when a test needs them: each process of the tests collects all tests, and runs some.
@functools.cache
def syntax_trees() -> dict[str, ast.Module]:
    """Syntax tree of every module by its dotted name; a package goes by its own."""
    trees = {}
    for package, folder in SOURCES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = (package, *path.relative_to(folder).with_suffix("").parts)
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    return trees


@functools.cache
def imports() -> dict[str, set[str]]:
    """Dotted names that each module imports."""
    found = {name: imports_of(tree) for name, tree in syntax_trees().items()}
    return {name: {each for each in names if not within(each, DOORS.get(name, set()))} for name, names in found.items()}


@functools.cache
def packages() -> set[str]:
    return {".".join(name.split(".")[:end]) for name in syntax_trees() for end in range(1, name.count(".") + 1)}


def imports_of(tree: ast.Module) -> set[str]:
    """Dotted names that a module imports, anywhere in it; a submodule rather than the package it is taken from."""
    modules = syntax_trees().keys()
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module, "imports are absolute"
            assert node.level == 0, "imports are absolute"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= (inner & modules) | ({node.module} if inner - modules else set())
    return names


def within(name: str, inside: set[str]) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in inside)


def floor(name: str, house: str, floors: tuple[set[str], ...]) -> tuple[int, str] | None:
    """Height of the floor that a module stands on, and its room; None for what is not in this house."""
    if not name.startswith(f"{house}."):
        return None
    room = name.removeprefix(f"{house}.").partition(".")[0]
    return next(((-depth, room) for depth, rooms in enumerate(floors) if room in rooms), None)


def climbs(name: str, imported: str, house: str, floors: tuple[set[str], ...]) -> bool:
    """Whether an import goes to a floor above, or to another room of a floor that has rooms (not single modules)."""
    own, other = floor(name, house, floors), floor(imported, house, floors)
    if own is None or other is None or own[1] == other[1]:
        return False
    beside = own[0] == other[0] and f"{house}.{other[1]}" in packages()
    return other[0] > own[0] or beside


def within_any(names: set[str], inside: set[str]) -> bool:
    return any(within(name, inside) for name in names)


def test_the_factors_know_nothing_of_fgpose() -> None:
    wrong = [name for name in imports() if within(name, {"fgpose_factors"}) and within_any(imports()[name], {"fgpose"})]
    assert not wrong


def test_the_core_knows_nothing_of_the_benchmarks() -> None:
    core = {"fgpose", "fgpose_factors"}
    assert not [name for name in imports() if within(name, core) and within_any(imports()[name], {"fgpose_benchmarks"})]


@pytest.mark.parametrize("library", ALLOWED)
def test_a_library_is_imported_only_where_it_belongs(library: str) -> None:
    users = {name for name, imported in imports().items() if within_any(imported, {library})}
    assert not [name for name in users if not within(name, ALLOWED[library])]


HOUSES = pytest.mark.parametrize(
    ("house", "floors"), [("fgpose", FLOORS), ("fgpose.estimation", ESTIMATION_FLOORS)], ids=["house", "estimation"]
)


@HOUSES
def test_arrows_only_point_down(house: str, floors: tuple[set[str], ...]) -> None:
    arrows = [(name, imported) for name, names in imports().items() for imported in names]
    assert not [f"{name} -> {imported}" for name, imported in arrows if climbs(name, imported, house, floors)]


@pytest.mark.parametrize("door", DOORS)
def test_what_lies_behind_a_door_is_imported_when_it_is_needed(door: str) -> None:
    tree = syntax_trees()[door]
    assert within_any(imports_of(tree), DOORS[door])
    # What is under a condition is for type checkers.
    at_once = ast.Module([node for node in tree.body if not isinstance(node, ast.ClassDef | ast.If)], [])
    assert not within_any(imports_of(at_once), DOORS[door])


@HOUSES
def test_every_module_has_its_floor(house: str, floors: tuple[set[str], ...]) -> None:
    inside = {name for name in syntax_trees() if name.startswith(f"{house}.") and name != "fgpose.__main__"}
    assert not [name for name in sorted(inside) if floor(name, house, floors) is None]


def test_a_folder_is_seen_at_a_glance() -> None:
    """At most 15 files."""
    count = Counter(path.parent.relative_to(ROOT).as_posix() for path in SOURCES["fgpose"].rglob("*.py"))
    assert {folder: n for folder, n in count.items() if n > 15} == {}


def test_only_the_top_knows_the_pipeline_and_the_command_line() -> None:
    tops = {"fgpose.pipeline", "fgpose.cli", "fgpose.study", "fgpose_benchmarks"}
    users = {name for name, names in imports().items() if within_any(names, tops)}
    assert not [name for name in users if not within(name, {*tops, "fgpose.__main__"}) and name != "fgpose"]


def test_there_are_no_import_cycles() -> None:
    # static_order raises CycleError, which names the cycle.
    order = TopologicalSorter({name: names & syntax_trees().keys() for name, names in imports().items()}).static_order()
    assert set(order) == set(syntax_trees())


def test_the_library_never_prints() -> None:
    printing = {
        name
        for name, tree in syntax_trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    }
    assert not [name for name in printing if not within(name, {"fgpose.cli", "fgpose_benchmarks.cli"})]


def test_the_names_of_fgpose_stay_light() -> None:
    heavy = (
        "rerun",
        "onnxruntime",
        "onnx",
        "tflite",
        "tyro",
        "pyarrow",
        "cv2",
        "ezc3d",
        "zmq",
        "msgpack",
        "msgspec",
        "pylsl",
        "mcap",
        "rosbags",
        "av",
        "distributed",
        "dask",
        "bokeh",
        "jinja2",
        "pandas",
        "matplotlib",
        "fgpose.notebook",
    )
    assert loaded("import fgpose; [getattr(fgpose, name) for name in fgpose.__all__]", heavy) == []


@pytest.mark.parametrize("module", ["fgpose", "fgpose.live.page.page_server"])
def test_nothing_is_loaded_before_it_is_asked_for(module: str) -> None:
    assert loaded(f"import {module}", ("gtsam", "scipy", "fgpose.geometry.camera", "fgpose.estimation")) == []


@pytest.mark.slow
@pytest.mark.parametrize("room", sorted(name for name in packages() if within(name, {"fgpose"})))
def test_each_room_can_be_loaded_first(room: str) -> None:
    """No circle of imports is hidden by what happened to be loaded before."""
    assert loaded(f"import {room}", (room,)) == [room]


def loaded(code: str, modules: Sequence[str]) -> list[str]:
    """Which of these modules a process has loaded after this."""
    command = f"{code}\nimport sys; print(*[name for name in {modules} if name in sys.modules])"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "factors")))}
    found = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, env=environment, cwd=ROOT
    )
    return found.stdout.split()


def test_the_rules_see_what_they_are_about() -> None:
    # Guards against a rule that holds because nothing is found.
    assert "gtsam" in imports()["fgpose.geometry.camera"]
    assert "fgpose.geometry.camera" in imports()["fgpose.geometry.triangulation"]
    assert climbs("fgpose.geometry.camera", "fgpose.estimation.smoother", "fgpose", FLOORS)
    assert climbs("fgpose.viewer.rerun.scene", "fgpose.monocular.networks.crops", "fgpose", FLOORS)
    assert not climbs("fgpose.estimation.smoother", "fgpose.geometry.camera", "fgpose", FLOORS)
    assert climbs("fgpose.estimation.segment", "fgpose.estimation.smoother", "fgpose.estimation", ESTIMATION_FLOORS)
