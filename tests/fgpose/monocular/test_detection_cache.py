from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import pytest

from fgpose.io.code_digest import class_digest, code_digest
from fgpose.monocular import detection, detection_cache
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect
from fgpose.monocular.detection_cache import ViewDetections, cache_path, load_detections, store_detections
from fgpose.monocular.network import People
from fgpose.monocular.networks.blazepose import BlazePose
from fgpose.monocular.sources import Sources, open_sources

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

N_IMAGES = 24
N_CAMERAS = 3
N_JOINTS = 4


def some_people(n_people: int, seed: int) -> People:
    rng = np.random.default_rng(seed)
    shapes = ((5,), (N_JOINTS, 2), (N_JOINTS,), (N_JOINTS, 3), (N_JOINTS, 3, 3))
    boxes, points2d_px, confidence, points3d_m, covariance_m2 = (rng.uniform(0, 1, (n_people, *s)) for s in shapes)
    points3d_m[:, 1] = np.nan
    problems = ("", f"poor fit: {seed} times", "cut by the border")[:n_people]
    return People(boxes, points2d_px, confidence, points3d_m, covariance_m2, problems)


def assert_same(actual: ViewDetections, expected: ViewDetections) -> None:
    np.testing.assert_array_equal(actual.stamps_s, expected.stamps_s)
    np.testing.assert_array_equal(actual.n_people, expected.n_people)
    for name in ("boxes", "points2d_px", "confidence", "points3d_m", "covariance_m2"):
        np.testing.assert_array_equal(getattr(actual.people, name), getattr(expected.people, name))
    assert actual.people.problems == expected.people.problems


def assert_same_detections(actual: Detected, expected: Detected) -> None:
    for a, e in zip(actual.views, expected.views, strict=True):
        assert_same(a, e)


