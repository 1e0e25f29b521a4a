"""The tables of the benchmark, in GitHub's Markdown. Methods stand in their groups; the best of a column is bold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fgpose_benchmarks.comparison.scores import COVERAGE_LEVELS
from fgpose_benchmarks.comparison.summary import Summaries, Summary, best_other, methods_of, paired_ratio, variants_of

NONE = "–"
"""A number that does not exist."""
FEWER = "†"
"""Marks a mean over fewer recordings than the variant has."""
BATCH = "fgpose batch"
ONLINE = "fgpose online, lag 0.2 s"
"""What is stated of every family."""
_ORACLE = "oracle"
"""A group whose methods know the truth: never marked as the best."""
_MAX_VARIANTS = 6
"""More columns than these are hard to read: further variants get a table of their own."""
_ACCELERATION = "acceleration_mm_per_frame2"

Cells = Mapping[str, str]
"""Of one column, by method."""


@dataclass(frozen=True)
class Column:
    """A number of the methods, as a column of a table."""

    title: str
    text: Callable[[Summary], str]
    cost: Callable[[Summary], float] | None = None
    """The lowest is the best; None: no best."""
    note: Callable[[Summary], str] = lambda summary: ""
    """What follows the text, never bold."""


def absolute_errors(summaries: Summaries) -> str:
    """Absolute MPJPE of every method on every variant, with half the width of its confidence interval."""
    variants, groups = variants_of(summaries), methods_of(summaries)
    tables = []
    for start in range(0, len(variants), _MAX_VARIANTS):
        part = {variant: entries_of(summaries, variant) for variant in variants[start : start + _MAX_VARIANTS]}
        columns = {words(variant): _cells(_error_column(entries), entries) for variant, entries in part.items()}
        tables.append(_by_method(groups, columns))
    return "\n\n".join(tables)


def all_numbers(summaries: Summaries, variant: str) -> str:
    """Every number of every method on one variant."""
    entries = entries_of(summaries, variant)
    return of_methods(entries, (_error_column(entries), *_COLUMNS))


def of_methods(entries: Mapping[str, Summary], columns: Sequence[Column]) -> str:
    """Some numbers of all methods on one variant."""
    cells = {column.title: _cells(column, entries) for column in columns}
    return _by_method({method: entry.group for method, entry in entries.items()}, cells)


def comparison(summaries: Summaries, method: str) -> str:
    """Ratios of the means of one method to those of the best others on every variant, with confidence intervals.

    Each number is compared with that of the method that is best in it.
    """
    rows = []
    for variant in variants_of(summaries):
        if ours := summaries.get((variant, method)):
            other = best_other(summaries, variant)
            rows.append(
                [
                    words(variant),
                    f"{other.method}, {fixed(other.mean('mpjpe_mm'))}" if other else NONE,
                    fixed(ours.mean("mpjpe_mm")),
                    _ratio(ours, other, "mpjpe_mm"),
                    _ratio(ours, best_other(summaries, variant, "p95_mm"), "p95_mm"),
                    _ratio(ours, best_other(summaries, variant, groups=(_ORACLE,)), "mpjpe_mm"),
                    _ratio(ours, best_other(summaries, variant, _ACCELERATION, ("linear",)), _ACCELERATION),
                ]
            )
    header = ["variant", "best other", "ours", "ours / best other", "at 95 %", "ours / oracle", "acceleration / linear"]
    return markdown(header, rows)


def of_family(summaries: Summaries, variants: Sequence[str]) -> str:
    """Batch, online estimator and oracle on the variants of a family: mean errors with 95th percentiles, and ratios."""
    rows = []
    for variant in variants:
        batch, online = (summaries.get((variant, method)) for method in (BATCH, ONLINE))
        oracle = best_other(summaries, variant, groups=(_ORACLE,))
        per_frame = best_other(summaries, variant, groups=("per-frame",))
        rows.append(
            [
                words(variant),
                *(_mean_and_tail(entry) for entry in (per_frame, online, batch, oracle)),
                _ratio(batch, oracle, "mpjpe_mm"),
                _ratio(online, batch, "mpjpe_mm"),
            ]
        )
    header = ["variant", "best per frame", "online, lag 0.2 s", "batch", "oracle", "batch / oracle", "online / batch"]
    return markdown(header, rows)


def _mean_and_tail(entry: Summary | None) -> str:
    return f"{fixed(entry.mean('mpjpe_mm'))}, {fixed(entry.mean('p95_mm'))}" if entry else NONE


def calibration(summaries: Summaries, number: str) -> str | None:
    """Coverage in percent on every variant, and its largest deviation from the nominal one; None where there is none.

    Args:
        number: coverage or coverage_occluded.
    """
    shares = {
        (variant, method): values
        for (variant, method), entry in summaries.items()
        if np.isfinite(values := _coverage(entry, number)).all()
    }
    methods = [method for method in methods_of(summaries) if any(method == key[1] for key in shares)]
    rows = [
        [words(variant), *(_slashed(shares.get((variant, method))) for method in methods)]
        for variant in variants_of(summaries)
        if any(variant == key[0] for key in shares)
    ]
    worst = [
        max(np.abs(values - _NOMINAL).max() for (_, owner), values in shares.items() if owner == method)
        for method in methods
    ]
    rows.append(["*largest deviation*", *(f"*{fixed(float(points))}*" for points in worst)])
    return markdown(["variant", *methods], rows) if methods else None


def time_offsets(summaries: Summaries) -> str | None:
    """Errors of the estimated time offsets in frames: the mean over the recordings, the largest in brackets; None where
    no method estimates any."""
    errors = {key: entry.by_clip("offset_error_frames").values() for key, entry in summaries.items()}
    known = {key: finite for key, values in errors.items() if (finite := [v for v in values if np.isfinite(v)])}
    methods = [method for method in methods_of(summaries) if any(method == key[1] for key in known)]
    cells = {key: f"{fixed(float(np.mean(values)), 2)} ({fixed(max(values), 2)})" for key, values in known.items()}
    rows = [
        [words(variant), *(cells.get((variant, method), NONE) for method in methods)]
        for variant in variants_of(summaries)
        if any(variant == key[0] for key in known)
    ]
    return markdown(["variant", *methods], rows) if methods else None


def entries_of(summaries: Summaries, variant: str) -> dict[str, Summary]:
    """What there is on one variant, by method."""
    return {summary.method: summary for summary in summaries.values() if summary.variant == variant}


def words(variant: str) -> str:
    """The name as words, between which a narrow column can break."""
    return variant.replace("_", " ")


def _cells(column: Column, entries: Mapping[str, Summary]) -> Cells:
    texts = {method: column.text(entry) for method, entry in entries.items()}
    top = None
    if column.cost is not None:
        costs = {method: column.cost(entry) for method, entry in entries.items() if entry.group != _ORACLE}
        known = {method: cost for method, cost in costs.items() if np.isfinite(cost)}
        top = texts[min(known, key=known.__getitem__)] if known else None
    # Whoever shows the same digits as the best is as good.
    bold = {method for method, entry in entries.items() if entry.group != _ORACLE and texts[method] == top}
    return {
        method: (f"**{text}**" if method in bold else text) + column.note(entries[method])
        for method, text in texts.items()
    }


def _error_column(entries: Mapping[str, Summary]) -> Column:
    n_recordings = len({score.clip for entry in entries.values() for score in entry.scores})

    def note(entry: Summary) -> str:
        error_mm = entry.interval("mpjpe_mm")
        width = f" ±{fixed(error_mm.half_width)}" if np.isfinite(error_mm.half_width) else ""
        return width + (FEWER if error_mm.n_recordings < n_recordings else "")

    return Column("absolute", lambda e: fixed(e.mean("mpjpe_mm")), lambda e: e.mean("mpjpe_mm"), note)


def lower_is_better(title: str, number: str, decimals: int = 1) -> Column:
    return Column(title, lambda e: fixed(e.mean(number), decimals), lambda e: e.mean(number))


_COLUMNS = (
    lower_is_better("relative", "relative_mpjpe_mm"),
    lower_is_better("median", "median_mm"),
    lower_is_better("95 %", "p95_mm"),
    Column("PCK", lambda e: fixed(100 * e.mean("pck_150mm")), lambda e: -e.mean("pck_150mm")),
    Column("missing", lambda e: fixed(100 * e.mean("missing_share"))),
    lower_is_better("accel.", _ACCELERATION, 2),
    lower_is_better("bones", "bone_spread_mm"),
    Column("ms", lambda e: significant(e.mean("ms_per_frame"))),
    Column("50/90/99 %", lambda e: _slashed(_coverage(e, "coverage"))),
    Column("NEES", lambda e: significant(e.mean("nees"))),
)
_NOMINAL = 100 * np.array(COVERAGE_LEVELS)  # percent


def _coverage(entry: Summary, number: str) -> np.ndarray:
    """In percent, one for each of COVERAGE_LEVELS."""
    return np.array([100 * entry.mean(number, level) for level in range(len(COVERAGE_LEVELS))])


def _ratio(ours: Summary | None, other: Summary | None, number: str) -> str:
    if ours is None or other is None:
        return NONE
    ratio = paired_ratio(ours, other, number)
    interval = f" ({ratio.low:.2f}–{ratio.high:.2f})" if np.isfinite(ratio.half_width) else ""
    return fixed(ratio.value, 2) + interval


def fixed(value: float, decimals: int = 1) -> str:
    return NONE if np.isnan(value) else f"{value:.{decimals}f}"


def significant(value: float) -> str:
    """Three digits, or all before the point."""
    if np.isnan(value):
        return NONE
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:#.3g}".rstrip(".")


def _slashed(percent: np.ndarray | None) -> str:
    if percent is None or not np.isfinite(percent).all():
        return NONE
    return "/".join(f"{share:.0f}" for share in percent)


def _by_method(groups: Mapping[str, str], columns: Mapping[str, Cells]) -> str:
    """One row for each method, after the name of its group."""
    rows, previous = [], None
    for method, group in groups.items():
        if group != previous and group != method:
            rows.append([f"*{group}*", *("" for _ in columns)])
        previous = group
        rows.append([method, *(cells.get(method, NONE) for cells in columns.values())])
    return markdown(["method", *columns], rows)


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column stands left and whose others stand right."""
    rule = ["---", *("---:" for _ in header[1:])]
    return "\n".join(f"| {' | '.join(_escaped(cell) for cell in row)} |" for row in (header, rule, *rows))


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")
