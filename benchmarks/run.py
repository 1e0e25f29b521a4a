"""Measure fgpose: ``python benchmarks/run.py [--quick] [--only NAME]``. Exit code 1 when a limit is missed.

Prints a Markdown table and, but for --quick, updates benchmarks/results.json. See README.md beside this file.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

import accuracy
import people_speed
import speed
import stage1
import video
from fgpose.io.atomic import write_text
from metric import Metric, markdown_table

_RESULTS = Path(__file__).with_name("results.json")

Benchmarks = dict[str, Callable[[], list[Metric]]]


def _full() -> Benchmarks:
    return {
        "batch": partial(speed.batch, 300, 9),
        "batch-long": partial(speed.batch_long, 30_000),
        "aniposelib": partial(accuracy.against_aniposelib, 300, 5, accuracy.FULL_SWEEP),
        "online": partial(speed.online, 2_000, "isam2"),
        "online-window": partial(speed.online, 2_000, "window"),
        "online-window-33": partial(speed.online, 2_000, "window", 33),
        "online-window-occluded": partial(speed.online_occluded, 2_000, "window"),
        "online-long": partial(speed.online_long, 20_000, "isam2"),
        "online-window-long": partial(speed.online_long, 20_000, "window"),
        "covariance": partial(speed.covariance, 300, 5),
        "import": partial(speed.import_time, 7),
        "people": partial(people_speed.live, 20.0),
        "people-long": partial(people_speed.live_long, 20_000),
        "people-batch": partial(people_speed.batch, 20.0, 3),
        "stage1": partial(stage1.time_per_view, 20, ("blazepose-lite", "blazepose-full", "blazepose-heavy")),
        "stage1-parallel": partial(stage1.parallel, 50, 5),
        "mediapipe": stage1.agreement_with_mediapipe,
        "fused": partial(video.fused_against_triangulated, ("blazepose-full", "blazepose-heavy")),
        "smoothness": partial(video.smoothness, "blazepose-full"),
        "occluders": partial(
            video.occluders_pasted, ("blazepose-full", "blazepose-heavy"), (video.EACH_FRAME, video.STAYING)
        ),
    }


def _quick() -> Benchmarks:
    """The same on fewer frames and runs, in less than two minutes: for a first look, not for the record."""
    return {
        "batch": partial(speed.batch, 300, 3),
        "batch-long": partial(speed.batch_long, 2_000),
        "aniposelib": partial(accuracy.against_aniposelib, 60, 2, accuracy.QUICK_SWEEP),
        "online": partial(speed.online, 500, "isam2"),
        "online-window": partial(speed.online, 500, "window"),
        "online-window-33": partial(speed.online, 500, "window", 33),
        "online-window-occluded": partial(speed.online_occluded, 500, "window"),
        "online-long": partial(speed.online_long, 1_500, "isam2"),
        "online-window-long": partial(speed.online_long, 1_500, "window"),
        "covariance": partial(speed.covariance, 300, 2),
        "import": partial(speed.import_time, 3),
        "people": partial(people_speed.live, 8.0),
        "people-long": partial(people_speed.live_long, 1_200),
        "people-batch": partial(people_speed.batch, 6.0, 1),
        "stage1": partial(stage1.time_per_view, 5, ("blazepose-full",)),
        "stage1-parallel": partial(stage1.parallel, 20, 1),
        "mediapipe": stage1.agreement_with_mediapipe,
        "fused": partial(video.fused_against_triangulated, ("blazepose-full",)),
        "smoothness": partial(video.smoothness, "blazepose-full"),
        "occluders": partial(video.occluders_pasted, ("blazepose-full",), (video.EACH_FRAME,)),
    }


def _measure(benchmarks: Benchmarks) -> dict[str, list[Metric]]:
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    results = {}
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=len(benchmarks))
        for name, benchmark in benchmarks.items():
            progress.update(task, description=name)
            results[name] = benchmark()
            progress.advance(task)
    return results


def _conditions() -> dict[str, object]:
    """What the numbers depend on besides the code."""
    packages = ("gtsam", "numpy", "scipy")
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load_1min": round(os.getloadavg()[0], 2),
        **{package: version(package) for package in packages},
    }


def main(quick: bool = False, only: str = "") -> int:
    """Measure speed, memory and accuracy.

    Args:
        quick: fewer frames and runs, less than two minutes.
        only: one benchmark by name.
    """
    benchmarks = _quick() if quick else _full()
    if only and only not in benchmarks:
        print(f"no benchmark {only}; there are {', '.join(benchmarks)}", file=sys.stderr)
        return 2
    results = _measure({only: benchmarks[only]} if only else benchmarks)
    metrics = [metric for group in results.values() for metric in group]
    print(markdown_table(metrics))
    if not quick:
        _keep(results)
    return int(any(metric.missed for metric in metrics))


def _keep(results: dict[str, list[Metric]]) -> None:
    """Replace these benchmarks in the results file."""
    kept = json.loads(_RESULTS.read_text(encoding="utf-8")) if _RESULTS.exists() else {}
    for name, metrics in results.items():
        kept[name] = {
            "conditions": _conditions(),
            "metrics": [{**asdict(metric), "met": metric.met} for metric in metrics],
        }
    write_text(_RESULTS, json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
