"""The report of the benchmark: one Markdown file and its pictures; and stored errors to compare later runs with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fgpose.io.atomic import write_text
from fgpose.io.content import parse_json, read_content
from fgpose_benchmarks.accuracy.families import VARIANTS, family_of
from fgpose_benchmarks.accuracy.figures import write_figures
from fgpose_benchmarks.comparison import tables
from fgpose_benchmarks.comparison.scores import Score
from fgpose_benchmarks.comparison.summary import (
    CONFIDENCE,
    FEWEST_RECORDINGS,
    OTHERS,
    RESAMPLES,
    Summaries,
    Summary,
    methods_of,
    summarise,
    variants_of,
)

TOLERANCE = 0.02
"""By which share of the stored mean an error may lie outside its stored interval: room for what other processors and
versions of the libraries change."""
_FEW = (
    f"From fewer than {FEWEST_RECORDINGS} recordings there is no such confidence: the intervals are then the range "
    "from the best recording to the worst; one recording has none."
)
_NUMBERS = ("mean_mm", "low_mm", "high_mm")


def write_report(scores: list[Score], folder: Path, command: str = "fgpose benchmark") -> list[Path]:
    """Write report.md and its pictures into a folder.

    Args:
        folder: made if it is absent.
        command: what makes the same report again.

    Returns:
        The files, report.md first.

    Raises:
        ValueError: there are no scores, or they contradict one another; as summarise().
        ImportError: matplotlib is not installed; the message says how to.
        OSError: the folder cannot be written into.
    """
    summaries = summarise(scores)
    main = _standard(summaries)
    figures = write_figures(main, folder)
    pictures = [f"![{text}]({path.name})" for path, text in figures.items()]
    parts = [
        *_head(summaries, command),
        *pictures,
        *_overview(main),
        *_families(summaries),
        *_calibration(main),
        *_details(summaries),
    ]
    path = folder / "report.md"
    write_text(path, "\n\n".join(parts) + "\n")
    return [path, *figures]


def _version() -> int:
    from fgpose_benchmarks.accuracy.variants import VERSION

    return VERSION


def _head(summaries: Summaries, command: str) -> list[str]:
    counts = [len(_clips(summaries, variant)) for variant in variants_of(summaries)]
    number = f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)} to {max(counts)}"
    return [
        "# The occlusion benchmark",
        f"Version {_version()}. Variants: {len(counts)}; recordings of each: {number}; "
        f"methods: {len(methods_of(summaries))}. To reproduce:",
        f"    {command}",
        f"Numbers are means over the recordings. ± is half the width of the {100 * CONFIDENCE:.0f} % confidence "
        f"interval over the recordings, by bootstrap ({RESAMPLES} resamples), widened for small numbers of them; "
        "ratios, with their intervals, are those of means over the same recordings. Bold: the best, without the "
        f"oracle, which knows the truth. {tables.FEWER}: over fewer recordings than the others. "
        f"{tables.NONE}: no such number.",
        *([_FEW] if min(counts) < FEWEST_RECORDINGS else []),
    ]


def _standard(summaries: Summaries) -> Summaries:
    """Without the families that have a table of their own; all where there is nothing else."""
    kept = {key: entry for key, entry in summaries.items() if family_of(key[0]) in ("standard", None)}
    return kept or summaries


def _clips(summaries: Summaries, variant: str) -> set[str]:
    return {score.clip for entry in tables.entries_of(summaries, variant).values() for score in entry.scores}


def _overview(summaries: Summaries) -> list[str]:
    parts = ["## Absolute MPJPE (mm)", tables.absolute_errors(summaries)]
    ours = [method for method, group in methods_of(summaries).items() if group == "ours"]
    if ours:
        parts += [
            "## Ours against the best other",
            f"Absolute MPJPE in mm. Best other: the lowest of the groups {', '.join(OTHERS)}. The ratios compare the "
            "MPJPE and the 95th percentile of the error, each with the method that is best in it, the MPJPE with the "
            "oracle's, and the acceleration error with the best linear method's. Below 1, ours is better.",
        ]
    for method in ours:
        parts += [f"### {method}", tables.comparison(summaries, method)]
    return parts


def _families(summaries: Summaries) -> list[str]:
    families: dict[str, list[str]] = {}
    for variant in variants_of(summaries):
        if (family := family_of(variant)) not in ("standard", None):
            families.setdefault(str(family), []).append(variant)
    if not families:
        return []
    parts = [
        "## Errors for which no default was chosen",
        "Absolute MPJPE and 95th percentile in mm. Defaults are chosen on the tuning clips of the standard family, the "
        "tables above; what they are worth on other errors is stated here, beside the oracle, which leaves out every "
        "detection of a hidden joint. Ratios compare the MPJPE, with their intervals.",
    ]
    for family, variants in families.items():
        parts += [f"### Family: {family}", tables.of_family(summaries, variants)]
    return parts


def _calibration(summaries: Summaries) -> list[str]:
    parts = []
    titles = {
        "coverage": "All joints",
        "coverage_occluded": "Joints that at least half of the cameras cannot see",
    }
    for number, title in titles.items():
        if table := tables.calibration(summaries, number):
            parts += [f"### {title}", table]
    if parts:
        parts[:0] = [
            "## Calibration of the covariance",
            "Percentage of the joints inside their 50, 90 and 99 % ellipsoids; last, the largest deviation from these "
            "in percentage points.",
        ]
    if offsets := tables.time_offsets(summaries):
        parts += [
            "## Estimated time offsets",
            "Error of the worst camera in frames: mean over the recordings (largest).",
            offsets,
        ]
    return parts


def _details(summaries: Summaries) -> list[str]:
    parts = [
        "## Every number",
        "Absolute and pelvis-relative MPJPE, median and 95th percentile of the absolute error in mm; PCK: joints "
        "within 150 mm, and missing joints, in %; acceleration error in mm/frame²; bones: standard deviation of the "
        "bone lengths over time in mm; ms per frame; coverage of the 50/90/99 % ellipsoids in %; NEES per degree of "
        "freedom (1 if consistent).",
    ]
    for variant in variants_of(summaries):
        parts += [f"### {tables.words(variant)}", *_description(variant), tables.all_numbers(summaries, variant)]
    return parts


def _description(variant: str) -> list[str]:
    """What the open benchmark says of its variants; nothing of others, as of recordings of Human3.6M."""
    return [f"{known.description}." for known in VARIANTS if known.name == variant]


def store_intervals(scores: list[Score], path: Path, margin: float | None = None) -> None:
    """Write the mean MPJPE of every variant and method with an interval as JSON, for check_against().

    Args:
        margin: the interval is the mean plus and minus this share of it: how far runs on the same recordings may
            differ. None: the confidence interval over the recordings, which says how far other recordings may; from
            two or three recordings it reaches from the best to the worst.

    Raises:
        ValueError: a method has no finite MPJPE on a variant, or as summarise().
        OSError: the file cannot be written.
    """
    intervals = [_stored(summary, margin) for summary in summarise(scores).values()]
    # One line for each, so that changes of the file can be read.
    lines = ",\n".join(f"  {json.dumps(interval, allow_nan=False)}" for interval in intervals)
    write_text(path, f'{{"version": {_version()}, "intervals": [\n{lines}\n]}}\n')


def _stored(summary: Summary, margin: float | None) -> dict[str, Any]:
    error_mm = summary.interval("mpjpe_mm")
    mean_mm, ends_mm = error_mm.value, (error_mm.low, error_mm.high)
    if not np.isfinite(mean_mm):
        raise ValueError(f"variant {summary.variant}: {summary.method} has no finite MPJPE to store")
    if margin is not None:
        ends_mm = ((1 - margin) * mean_mm, (1 + margin) * mean_mm)
    elif error_mm.n_recordings == 1:
        ends_mm = (mean_mm, mean_mm)
    key = {"variant": summary.variant, "method": summary.method}
    return key | dict(zip(_NUMBERS, (round(value_mm, 3) for value_mm in (mean_mm, *ends_mm)), strict=True))


def check_against(stored: Path, scores: list[Score]) -> list[str]:
    """Compare the mean MPJPE of every variant and method with its stored interval.

    An interval is widened on both sides by TOLERANCE times the stored mean. An error below its interval is a violation
    too: the stored intervals are then out of date.

    Returns:
        What is violated, one line each; also what is stored and has no score, and the other way round.

    Raises:
        ValueError: the file is not of store_intervals(), or as summarise().
        OSError: the file cannot be read.
    """
    version, intervals = _read_intervals(stored)
    if version != _version():
        return [f"{stored} is of version {version} of the benchmark, this is version {_version()}: store it anew"]
    summaries = summarise(scores)
    absent = [f"{variant}, {method}: stored, but there is no score" for variant, method in intervals.keys() - summaries]
    checked = [_violation(summary, intervals.get(key)) for key, summary in summaries.items()]
    return sorted(absent) + [violation for violation in checked if violation is not None]


def _read_intervals(path: Path) -> tuple[Any, dict[tuple[str, str], dict[str, Any]]]:
    wrong = ValueError(f"{path} does not hold stored intervals of the benchmark")
    try:
        content = parse_json(read_content(path))
        version, entries = content["version"], content["intervals"]
        intervals = {(entry["variant"], entry["method"]): entry for entry in entries}
        numbers = [entry[name] for entry in entries for name in _NUMBERS]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise wrong from None
    if not all(isinstance(number, int | float) for number in numbers):
        raise wrong
    return version, intervals


def _violation(summary: Summary, interval: dict[str, Any] | None) -> str | None:
    name = f"{summary.variant}, {summary.method}"
    error_mm = summary.mean("mpjpe_mm")
    if interval is None:
        return f"{name}: no stored interval"
    margin_mm = TOLERANCE * interval["mean_mm"]
    low_mm, high_mm = interval["low_mm"] - margin_mm, interval["high_mm"] + margin_mm
    if low_mm <= error_mm <= high_mm:
        return None
    change = "better" if error_mm < low_mm else "worse"
    return f"{name}: MPJPE {error_mm:.2f} mm is {change} than stored, {low_mm:.2f} to {high_mm:.2f} mm"
