"""Which axis is up, as a study file says it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fgpose.io.studies.state import load_state
from fgpose.study import Plan, RecordingOutcome, load_study, process

pytestmark = pytest.mark.usefixtures("without_search_for_faults")


def run(file: Path) -> tuple[RecordingOutcome, str]:
    """What was done of the first recording, and what is suspicious of it."""
    study = load_study(file)
    outcome = process(study, next(iter(Plan(study))))
    state = load_state(outcome.recording.folder(study.output))
    assert state is not None, outcome.reason
    return outcome, str(state.row["suspicions"])


def test_nothing_is_left_of_a_wrong_axis_that_was_put_right(edited: Callable[[str, str], Path]) -> None:
    _, suspicions = run(edited("[steps]", '[steps]\nworld_up = "y"'))
    assert "world-up y was given, but the body stands along +z of the world, not along +y" in suspicions
    # Of the world in which y is taken to be up, nothing is said as if it were that of the calibration.
    assert "taken to be up" not in suspicions
    outcome, suspicions = run(edited('"y"', '"z"'))
    assert outcome.ran == ("judge",)
    assert "world" not in suspicions
