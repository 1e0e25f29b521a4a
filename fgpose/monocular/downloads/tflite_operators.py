"""An ONNX graph that grows out of a TensorFlow Lite one, and what each operator is in it (opset 13)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Shaped

from fgpose.monocular.downloads.tflite_model import Operator, TfliteModel

if TYPE_CHECKING:
    import onnx

# Permutations of (image, row, column, channel) and back.
CHANNELS_FIRST = (0, 3, 1, 2)
_CHANNELS_LAST = (0, 2, 3, 1)


class OnnxGraph:
    """Nodes and constants so far. Every value with four dimensions is kept with its channels first."""

    def __init__(self, model: TfliteModel, constants: Mapping[int, np.ndarray]) -> None:
        """
        Args:
            model: where the values come from.
            constants: tensors whose numbers are known, by index.
        """
        self.model = model
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: dict[str, onnx.TensorProto] = {}
        self._constants = constants
        self._values: dict[int, str] = {}
        self._channels_last: dict[int, str] = {}

    def shape(self, tensor: int) -> tuple[int, ...]:
        """With the channels last."""
        return self.model.tensors[tensor].shape

    def node(self, kind: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        """Append a node; returns the name of its output. An empty name is an input left out."""
        from onnx import helper

        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def constant(self, name: str, array: Shaped[np.ndarray, "*shape"]) -> str:
        """Name of a constant; the same name is the same constant. Half precision is stored as such and widened."""
        from onnx import TensorProto, numpy_helper

        if name in self.initializers:
            return name
        is_half = array.dtype == np.float16
        stored = f"{name}_half" if is_half else name
        if stored not in self.initializers:
            self.initializers[stored] = numpy_helper.from_array(np.ascontiguousarray(array), stored)
            if is_half:
                self.node("Cast", [stored], name, to=TensorProto.FLOAT)
        return name

    def is_constant(self, tensor: int) -> bool:
        return tensor in self._constants

    def numbers(self, tensor: int) -> Shaped[np.ndarray, "*shape"]:
        """Numbers of a constant tensor, channels last. Raises ValueError if they are only known at run time."""
        if tensor not in self._constants:
            raise ValueError(f"tensor {self.model.tensors[tensor].name!r} must be a constant")
        return self._constants[tensor]

    def value(self, tensor: int) -> str:
        """Name of a computed value, channels first. Raises ValueError for a constant."""
        if tensor not in self._values:
            raise ValueError(f"tensor {self.model.tensors[tensor].name!r} must be computed from the input")
        return self._values[tensor]

    def set_value(self, tensor: int, name: str) -> None:
        """Say what a tensor is called here; channels first."""
        self._values[tensor] = name

    def channels_last(self, tensor: int) -> str:
        """Name of a computed value with the channels last."""
        name = self.value(tensor)
        if len(self.shape(tensor)) != 4:
            return name
        if tensor not in self._channels_last:
            output = f"tensor_{tensor}_channels_last"
            self._channels_last[tensor] = self.node("Transpose", [name], output, perm=_CHANNELS_LAST)
        return self._channels_last[tensor]

    def channels_first(self, name: str, tensor: int, output: str) -> str:
        """The value of a tensor that is known with its channels last."""
        if len(self.shape(tensor)) != 4:
            return name
        return self.node("Transpose", [name], output, perm=CHANNELS_FIRST)


OPSET = 13  # of ONNX; every onnxruntime that fgpose supports runs it

_CLIPS = {"RELU6": (0.0, 6.0), "RELU_N1_TO_1": (-1.0, 1.0)}


def convert_operator(graph: OnnxGraph, operator: Operator) -> None:
    """Append what the operator computes to the graph.

    Raises:
        ValueError: it is not supported, or not with these options; the message names it and its output.
    """
    try:
        if operator.kind not in _CONVERTERS:
            raise ValueError(f"supported are {', '.join(sorted(SUPPORTED))}")
        _check_batch(graph, operator)
        name = _CONVERTERS[operator.kind](graph, operator, f"tensor_{operator.output}")
    except (ValueError, ArithmeticError, LookupError, TypeError) as error:
        # A damaged file may have a stride of 0, or a constant with other dimensions than its operator takes.
        tensor = graph.model.tensors[operator.output].name
        message = f"the TensorFlow Lite operator {operator.kind} that gives {tensor!r} cannot be converted: {error}"
        raise ValueError(message) from None
    graph.set_value(operator.output, name)


def fold_constants(operators: tuple[Operator, ...], constants: dict[int, np.ndarray]) -> tuple[Operator, ...]:
    """Operators that only unpack a constant are done here: sparse ones are dense already, half precision stays.

    Args:
        operators: in the order of execution.
        constants: by tensor; the unpacked ones are added.

    Returns:
        The other operators.
    """
    left = []
    for operator in operators:
        packed = constants.get(operator.inputs[0]) if operator.inputs else None
        if packed is not None and (operator.kind == "DENSIFY" or _is_half(operator, packed)):
            constants[operator.output] = packed
        else:
            left.append(operator)
    return tuple(left)


def _is_half(operator: Operator, packed: np.ndarray) -> bool:
    return operator.kind == "DEQUANTIZE" and packed.dtype == np.float16


def _check_batch(graph: OnnxGraph, operator: Operator) -> None:
    """The first dimension counts images, of which there may be any number: nothing may mix or add them."""
    batch = graph.shape(operator.output)[:1]
    computed = [tensor for tensor in operator.inputs if tensor != -1 and not graph.is_constant(tensor)]
    if any(graph.shape(tensor)[:1] != batch for tensor in computed):
        raise ValueError("it changes the first dimension, the number of images")


def _convolution(graph: OnnxGraph, operator: Operator, output: str) -> str:
    image, kernel = operator.inputs[:2]
    weights = graph.numbers(kernel)
    # Stored as (out, height, width, in), depthwise as (1, height, width, out); ONNX has (out, in / groups, h, w).
    weights = weights.transpose(3, 0, 1, 2) if operator.kind.startswith("DEPTHWISE") else weights.transpose(0, 3, 1, 2)
    names = [graph.value(image), graph.constant(f"{output}_weights", weights)]
    if len(operator.inputs) > 2 and operator.inputs[2] != -1:
        names.append(graph.constant(f"{output}_bias", graph.numbers(operator.inputs[2])))
    kernel_hw = weights.shape[2:]
    stride_hw = operator.options["StrideH"], operator.options["StrideW"]
    dilation_hw = operator.options["DilationHFactor"], operator.options["DilationWFactor"]
    result = graph.node(
        "Conv",
        names,
        output,
        kernel_shape=kernel_hw,
        strides=stride_hw,
        dilations=dilation_hw,
        pads=_pads(operator, graph.shape(image)[1:3], kernel_hw, stride_hw, dilation_hw),
        group=graph.shape(image)[3] // weights.shape[1],
    )
    return _activated(graph, operator, result)


def _max_pool(graph: OnnxGraph, operator: Operator, output: str) -> str:
    (image,) = operator.inputs
    kernel_hw = operator.options["FilterHeight"], operator.options["FilterWidth"]
    stride_hw = operator.options["StrideH"], operator.options["StrideW"]
    pads = _pads(operator, graph.shape(image)[1:3], kernel_hw, stride_hw, (1, 1))
    result = graph.node("MaxPool", [graph.value(image)], output, kernel_shape=kernel_hw, strides=stride_hw, pads=pads)
    return _activated(graph, operator, result)


def _pads(
    operator: Operator,
    size_hw: tuple[int, ...],
    kernel_hw: tuple[int, ...],
    stride_hw: tuple[int, ...],
    dilation_hw: tuple[int, ...],
) -> tuple[int, ...]:
    """Rows and columns added before, then after. SAME gives ceil(size / stride) outputs, an odd row at the end."""
    if operator.options["Padding"] == "VALID":
        return 0, 0, 0, 0
    steps_hw = [-(-size // stride) - 1 for size, stride in zip(size_hw, stride_hw, strict=True)]
    spans_hw = [(kernel - 1) * dilation + 1 for kernel, dilation in zip(kernel_hw, dilation_hw, strict=True)]
    missing_hw = [
        max(steps * stride + span - size, 0)
        for steps, stride, span, size in zip(steps_hw, stride_hw, spans_hw, size_hw, strict=True)
    ]
    before_hw = [missing // 2 for missing in missing_hw]
    return *before_hw, *(missing - before for missing, before in zip(missing_hw, before_hw, strict=True))


def _add(graph: OnnxGraph, operator: Operator, output: str) -> str:
    rank = len(graph.shape(operator.output))
    return _activated(graph, operator, graph.node("Add", [_term(graph, i, rank) for i in operator.inputs], output))


def _term(graph: OnnxGraph, tensor: int, rank: int) -> str:
    """A term of a sum with so many dimensions; one with fewer is broadcast along the first ones."""
    if graph.is_constant(tensor):
        numbers = graph.numbers(tensor)
        numbers = numbers.reshape((1,) * (rank - numbers.ndim) + numbers.shape)
        return graph.constant(f"tensor_{tensor}", numbers.transpose(CHANNELS_FIRST) if rank == 4 else numbers)
    if len(graph.shape(tensor)) != rank:
        raise ValueError("its terms have different numbers of dimensions")
    return graph.value(tensor)


def _pad(graph: OnnxGraph, operator: Operator, output: str) -> str:
    image, paddings = operator.inputs
    before_after = graph.numbers(paddings)
    if len(before_after) == 4:
        before_after = before_after[list(CHANNELS_FIRST)]
    pads = graph.constant(f"{output}_pads", before_after.T.ravel().astype(np.int64))
    return graph.node("Pad", [graph.value(image), pads], output)


def _resize_bilinear(graph: OnnxGraph, operator: Operator, output: str) -> str:
    if operator.options["AlignCorners"]:
        mode = "align_corners"
    else:
        mode = "half_pixel" if operator.options["HalfPixelCenters"] else "asymmetric"
    sizes_hw = zip(graph.shape(operator.inputs[0])[1:3], graph.shape(operator.output)[1:3], strict=True)
    scales = np.array([1.0, 1.0, *(_scale(before, after) for before, after in sizes_hw)], dtype=np.float32)
    inputs = [graph.value(operator.inputs[0]), "", graph.constant(f"{output}_scales", scales)]
    return graph.node("Resize", inputs, output, mode="linear", coordinate_transformation_mode=mode)


def _scale(before: int, after: int) -> np.float32:
    """The factor whose product with the size, rounded down, is the new size.

    Sizes cannot be given: of all four dimensions together, the first is unknown, and for some of them (opset 18)
    onnxruntime 1.31 fails when it moves a transpose past the node.
    """
    scale = np.float32(after / before)
    return scale if float(scale) * before >= after else np.nextafter(scale, np.float32(np.inf))


def _depth_to_space(graph: OnnxGraph, operator: Operator, output: str) -> str:
    block = operator.options["BlockSize"]
    return graph.node("DepthToSpace", [graph.value(operator.inputs[0])], output, blocksize=block, mode="DCR")


def _logistic(graph: OnnxGraph, operator: Operator, output: str) -> str:
    return graph.node("Sigmoid", [graph.value(operator.inputs[0])], output)


def _reshape(graph: OnnxGraph, operator: Operator, output: str) -> str:
    # 0 keeps the first dimension, whatever it is.
    shape = np.array([0, *graph.shape(operator.output)[1:]], dtype=np.int64)
    names = [graph.channels_last(operator.inputs[0]), graph.constant(f"{output}_shape", shape)]
    reshaped = graph.node("Reshape", names, output)
    return graph.channels_first(reshaped, operator.output, f"{output}_channels_first")


def _concatenation(graph: OnnxGraph, operator: Operator, output: str) -> str:
    rank = len(graph.shape(operator.output))
    axis = operator.options["Axis"] % rank
    axis = CHANNELS_FIRST.index(axis) if rank == 4 else axis
    return _activated(
        graph, operator, graph.node("Concat", [graph.value(i) for i in operator.inputs], output, axis=axis)
    )


def _activated(graph: OnnxGraph, operator: Operator, name: str) -> str:
    """The activation function that is part of an operator."""
    kind = operator.options["FusedActivationFunction"]
    if kind == "NONE":
        return name
    if kind == "RELU":
        return graph.node("Relu", [name], f"{name}_relu")
    if kind not in _CLIPS:
        raise ValueError(f"its activation function is {kind}")
    bounds = [graph.constant(f"bound_{bound:g}", np.array(bound, dtype=np.float32)) for bound in _CLIPS[kind]]
    return graph.node("Clip", [name, *bounds], f"{name}_{kind.lower()}")


_CONVERTERS: dict[str, Callable[[OnnxGraph, Operator, str], str]] = {
    "ADD": _add,
    "CONCATENATION": _concatenation,
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _convolution,
    "DEPTH_TO_SPACE": _depth_to_space,
    "LOGISTIC": _logistic,
    "MAX_POOL_2D": _max_pool,
    "PAD": _pad,
    "RESHAPE": _reshape,
    "RESIZE_BILINEAR": _resize_bilinear,
}
SUPPORTED = (*_CONVERTERS, "DENSIFY of constants", "DEQUANTIZE of constants in half precision")
