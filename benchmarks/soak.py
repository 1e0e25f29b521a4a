"""The online estimator under random trouble: ``python benchmarks/soak.py``. Exit code 1 unless it holds.

Random scenes (soak_scenes.py), one after the other in a child process (soak_run.py), so that a crash is seen as such
and ends one run only. What is done already is not done again: an interrupted soak goes on where it stopped.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from soak_run import SoakResult
from soak_scenes import draw

_RUN = Path(__file__).with_name("soak_run.py")
_RUNS_PER_PROCESS = 20  # to start Python takes a second or two
_POLL_S = 0.1
_S_PER_FRAME = 4.0  # a run that takes longer than this times its frames hangs; the slowest take a tenth
# Beside what the longest window can take, which comes and goes. What leaks shows in the run of 100,000 frames: there
# this is 1 kB a frame.
_MAX_GROWTH_MB = 100.0


def soak(
    first: int, runs: int, frames: int, output: Path, done: Callable[[int], None] = lambda _: None
) -> list[SoakResult]:
    """The results of the runs with these seeds, from the file or anew.

    Args:
        done: called with how many runs there are so far.
    """
    output.mkdir(parents=True, exist_ok=True)
    path, seeds = output / f"runs_of_{frames}_frames.jsonl", range(first, first + runs)
    while todo := [seed for seed in seeds if seed not in (results := _results(path))]:
        n_runs = next((n for n, seed in enumerate(todo) if seed != todo[0] + n), len(todo))
        ended = _in_child(path, todo[0], min(n_runs, _RUNS_PER_PROCESS), frames, lambda: done(_n_of(path, seeds)))
        results = _results(path)
        died = next((seed for seed in todo[: min(n_runs, _RUNS_PER_PROCESS)] if seed not in results), None)
        if died is not None:
            result = SoakResult(died, frames, draw(died).conditions, death=ended)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(result)) + "\n")
    done(runs)
    return [results[seed] for seed in seeds]


def _results(path: Path) -> dict[int, SoakResult]:
    if not path.exists():
        return {}
    results = [SoakResult(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {result.seed: result for result in results}


def _n_of(path: Path, seeds: range) -> int:
    return sum(seed in seeds for seed in _results(path))


def _in_child(path: Path, first: int, runs: int, frames: int, done: Callable[[], None]) -> str:
    """How the child ended. It appends a line to the file after each run; when none comes, it is killed."""
    command = [sys.executable, "-W", "error::RuntimeWarning", str(_RUN)]
    command += [str(path), str(first), str(runs), str(frames)]
    with path.with_suffix(".txt").open("w", encoding="utf-8") as printed:
        child = subprocess.Popen(command, stdout=printed, stderr=subprocess.STDOUT)
        size, since_s = -1, time.monotonic()
        try:
            while child.poll() is None:
                time.sleep(_POLL_S)
                new_size = path.stat().st_size if path.exists() else 0
                if new_size != size:
                    size, since_s = new_size, time.monotonic()
                    done()
                elif time.monotonic() - since_s > 60 + _S_PER_FRAME * frames:
                    return "hung"
        finally:
            child.kill()
            child.wait()
    return f"exit code {child.returncode}"


def table(results: list[SoakResult]) -> str:
    """One row for every condition, in Markdown."""
    rows = [_row("all", results)]
    for condition in sorted({condition for result in results for condition in result.conditions}):
        rows.append(_row(condition, [result for result in results if condition in result.conditions]))
    head = "| condition | runs | deaths | exceptions | other failures | repairs | most memory gained, MB |\n"
    return head + "|---|---|---|---|---|---|---|\n" + "\n".join(rows)


def _row(condition: str, results: list[SoakResult]) -> str:
    deaths = sum(result.death is not None for result in results)
    exceptions = sum(any("Traceback" in failure for failure in result.failures) for result in results)
    others = sum(any("Traceback" not in reason for reason in failures(result)) for result in results) - deaths
    repairs = sum(result.repairs for result in results)
    growth_mb = max(result.memory_growth_mb for result in results)
    return f"| {condition} | {len(results)} | {deaths} | {exceptions} | {others} | {repairs} | {growth_mb:.1f} |"


def failures(result: SoakResult) -> list[str]:
    """Why a run does not count as passed."""
    reasons = list(result.failures)
    if result.death is not None:
        reasons.append(f"died: {result.death}")
    if result.memory_growth_mb > _MAX_GROWTH_MB + result.window_mb:
        reasons.append(f"memory grew by {result.memory_growth_mb:.0f} MB")
    if result.slots > 1:
        reasons.append("iSAM2 holds more factors than its window can have")
    if result.printed_bytes:
        reasons.append(f"{result.printed_bytes} bytes were printed")
    return reasons


def main(first: int = 0, runs: int = 1000, frames: int = 500, output: Path = Path("out/soak")) -> int:
    """Run the soak and print its table.

    Args:
        first: seed of the first run; every run is made by its seed alone.
        runs: how many.
        frames: of each run.
        output: folder of the results, a line of JSON for each run.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the child ends too
    columns = TextColumn("soak"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("soak", total=runs)
        results = soak(first, runs, frames, output, lambda n: progress.update(task, completed=n))
    print(table(results))
    failed = [result for result in results if failures(result)]
    for result in failed:
        print(f"\nseed {result.seed}", *failures(result), sep="\n  ")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
