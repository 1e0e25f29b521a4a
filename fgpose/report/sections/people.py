"""Several people: their lives, what happened to their tracks, and what is shown of the one who is chosen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import root_m, sigma_m
from fgpose.report.blocks import Block, Folded, Note, OfPerson, Plot, Section, Table, TableCell, number, percent
from fgpose.report.plots import COLOURS, MAX_COLUMNS, models, time_figure
from fgpose.sampling import stretches
from fgpose.trajectory import Trajectory
from fgpose_factors.robust_statistics import known_quantile

_AT_MOST_PEOPLE = 6
# Of all people's figures over time: with them the page of a minute stays below 5 MB.
_COLUMNS = 3 * MAX_COLUMNS
_MAX_EVENTS, _FEW_EVENTS = 200, 5


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


def people_section(recording: FinishedRecording) -> Section | None:
    """None where there is one person and nothing happened."""
    if len(recording.people) == 1 and not recording.events:
        return None
    blocks: list[Block] = [_lives(recording), _table(recording)]
    n_shown = len(people_shown(recording))
    if n_shown < len(recording.people):
        note = f"The {n_shown} people who are seen most can be chosen at the top; no figures are drawn of the others."
        blocks.append(Note(note, is_missing=True))
    if recording.events:
        rows = [
            (
                number(event.time_s, 2),
                TableCell(f"person {event.person}"),
                TableCell(event.what),
                TableCell(event.reason),
            )
            for event in recording.events[:_MAX_EVENTS]
        ]
        columns, numeric = ("time / s", "who", "what", "why"), (True, False, False, False)
        table = Table(columns, tuple(rows), "Events of the tracks", numeric=numeric, identifier="events")
        said = f"Events of the tracks: {len(recording.events)}, the diamonds above"
        blocks.append(table if len(rows) <= _FEW_EVENTS else Folded(said, (table,)))
    else:
        blocks.append(Note("The events of the tracks were not stored with the result.", is_missing=True))
    return Section("People and identities", "people", blocks, short="People")


def _lives(recording: FinishedRecording) -> Plot:
    names = [f"person {person}" for person in recording.people][::-1]
    height_px = 24 * len(names) + 70
    plot = time_figure("", height_px)
    everybody = recording.people.values()
    plot.x_range = models().Range1d(
        min(float(each.time_s[0]) for each in everybody), max(float(each.time_s[-1]) for each in everybody)
    )
    bars: dict[str, list[object]] = {"y": [], "left": [], "right": [], "name": [], "colour": []}
    for n, (person, trajectory) in enumerate(recording.people.items()):
        known = np.asarray(np.isfinite(root_m(trajectory)).all(axis=1))
        for first, last in stretches(known):
            values = (len(names) - 1 - n, float(trajectory.time_s[first]), float(trajectory.time_s[last - 1]))
            for key, value in zip(bars, (*values, f"person {person}", COLOURS[n % len(COLOURS)]), strict=True):
                bars[key].append(value)
    plot.hbar("y", height=0.6, left="left", right="right", color="colour", source=bars)
    plot.add_tools(models().HoverTool(tooltips=[("", "@name"), ("from", "@left{0.00} s"), ("to", "@right{0.00} s")]))
    events: dict[str, list[object]] = {"x": [], "y": [], "what": [], "why": []}
    order = list(recording.people)
    for event in recording.events:
        if event.person in recording.people:
            row = (event.time_s, len(names) - 1 - order.index(event.person), event.what, event.reason)
            for key, value in zip(events, row, strict=True):
                events[key].append(value)
    dots = plot.scatter("x", "y", size=9, marker="diamond", color="#e69f00", line_color="#555", source=events)
    plot.add_tools(models().HoverTool(renderers=[dots], tooltips=[("", "@what"), ("at", "@x{0.00} s"), ("", "@why")]))
    plot.yaxis.ticker = list(range(len(names)))
    plot.yaxis.major_label_overrides = dict(enumerate(names))
    plot.ygrid.grid_line_color = None
    return Plot(plot, "When everybody is there; diamonds: events of their tracks", height_px)


def _table(recording: FinishedRecording) -> Table:
    rows = []
    for person, trajectory in recording.people.items():
        residual_px = np.full((1, 1), np.nan) if trajectory.residual_px is None else trajectory.residual_px
        rows.append((
            TableCell(f"person {person}"), number(float(trajectory.time_s[0]), 2),
            number(float(trajectory.time_s[-1]), 2),
            percent(float(trajectory.observed.mean()), bad_below=0.7), number(known_quantile(residual_px, 0.5)),
            number(1000 * known_quantile(sigma_m(trajectory), 0.5)),
        ))  # fmt: skip
    columns = ("who", "from / s", "to / s", "seen by two", "reprojection / px", "sigma / mm")
    return Table(columns, tuple(rows), "People")
