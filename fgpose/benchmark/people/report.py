"""The report of the benchmark of several people: one Markdown file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fgpose.benchmark import tables
from fgpose.benchmark.people.methods import TOLD
from fgpose.benchmark.people.scores import PeopleScore
from fgpose.benchmark.people.variants import VARIANTS, VERSION, group_of
from fgpose.benchmark.summary import Summary, summarise
from fgpose.benchmark.tables import Column
from fgpose.io.atomic import write_text

_HEAD = (
    "Simulated crowds, the same detections for every method. Numbers are means over the recordings, after the protocol "
    "of fgpose.assessment.people (matches within 0.5 m): shares in percent; identity switches and fragmentations per "
    "person and minute; absolute MPJPE of matched people in mm, and its ratio to that of the line *told who is who*, "
    "which smooths with the true association; joints that lie on somebody else; processor time for the images of all "
    "cameras of about one time. An MPJPE without recall and precision rewards leaving people out. Bold: the best, "
    "without the line that is told."
)


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
    parts = ["# The benchmark of several people", f"Version {VERSION}. To reproduce:", f"    {command}", _HEAD]
    groups: dict[str, list[str]] = {}
    for score in scores:
        groups.setdefault(group_of(score.variant), []).append(score.variant)
    for group, named in groups.items():
        variants = list(dict.fromkeys(named))
        parts.append(f"## {group.capitalize()}")
        if len(variants) > 1:
            together = summarise(_as_one(group, [score for score in scores if score.variant in variants]))
            parts += [f"All {len(variants)} variants together:", _table(tables.entries_of(together, group))]
        for variant in variants:
            parts += [f"### {tables.words(variant)}", *_description(variant)]
            parts.append(_table(tables.entries_of(summaries, variant)))
    path = folder / "report.md"
    write_text(path, "\n\n".join(parts) + "\n")
    return path


def _as_one(group: str, scores: Sequence[PeopleScore]) -> list[PeopleScore]:
    """As if the recordings of several variants were of one."""
    return [replace(score, variant=group, clip=f"{score.variant}, {score.clip}") for score in scores]


def _description(variant: str) -> list[str]:
    return [f"{known.description}." for known in VARIANTS if known.name == variant]


def _table(entries: Mapping[str, Summary]) -> str:
    told = entries.get(TOLD.name)

    def to_told(entry: Summary) -> str:
        return tables.NONE if told is None else tables.fixed(entry.mean("mpjpe_mm") / told.mean("mpjpe_mm"), 2)

    columns = (
        *(_percent(title, number) for title, number in _SHARES),
        tables.lower_is_better("switches", "switches", 2),
        tables.lower_is_better("fragm.", "fragmentations", 2),
        tables.lower_is_better("MPJPE", "mpjpe_mm"),
        Column("/ told", to_told),
        _percent("PCP", "pcp"),
        _percent("wrong", "wrong_person", worth=-1, decimals=2),
        Column("missing", lambda entry: tables.fixed(100 * entry.mean("missing"))),
        Column("ms", lambda entry: tables.significant(entry.mean("ms_per_frame"))),
    )
    return tables.of_methods(entries, columns)


_SHARES = (
    ("recall", "recall"),
    ("precision", "precision"),
    ("F1", "f1"),
    ("MOTA", "mota"),
    ("IDF1", "idf1"),
    ("HOTA", "hota"),
)


def _percent(title: str, number: str, worth: int = 1, decimals: int = 1) -> Column:
    """Of a share of which more is better, or with a worth of -1 less."""
    return Column(
        title,
        lambda entry: tables.fixed(100 * entry.mean(number), decimals),
        lambda entry: -worth * entry.mean(number),
    )
