from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from tiny_tflite import Sparse, TinyTflite, interpret, schema

from fgpose.monocular.downloads.tflite import convert
from fgpose.monocular.downloads.tflite_model import read_tflite

SAME, VALID = schema.Padding.SAME, schema.Padding.VALID
NONE, RELU = schema.ActivationFunctionType.NONE, schema.ActivationFunctionType.RELU
RELU6, RELU_N1_TO_1 = schema.ActivationFunctionType.RELU6, schema.ActivationFunctionType.RELU_N1_TO_1
TANH = schema.ActivationFunctionType.TANH


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=2.0, size=shape).astype(np.float32)


def run_onnx(data: bytes, images: np.ndarray) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    results: list[Any] = list(session.run(names, {session.get_inputs()[0].name: images}))
    return dict(zip(names, results, strict=True))


def assert_agrees(data: bytes, *shape: int) -> dict[str, np.ndarray]:
    """The converted model gives for a batch of three images what the interpreter gives for each of them."""
    images = normal(3, *shape, seed=1)
    found, expected = run_onnx(convert(data), images), interpret(data, images)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].shape == value.shape
        # Sums of at most 100 products of numbers about 2, each rounded to 24 bits.
        np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-4)
    return found


def single(
    kind: str, shape: tuple[int, ...], result: tuple[int, ...], table: str = "", *constants: np.ndarray, **options: Any
) -> bytes:
    """A model of one operator that takes the image and constants."""
    tiny = TinyTflite()
    image, output = tiny.tensor(1, *shape, name="image"), tiny.tensor(1, *result, name="result")
    tiny.operator(kind, [image, *map(tiny.constant, constants)], output, table, **options)
    return tiny.build([image], [output])


def window(
    stride: tuple[int, int] = (1, 1), padding: int = SAME, activation: int = NONE, **more: int
) -> dict[str, int]:
    return {
        "strideH": stride[0],
        "strideW": stride[1],
        "padding": padding,
        "fusedActivationFunction": activation,
        **more,
    }


