from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from topdown_networks import FLOAT, FLOAT16, Graph

from fgpose.monocular.networks.sessions import Shape, check_signature, open_session

INPUTS: dict[str, Shape] = {"image": (None, 4, 4, 3)}
OUTPUTS: dict[str, Shape] = {"sum": ("batch", 1)}


def network(path: Path, *, rename: str = "image", shape: Any = ("n", 4, 4, 3), kind: int = FLOAT, more: bool = False):
    """Sums the pixels of images; with more it also takes a number."""
    graph = Graph()
    total = graph.op("ReduceSum", rename, graph.integers(*range(1, len(shape))), keepdims=0)
    total = graph.op("Add", total, "number") if more else total
    graph.op("Unsqueeze", total, graph.integers(1), output="sum")
    graph.op("Identity", rename, output="echo")
    inputs = [(rename, kind, list(shape)), *([("number", kind, [1])] if more else [])]
    return graph.save(path, inputs, [("sum", kind, ["n", 1]), ("echo", kind, list(shape))])


def test_a_network_runs_with_the_threads_asked_for(tmp_path: Path) -> None:
    images = np.random.default_rng(0).random((2, 4, 4, 3)).astype(np.float32)
    for threads in (1, 2):
        session = open_session(network(tmp_path / "sum.onnx"), threads)
        assert session.get_session_options().intra_op_num_threads == threads
        (total,) = session.run(["sum"], {"image": images})
        np.testing.assert_allclose(np.asarray(total)[:, 0], images.sum(axis=(1, 2, 3)), rtol=1e-5)


def test_what_is_expected_may_leave_lengths_open_and_so_may_the_file(tmp_path: Path) -> None:
    path = network(tmp_path / "sum.onnx", shape=("n", "height", 4, 3))
    check_signature(open_session(path), path, INPUTS, OUTPUTS)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"rename": "picture"}, "picture [any, 4, 4, 3]"),
        ({"shape": ("n", 4, 4, 1)}, "image [any, 4, 4, 1]"),
        ({"shape": ("n", 4, 12)}, "image [any, 4, 12]"),
        ({"kind": FLOAT16}, "image [any, 4, 4, 3] tensor(float16)"),
        ({"more": True}, "number [1]"),
    ],
)
def test_another_network_is_refused_with_what_it_has(tmp_path: Path, changes: dict[str, Any], found: str) -> None:
    path = network(tmp_path / "other.onnx", **changes)
    with pytest.raises(ValueError, match="another network") as caught:
        check_signature(open_session(path), path, INPUTS, OUTPUTS)
    for part in (str(path), "image [any, 4, 4, 3]", "sum [any, 1]", found):
        assert part in str(caught.value)


def test_an_output_may_not_be_missing(tmp_path: Path) -> None:
    path = network(tmp_path / "sum.onnx")
    with pytest.raises(ValueError, match=r"outputs mean \[any, 1\] in float32"):
        check_signature(open_session(path), path, INPUTS, {"mean": (None, 1)})


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"absent\.onnx: there is no such network file"):
        open_session(tmp_path / "absent.onnx")


@pytest.mark.parametrize("content", [b"", b"not a network", bytes(range(256)) * 8])
def test_a_file_that_is_no_network_is_named(tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "text.onnx"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"text\.onnx is not an ONNX network"):
        open_session(path)
    assert capfd.readouterr() == ("", "")


def test_a_damaged_network_is_named(tmp_path: Path) -> None:
    path = network(tmp_path / "cut.onnx")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match=r"cut\.onnx is not an ONNX network"):
        open_session(path)


@pytest.mark.parametrize("location", ["../secret", "link", "absolute"])
def test_a_network_reads_no_file_outside_its_folder(tmp_path: Path, location: str) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(16))
    path = network(tmp_path / "sum.onnx")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/link").symlink_to(secret)
    model = onnx.load(path)
    tensor = model.graph.initializer.add(name="secret", data_type=FLOAT, dims=[4])
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location if location != "absolute" else str(secret))
    model.graph.node.add(op_type="Identity", input=["secret"], output=["read"])
    model.graph.output.add(name="read").type.tensor_type.elem_type = FLOAT
    crafted = tmp_path / "folder/crafted.onnx"
    crafted.write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match=r"crafted\.onnx is not an ONNX network that onnxruntime can run: .*xternal"):
        open_session(crafted)


def test_no_threads_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one thread, got 0"):
        open_session(network(tmp_path / "sum.onnx"), 0)
