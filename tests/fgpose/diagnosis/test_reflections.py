"""Images of mirrors are told from people."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.reflections import reflections
from fgpose.finding import Code, Severity
from tests.fgpose.diagnosis.damaged import FPS, SKELETON, motion_m

N_FRAMES = 150
NORMAL = np.array([0.6, 0.8, 0.0])


def somebody(positions_m: np.ndarray, n_views: int) -> fgpose.Trajectory:
    """As estimated from so many views, with errors of 2 cm."""
    errors_m = np.random.default_rng(n_views).normal(0, 0.02, positions_m.shape)
    status = np.full(positions_m.shape[:2], fgpose.Status.OBSERVED)
    visibility = np.where(np.arange(4)[:, None] < n_views, 1.0, np.nan) * np.ones((len(status), 4, SKELETON.n_joints))
    return fgpose.Trajectory(
        SKELETON,
        np.arange(len(positions_m)) / FPS,
        positions_m + errors_m,
        status,
        visibility=visibility,
        camera_names=("a", "b", "c", "d"),
    )


def reflected_m(positions_m: np.ndarray) -> np.ndarray:
    """In a mirror 2 m away; a detector calls left what looks so."""
    off_m = positions_m @ NORMAL - 2.0
    return (positions_m - 2 * off_m[..., None] * NORMAL)[:, SKELETON.mirror]


def test_the_image_of_a_mirror_is_said() -> None:
    walks_m = motion_m(n_frames=N_FRAMES)
    people = {0: somebody(reflected_m(walks_m), 2), 1: somebody(walks_m, 4)}
    (finding,) = reflections(FinishedRecording("people", people))
    assert (finding.code, finding.severity, finding.person) == (Code.REFLECTION, Severity.DOUBTFUL, 0)
    assert "person 0 moves as person 1 does" in finding.reason


@pytest.mark.parametrize("late", [20, None])
def test_who_walks_the_same_way_later_or_beside_is_no_image(late: int | None) -> None:
    walks_m = motion_m(n_frames=N_FRAMES + 20)
    other_m = walks_m[:N_FRAMES] + 1.0 if late is None else reflected_m(walks_m[late:])
    people = {0: somebody(other_m, 2), 1: somebody(walks_m[:N_FRAMES], 4)}
    assert reflections(FinishedRecording("people", people)) == []


def test_of_a_moment_nothing_is_said() -> None:
    walks_m = motion_m(n_frames=30)
    people = {0: somebody(reflected_m(walks_m), 2), 1: somebody(walks_m, 4)}
    assert reflections(FinishedRecording("people", people)) == []
    assert reflections(FinishedRecording("one", {1: somebody(walks_m, 4)})) == []
