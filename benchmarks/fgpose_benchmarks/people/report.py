"""The report of the benchmark of several people: one Markdown file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_text
from fgpose_benchmarks.comparison import tables
from fgpose_benchmarks.comparison.summary import Summary, summarise
from fgpose_benchmarks.comparison.tables import Column
from fgpose_benchmarks.people.methods import TOLD
from fgpose_benchmarks.people.scores import PeopleScore
from fgpose_benchmarks.people.variants import VARIANTS, VERSION, group_of

_HEAD = (
    "Simulated crowds, the same detections for every method, scored by the protocol of fgpose.assessment.people "
    "(matches within 0.5 m). Numbers are means over the recordings; counts, what is divided by them, medians and "
    "percentiles are of all recordings together. Bold: the best, without the line *told who is who*, which smooths "
    "with the true association."
)
_QUESTIONS = {
    "Who is there?": "Shares in percent; fragmentations per person and minute; time from when two cameras detect "
    "somebody who comes, or is there at the start, until they are in the result, median and 95th percentile in ms, and "
    "how many never are; false tracks (identities that are matched in less than half of their frames) per 10 minutes, "
    "and the longest life of one in s.",
    "Who is who?": "IDF1 in percent, as everybody is called at the time and by the numbers that they have in the end; "
    "HOTA in percent; identity switches per person and minute: all, those at encounters in "
    "which two people come as near as 0.5 to 1 m, and nearer than 0.5 m, in brackets how many encounters there are "
    "(switches at a return are not among them); how many of those who return are recognised, after being away for up "
    "to 5 s and for longer; how many of those who arrive, returning or new, are mistaken for somebody else.",
    "Where?": "Absolute MPJPE of matched people in mm, which alone rewards leaving people out, and its ratio to that "
    "of the line that is told; PCP, joints that lie on somebody else, and joints that the method does not give, in "
    "percent; processor time in ms for the images of all cameras of about one time.",
}


def write_report(scores: Sequence[PeopleScore], folder: Path, command: str) -> Path:
    """Write report.md into a folder, whole or not at all.

    Args:
        folder: made if it is absent.
        command: what makes the same report again.

    Raises:
        ValueError: there are no scores, or they contradict one another; as summarise().
        OSError: the folder cannot be written into.
    """
    summaries = summarise(scores)
    parts = [
        "# The benchmark of several people",
        f"Version {VERSION}. To reproduce:",
        f"    {command}",
        _HEAD,
        *(f"- **{question}** {columns}" for question, columns in _QUESTIONS.items()),
    ]
    groups: dict[str, list[str]] = {}
    for score in scores:
        groups.setdefault(group_of(score.variant), []).append(score.variant)
    for group, named in groups.items():
        variants = list(dict.fromkeys(named))
        parts.append(f"## {group.capitalize()}")
        if len(variants) > 1:
            together = summarise(_as_one(group, [score for score in scores if score.variant in variants]))
            parts += [f"All {len(variants)} variants together:", *_tables(tables.entries_of(together, group))]
        for variant in variants:
            parts += [f"### {tables.words(variant)}", *_description(variant)]
            parts += _tables(tables.entries_of(summaries, variant))
    path = folder / "report.md"
    write_text(path, "\n\n".join(parts) + "\n")
    return path


def _as_one(group: str, scores: Sequence[PeopleScore]) -> list[PeopleScore]:
    """As if the recordings of several variants were of one."""
    return [replace(score, variant=group, clip=f"{score.variant}, {score.clip}") for score in scores]


def _description(variant: str) -> list[str]:
    return [f"{known.description}." for known in VARIANTS if known.name == variant]


def _tables(entries: Mapping[str, Summary]) -> list[str]:
    """One for each question, after it."""
    told = entries.get(TOLD.name)

    def to_told(entry: Summary) -> str:
        return tables.NONE if told is None else tables.fixed(entry.mean("mpjpe_mm") / told.mean("mpjpe_mm"), 2)

    where = (
        tables.lower_is_better("MPJPE", "mpjpe_mm"),
        Column("/ told", to_told),
        _percent("PCP", "pcp"),
        _percent("wrong", "wrong_person", worth=-1, decimals=2),
        Column("missing", lambda entry: tables.fixed(100 * entry.mean("missing"))),
        Column("ms", lambda entry: tables.significant(entry.mean("ms_per_frame"))),
    )
    every = (tables.of_methods(entries, columns) for columns in (_WHO_IS_THERE, _WHO_IS_WHO, where))
    return [part for pair in zip(_QUESTIONS, every, strict=True) for part in pair]


def _percent(title: str, number: str, worth: int = 1, decimals: int = 1) -> Column:
    """Of a share of which more is better, or with a worth of -1 less."""
    return Column(
        title,
        lambda entry: tables.fixed(100 * entry.mean(number), decimals),
        lambda entry: -worth * entry.mean(number),
    )


def _rate(title: str, number: str, of: str, scale: float, decimals: int, note: str | None = None) -> Column:
    """What is counted in all recordings, for each so many (scale) of what they have."""

    def rate(entry: Summary) -> float:
        return scale * _total(entry, number) / _total(entry, of)

    return Column(
        title,
        lambda entry: tables.fixed(rate(entry), decimals),
        rate,
        lambda entry: f" ({_total(entry, note):.0f})" if note else "",
    )


def _total_of(title: str, number: str) -> Column:
    """A count, of which less is better."""
    return Column(title, lambda entry: f"{_total(entry, number):.0f}", lambda entry: _total(entry, number))


def _part(title: str, number: str, of: str, worth: int) -> Column:
    """So many of so many, of which more is better, or with a worth of -1 less."""

    def text(entry: Summary) -> str:
        whole = _total(entry, of)
        return f"{_total(entry, number):.0f} of {whole:.0f}" if whole else tables.NONE

    def cost(entry: Summary) -> float:
        return -worth * _total(entry, number) if _total(entry, of) else np.nan

    return Column(title, text, cost)


def _time(title: str, number: str, of: Callable[[np.ndarray], float], scale: float, decimals: int) -> Column:
    """Of the times of all recordings together."""

    def cost(entry: Summary) -> float:
        times_s = _all(entry, number)
        return float(of(times_s)) if len(times_s) else np.nan

    return Column(title, lambda entry: tables.fixed(scale * cost(entry), decimals), cost)


def _all(entry: Summary, number: str) -> Float[np.ndarray, " each"]:
    """The numbers of all recordings; a count is one number, times are several."""
    return np.concatenate([np.atleast_1d(np.asarray(getattr(score, number), dtype=float)) for score in entry.scores])


def _total(entry: Summary, number: str) -> float:
    """Of a number, the sum; of times, how many."""
    return float(
        sum(len(value) if isinstance(value := getattr(score, number), tuple) else value for score in entry.scores)
    )


_WHO_IS_THERE = (
    _percent("recall", "recall"),
    _percent("precision", "precision"),
    _percent("F1", "f1"),
    _percent("MOTA", "mota"),
    tables.lower_is_better("fragm.", "fragmentations", 2),
    _time("found after", "confirmed_s", np.median, 1000.0, 0),
    _time("95 %", "confirmed_s", lambda times_s: float(np.percentile(times_s, 95)), 1000.0, 0),
    _total_of("never", "n_unconfirmed"),
    _rate("false tracks", "false_tracks_s", "minutes", 10.0, 1),
    replace(_time("longest", "false_tracks_s", np.max, 1.0, 2), cost=None),  # without false tracks there is none
)
_WHO_IS_WHO = (
    _percent("IDF1", "idf1"),
    _percent("revised", "idf1_revised"),
    _percent("HOTA", "hota"),
    tables.lower_is_better("switches", "switches", 2),
    _rate("at 0.5–1 m", "pass_switches", "person_minutes", 1.0, 2, "n_passes"),
    _rate("nearer", "close_switches", "person_minutes", 1.0, 2, "n_close_passes"),
    _part("back in 5 s", "n_short_recognised", "n_short_returns", 1),
    _part("back later", "n_long_recognised", "n_long_returns", 1),
    _part("mistaken", "n_mistaken", "n_arrivals", -1),
)
