"""A TensorFlow Lite file as plain data: tensors, their constants, and operators with their options.

The format is a flatbuffer whose schema the package tflite has. Sparse constants are decoded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Int, Shaped

_IDENTIFIER = b"TFL3"
_DTYPES = {"FLOAT32": np.float32, "FLOAT16": np.float16, "INT32": np.int32, "INT64": np.int64}
# Of each operator that has options: the table in the schema and the fields that matter.
_WINDOW = ("Padding", "StrideH", "StrideW", "FusedActivationFunction")
_OPTIONS = {
    "CONV_2D": ("Conv2DOptions", (*_WINDOW, "DilationHFactor", "DilationWFactor")),
    "DEPTHWISE_CONV_2D": ("DepthwiseConv2DOptions", (*_WINDOW, "DilationHFactor", "DilationWFactor")),
    "MAX_POOL_2D": ("Pool2DOptions", (*_WINDOW, "FilterHeight", "FilterWidth")),
    "ADD": ("AddOptions", ("FusedActivationFunction",)),
    "CONCATENATION": ("ConcatenationOptions", ("Axis", "FusedActivationFunction")),
    "RESIZE_BILINEAR": ("ResizeBilinearOptions", ("AlignCorners", "HalfPixelCenters")),
    "DEPTH_TO_SPACE": ("DepthToSpaceOptions", ("BlockSize",)),
}
# No useful weights are sparser; a damaged shape must not take all the memory.
_MAX_SPARSENESS = 1000
_ENUMERATIONS = {"Padding": "Padding", "FusedActivationFunction": "ActivationFunctionType"}


@dataclass(frozen=True, eq=False)
class Tensor:
    """A value of the graph."""

    name: str
    shape: tuple[int, ...]
    """Channels last."""
    kind: str
    """Type of its numbers as the schema names it: FLOAT32, FLOAT16, INT8, ..."""
    constant: Shaped[np.ndarray, "*shape"] | None
    """Its numbers, where the file has them."""


@dataclass(frozen=True)
class Operator:
    """One operator with a single output."""

    kind: str
    """As the schema names it: CONV_2D, ..."""
    inputs: tuple[int, ...]
    """Indices of tensors; -1 = left out."""
    output: int
    options: Mapping[str, Any]
    """By the schema's names; members of enumerations as words (Padding: "SAME")."""


@dataclass(frozen=True)
class TfliteModel:
    """A graph whose operators are in the order of execution."""

    tensors: tuple[Tensor, ...]
    operators: tuple[Operator, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]


def read_tflite(data: bytes) -> TfliteModel:
    """Parse a .tflite file.

    Raises:
        ValueError: the data is no TensorFlow Lite model, or damaged, or has several graphs or operators with several
            outputs.
    """
    import tflite

    if data[4:8] != _IDENTIFIER:
        raise ValueError("this is not a TensorFlow Lite model: its identifier TFL3 is missing")
    try:
        return _model(tflite.Model.GetRootAsModel(data, 0))
    except _UnsupportedError as error:
        raise ValueError(str(error)) from None
    except Exception as error:
        # The generated accessors follow any offset in the file, so a damaged file can raise any exception.
        raise ValueError(f"this TensorFlow Lite model is damaged: {type(error).__name__}: {error}") from error


class _UnsupportedError(Exception):
    """The file is intact, but this reader does not support what it contains."""


def _model(table: Any) -> TfliteModel:
    if table.SubgraphsLength() != 1:
        raise _UnsupportedError(f"a TensorFlow Lite model with {table.SubgraphsLength()} graphs is not supported")
    graph = table.Subgraphs(0)
    tensors = tuple(_tensor(graph.Tensors(i), table) for i in range(graph.TensorsLength()))
    operators = tuple(_operator(graph.Operators(i), table) for i in range(graph.OperatorsLength()))
    inputs = tuple(graph.Inputs(i) for i in range(graph.InputsLength()))
    outputs = tuple(graph.Outputs(i) for i in range(graph.OutputsLength()))
    used = {*inputs, *outputs, *(i for each in operators for i in (*each.inputs, each.output) if i != -1)}
    if not outputs or min(used) < 0 or max(used) >= len(tensors):
        raise IndexError("an operator refers to a tensor that is not there")
    return TfliteModel(tensors, operators, inputs, outputs)


def _tensor(table: Any, model: Any) -> Tensor:
    import tflite

    name, kind = table.Name().decode(), _words(tflite.TensorType)[table.Type()]
    shape = tuple(table.Shape(i) for i in range(table.ShapeLength()))
    buffer = model.Buffers(table.Buffer())
    if not buffer.DataLength() or kind not in _DTYPES:
        return Tensor(name, shape, kind, None)
    flat = np.frombuffer(buffer.DataAsNumpy().tobytes(), _DTYPES[kind])
    constant = flat.reshape(shape) if table.Sparsity() is None else _dense(flat, shape, table.Sparsity())
    constant.flags.writeable = False
    return Tensor(name, shape, kind, constant)


