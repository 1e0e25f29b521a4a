"""TensorFlow Lite to ONNX, for convolutional networks of floating-point numbers such as BlazePose.

Inputs and outputs keep their names and have the channels last, as in the original; their first dimension becomes
free, so any number of images can be run at once. Weights in half precision stay so. The same file always gives the same
bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from fgpose.monocular.downloads.tflite_model import Operator, TfliteModel, read_tflite
from fgpose.monocular.downloads.tflite_operators import OPSET, OnnxGraph, convert_operator, fold_constants

if TYPE_CHECKING:
    import onnx

_IR_VERSION = 8  # of ONNX; fixed, so that the bytes do not depend on the version of onnx
_BATCH = "N"


def convert(
    data: bytes,
    *,
    name: str = "the model",
    outputs: Sequence[str] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> bytes:
    """The ONNX file of a TensorFlow Lite file.

    Args:
        data: content of a .tflite file.
        name: of the file, for messages.
        outputs: names of those wanted, in this order; by default all. What only the others need is left out.
        metadata: kept in the file (metadata_props).

    Raises:
        ValueError: the data is no TensorFlow Lite model, or damaged, or has no such output, or has operators or types
            that are not supported; the message names the file and them.
    """
    try:
        return _converted(data, outputs, metadata or {})
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _converted(data: bytes, outputs: Sequence[str] | None, metadata: Mapping[str, str]) -> bytes:
    import onnx

    model = read_tflite(data)
    wanted = _wanted(model, outputs)
    constants = {i: tensor.constant for i, tensor in enumerate(model.tensors) if tensor.constant is not None}
    operators = _needed(fold_constants(model.operators, constants), wanted)
    graph = OnnxGraph(model, constants)
    inputs = [_input(graph, tensor) for tensor in model.inputs]
    for operator in operators:
        convert_operator(graph, operator)
    results = [_output(graph, tensor) for tensor in wanted]
    proto = _proto(graph, inputs, results, metadata)
    try:
        onnx.checker.check_model(proto, full_check=True)
    except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise ValueError(f"this TensorFlow Lite model contradicts itself: {error}") from None
    return proto.SerializeToString(deterministic=True)


def _wanted(model: TfliteModel, outputs: Sequence[str] | None) -> tuple[int, ...]:
    by_name = {model.tensors[tensor].name: tensor for tensor in model.outputs}
    missing = [name for name in outputs or () if name not in by_name]
    if missing:
        raise ValueError(f"the model has no output {', '.join(missing)}; it has {', '.join(by_name)}")
    return tuple(by_name[name] for name in (by_name if outputs is None else outputs))


def _needed(operators: tuple[Operator, ...], wanted: tuple[int, ...]) -> tuple[Operator, ...]:
    """The operators on which the wanted tensors depend."""
    needed, found = set(wanted), []
    for operator in reversed(operators):
        if operator.output in needed:
            needed.update(operator.inputs)
            found.append(operator)
    return tuple(reversed(found))


def _input(graph: OnnxGraph, tensor: int) -> onnx.ValueInfoProto:
    info = _value_info(graph, tensor)
    graph.set_value(tensor, graph.channels_first(info.name, tensor, f"tensor_{tensor}"))
    return info


def _output(graph: OnnxGraph, tensor: int) -> onnx.ValueInfoProto:
    info = _value_info(graph, tensor)
    graph.node("Identity", [graph.channels_last(tensor)], info.name)
    return info


def _value_info(graph: OnnxGraph, tensor: int) -> onnx.ValueInfoProto:
    from onnx import TensorProto, helper

    name, kind = graph.model.tensors[tensor].name, graph.model.tensors[tensor].kind
    if kind != "FLOAT32":
        raise ValueError(f"input or output {name!r} is {kind}; only models of FLOAT32 can be converted")
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [_BATCH, *graph.shape(tensor)[1:]])


def _proto(
    graph: OnnxGraph,
    inputs: list[onnx.ValueInfoProto],
    outputs: list[onnx.ValueInfoProto],
    metadata: Mapping[str, str],
) -> onnx.ModelProto:
    """Everything that a library would fill in by its own version is set, so that the bytes do not depend on it."""
    from onnx import helper

    body = helper.make_graph(graph.nodes, "tflite", inputs, outputs, list(graph.initializers.values()))
    opset = helper.make_opsetid("", OPSET)
    proto = helper.make_model(body, opset_imports=[opset], ir_version=_IR_VERSION, producer_name="fgpose")
    helper.set_model_props(proto, dict(metadata))
    return proto