@pytest.fixture(scope="module")
def sources(squares: SquaresScene, tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return open_sources(squares.write_all(tmp_path_factory.mktemp("videos"), N_IMAGES), squares.rig)


@pytest.fixture
def view() -> ViewDetections:
    """Images with 2, 0 and 1 people; the last has no stamp."""
    people = [some_people(n, seed) for seed, n in enumerate((2, 0, 1))]
    return ViewDetections.stacked([0.0, 0.1, float("nan")], people, N_JOINTS, ended=True)


def test_a_file_gives_back_what_was_stored(view: ViewDetections, tmp_path: Path) -> None:
    store_detections(view, tmp_path / "a.npz")
    loaded = load_detections(tmp_path / "a.npz", N_JOINTS)
    assert loaded is not None
    assert loaded.ended
    assert_same(loaded, view)
    assert load_detections(tmp_path / "b.npz", N_JOINTS) is None


def test_people_go_back_to_their_images(view: ViewDetections) -> None:
    images = view.unstacked()
    assert [people.n_people for people in images] == [2, 0, 1]
    # Single precision: 1 part in 10^7.
    np.testing.assert_allclose(images[2].points2d_px, some_people(1, 2).points2d_px, rtol=1e-6)
    np.testing.assert_allclose(images[0].covariance_m2, some_people(2, 0).covariance_m2, rtol=1e-6)
    assert [people.problems for people in images] == [("", "poor fit: 0 times"), (), ("",)]
    assert [people.n_people for people in view.first(1).unstacked()] == [2]
    assert not view.first(1).ended


def test_every_person_has_a_problem_or_nobody_has() -> None:
    people = some_people(2, 0)
    assert replace(people, problems=()).problems == ("", "")
    with pytest.raises(ValueError, match="2 people cannot have 1 problems"):
        replace(people, problems=("cut by the border",))


def test_nobody_in_any_image_is_a_result(tmp_path: Path) -> None:
    nobody = ViewDetections.stacked([0.0, 0.1], [People.nobody(N_JOINTS)] * 2, N_JOINTS, ended=False)
    store_detections(nobody, tmp_path / "a.npz")
    loaded = load_detections(tmp_path / "a.npz", N_JOINTS)
    assert loaded is not None
    assert [people.n_people for people in loaded.unstacked()] == [0, 0]
    assert loaded.people.problems == ()


@pytest.mark.parametrize("how", ["truncated", "empty", "text", "other arrays", "other joints", "other counts"])
def test_a_damaged_file_is_said_and_ignored(how: str, view: ViewDetections, tmp_path: Path) -> None:
    path, n_joints = tmp_path / "a.npz", N_JOINTS
    store_detections(view, path)
    if how == "truncated":
        path.write_bytes(path.read_bytes()[:700])
    elif how in ("empty", "text"):
        path.write_bytes(b"" if how == "empty" else b"no archive")
    elif how == "other arrays":
        np.savez(path, a=np.zeros(3))
    elif how == "other joints":
        n_joints = 5
    else:
        store_detections(replace(view, n_people=np.array([2, 0, 2])), path)
    with pytest.warns(UserWarning, match=r"a\.npz: damaged, detected again"):
        assert load_detections(path, n_joints) is None


def test_the_name_depends_on_everything_that_matters(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    clip, camera = sources.clips[0], sources.rig.cameras[0]
    path = cache_path(tmp_path, clip, squares_network, camera)
    assert path.parent == tmp_path
    assert path.name.startswith("ring_0-")
    moved = camera.world_T_camera.copy()
    moved[:3, 3] += 1.0
    assert cache_path(tmp_path, clip, squares_network, replace(camera, world_T_camera=moved)) == path
    assert cache_path(tmp_path, replace(clip, given_fps=7.0, fps=7.0), squares_network, camera) == path
    other_camera = replace(camera, K=camera.K + np.diag([1.0, 0.0, 0.0]))
    others = [
        cache_path(tmp_path, sources.clips[1], squares_network, camera),
        cache_path(tmp_path, clip, replace(squares_network, name="squares 2"), camera),
        cache_path(tmp_path, clip, squares_network, other_camera),
        cache_path(tmp_path, clip, squares_network, replace(camera, distortion=np.array([0.1, 0.0, 0.0, 0.0]))),
    ]
    assert len({path, *others}) == 5


def test_the_second_run_takes_everything_from_the_cache(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    first = detect(sources, squares_network, cache=tmp_path)
    assert first.n_new_images == len(squares_network.seen) == N_CAMERAS * N_IMAGES
    files = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert len(files) == N_CAMERAS
    second = detect(sources, squares_network, cache=tmp_path)
    assert second.n_new_images == 0
    assert len(squares_network.seen) == N_CAMERAS * N_IMAGES
    assert squares_network.trackers == list(squares_network.trackers[:N_CAMERAS])
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == files
    assert_same_detections(second, first)


def test_a_longer_run_goes_on_where_a_shorter_ended(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    short = detect(sources, squares_network, cache=tmp_path, frames=7)
    assert [view.n_images for view in short.views] == [7] * N_CAMERAS
    assert len(squares_network.seen) == 7 * N_CAMERAS
    everything = detect(sources, squares_network, cache=tmp_path)
    assert len(squares_network.seen) == N_CAMERAS * N_IMAGES
    # This network has no memory, so that going on gives what one run gives.
    assert_same_detections(everything, detect(sources, squares_network))
    # And a shorter run afterwards takes the beginning.
    again = detect(sources, squares_network, cache=tmp_path, frames=7)
    assert again.n_new_images == 0
    assert_same_detections(again, short)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError("a broken network")])
def test_what_was_found_before_an_interruption_is_reused(
    error: BaseException | type[BaseException], sources: Sources, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    n_before = 31

    def fail(n_seen: int) -> None:
        if n_seen >= n_before:
            raise error

    squares_network.before_image = fail
    with pytest.raises(error if isinstance(error, type) else type(error)):
        detect(sources, squares_network, cache=tmp_path, jobs=2)
    assert len(squares_network.seen) == n_before
    squares_network.before_image = lambda n_seen: None
    resumed = detect(sources, squares_network, cache=tmp_path, jobs=2)
    assert resumed.n_new_images == N_CAMERAS * N_IMAGES - n_before
    assert len(squares_network.seen) == N_CAMERAS * N_IMAGES
    # Each image once: none twice, none left out.
    assert sorted(squares_network.seen) == sorted(list(sources.rig.names) * N_IMAGES)
    assert_same_detections(resumed, detect(sources, squares_network))


def test_files_are_written_while_it_runs(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crash loses one block at most."""
    monkeypatch.setattr(detection, "_STORE_IMAGES", 10)
    stored: list[int] = []

    def store(view: ViewDetections, path: Path) -> None:
        stored.append(view.n_images)
        store_detections(view, path)

    monkeypatch.setattr(detection, "store_detections", store)
    detect(sources, squares_network, cache=tmp_path, jobs=1)
    assert sorted(stored) == sorted([10, 20, N_IMAGES] * N_CAMERAS)


def test_a_damaged_cache_is_detected_again(sources: Sources, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    first = detect(sources, squares_network, cache=tmp_path)
    damaged = min(tmp_path.iterdir())
    damaged.write_bytes(damaged.read_bytes()[:1000])
    with pytest.warns(UserWarning, match="damaged, detected again"):
        second = detect(sources, squares_network, cache=tmp_path)
    assert second.n_new_images == N_IMAGES
    assert_same_detections(second, first)
    assert detect(sources, squares_network, cache=tmp_path).n_new_images == 0


def test_a_cache_that_cannot_be_written_is_found_before_the_work(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file/cache"):
        detect(sources, squares_network, cache=tmp_path / "file" / "cache")
    assert squares_network.seen == []


def test_a_full_disk_costs_the_cache_and_not_the_work(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(view: ViewDetections, path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(detection, "store_detections", full)
    with pytest.warns(UserWarning, match=r"detections are not kept: .*ring_.*No space left on device"):
        detected = detect(sources, squares_network, cache=tmp_path)
    assert detected.n_images == N_CAMERAS * N_IMAGES
    assert list(tmp_path.iterdir()) == []


def test_without_a_cache_nothing_is_written(sources: Sources, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    detect(sources, squares_network, frames=2)
    assert detect(sources, squares_network, frames=2).n_new_images == 2 * N_CAMERAS
    assert list(tmp_path.iterdir()) == []


def test_detections_of_another_code_are_made_anew(
    sources: Sources, squares_network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip, camera = sources.clips[0], sources.rig.cameras[0]
    own = detection_cache.cache_path(tmp_path, clip, squares_network, camera)
    asked: list[str] = []
    monkeypatch.setattr(detection_cache, "code_digest", lambda package: asked.append(package.name) or "another")
    assert detection_cache.cache_path(tmp_path, clip, squares_network, camera) != own
    assert asked == ["monocular"]


def test_the_digest_is_of_all_modules_below(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "inner").mkdir(parents=True)
    (package / "inner" / "crops.py").write_text("one")
    one = code_digest.__wrapped__(package)
    (package / "inner" / "crops.py").write_text("two")
    assert code_digest.__wrapped__(package) != one


@pytest.mark.parametrize("corrected", ["own_network.py", "own_tracker.py", "own_helpers.py"])
def test_detections_of_a_corrected_network_of_another_package_are_made_anew(
    corrected: str,
    sources: Sources,
    squares_network: SquaresNetwork,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_helpers.py").write_text("def helper():\n    pass\n")
    (tmp_path / "own_tracker.py").write_text("class Tracker:\n    pass\n")
    (tmp_path / "own_network.py").write_text(
        "from own_helpers import helper\nfrom own_tracker import Tracker\n\n\nclass Network:\n    pass\n"
    )
    for name in ("own_network", "own_tracker", "own_helpers"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    network = importlib.import_module("own_network").Network()
    network.name, network.skeleton, network.tracker = "mine", squares_network.skeleton, squares_network.tracker

    def path() -> Path:
        return cache_path(tmp_path, sources.clips[0], network, sources.rig.cameras[0])

    before = path()
    assert path() == before
    with (tmp_path / corrected).open("a") as file:
        file.write("# corrected\n")
    assert path() != before


def test_a_constant_in_the_package_of_a_network_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    package = tmp_path / "own_package"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "settings.py").write_text("SHIFT_PX = 0.0\n")
    (package / "network.py").write_text("from own_package.settings import SHIFT_PX\n\n\nclass Network:\n    pass\n")
    own = importlib.import_module("own_package.network").Network
    before = class_digest(own)
    (package / "settings.py").write_text("SHIFT_PX = 25.0\n")
    assert class_digest(own) != before


def test_code_of_fgpose_and_of_a_session_is_in_no_file_of_a_class(monkeypatch: pytest.MonkeyPatch) -> None:
    session = ModuleType("session")
    monkeypatch.setitem(sys.modules, "session", session)
    nothing = class_digest(type("TypedIn", (), {"__module__": "session"}))
    assert nothing == class_digest(BlazePose) != class_digest(type("OfTests", (), {"__module__": __name__}))
