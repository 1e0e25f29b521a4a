"""What is suspicious of the motion of people."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.association.track import TrackEvent
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.motion_checks import motionless, perhaps_exchanged, perhaps_same
from fgpose.finding import Code, Severity
from tests.fgpose.diagnosis.damaged import FPS, SKELETON, motion_m


def somebody(positions_m: np.ndarray) -> fgpose.Trajectory:
    """As estimated, with errors of 2 mm."""
    errors_m = np.random.default_rng(0).normal(0, 0.002, positions_m.shape)
    status = np.full(positions_m.shape[:2], fgpose.Status.OBSERVED)
    return fgpose.Trajectory(SKELETON, np.arange(len(positions_m)) / FPS, positions_m + errors_m, status)


def swaying_m(sway_m: float, n_frames: int = 300) -> np.ndarray:
    """Standing, the ankles at rest and the head swaying by this, root mean square."""
    stood_m = np.repeat(motion_m()[:1], n_frames, axis=0)
    height = stood_m[0, :, 2] / stood_m[0, :, 2].max()
    stood_m[..., 0] += np.sqrt(2) * sway_m * np.sin(2 * np.pi * np.arange(n_frames) / 90)[:, None] * height
    return stood_m


def test_a_picture_of_somebody_is_told_from_people() -> None:
    people = {0: somebody(motion_m(n_frames=300)), 1: somebody(swaying_m(0.0)), 2: somebody(swaying_m(0.008))}
    (finding,) = motionless(FinishedRecording("people", people))
    assert (finding.code, finding.severity, finding.person) == (Code.MOTIONLESS, Severity.NOTE, 1)


@pytest.mark.parametrize("others", [{}, {1: somebody(motion_m(n_frames=150))}])
def test_nothing_is_told_of_one_alone_or_of_some_seconds(others: dict[int, fgpose.Trajectory]) -> None:
    still = somebody(swaying_m(0.0, 300 if not others else 120))
    assert motionless(FinishedRecording("people", {0: still, **others})) == []


def test_who_may_have_been_exchanged_is_said_once_and_as_long_as_it_is_open() -> None:
    def of_both(time_s: float, what: str, one: int, other: int) -> list[TrackEvent]:
        return [
            TrackEvent(time_s, a, what, f"with {b}: too near to be told apart from 3.1 to 6.4 s", beside=b)
            for a, b in ((one, other), (other, one))
        ]

    people = {person: somebody(motion_m(n_frames=30)) for person in range(3)}
    settled = [*of_both(2.0, "perhaps exchanged", 0, 2), *of_both(5.0, "not exchanged", 0, 2)]
    again = [*of_both(2.0, "perhaps exchanged", 1, 2), *of_both(5.0, "exchanged", 1, 2)]
    events = (*settled, *again, *of_both(7.0, "perhaps exchanged", 1, 2))
    (finding,) = perhaps_exchanged(FinishedRecording("people", people, events=events))
    assert (finding.code, finding.severity) == (Code.PERHAPS_EXCHANGED, Severity.DOUBTFUL)
    assert (finding.person, finding.from_s) == (1, 7.0)
    assert "person 1 may have changed numbers with 2: too near" in finding.reason


@pytest.mark.parametrize(
    ("first", "aside_m", "is_said"),
    [(160, 0.1, True), (140, 0.1, True), (160, 1.5, False), (200, 0.1, False), (90, 0.1, False)],
)
def test_who_begins_where_another_ends_may_be_the_same(first: int, aside_m: float, is_said: bool) -> None:
    """One ends at 5 s, the other begins up to 1.7 s later, or before; a third is there all the time, 3 m away."""
    stands, aside = somebody(swaying_m(0.008)), np.array([aside_m, 0.0, 0.0])
    later = somebody(swaying_m(0.008) + aside)[first:]
    people = {0: stands[:150], 1: later, 2: somebody(swaying_m(0.008) + np.array([3.0, 3.0, 0.0]))}
    found = perhaps_same(FinishedRecording("people", people))
    assert [(each.code, each.severity, each.person) for each in found] == [
        (Code.PERHAPS_SAME, Severity.NOTE, 1)
    ] * is_said
