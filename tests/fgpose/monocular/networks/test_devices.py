"""On what networks run: on the processor, which is always there, and on devices that are pretended."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import onnxruntime
import pytest
from topdown_networks import FLOAT, Graph

from fgpose.monocular.downloads import models
from fgpose.monocular.networks import open_network, sessions
from fgpose.monocular.networks.devices import Device, available_devices, chosen_device
from fgpose.monocular.networks.sessions import identity, open_session

CPU, CUDA, TENSORRT = "CPUExecutionProvider", "CUDAExecutionProvider", "TensorrtExecutionProvider"
OPENVINO, COREML, DIRECTML = "OpenVINOExecutionProvider", "CoreMLExecutionProvider", "DmlExecutionProvider"
AZURE = "AzureExecutionProvider"  # is in every wheel, and no device
IMAGES = np.random.default_rng(0).random((2, 4, 4, 3)).astype(np.float32)


@pytest.fixture
def network(tmp_path: Path) -> Path:
    """Sums the pixels of images."""
    graph = Graph()
    graph.op("ReduceSum", "image", graph.integers(1, 2, 3), keepdims=0, output="sum")
    return graph.save(tmp_path / "sum.onnx", [("image", FLOAT, ["n", 4, 4, 3])], [("sum", FLOAT, ["n"])])


class Pretended:
    """An onnxruntime with other providers. Its sessions run on the processor, and say that they run on what starts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.has: list[str] = [AZURE, CPU]
        self.starts: set[str] | None = None
        """None: all that it has."""
        self.raises = False
        """Rather than to go on with the providers that start."""
        self.asked: list[list[str]] = []
        """The providers of each session."""
        self.told: list[list[dict[str, str]]] = []
        """Their options."""
        self.within: Callable[[], object] = lambda: None
        """Called within each run."""
        pretended, real = self, onnxruntime.InferenceSession

        class Session(real):
            def __init__(
                self, path: Path, options: Any, providers: list[str], own: list[dict[str, str]], **more: Any
            ) -> None:
                pretended.asked.append(providers)
                pretended.told.append(own)
                starts = pretended.has if pretended.starts is None else pretended.starts
                self.started = [provider for provider in providers if provider in starts]
                if pretended.raises and self.started != providers:
                    raise RuntimeError("libcudnn.so.9: cannot open shared object file")
                super().__init__(path, options, providers=[CPU], **more)

            def get_providers(self) -> list[str]:
                return self.started

            def run(self, *args: Any, **kwargs: Any) -> Any:
                pretended.within()
                return super().run(*args, **kwargs)

        monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: self.has)
        monkeypatch.setattr(onnxruntime, "InferenceSession", Session)


@pytest.fixture
def pretended(monkeypatch: pytest.MonkeyPatch) -> Pretended:
    return Pretended(monkeypatch)


def test_the_processor_is_always_there(network: Path) -> None:
    assert "cpu" in available_devices()
    session = open_session(network, device="cpu")
    assert session.get_providers() == [CPU]
    (total,) = session.run(["sum"], {"image": IMAGES})
    np.testing.assert_allclose(np.asarray(total), IMAGES.sum(axis=(1, 2, 3)), rtol=1e-5)


def test_where_there_is_only_the_processor_auto_takes_nothing_else(network: Path, pretended: Pretended) -> None:
    assert available_devices() == ("cpu",)
    assert identity(network, open_session(network)) == identity(network, open_session(network, device="cpu"))
    assert pretended.asked == [[CPU], [CPU]]


@pytest.mark.parametrize(
    ("has", "taken"),
    [
        ([TENSORRT, CUDA, CPU], "cuda"),
        ([DIRECTML, CPU], "directml"),
        ([OPENVINO, CPU], "openvino"),
        ([COREML, AZURE, CPU], "cpu"),
        ([TENSORRT, CPU], "cpu"),
        (["NewExecutionProvider", CPU], "cpu"),
    ],
)
def test_what_auto_takes(has: list[str], taken: str, pretended: Pretended) -> None:
    pretended.has = has
    assert chosen_device("auto") == taken


@pytest.mark.parametrize(
    ("device", "has", "asked"),
    [
        ("auto", [TENSORRT, CUDA, CPU], [CUDA, CPU]),
        ("cpu", [TENSORRT, CUDA, CPU], [CPU]),
        ("cuda", [TENSORRT, CUDA, CPU], [CUDA, CPU]),
        ("tensorrt", [TENSORRT, CUDA, CPU], [TENSORRT, CUDA, CPU]),
        ("tensorrt", [TENSORRT, CPU], [TENSORRT, CPU]),
        ("openvino", [OPENVINO, CPU], [OPENVINO, CPU]),
        ("coreml", [COREML, CPU], [COREML, CPU]),
        ("directml", [DIRECTML, CPU], [DIRECTML, CPU]),
    ],
)
def test_the_processor_takes_what_a_device_cannot(
    device: Device, has: list[str], asked: list[str], network: Path, pretended: Pretended
) -> None:
    pretended.has = has
    session = open_session(network, device=device)
    assert pretended.asked == [asked]
    (total,) = session.run(["sum"], {"image": IMAGES})
    np.testing.assert_allclose(np.asarray(total), IMAGES.sum(axis=(1, 2, 3)), rtol=1e-5)


