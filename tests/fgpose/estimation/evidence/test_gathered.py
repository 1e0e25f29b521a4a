"""The evidence of a long recording, part by part, is that of the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.config import Config
from fgpose.estimation.evidence import gathered as gathered_module
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.gathered import Gathered
from fgpose.estimation.smoother import smooth
from fgpose.observations import Observations
from fgpose_benchmarks.synthetic import Scene

COAST_S = 1.0


@pytest.fixture
def seen(walking_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Observations:
    """Somebody who is away for 1.3 s, with a frame that makes no body, and a camera whose clock is late."""
    monkeypatch.setattr(gathered_module, "FRAMES_AT_ONCE", 7)
    observations = walking_scene.observations
    points2d_px, confidence = observations.points2d_px.copy(), observations.confidence.copy()
    points2d_px[15:55], confidence[15:55] = np.nan, 0.0
    points2d_px[4] *= 40
    time_s = observations.time_s[:, None] + np.array([0.0, 0.004, 0.0, 0.0])
    changed = {"points2d_px": points2d_px, "confidence": confidence, "time_s": time_s}
    return replace(observations, **changed, points3d_m=None, covariance3d_m2=None)


@pytest.mark.parametrize("frames", [slice(None), slice(3, 30), slice(0, None, 9), np.array([4, 8, 55, 59])])
def test_evidence_of_some_frames(seen: Observations, walking_scene: Scene, frames: slice | np.ndarray) -> None:
    rig, config = walking_scene.rig, Config()
    whole, parts = gather(seen, rig, config), Gathered.of(seen, rig, config)
    assert whole.implausible_frames == parts.implausible_frames == (4,)
    np.testing.assert_array_equal(parts.guess_m, whole.guess_m)
    np.testing.assert_array_equal(parts.present(COAST_S), whole.present(COAST_S))
    some = parts.frames(frames)
    for name, expected in whole.frames(frames).arrays.items():
        # Parts of other lengths are summed in another order.
        np.testing.assert_allclose(getattr(some, name), expected, rtol=1e-9, atol=1e-9, err_msg=name)


def test_credibilities_are_those_of_the_whole(seen: Observations, walking_scene: Scene) -> None:
    """Kept are those of frames in which some joint is doubted."""
    confidence = seen.confidence.copy()
    confidence[56:60, :, 3] *= 0.2
    doubted = replace(seen, confidence=confidence)
    expected = gather(doubted, walking_scene.rig, Config()).credible
    assert (expected < 1).any()
    assert (expected == 1).all(axis=1).any()
    parts = Gathered.of(doubted, walking_scene.rig, Config())
    np.testing.assert_array_equal(parts.frames(slice(None)).credible, expected)


def test_first_guesses_that_were_handed_over_are_made_again(seen: Observations, walking_scene: Scene) -> None:
    """They are asked for again by who smooths the same recording once more."""
    gathered = Gathered.of(seen, walking_scene.rig, Config())
    some = gathered.joints([3, 0])
    of_some_m = some.guess_m
    for each in (gathered, some, some.held(0, np.ones((seen.n_frames, 3)), np.tile(np.eye(3), (seen.n_frames, 1, 1)))):
        kept_m = each.guess_m
        assert each.hand_over_guess_m() is kept_m
        np.testing.assert_array_equal(each.guess_m, kept_m)
    np.testing.assert_array_equal(gathered.joints([3, 0]).guess_m, of_some_m)


def test_a_long_recording_is_smoothed_as_a_short_one(
    seen: Observations, walking_scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = smooth(seen, walking_scene.rig)
    monkeypatch.setattr(gathered_module, "LONG_FRAMES", 1)
    found = smooth(seen, walking_scene.rig)
    np.testing.assert_array_equal(found.status, expected.status)
    assert found.implausible_frames == expected.implausible_frames == (4,)
    # To what the optimiser's tolerance leaves, where guesses differ by rounding.
    np.testing.assert_allclose(found.positions_m, expected.positions_m, atol=1e-6)
