"""What messages from elsewhere may be: each is compared with its schema before anything else touches it."""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np

from fgpose.live.reception.rejections import MessageError

try:
    import msgspec
except ImportError:
    raise ImportError("messages need msgspec: pip install 'fgpose[live]'") from None

Document = TypeVar("Document", bound=msgspec.Struct)
Converted = TypeVar("Converted")
# Of a reason that is shown: it may quote what was sent.
_MAX_REASON = 200


class PackedArray(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An array, as a map of its shape, its type and its bytes (fgpose.io.live.packing)."""

    # The product of more lengths than these would take time; no array here has more than four.
    shape: Annotated[tuple[Annotated[int, msgspec.Meta(ge=0)], ...], msgspec.Meta(max_length=8)]
    dtype: Literal["<f4", "<f8", "<i8", "|u1"]
    data: bytes

    def __post_init__(self) -> None:
        if math.prod(self.shape) * np.dtype(self.dtype).itemsize != len(self.data):
            raise ValueError(
                f"an array of shape {quoted(self.shape)} and type {self.dtype} has another number of bytes"
            )

    def array(self) -> np.ndarray:
        """(*shape) float64."""
        return np.frombuffer(self.data, self.dtype).reshape(self.shape).astype(float)


class Schema(Generic[Document]):
    """Of the messages of a kind, MessagePack documents.

    Args:
        kind: what a message holds; unknown keys are refused where it forbids them.
        name: of the format, for people.
        max_bytes: a message that is longer is not looked at.
    """

    def __init__(self, kind: type[Document], name: str, max_bytes: int) -> None:
        self._decoder = msgspec.msgpack.Decoder(kind)
        self._name, self._max_bytes = name, max_bytes

    def document(self, body: bytes | memoryview) -> Document:
        """What a message holds.

        Raises:
            MessageError: the message is refused. Nothing else is raised, whatever the bytes are.
        """
        if len(body) > self._max_bytes:
            raise MessageError("size", f"a message of {len(body)} bytes, at most {self._max_bytes} are possible")
        try:
            return self._decoder.decode(body)
        # It names its own errors; texts that are no UTF-8 and endless nesting raise others.
        except Exception as error:
            reason = f"{str(error)[:_MAX_REASON] or type(error).__name__}"
            raise MessageError("content", f"not a message of {self._name}: {reason}") from None


def as_dataclass(document: Any, kind: type[Converted]) -> Converted:
    """A document that is unpacked already, arrays and all, as a dataclass.

    Raises:
        ValueError: it is none; the text says what is wrong.
    """
    return msgspec.convert(document, kind, dec_hook=_as_it_is)


def _as_it_is(kind: type, value: Any) -> Any:
    if not isinstance(value, kind):
        raise ValueError(f"Expected `{kind.__name__}`, got `{type(value).__name__}`")
    return value


def quoted(value: Any) -> str:
    """For a reason, however long the value is."""
    return reprlib.repr(value)
