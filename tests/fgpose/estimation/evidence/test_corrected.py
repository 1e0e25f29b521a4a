"""Observations that were corrected are kept beside those that were given."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.estimation.evidence import corrected
from fgpose.estimation.evidence.corrected import Corrected
from fgpose.estimation.evidence.image_checks.sides import with_sides_exchanged
from fgpose.observations import Observations
from fgpose.sampling import parts_of
from fgpose_benchmarks.synthetic import Scene


@pytest.fixture
def changed(walking_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Observations:
    """With detections of one frame left out, and the sides of some in a row exchanged."""
    parts = parts_of
    monkeypatch.setattr(corrected, "parts_of", lambda n_frames: parts(n_frames, 7))
    exchanged = np.zeros(walking_scene.observations.confidence.shape, dtype=bool)
    exchanged[20:23, 1], left_out = True, exchanged.copy()
    left_out[4, 2, 5] = True
    return with_sides_exchanged(walking_scene.observations, exchanged).without(left_out & ~exchanged)


def test_of_some_frames_they_are_what_was_corrected(walking_scene: Scene, changed: Observations) -> None:
    both = Corrected.of(walking_scene.observations, changed)
    for part in (slice(0, 10), slice(4, 5), slice(10, 30), slice(21, 60), slice(0, changed.n_frames)):
        expected, found = changed.frames(part), both.frames(part)
        np.testing.assert_array_equal(found.time_s, expected.time_s)
        arrays = found.per_detection(np.asarray)
        for name, array in expected.per_detection(np.asarray).items():
            np.testing.assert_array_equal(arrays[name], array, err_msg=name)


def test_only_what_is_other_takes_memory(walking_scene: Scene, changed: Observations) -> None:
    given = walking_scene.observations
    both = Corrected.of(given, changed)
    assert np.flatnonzero(both.is_other).tolist() == [4, 20, 21, 22]
    assert np.shares_memory(both.frames(slice(5, 20)).points2d_px, given.points2d_px)
    assert not Corrected.of(given, given).is_other.any()