def _dense(flat: np.ndarray, shape: tuple[int, ...], sparsity: Any) -> np.ndarray:
    """Decode a sparse tensor: levels of dense and compressed (CSR) dimensions, the last of them within blocks.

    See SparsityParameters in the schema: level l stands for dimension order[l]; those from the rank on count within
    the blocks into which dimension block_map[...] is cut.
    """
    if math.prod(shape) > _MAX_SPARSENESS * len(flat):
        raise ValueError(f"a sparse tensor has {len(flat)} numbers for the shape {shape}")
    levels = [_level(sparsity.DimMetadata(i)) for i in range(sparsity.DimMetadataLength())]
    order = [sparsity.TraversalOrder(i) for i in range(sparsity.TraversalOrderLength())]
    block_map = [sparsity.BlockMap(i) for i in range(sparsity.BlockMapLength())]
    block_sizes = {
        block_map[o - len(shape)]: level.size for o, level in zip(order, levels, strict=True) if o >= len(shape)
    }
    stored, indices = np.zeros(1, dtype=np.int64), np.zeros((len(shape), 1), dtype=np.int64)
    for o, level in zip(order, levels, strict=True):
        if level.n_children(stored) > math.prod(shape):
            raise ValueError(f"a sparse tensor has more places than its shape {shape}")
        parent, index, stored = level.children(stored)
        indices = indices[:, parent]
        dimension, step = (o, block_sizes.get(o, 1)) if o < len(shape) else (block_map[o - len(shape)], 1)
        indices[dimension] += step * index
    dense = np.zeros(shape, flat.dtype)
    dense[tuple(indices)] = flat[stored]
    return dense


@dataclass(frozen=True, eq=False)
class _Level:
    """A dimension of a sparse tensor: dense, or with the filled places of each parent listed."""

    size: int
    segments: Int[np.ndarray, " parents"] | None = None
    places: Int[np.ndarray, " children"] | None = None

    def n_children(self, parents: np.ndarray) -> int:
        return len(parents) * self.size if self.segments is None else int(np.diff(self.segments)[parents].sum())

    def children(self, parents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all children in order: which of the parents is theirs, their place in it, and where they are stored."""
        if self.segments is None or self.places is None:
            parent = np.repeat(np.arange(len(parents)), self.size)
            place = np.tile(np.arange(self.size), len(parents))
            return parent, place, parents[parent] * self.size + place
        first, count = self.segments[parents], np.diff(self.segments)[parents]
        parent = np.repeat(np.arange(len(parents)), count)
        stored = np.arange(len(parent)) + np.repeat(first - (np.cumsum(count) - count), count)
        return parent, self.places[stored], stored


def _level(table: Any) -> _Level:
    import tflite

    if table.Format() == tflite.DimensionType.DENSE:
        return _Level(table.DenseSize())
    segments = _index_vector(table.ArraySegmentsType(), table.ArraySegments())
    return _Level(0, segments, _index_vector(table.ArrayIndicesType(), table.ArrayIndices()))


def _index_vector(kind: int, union: Any) -> np.ndarray:
    import tflite

    vector = getattr(tflite, _words(tflite.SparseIndexVector)[kind])()
    vector.Init(union.Bytes, union.Pos)
    return vector.ValuesAsNumpy().astype(np.int64)


def _operator(table: Any, model: Any) -> Operator:
    import tflite

    code = model.OperatorCodes(table.OpcodeIndex())
    # Files from before the 128th operator have the number in the older field only, newer ones in both.
    number = max(code.BuiltinCode(), code.DeprecatedBuiltinCode())
    kind = _words(tflite.BuiltinOperator).get(number, f"number {number}")
    if kind == "CUSTOM":
        kind = f"CUSTOM {code.CustomCode().decode()}"
    if table.OutputsLength() != 1:
        raise _UnsupportedError(
            f"the TensorFlow Lite operator {kind} with {table.OutputsLength()} outputs is not supported"
        )
    inputs = tuple(table.Inputs(i) for i in range(table.InputsLength()))
    return Operator(kind, inputs, table.Outputs(0), _options(kind, table))


def _options(kind: str, table: Any) -> dict[str, Any]:
    import tflite

    if kind not in _OPTIONS:
        return {}
    name, fields = _OPTIONS[kind]
    options, union = getattr(tflite, name)(), table.BuiltinOptions()
    options.Init(union.Bytes, union.Pos)
    values = {field: getattr(options, field)() for field in fields}
    return {
        field: _words(getattr(tflite, _ENUMERATIONS[field]))[value] if field in _ENUMERATIONS else value
        for field, value in values.items()
    }


@cache
def _words(enumeration: type) -> dict[int, str]:
    """Names of an enumeration's members by their numbers."""
    return {number: word for word, number in vars(enumeration).items() if isinstance(number, int)}
