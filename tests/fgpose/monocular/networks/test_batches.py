"""How many runs of a network several crops take. The networks are real ones of onnxruntime, on the processor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import test_metrabs as metrabs
import topdown_networks as tiny
from topdown_networks import FLOAT, JOINT_COLOURS, Boxes, Graph

from fgpose.monocular.network import People
from fgpose.monocular.networks.batches import Batches
from fgpose.monocular.networks.metrabs import MeTRAbs
from fgpose.monocular.networks.rtmpose import RTMPose
from fgpose.monocular.networks.rtmw3d import RTMW3D
from fgpose.monocular.networks.sessions import open_session

CPU = "CPUExecutionProvider"
# Boxes of people and how sure they are; their joints are discs at random places within.
BOXES = [(40, 150, 200, 400, 0.9), (340, 100, 220, 380, 0.8), (640, 200, 240, 420, 0.7)]


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many inputs each run of any network has had."""
    lengths: list[int] = []

    class Session(onnxruntime.InferenceSession):
        def run(self, output_names: Any, input_feed: dict[str, np.ndarray], run_options: Any = None) -> Any:
            lengths.append(len(next(iter(input_feed.values()))))
            return super().run(output_names, input_feed, run_options)

    monkeypatch.setattr(onnxruntime, "InferenceSession", Session)
    return lengths


def people_in(network: RTMPose | RTMW3D, runs: list[int]) -> People:
    """In an image of three; runs then has those for this image only."""
    random, image = np.random.default_rng(0), np.full((720, 960, 3), 20, dtype=np.uint8)
    for left, top, width, height, _ in BOXES:
        points_px = random.uniform((left + 10, top + 10), (left + width - 10, top + height - 10), (17, 2))
        tiny.discs(image, points_px, JOINT_COLOURS[:17], 8.0)
    runs.clear()
    return network.tracker(tiny.camera()).detect(image)


def assert_same(one: People, two: People) -> None:
    # A row of a batch goes through the same operations in 32 bits, in another order at most.
    for name in ("boxes", "points2d_px", "confidence", "points3d_m", "covariance_m2"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-5, atol=1e-6)
    assert one.problems == two.problems


def test_all_people_of_an_image_are_in_one_run_where_the_file_leaves_the_batch_open(tmp_path: Path, runs: list[int]):
    free, fixed = (RTMPose(tiny.simcc(tmp_path / f"{batch}.onnx", batch=batch), Boxes(BOXES)) for batch in ("batch", 1))
    together = people_in(free, runs)
    assert runs == [3]
    one_by_one = people_in(fixed, runs)
    assert runs == [1, 1, 1]
    assert together.n_people == 3
    assert (together.confidence > 0).sum() > 40  # of 51; a disc may hide another
    assert_same(together, one_by_one)


def test_joints_in_three_dimensions_are_the_same(tmp_path: Path, runs: list[int]):
    bins = np.random.default_rng(1).integers(250, 330, 133)
    free, fixed = (
        RTMW3D(tiny.simcc(tmp_path / f"{batch}.onnx", 133, batch=batch, depth_bins=bins), Boxes(BOXES))
        for batch in ("batch", 1)
    )
    together = people_in(free, runs)
    assert runs == [3]
    one_by_one = people_in(fixed, runs)
    assert runs == [1, 1, 1]
    assert_same(together, one_by_one)


def test_the_augmentations_of_everybody_are_in_one_run(tmp_path: Path, runs: list[int]):
    points3d_m = metrabs.body(0.3, 0.1, 3.5)
    image, points_px = metrabs.picture(points3d_m)
    box = metrabs.box_around(points_px)
    boxes = Boxes([box, (*np.add(box[:4], (-30, -20, 60, 40)).tolist(), 0.8)])
    found = []
    for batch, expected in (("n", [6]), (1, [1] * 6)):
        path = metrabs.crop_model(tmp_path / f"{batch}.onnx", points3d_m, batch=batch)
        tracker = MeTRAbs(path, boxes, metrabs.SKELETON, num_aug=3).tracker(metrabs.CAMERA)
        runs.clear()
        found.append(tracker.detect(image))
        assert runs == expected
    np.testing.assert_allclose(found[0].points3d_m[0], points3d_m, atol=metrabs.TOLERANCE_M)
    assert_same(*found)


def summing(path: Path, fixed_inside: int | None = None) -> Path:
    """[n, 4] -> [n, 2]: sum and largest; with a number the file shapes its answer for so many, though it says n."""
    graph = Graph()
    total = graph.op("ReduceSum", "x", graph.integers(1), keepdims=1)
    both = graph.op("Concat", total, graph.op("ReduceMax", "x", axes=[1], keepdims=1), axis=1)
    graph.op("Reshape", both, graph.integers(-1 if fixed_inside is None else fixed_inside, 2), output="y")
    return graph.save(path, [("x", FLOAT, ["n", 4])], [("y", FLOAT, ["n", 2])])


def batches(path: Path) -> Batches:
    return Batches(open_session(path), {"x": np.eye(4, dtype=np.float32)[:2]})


X = np.random.default_rng(2).random((19, 4), dtype=np.float32)
SUMS = np.stack([X.sum(axis=1), X.max(axis=1)], axis=1)


def test_many_inputs_take_runs_of_eight(tmp_path: Path, runs: list[int]):
    network = batches(summing(tmp_path / "sum.onnx"))
    runs.clear()
    (sums,) = network.run({"x": X})
    np.testing.assert_allclose(sums, SUMS, rtol=1e-6)
    assert runs == [8, 8, 3]


def test_a_file_that_fixes_the_length_further_inside_gets_one_at_a_time(tmp_path: Path, runs: list[int]):
    network = batches(summing(tmp_path / "sum.onnx", fixed_inside=1))
    runs.clear()
    (sums,) = network.run({"x": X[:3]})
    np.testing.assert_allclose(sums, SUMS[:3], rtol=1e-6)
    assert runs == [1, 1, 1]


def test_a_file_in_which_inputs_meet_gets_one_at_a_time(tmp_path: Path, runs: list[int]):
    graph = Graph()
    graph.op("Sub", "x", graph.op("ReduceMean", "x", axes=[0], keepdims=1), output="y")
    network = batches(graph.save(tmp_path / "mean.onnx", [("x", FLOAT, ["n", 4])], [("y", FLOAT, ["n", 4])]))
    runs.clear()
    np.testing.assert_array_equal(network.run({"x": X[:3]})[0], np.zeros((3, 4)))
    assert runs == [1, 1, 1]


@pytest.mark.parametrize(
    ("provider", "expected"),
    [
        (CPU, [3]),
        ("CUDAExecutionProvider", [3]),
        ("TensorrtExecutionProvider", [1, 1, 1]),
        ("OpenVINOExecutionProvider", [1, 1, 1]),
        ("CoreMLExecutionProvider", [1, 1, 1]),
        ("DmlExecutionProvider", [1, 1, 1]),
    ],
)
def test_devices_that_prepare_for_each_length_get_one_at_a_time(
    provider: str, expected: list[int], tmp_path: Path, runs: list[int], monkeypatch: pytest.MonkeyPatch
):
    path = summing(tmp_path / "sum.onnx")
    session = open_session(path, device="cpu")
    monkeypatch.setattr(session, "get_providers", lambda: [provider])
    network = Batches(session, {"x": np.eye(4, dtype=np.float32)[:2]})
    runs.clear()
    np.testing.assert_allclose(network.run({"x": X[:3]})[0], SUMS[:3], rtol=1e-6)
    assert runs == expected
