"""The parts of the page of a recording, in their order; each says in one line what it lacks."""

from __future__ import annotations

from collections.abc import Sequence

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Section, Table, TableCell, number
from fgpose.report.plots import TIME_AXIS, models
from fgpose.report.sections.angles import angle_section
from fgpose.report.sections.body import bone_section, sigma_section
from fgpose.report.sections.cameras import camera_section, reprojection_section, seen_section
from fgpose.report.sections.moments import moment_section
from fgpose.report.sections.origin import origin_section
from fgpose.report.sections.people import people_section

# More lines than this hide what is under them.
_MAX_LINES = 40
_MANY_ROWS = 10  # to be looked through
_COLOUR = "#d81b8c"  # in none of the palettes of heat maps and curves, and dark enough on white


def sections(recording: FinishedRecording) -> list[Section]:
    """All of a page but its head."""
    made = [
        moment_section(recording),
        seen_section(recording),
        reprojection_section(recording),
        sigma_section(recording),
        bone_section(recording),
        angle_section(recording),
        _marks(recording),
        camera_section(recording),
        people_section(recording),
        origin_section(recording),
    ]
    known = [section for section in made if section is not None]
    _draw_marks(known, recording)
    return known


def _marks(recording: FinishedRecording) -> Section | None:
    """What happened at known times, as whoever recorded it has noted; None where nothing was."""
    if not recording.marks:
        return None
    rows = tuple((TableCell(mark.name), number(mark.time_s, 2)) for mark in recording.marks)
    table = Table(("event", "time / s"), rows, identifier="marks" if len(rows) > _MANY_ROWS else "")
    drawn = "Vertical lines in the figures over time." if len(rows) <= _MAX_LINES else ""
    return Section("Events", "marks", [table], f"As noted in the table of events. {drawn}".rstrip())


def _draw_marks(sections: Sequence[Section], recording: FinishedRecording) -> None:
    """Draw a line at the time of each into the figures over time, if there are not too many to be told apart."""
    first_s = min(each.time_s[0] for each in recording.people.values())
    last_s = max(each.time_s[-1] for each in recording.people.values())
    # One at another time would widen the axes.
    marks = [mark for mark in recording.marks if first_s <= mark.time_s <= last_s]
    if not marks or len(recording.marks) > _MAX_LINES:
        return
    for plot in (plot.model for section in sections for plot in section.plots):
        if TIME_AXIS in plot.tags:
            noted = {"x": [mark.time_s for mark in marks], "name": [mark.name for mark in marks]}
            lines = plot.vspan("x", line_color=_COLOUR, line_dash="dashed", line_width=1.5, source=noted)
            plot.add_tools(models().HoverTool(renderers=[lines], tooltips=[("", "@name, @x{0.00} s")]))
