"""Several inputs of a network, in one run where file and device allow it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fgpose.monocular.networks.devices import Device, device_of

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

# How many people are in an image changes all the time. TensorRT builds its engine anew for a batch that is larger than
# all before, which takes minutes. CoreML does not take every network with a batch of any length, and crashes on some
# (onnxruntime's issue 21227). DirectML and OpenVINO prepare for a new shape when it comes: on a processor OpenVINO took
# twice as long as for single crops for the first batch of a length, and as long as for them after it.
_DEVICES: tuple[Device, ...] = ("cpu", "cuda")
# CUDA looks for the best algorithm once for each length. More crops do not make a GPU faster, but need more memory.
_AT_ONCE = 8
# Of the largest number in an output: devices round differently for another length, but far less than this.
_ROUNDING = 1e-2


class Batches:
    """Runs a network on any number of inputs. Its session may be used from several threads.

    One run takes up to eight of them if the file does not fix the length of the batch, if the device takes another
    length without preparing for it, and if two examples together give what each gives alone: some files leave the
    length open and fix it further inside. Otherwise each has a run of its own.

    Args:
        session: what open_session made of the file.
        examples: by name, two different inputs, one after the other along the first axis.
    """

    def __init__(self, session: InferenceSession, examples: Mapping[str, np.ndarray]) -> None:
        self._session = session
        self._at_once = _AT_ONCE if _takes_any_length(session) and _agree(session, examples) else 1

    def run(self, inputs: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """All outputs in the order of the file, along the first axis as the inputs, of which there is one at least."""
        return _in_runs_of(self._at_once, self._session, inputs)


def _in_runs_of(n: int, session: InferenceSession, inputs: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    count = len(next(iter(inputs.values())))
    parts = [{name: values[first : first + n] for name, values in inputs.items()} for first in range(0, count, n)]
    return [np.concatenate(outputs) for outputs in zip(*(session.run(None, part) for part in parts), strict=True)]


def _takes_any_length(session: InferenceSession) -> bool:
    is_fixed = any(isinstance(node.shape[0], int) for node in session.get_inputs())
    return not is_fixed and device_of(session.get_providers()[0]) in _DEVICES


def _agree(session: InferenceSession, examples: Mapping[str, np.ndarray]) -> bool:
    alone = _in_runs_of(1, session, examples)
    try:
        together = _in_runs_of(2, session, examples)
    except Exception:  # onnxruntime has one exception class per status code, with no common base
        return False
    return all(
        one.shape == two.shape
        and np.allclose(one, two, rtol=0.0, atol=_ROUNDING * np.max(np.abs(one), initial=0.0), equal_nan=True)
        for one, two in zip(alone, together, strict=True)
    )
