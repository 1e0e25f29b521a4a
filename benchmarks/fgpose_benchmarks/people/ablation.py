"""The association with one part removed or replaced at a time, which shows the effect of each.

The library has no switches for its parts: while a method runs, another function stands in the place of one of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fgpose.association import matching
from fgpose.association import recording as whole_recording
from fgpose.association.pose_filter import Expected, PoseFilters
from fgpose_benchmarks.comparison.recording import Method
from fgpose_benchmarks.people.methods import POSITIONS_ONLY, TOLD, batch
from fgpose_benchmarks.people.recording import PeopleMethod, PeopleRecording, PeopleResult

# With this spread a joint 4 to 5 m away fits a person up to about 60 px, the threshold of Chen et al. (2020).
_FIXED_PX = 20.0


def ablations() -> list[PeopleMethod]:
    """The batch without a change, then with each change alone; last, the batch that is told who is who."""
    return [
        Method("as it is", "ours", partial(batch, POSITIONS_ONLY)),
        Method("fixed gates", "ours", _Changed(fixed_gates)),
        Method("no hand-over of joints", "ours", _Changed(no_hand_over)),
        Method("no recognition", "ours", _Changed(no_recognition)),
        TOLD,
    ]


@dataclass(frozen=True)
class _Changed:
    """The batch while something is changed."""

    change: Callable[[], AbstractContextManager[None]]

    def __call__(self, recording: PeopleRecording) -> PeopleResult:
        with self.change():
            return batch(POSITIONS_ONLY, recording)


@contextmanager
def _replaced(owner: Any, name: str, replacement: Any) -> Iterator[None]:
    original = getattr(owner, name)
    setattr(owner, name, replacement)
    try:
        yield
    finally:
        setattr(owner, name, original)


def fixed_gates() -> AbstractContextManager[None]:
    """Detections are expected around the predicted joints with one spread in pixels, instead of that of the prediction
    and the detector."""
    seen_by = PoseFilters.seen_by

    def with_one_spread(*arguments: Any) -> Expected:
        expected = seen_by(*arguments)
        return replace(
            expected, covariance_px2=np.broadcast_to(_FIXED_PX**2 * np.eye(2), (*expected.sigma_px.shape, 2, 2))
        )

    return _replaced(PoseFilters, "seen_by", with_one_spread)


def no_hand_over() -> AbstractContextManager[None]:
    """A detection is of one person as a whole."""
    return _replaced(matching, "hand_over", lambda *_: None)


def no_recognition() -> AbstractContextManager[None]:
    """Who comes back is somebody new."""
    return _replaced(whole_recording, "links", lambda *_: [])
