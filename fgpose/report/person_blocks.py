"""What is shown of each person: where there are several, of the one who is chosen on the page."""

from __future__ import annotations

from collections.abc import Callable

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Block, OfPerson
from fgpose.report.plots import MAX_COLUMNS
from fgpose.trajectory import Trajectory

_AT_MOST_PEOPLE = 6
# Of all people's figures over time: with them the page of a minute stays below 5 MB.
_COLUMNS = 3 * MAX_COLUMNS


def people_shown(recording: FinishedRecording) -> list[int]:
    """Who can be chosen: those who are seen most, by their numbers."""
    people = sorted(recording.people, key=lambda person: -int(recording.people[person].observed.sum()))
    return sorted(people[:_AT_MOST_PEOPLE])


def of_people(recording: FinishedRecording, blocks_of: Callable[[Trajectory, int], list[Block]]) -> list[Block]:
    """The blocks of the only person, or those of each who can be chosen.

    Args:
        recording: of one or more people.
        blocks_of: makes them, given the trajectory and how many parts figures divide the time into.
    """
    if len(recording.people) == 1:
        return blocks_of(recording.main, MAX_COLUMNS)
    shown = people_shown(recording)
    columns = min(MAX_COLUMNS, _COLUMNS // len(shown))
    made = {person: tuple(blocks_of(recording.people[person], columns)) for person in shown}
    return [
        OfPerson(recording.called(person), blocks, person == recording.main_person)
        for person, blocks in made.items()
        if blocks
    ]


def of_everybody(recording: FinishedRecording) -> str:
    """What the caption of a figure of all people ends with."""
    return ", all people" if len(recording.people) > 1 else ""
