"""The page of a study: all recordings in one table, those unlike the others first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_text
from fgpose.report.blocks import Block, Plot, Section, Table, TableCell, number
from fgpose.report.page import KeyFigure, Page, html
from fgpose.report.plots import COLOURS, legend_below, models, plain_figure
from fgpose_factors.robust_statistics import known_quantile, robust_sigma

MEASURES = {
    "seen_share": -1,
    "views": -1,
    "unobservable_share": 1,
    "longest_gap_s": 1,
    "reprojection_px": 1,
    "worst_camera_px": 1,
    "hallucinated_share": 1,
    "sigma_mm": 1,
    "bone_spread_share": 1,
    "bone_asymmetry_share": 1,
    "max_speed_mps": 1,
}
"""Numbers of Quality by which recordings are compared: 1 where larger is worse, -1 where smaller is."""
OUTLIER_Z = 3.5
"""Iglewicz and Hoaglin (1993): how to detect and handle outliers."""
# With fewer, every recording is an outlier or none.
_LEAST = 5
# Of the median: recordings that are nearly all alike have no outlier that differs by less than 3.5 %.
_LEAST_SPREAD = 0.01
# Column: name in Quality, heading, factor, digits.
_COLUMNS = (
    ("duration_s", "duration / s", 1.0, 1),
    ("seen_share", "seen by two / %", 100.0, 1),
    ("reprojection_px", "reprojection / px", 1.0, 1),
    ("sigma_mm", "sigma / mm", 1.0, 1),
    ("longest_gap_s", "longest gap / s", 1.0, 2),
    ("hallucinated_share", "hallucinated / %", 100.0, 1),
    ("bone_spread_share", "bone spread / %", 100.0, 2),
    ("n_suspicions", "suspicions", 1.0, 0),
)
_WORDS = {name: heading.rpartition(" / ")[0] or heading for name, heading, *_ in _COLUMNS} | {
    "views": "cameras per joint",
    "unobservable_share": "unobservable joints",
    "worst_camera_px": "worst camera",
    "bone_asymmetry_share": "left and right bones",
    "max_speed_mps": "speed",
}
_INTRO = (
    "What failed first, then what is unlike the others: z is the distance from the median of the study in robust "
    f"standard deviations, in the measure in which a recording is furthest on the bad side; from {OUTLIER_Z} on it is "
    "an outlier. Click on a heading to sort. Small pictures: the way of the hips from above, turned so that it fills "
    "the picture, with a dot at its end, and how far it reaches; the share of joints that two cameras see over time, "
    "from orange to blue, which is all."
)


@dataclass(frozen=True)
class Outlier:
    """How far a recording is from the others, in the measure in which it is furthest on the bad side."""

    z: float
    measure: str
    """Empty if it is no worse than the median in any."""


def robust_z(values: Float[np.ndarray, " recording"]) -> Float[np.ndarray, " recording"]:
    """Distance from the median in standard deviations by the median absolute deviation; where more than half are equal,
    by the mean absolute deviation (the same reference). NaN where not known, or too few are."""
    known = np.isfinite(values)
    if known.sum() < _LEAST:
        return np.full(values.shape, np.nan)
    difference = values - np.median(values[known])
    spread = robust_sigma(difference[known]) or 1.2533 * float(np.mean(np.abs(difference[known])))
    spread = max(spread, _LEAST_SPREAD * abs(float(np.median(values[known]))))
    return difference / spread if spread > 0 else np.where(known, 0.0, np.nan)


def outliers(columns: dict[str, Float[np.ndarray, " recording"]]) -> list[Outlier]:
    """One for each recording.

    Args:
        columns: of MEASURES, those that are known.
    """
    names: Sequence[str] = [name for name in MEASURES if name in columns]
    if not names:
        return []
    scores = np.stack([MEASURES[name] * robust_z(columns[name]) for name in names])
    scores = np.where(np.isfinite(scores), scores, 0.0)
    worst = scores.argmax(axis=0)
    best = scores.max(axis=0)
    return [
        Outlier(float(z), names[index] if z > 0 else "") for z, index in zip(best.tolist(), worst.tolist(), strict=True)
    ]


@dataclass(frozen=True)
class StudyRecording:
    """A row of the table of a study."""

    name: str
    """subject/session/trial."""
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    """Of Quality, by name; empty if it has failed."""
    status: str = "done"
    """done, failed, outdated, ..."""
    reason: str = ""
    """Why it has failed, or what is suspicious, in words."""
    report: str = ""
    """Path of its report, from the page."""
    picture: str = ""
    """See thumbnail()."""


def write_study_report(recordings: Sequence[StudyRecording], path: str | Path, title: str = "Study") -> None:
    """Write the report on a study as one HTML file, which needs no network; reports of recordings are linked.

    Args:
        recordings: failed ones too.
        path: of the file; it appears whole or not at all.
        title: of the page.

    Raises:
        ValueError: there is no recording.
        ImportError: Bokeh is not installed.
        OSError: the file cannot be written.
    """
    if not recordings:
        raise ValueError(f"{path}: a report on a study needs at least one recording")
    done = [each for each in recordings if each.numbers]
    others = [each for each in recordings if not each.numbers]
    columns = {name: _column(done, name) for name in {*MEASURES, *(column for column, *_ in _COLUMNS)}}
    scores = outliers(columns)
    blocks: list[Block] = [_table(done, others, columns, scores)]
    plot = _scatter(done, columns, scores)
    sections = [Section("Recordings", "recordings", blocks, _INTRO)]
    if plot is not None:
        sections.append(Section("Errors and uncertainty", "errors", [plot]))
    page = Page(
        title=title,
        kicker="Study",
        made=f"{len(recordings)} recordings. Report of {datetime.now():%d %B %Y, %H:%M}.",
        sections=sections,
        figures=_figures(done, others, columns, scores),
    )
    write_text(Path(path), html(page))


def _column(done: Sequence[StudyRecording], name: str) -> Float[np.ndarray, " recording"]:
    values = [each.numbers.get(name) for each in done]
    return np.array([np.nan if value is None else float(value) for value in values])


def _figures(
    done: Sequence[StudyRecording],
    others: Sequence[StudyRecording],
    columns: Mapping[str, Float[np.ndarray, " recording"]],
    scores: Sequence[Outlier],
) -> list[KeyFigure]:
    n_outliers = sum(score.z >= OUTLIER_Z for score in scores)
    medians = {name: known_quantile(columns[name], 0.5) for name in ("seen_share", "reprojection_px", "sigma_mm")}
    return [
        KeyFigure("Recordings done", f"{len(done)}", f"of {len(done) + len(others)}"),
        KeyFigure("Failed or not done", f"{len(others)}"),
        KeyFigure("Outliers", f"{n_outliers}", "", f"z of {OUTLIER_Z} or more in some measure"),
        KeyFigure("With suspicions", f"{int(np.nansum(columns['n_suspicions'] > 0))}"),
        KeyFigure("Recorded", f"{np.nansum(columns['duration_s']) / 60:.1f}", "min"),
        KeyFigure("Seen by two cameras", f"{100 * medians['seen_share']:.1f}", "%", "median of the recordings"),
        KeyFigure("Reprojection error", f"{medians['reprojection_px']:.1f}", "px", "median of the recordings"),
        KeyFigure("Sigma", f"{medians['sigma_mm']:.1f}", "mm", "median of the recordings"),
    ]


def _table(
    done: Sequence[StudyRecording],
    others: Sequence[StudyRecording],
    columns: Mapping[str, Float[np.ndarray, " recording"]],
    scores: Sequence[Outlier],
) -> Table:
    headings = ("recording", "way, and seen", "status", "z", "in words", *(heading for _, heading, *_ in _COLUMNS))
    unknown = len(_COLUMNS) * [number(None)]
    rows: list[tuple[TableCell, ...]] = [
        (
            _linked(each),
            TableCell(""),
            TableCell(each.status, 1.0),
            number(None),
            TableCell(each.reason, is_long=True),
            *unknown,
        )
        for each in others
    ]
    for n in sorted(range(len(done)), key=lambda n: -scores[n].z):
        each, score = done[n], scores[n]
        numbers = [
            _shaded(number(factor * columns[name][n], digits), name, score) for name, _, factor, digits in _COLUMNS
        ]
        unlike = f"{_WORDS[score.measure]} unlike the others. ".capitalize() if score.z >= OUTLIER_Z else ""
        rows.append((
            _linked(each), TableCell("", svg=each.picture, key=-score.z), TableCell(each.status),
            number(score.z, 1, worst=2 * OUTLIER_Z), TableCell(f"{unlike}{each.reason}", is_long=True), *numbers,
        ))  # fmt: skip
    numeric = (False, False, False, True, False, *len(_COLUMNS) * (True,))
    return Table(headings, tuple(rows), "", numeric, identifier="recordings-table", sorted_by=3)


def _linked(recording: StudyRecording) -> TableCell:
    # Quoted, a name is no address: javascript:... would run in the page.
    return TableCell(recording.name, href=quote(recording.report))


def _shaded(cell: TableCell, name: str, score: Outlier) -> TableCell:
    """The measure in which a recording is an outlier stands out."""
    return TableCell(cell.text, 0.8, cell.key) if name == score.measure and score.z >= OUTLIER_Z else cell


def _scatter(
    done: Sequence[StudyRecording],
    columns: Mapping[str, Float[np.ndarray, " recording"]],
    scores: Sequence[Outlier],
) -> Plot | None:
    x, y = columns["reprojection_px"], columns["sigma_mm"]
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return None
    plot = plain_figure("reprojection error / px", "sigma / mm", 360)
    is_outlier = np.array([score.z >= OUTLIER_Z for score in scores])
    for wanted, colour, label in ((False, COLOURS[0], "usual"), (True, COLOURS[1], "outlier")):
        which = np.flatnonzero(known & (is_outlier == wanted))
        if len(which):
            data = {"x": x[which], "y": y[which], "name": [done[n].name for n in which.tolist()]}
            plot.scatter("x", "y", source=data, size=9, color=colour, fill_alpha=0.6, legend_label=label)
    tips = [("", "@name"), ("reprojection", "@x{0.0} px"), ("sigma", "@y{0.0} mm")]
    plot.add_tools(models().HoverTool(tooltips=tips))
    # Inside of the figure it would be over the outliers, which are far from the others.
    legend_below(plot)
    return Plot(plot, "Each recording by its median reprojection error and its median sigma", 360)