@pytest.mark.parametrize("size", [(8, 9), (7, 10)])
@pytest.mark.parametrize("padding", [SAME, VALID])
@pytest.mark.parametrize(
    ("stride", "dilation"), [((1, 1), (1, 1)), ((2, 2), (1, 1)), ((3, 2), (1, 1)), ((1, 1), (2, 1)), ((2, 1), (1, 2))]
)
def test_convolution(size: tuple[int, int], stride: tuple[int, int], padding: int, dilation: tuple[int, int]) -> None:
    # An even kernel: SAME adds one row more after than before.
    kernel, spans = (4, 3), [(k - 1) * d + 1 for k, d in zip((4, 3), dilation, strict=True)]
    lost = (0, 0) if padding == SAME else [span - 1 for span in spans]
    result = [-(-(n - less) // s) for n, less, s in zip(size, lost, stride, strict=True)]
    options = window(stride, padding, dilationHFactor=dilation[0], dilationWFactor=dilation[1])
    data = single(
        "CONV_2D", (*size, 3), (*result, 5), "Conv2DOptions", normal(5, *kernel, 3), normal(5, seed=2), **options
    )
    assert_agrees(data, *size, 3)


@pytest.mark.parametrize("activation", [NONE, RELU, RELU6, RELU_N1_TO_1])
def test_activation_functions(activation: int) -> None:
    options = window(activation=activation)
    data = single("CONV_2D", (5, 5, 2), (5, 5, 4), "Conv2DOptions", normal(4, 1, 1, 2), normal(4), **options)
    (result,) = assert_agrees(data, 5, 5, 2).values()
    unbounded = single("CONV_2D", (5, 5, 2), (5, 5, 4), "Conv2DOptions", normal(4, 1, 1, 2), normal(4), **window())
    (before,) = run_onnx(convert(unbounded), normal(3, 5, 5, 2, seed=1)).values()
    assert (result != before).any() == (activation != NONE)


@pytest.mark.parametrize("multiplier", [1, 2])
@pytest.mark.parametrize("stride", [1, 2])
def test_depthwise_convolution(multiplier: int, stride: int) -> None:
    side, options = -(-8 // stride), window((stride, stride), depthMultiplier=multiplier)
    kernel, bias = normal(1, 5, 5, 3 * multiplier), normal(3 * multiplier, seed=2)
    result = (side, side, 3 * multiplier)
    assert_agrees(
        single("DEPTHWISE_CONV_2D", (8, 8, 3), result, "DepthwiseConv2DOptions", kernel, bias, **options), 8, 8, 3
    )


def test_grouped_convolution() -> None:
    data = single("CONV_2D", (6, 6, 4), (6, 6, 6), "Conv2DOptions", normal(6, 3, 3, 2), normal(6, seed=2), **window())
    assert_agrees(data, 6, 6, 4)


@pytest.mark.parametrize(("padding", "side"), [(SAME, 4), (VALID, 3)])
def test_max_pool(padding: int, side: int) -> None:
    # Negative everywhere: what is added around the image must not count as 0.
    tiny = TinyTflite()
    image, lower, output = tiny.tensor(1, 7, 7, 2, name="image"), tiny.tensor(1, 7, 7, 2), tiny.tensor(1, side, side, 2)
    tiny.operator("ADD", [image, tiny.constant(np.full(2, -50, dtype=np.float32))], lower, "AddOptions")
    options = window((2, 2), padding, filterHeight=2, filterWidth=3)
    tiny.operator("MAX_POOL_2D", [lower], output, "Pool2DOptions", **options)
    (result,) = assert_agrees(tiny.build([image], [output]), 7, 7, 2).values()
    assert (result < 0).all()


@pytest.mark.parametrize("constant", [(3,), (1, 1, 1, 3), (4, 1, 3), (1, 4, 5, 3)])
def test_sum_with_a_constant(constant: tuple[int, ...]) -> None:
    data = single("ADD", (4, 5, 3), (4, 5, 3), "AddOptions", normal(*constant), fusedActivationFunction=RELU6)
    assert_agrees(data, 4, 5, 3)


def test_sum_of_two_branches() -> None:
    tiny = TinyTflite()
    image, left, output = tiny.tensor(1, 4, 4, 3, name="image"), tiny.tensor(1, 4, 4, 3), tiny.tensor(1, 4, 4, 3)
    tiny.operator("LOGISTIC", [image], left)
    tiny.operator("ADD", [left, image], output, "AddOptions", fusedActivationFunction=RELU)
    assert_agrees(tiny.build([image], [output]), 4, 4, 3)


def test_pad() -> None:
    around = np.array([[0, 0], [1, 2], [3, 0], [0, 4]], dtype=np.int32)
    assert_agrees(single("PAD", (4, 5, 3), (7, 8, 7), "", around), 4, 5, 3)


@pytest.mark.parametrize("mode", [{}, {"alignCorners": True}, {"halfPixelCenters": True}])
@pytest.mark.parametrize("size", [(10, 14), (7, 11), (3, 4)])
def test_resize(mode: dict[str, bool], size: tuple[int, int]) -> None:
    data = single(
        "RESIZE_BILINEAR", (5, 7, 2), (*size, 2), "ResizeBilinearOptions", np.array(size, dtype=np.int32), **mode
    )
    assert_agrees(data, 5, 7, 2)


def test_depth_to_space() -> None:
    assert_agrees(single("DEPTH_TO_SPACE", (3, 4, 12), (6, 8, 3), "DepthToSpaceOptions", blockSize=2), 3, 4, 12)


def test_logistic() -> None:
    assert_agrees(single("LOGISTIC", (3, 4, 2), (3, 4, 2)), 3, 4, 2)


@pytest.mark.parametrize(("shape", "result"), [((4, 6, 3), (24, 3)), ((4, 6, 3), (2, 9, 4)), ((8, 9), (3, 4, 6))])
def test_reshape_keeps_the_order_of_the_numbers(shape: tuple[int, ...], result: tuple[int, ...]) -> None:
    sizes = np.array([1, *result], dtype=np.int32)
    assert_agrees(single("RESHAPE", shape, result, "ReshapeOptions", sizes, newShape=sizes), *shape)


@pytest.mark.parametrize("axis", [1, 2, 3, -1])
def test_concatenation(axis: int) -> None:
    tiny, sizes = TinyTflite(), [1, 4, 5, 3]
    sizes[axis] *= 2
    image, other, output = tiny.tensor(1, 4, 5, 3, name="image"), tiny.tensor(1, 4, 5, 3), tiny.tensor(*sizes)
    tiny.operator("LOGISTIC", [image], other)
    tiny.operator("CONCATENATION", [image, other], output, "ConcatenationOptions", axis=axis)
    assert_agrees(tiny.build([image], [output]), 4, 5, 3)


def test_concatenation_of_lists() -> None:
    tiny = TinyTflite()
    image, other, output = tiny.tensor(1, 6, 2, name="image"), tiny.tensor(1, 6, 2), tiny.tensor(1, 12, 2)
    tiny.operator("LOGISTIC", [image], other)
    tiny.operator("CONCATENATION", [image, other], output, "ConcatenationOptions", axis=1)
    assert_agrees(tiny.build([image], [output]), 6, 2)


def test_weights_in_half_precision_stay_so() -> None:
    weights = normal(64, 3, 3, 8).astype(np.float16)
    tiny = TinyTflite()
    image, output = tiny.tensor(1, 6, 6, 8, name="image"), tiny.tensor(1, 6, 6, 64)
    wide, bias = tiny.tensor(*weights.shape), tiny.constant(normal(64))
    tiny.operator("DEQUANTIZE", [tiny.constant(weights)], wide)
    tiny.operator("CONV_2D", [image, wide, bias], output, "Conv2DOptions", **window())
    data = tiny.build([image], [output])
    assert_agrees(data, 6, 6, 8)
    assert len(convert(data)) < weights.nbytes + 1500


def test_an_output_may_be_used_further() -> None:
    # The sum is an output with four dimensions and is flattened too; both need its channels last.
    tiny = TinyTflite()
    image, total, flat = tiny.tensor(1, 2, 3, 4, name="image"), tiny.tensor(1, 2, 3, 4), tiny.tensor(1, 24)
    tiny.operator("ADD", [image, image], total, "AddOptions")
    tiny.operator("RESHAPE", [total], flat, "ReshapeOptions", newShape=np.array([1, 24], dtype=np.int32))
    assert_agrees(tiny.build([image], [flat, total]), 2, 3, 4)


SPARSE: dict[str, Callable[[np.ndarray], Sparse]] = {
    "compressed channels": lambda dense: Sparse(dense, [0, 1, 2, 3], {}, [3]),
    "blocks of channels": lambda dense: Sparse(dense, [0, 1, 2, 3, 4], {3: 4}, [3]),
    "blocks of outputs and channels": lambda dense: Sparse(dense, [0, 1, 2, 3, 4, 5], {0: 2, 3: 4}, [3]),
    "channels before outputs": lambda dense: Sparse(dense, [3, 0, 2, 1, 4], {3: 4}, [0, 1]),
    "all of it dense": lambda dense: Sparse(dense, [0, 1, 2, 3], {}, []),
}


def sparse_model(encode: Callable[[np.ndarray], Sparse], outputs: int) -> tuple[bytes, np.ndarray]:
    """A convolution with sparse weights in half precision, and the weights."""
    dense = normal(outputs, 1, 2, 16).astype(np.float16)
    dense *= np.repeat(np.random.default_rng(3).random((outputs, 1, 2, 4)) < 0.3, 4, axis=3)
    encoded, tiny = encode(dense), TinyTflite()
    image, output = tiny.tensor(1, 5, 5, 16, name="image"), tiny.tensor(1, 5, 5, outputs)
    filled, wide = tiny.tensor(*dense.shape, kind="FLOAT16"), tiny.tensor(*dense.shape)
    tiny.operator("DENSIFY", [tiny.constant(dense, encoded.parameters(), encoded.stored)], filled)
    tiny.operator("DEQUANTIZE", [filled], wide)
    bias = tiny.constant(normal(outputs))
    tiny.operator("CONV_2D", [image, wide, bias], output, "Conv2DOptions", **window())
    return tiny.build([image], [output]), dense


def half_precision_constant(data: bytes) -> np.ndarray:
    (constant,) = (
        each.constant for each in read_tflite(data).tensors if each.kind == "FLOAT16" and each.constant is not None
    )
    return constant


# 8, 200 and 4500 outputs: the lists of the filled places need numbers of 8, 16 and 32 bits.
@pytest.mark.parametrize("outputs", [8, 200, 4500])
@pytest.mark.parametrize("encoding", SPARSE)
def test_sparse_weights(encoding: str, outputs: int) -> None:
    data, dense = sparse_model(SPARSE[encoding], outputs)
    np.testing.assert_array_equal(half_precision_constant(data), dense)
    if outputs == 8:
        assert_agrees(data, 5, 5, 16)


def two_heads() -> bytes:
    """A model whose second output needs an operator that cannot be converted."""
    tiny = TinyTflite()
    image = tiny.tensor(1, 4, 4, 2, name="image")
    points, mask = tiny.tensor(1, 4, 4, 2, name="points"), tiny.tensor(1, 4, 4, 2, name="mask")
    tiny.operator("LOGISTIC", [image], points)
    tiny.operator("TANH", [points], mask)
    return tiny.build([image], [points, mask])


def test_what_is_not_wanted_is_left_out() -> None:
    converted = onnx.load_from_string(convert(two_heads(), outputs=["points"]))
    assert [output.name for output in converted.graph.output] == ["points"]
    assert {node.op_type for node in converted.graph.node} == {"Transpose", "Sigmoid", "Identity"}


def test_metadata_and_bytes_are_reproducible() -> None:
    origin = {"source": "somewhere", "license": "Apache-2.0"}
    converted = convert(two_heads(), outputs=["points"], metadata=origin)
    assert {each.key: each.value for each in onnx.load_from_string(converted).metadata_props} == origin
    assert convert(two_heads(), outputs=["points"], metadata=origin) == converted


def test_an_unknown_operator_is_named() -> None:
    with pytest.raises(ValueError, match="operator TANH that gives 'mask' cannot be converted: supported are ADD, "):
        convert(two_heads())


def test_a_file_from_before_the_128th_operator() -> None:
    tiny = TinyTflite()
    image, output = tiny.tensor(1, 4, name="image"), tiny.tensor(1, 4, name="result")
    tiny.operator("LOGISTIC", [image], output)
    tiny.codes[0].builtinCode = 0  # the newer field did not exist
    assert_agrees(tiny.build([image], [output]), 4)


def test_an_unknown_output_is_named() -> None:
    with pytest.raises(ValueError, match="no output depth; it has points, mask"):
        convert(two_heads(), outputs=["points", "depth"])


def refused() -> dict[str, tuple[bytes, str]]:
    """Models that cannot be converted, and the error messages."""
    custom = TinyTflite()
    image, output = custom.tensor(1, 4, name="image"), custom.tensor(1, 4, name="result")
    custom.operator("CUSTOM", [image], output)
    custom.codes[0].customCode = "Warp"
    split = TinyTflite()
    halves = [split.tensor(1, 4, name="image"), split.tensor(1, 2), split.tensor(1, 2)]
    split.operator("SPLIT", [split.constant(np.array(1, dtype=np.int32)), halves[0]], halves[1:])
    integers = TinyTflite()
    bytes_in = integers.tensor(1, 4, name="image", kind="UINT8")
    integers.operator("LOGISTIC", [bytes_in], integers.tensor(1, 4, name="result"))
    spread = {"fusedActivationFunction": TANH}
    computed = TinyTflite()
    weights = [computed.tensor(1, 3, 3, 1, name="image"), computed.tensor(1, 3, 3, 1, name="result")]
    computed.operator("CONV_2D", [weights[0], weights[0]], weights[1], "Conv2DOptions", **window())
    return {
        "newer operator": (single("GELU", (3,), (3,)), "operator GELU that gives 'result'"),
        "custom": (custom.build([image], [output]), "operator CUSTOM Warp"),
        "several outputs": (split.build(halves[:1], halves[1:]), "operator SPLIT with 2 outputs"),
        "integers": (integers.build([bytes_in], [bytes_in + 1]), "'image' is UINT8"),
        "activation": (single("ADD", (3,), (3,), "AddOptions", normal(3), **spread), "activation function is TANH"),
        "computed weights": (computed.build(weights[:1], weights[1:]), "'image' must be a constant"),
    }


@pytest.mark.parametrize(
    "what", ["newer operator", "custom", "several outputs", "integers", "activation", "computed weights"]
)
def test_what_is_not_supported_is_said(what: str) -> None:
    data, message = refused()[what]
    with pytest.raises(ValueError, match=message):
        convert(data)


def test_images_must_not_be_mixed() -> None:
    tiny = TinyTflite()
    image, rows = tiny.tensor(1, 4, 3, name="image"), tiny.tensor(4, 3, name="rows")
    tiny.operator("RESHAPE", [image], rows, "ReshapeOptions", newShape=np.array([4, 3], dtype=np.int32))
    with pytest.raises(ValueError, match=r"RESHAPE that gives 'rows'.*changes the first dimension"):
        convert(tiny.build([image], [rows]))


def test_quantised_weights_are_refused() -> None:
    tiny = TinyTflite()
    image, weights = tiny.tensor(1, 4, name="image"), tiny.constant(np.zeros(4, dtype=np.int32))
    tiny.tensors[weights].type = schema.TensorType.INT32
    wide, output = tiny.tensor(4, name="wide"), tiny.tensor(1, 4, name="result")
    tiny.operator("DEQUANTIZE", [weights], wide)
    tiny.operator("ADD", [image, wide], output, "AddOptions")
    with pytest.raises(ValueError, match=r"DEQUANTIZE that gives 'wide'.*half precision"):
        convert(tiny.build([image], [output]))


@pytest.mark.parametrize("data", [b"", b"<html>not found</html>", b"PK\3\4" + bytes(100)])
def test_another_kind_of_file_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not a TensorFlow Lite model"):
        convert(data)


def test_a_truncated_file_is_refused() -> None:
    data, _ = sparse_model(SPARSE["blocks of channels"], 8)
    for length in range(8, len(data), 7):
        with pytest.raises(ValueError, match=r"damaged|not supported|cannot be converted"):
            convert(data[:length])


def test_a_damaged_file_never_crashes() -> None:
    data, _ = sparse_model(SPARSE["blocks of channels"], 8)
    rng, refusals = np.random.default_rng(0), 0
    for _ in range(400):
        damaged = bytearray(data)
        damaged[rng.integers(8, len(data))] = rng.integers(256)
        try:
            convert(bytes(damaged))
        except ValueError:
            refusals += 1
    # The rest of the bytes are weights, names and padding.
    assert refusals > 50


@pytest.mark.parametrize("data", [b"", b"nothing of this kind", two_heads()[:-100], two_heads()])
def test_what_is_refused_is_named(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"^heads\.tflite: "):
        convert(data, name="heads.tflite")