@pytest.mark.parametrize(
    ("device", "provider", "wheel"),
    [
        ("cuda", CUDA, "onnxruntime-gpu"),
        ("tensorrt", TENSORRT, "onnxruntime-gpu"),
        ("openvino", OPENVINO, "onnxruntime-openvino"),
        ("coreml", COREML, "onnxruntime for macOS"),
        ("directml", DIRECTML, "onnxruntime-directml"),
    ],
)
def test_a_device_that_is_not_there_is_refused_before_weights_are_fetched(
    device: Device, provider: str, wheel: str, pretended: Pretended, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched: list[str] = []
    monkeypatch.setattr(models, "pull", lambda name, progress=None: fetched.append(name))
    with pytest.raises(ValueError, match=f"device {device}: this onnxruntime has no {provider}; it has cpu") as caught:
        open_network("blazepose-full", device=device)
    assert wheel in str(caught.value)
    assert fetched == pretended.asked == []


def test_a_device_of_no_name() -> None:
    chosen_device("cpu")  # types are checked in the first call
    with pytest.raises(ValueError, match="no device 'gpu'; there is auto, cpu, cuda"):
        chosen_device("gpu")  # pyrefly: ignore[bad-argument-type]


@pytest.mark.parametrize("raises", [False, True])
def test_a_device_that_does_not_start_is_an_error_if_it_was_named(
    raises: bool,
    network: Path,
    pretended: Pretended,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sessions, "_WARNED", set())
    pretended.has, pretended.starts, pretended.raises = [TENSORRT, CUDA, CPU], {CPU}, raises
    message = "run on cuda: libcudnn" if raises else f"device cuda: onnxruntime has {CUDA} but could not start it"
    with pytest.raises(ValueError, match=message) as caught:
        open_session(network, device="cuda")
    assert str(network) in str(caught.value)
    with pytest.warns(UserWarning, match="networks run on the processor, as cuda does not start: "):
        session = open_session(network)
    open_session(network)  # nothing is said again
    assert session.get_providers() == [CPU]
    assert "cuda" not in identity(network, session)
    assert capfd.readouterr() == ("", "")


def test_a_device_that_fails_in_a_run_is_named(network: Path, pretended: Pretended) -> None:
    pretended.has = [CUDA, CPU]
    session = open_session(network)
    session.run(["sum"], {"image": IMAGES})
    pretended.within = Mock(side_effect=RuntimeError("CUDA failure 700: an illegal memory access\nat line 7"))
    message = r"device cuda has failed while it ran .*sum\.onnx: CUDA failure 700: .* access; with --device cpu"
    with pytest.raises(OSError, match=message):
        session.run(["sum"], {"image": IMAGES})


def test_tensorrt_that_leaves_everything_to_cuda_is_an_error(network: Path, pretended: Pretended) -> None:
    pretended.has, pretended.starts = [TENSORRT, CUDA, CPU], {CUDA, CPU}
    with pytest.raises(ValueError, match=r"device tensorrt: .* would run .*sum\.onnx on cuda"):
        open_session(network, device="tensorrt")


def test_each_device_keeps_to_the_threads(network: Path, pretended: Pretended) -> None:
    pretended.has = [CUDA, OPENVINO, CPU]
    for device in ("openvino", "cuda"):
        assert open_session(network, 3, device).get_session_options().intra_op_num_threads == 3
    assert pretended.told == [[{"num_of_threads": "3"}, {}], [{}, {}]]  # OpenVINO does not look at those of the session


def test_detections_of_another_device_are_not_taken_from_the_cache(network: Path, pretended: Pretended) -> None:
    pretended.has = [CUDA, OPENVINO, CPU]
    devices: tuple[Device, ...] = ("auto", "cuda", "openvino", "cpu")
    auto, cuda, openvino, cpu = (identity(network, open_session(network, device=device)) for device in devices)
    assert auto == cuda == f"{cpu} on cuda"
    assert openvino == f"{cpu} on openvino"


def run_three_times_at_once(session: onnxruntime.InferenceSession) -> None:
    """All give the same."""
    with ThreadPoolExecutor(3) as pool:
        sums = list(pool.map(lambda _: session.run(["sum"], {"image": IMAGES}), range(3)))
    np.testing.assert_array_equal(sums, 3 * [sums[0]])


def test_several_threads_run_a_network_at_the_same_time(network: Path, pretended: Pretended) -> None:
    meeting = threading.Barrier(3, timeout=60)  # broken if one of them waits for another to end
    pretended.has, pretended.within = [CUDA, CPU], meeting.wait
    run_three_times_at_once(open_session(network, device="cuda"))
    assert not meeting.broken


def test_directml_has_one_run_at_a_time_and_no_patterns_of_memory(network: Path, pretended: Pretended) -> None:
    alone = threading.Lock()

    def within() -> None:
        assert alone.acquire(blocking=False)
        time.sleep(0.02)
        alone.release()

    pretended.has, pretended.within = [DIRECTML, CPU], within
    session = open_session(network, device="directml")
    run_three_times_at_once(session)
    assert not session.get_session_options().enable_mem_pattern
