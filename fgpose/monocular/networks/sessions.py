"""Sessions of onnxruntime: opened for the processor, and checked for the inputs and outputs of the network wanted."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Shape = tuple[int | str | None, ...]
"""None or a name stands for any length."""

_FLOAT32 = "tensor(float)"
_FATAL = 4  # onnxruntime's number of this level


def open_session(path: Path, threads: int = 1) -> InferenceSession:
    """The network of an ONNX file, on the processor. Several threads may run it at the same time.

    Args:
        path: the ONNX file.
        threads: how many threads one run may use.

    Raises:
        OSError: there is no such file, or it cannot be read.
        ValueError: the file is not an ONNX network that onnxruntime can run, or threads is below 1.
    """
    if threads < 1:
        raise ValueError(f"a session needs at least one thread, got {threads}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such network file")
    path.open("rb").close()  # onnxruntime reports a file that may not be read as one that is damaged
    import onnxruntime

    options = onnxruntime.SessionOptions()  # pyright: ignore[reportAttributeAccessIssue]
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that wait busily for the next run take the cores from other sessions: two in turn, detector and landmarks
    # with two threads each, took 33 ms instead of 16.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = _FATAL  # what matters is raised; a library does not print
    try:
        return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has one exception class per status code, with no common base
        reason = str(error).strip().splitlines()[0]
        raise ValueError(f"{path} is not an ONNX network that onnxruntime can run: {reason}") from None


def check_signature(
    session: InferenceSession, path: Path, inputs: Mapping[str, Shape], outputs: Mapping[str, Shape]
) -> None:
    """Make sure that a network takes these inputs and no other, and gives at least these outputs, all float32.

    Args:
        session: what open_session made of the file.
        path: the file, for the message.
        inputs: shape of each input by name.
        outputs: shape of each output by name.

    Raises:
        ValueError: it does not; the message names the file, what is expected and what is there.
    """
    there = session.get_inputs(), session.get_outputs()
    missing = [
        name
        for expected, nodes in zip((inputs, outputs), there, strict=True)
        for name, shape in expected.items()
        if not any(node.name == name and node.type == _FLOAT32 and _fits(node.shape, shape) for node in nodes)
    ]
    if missing or len(there[0]) > len(inputs):
        raise ValueError(
            f"{path} is another network: expected inputs {_listed(inputs)} and outputs {_listed(outputs)} in float32,"
            f" found inputs {_found(there[0])} and outputs {_found(there[1])}"
        )


def _fits(found: Sequence[int | str | None], expected: Shape) -> bool:
    """Whether two shapes can be equal: of the same rank, and with no two different numbers at one place."""
    return len(found) == len(expected) and all(
        not isinstance(a, int) or not isinstance(b, int) or a == b for a, b in zip(found, expected, strict=True)
    )


def _listed(shapes: Mapping[str, Shape]) -> str:
    return ", ".join(f"{name} {_written(shape)}" for name, shape in shapes.items())


def _found(nodes: Sequence[Any]) -> str:
    return ", ".join(
        f"{node.name} {_written(node.shape)}" + ("" if node.type == _FLOAT32 else f" {node.type}") for node in nodes
    )


def _written(shape: Sequence[int | str | None]) -> str:
    return "[" + ", ".join(str(length) if isinstance(length, int) else "any" for length in shape) + "]"


def identity(path: Path) -> str:
    """Name and content of a file in a few characters, for a network's name."""
    with path.open("rb") as file:
        return f"{path.name}:{hashlib.file_digest(file, 'sha256').hexdigest()[:12]}"
