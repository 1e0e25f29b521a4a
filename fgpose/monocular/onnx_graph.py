"""An ONNX graph that grows out of a TensorFlow Lite one. TensorFlow Lite has the channels last, ONNX has them first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Shaped

from fgpose.monocular.tflite_model import TfliteModel

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
