"""The table of random recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgpose.io.atomic import write_text
from fgpose_benchmarks.comparison.scores import COVERAGE_LEVELS, Score
from fgpose_benchmarks.comparison.summary import Summary, summarise
from fgpose_benchmarks.random_recordings.conditions import draw

_ORACLE = "oracle"
_HEAD = (
    "Rigs, motion and errors of detections are drawn at random, without any of the error models of the other "
    "benchmarks. Seeds below 100 were looked at when fgpose was changed, no others. The oracle knows which detections "
    "are right, how large their noise is, the true cameras and clocks; it knows no more of the bones than the others. "
    "*Error*: of all joints that a method gives, median over the recordings. *Over the oracle*: ratio of the errors, "
    "median, and the worst tenth of the recordings. Ellipsoids: share of the errors in those of 50, 90 and 99 %, mean "
    "over the recordings; and how many recordings have less than 70 % in those of 90 %."
)


def write_report(scores: Sequence[Score], folder: Path, command: str) -> Path:
    """Write report.md into a folder.

    Raises:
        ValueError: there are no scores.
        OSError: the folder cannot be written into.
    """
    by_method = {summary.method: summary for summary in summarise(scores).values()}
    path = folder / "report.md"
    parts = [f"# Random recordings\n\n`{command}`", _HEAD, _methods(by_method), "## Recording by recording"]
    write_text(path, "\n\n".join([*parts, _recordings(by_method)]) + "\n")
    return path


def _methods(by_method: dict[str, Summary]) -> str:
    levels = ", ".join(f"{level:.0%}" for level in COVERAGE_LEVELS)
    rows = [
        "| | error, mm | over the oracle | worst tenth | ellipsoids of " + levels + " | below 70 % |",
        "|---|" + "---:|" * 5,
    ]
    oracle = by_method[_ORACLE].by_clip("mpjpe_mm") if _ORACLE in by_method else {}
    for name, summary in by_method.items():
        errors = summary.by_clip("mpjpe_mm")
        ratios = np.array([error / oracle[clip] for clip, error in errors.items() if clip in oracle])
        inside = [np.array(list(summary.by_clip("coverage", index).values())) for index in range(len(COVERAGE_LEVELS))]
        states = np.isfinite(inside[1])
        cells = [
            f"{np.nanmedian(list(errors.values())):.1f}",
            f"{np.nanmedian(ratios):.2f}" if ratios.size else "–",
            f"{np.nanquantile(ratios, 0.9):.2f}" if ratios.size else "–",
            ", ".join(f"{np.nanmean(each):.0%}" for each in inside) if states.any() else "–",
            f"{np.sum(inside[1][states] < 0.7)} of {states.sum()}" if states.any() else "–",
        ]
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _recordings(by_method: dict[str, Summary]) -> str:
    errors = {name: summary.by_clip("mpjpe_mm") for name, summary in by_method.items()}
    clips = sorted({clip for each in errors.values() for clip in each})
    rows = ["| | " + " | ".join(f"{name}, mm" for name in errors) + " | |", "|---|" + "---:|" * len(errors) + "---|"]
    for clip in clips:
        cells = [f"{each[clip]:.1f}" if clip in each else "–" for each in errors.values()]
        rows.append(f"| {clip} | " + " | ".join(cells) + f" | {draw(int(clip)).unusual()} |")
    return "\n".join(rows)
