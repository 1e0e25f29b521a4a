"""Sessions of onnxruntime: opened on a device, and checked for the inputs and outputs of the network wanted."""

from __future__ import annotations

import hashlib
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fgpose.monocular.networks.devices import CPU, Device, device_of, providers_of

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Shape = tuple[int | str | None, ...]
"""None or a name stands for any length."""

_FLOAT32 = "tensor(float)"
_FATAL = 4  # onnxruntime's number of this level
_WARNED: set[str] = set()
"""Devices of which is said that they do not start."""


def open_session(path: Path, threads: int = 1, device: Device = "auto") -> InferenceSession:
    """The network of an ONNX file. Several threads may run it at the same time.

    Args:
        path: the ONNX file.
        threads: how many threads of the processor one run may use.
        device: where it runs. With auto on the processor, if what is there does not start. A run raises OSError, which
            names the device, if a device fails that is not the processor.

    Warns:
        UserWarning: the device that auto takes does not start; once in a process.

    Raises:
        OSError: there is no such file, or it cannot be read.
        ValueError: the device is not available or does not start, the file is not an ONNX network that onnxruntime can
            run there, or threads is below 1.
    """
    if threads < 1:
        raise ValueError(f"a session needs at least one thread, got {threads}")
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such network file")
    path.open("rb").close()  # onnxruntime reports a file that may not be read as one that is damaged
    providers = providers_of(device)
    if device == "auto" and providers[0] != CPU:
        reason = "drivers or libraries that it needs are missing or too old"
        try:
            session = _opened(path, threads, providers)
        except ValueError as error:
            session, reason = _opened(path, threads, [CPU]), str(error)
        if session.get_providers()[0] == CPU:
            _warn_of_processor(device_of(providers[0]), reason)
        return session
    session = _opened(path, threads, providers)
    if session.get_providers()[0] != providers[0]:
        raise ValueError(
            f"device {device}: onnxruntime has {providers[0]} but could not start it, and would run {path} on"
            f" {device_of(session.get_providers()[0])}: drivers or libraries that it needs are missing or too old"
        )
    return session


def _opened(path: Path, threads: int, providers: list[str]) -> InferenceSession:
    """A session with the providers that start. Raises ValueError as open_session does."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Threads that wait busily for the next run take the cores from other sessions: two in turn, detector and landmarks
    # with two threads each, took 33 ms instead of 16.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    # DirectML allows one run of a session at a time, and no memory patterns.
    one_at_a_time = device_of(providers[0]) == "directml"
    options.enable_mem_pattern = not one_at_a_time
    options.log_severity_level = _FATAL  # what matters is raised; a library does not print
    # OpenVINO does not look at the number of threads of the session, and takes all cores.
    own = [{"num_of_threads": str(threads)} if device_of(each) == "openvino" else {} for each in providers]
    try:
        # Its own fallback prints, and hides on what a network runs.
        session = onnxruntime.InferenceSession(path, options, providers, own, enable_fallback=0)
    except Exception as error:  # onnxruntime has one exception class per status code, with no common base
        reason = str(error).strip().splitlines()[0]
        where = "" if providers[0] == CPU else f" on {device_of(providers[0])}"
        raise ValueError(f"{path} is not an ONNX network that onnxruntime can run{where}: {reason}") from None
    if one_at_a_time:
        session.run = _in_turns(session.run)
    if (provider := session.get_providers()[0]) != CPU:
        session.run = _naming(session.run, path, device_of(provider))
    return session


def _warn_of_processor(device: str, reason: str) -> None:
    """Once: every network of a process would say the same."""
    if device not in _WARNED:
        _WARNED.add(device)
        warnings.warn(
            f"networks run on the processor, as {device} does not start: {reason}; --device cpu takes the processor"
            " without this warning",
            stacklevel=3,
        )


def _naming(run: Callable[..., Any], path: Path, device: str) -> Callable[..., Any]:
    """A function that says which device has failed."""

    def run_on_device(*args: Any, **kwargs: Any) -> Any:
        try:
            return run(*args, **kwargs)
        except Exception as error:  # as above
            reason = str(error).strip().partition("\n")[0]
            raise OSError(
                f"device {device} has failed while it ran {path}: {reason}; with --device cpu it runs on the processor"
            ) from error

    return run_on_device


def _in_turns(run: Callable[..., Any]) -> Callable[..., Any]:
    """A function that only one thread at a time is in."""
    turn = threading.Lock()

    def run_alone(*args: Any, **kwargs: Any) -> Any:
        with turn:
            return run(*args, **kwargs)

    return run_alone


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


def identity(path: Path, session: InferenceSession) -> str:
    """Name and content of a file in a few characters, and the device unless it is the processor, for a network's name:
    devices round differently."""
    provider = session.get_providers()[0]
    where = "" if provider == CPU else f" on {device_of(provider)}"
    with path.open("rb") as file:
        return f"{path.name}:{hashlib.file_digest(file, 'sha256').hexdigest()[:12]}{where}"
