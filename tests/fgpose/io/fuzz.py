"""Damages small files of every format in many ways and reads them: only ValueError and OSError that name the file, in
a few words.

    python tests/fgpose/io/fuzz.py --runs 20000 --seed 3 [--formats "rig yaml" ...]

Runs are spread evenly over the formats. Each is read in a worker process, which is replaced when a file kills it or
holds it up. What goes wrong is kept in a folder that is printed, and can be made again from its seed.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
import warnings
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from mutations import mutate
from small_files import FORMATS, Format

# Each takes a few milliseconds, C3D half a second in a process of its own; a loaded machine is slower.
TIME_LIMIT_S = 30.0
# The worker itself takes one: what a file of some kilobytes may take on top is far below it.
MEMORY_LIMIT_BYTES = 6 << 30

# Names of all joints of a body and of all cameras, several times.
MAX_MESSAGE = 2000

READ, REFUSED = "read", "refused"
OUTCOMES = (READ, REFUSED, "unnamed", "long", "wrong exception", "hang", "death")


@dataclass
class Tally:
    """What came of the files of one format."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    """One line for each file that was neither read nor refused."""


@dataclass(frozen=True)
class Plan:
    """What is read, and with how much patience."""

    seed: int
    """Of all mutations."""
    keep: Path | None = None
    """Folder for the files that were neither read nor refused."""
    catalogue: str = "small_files"
    """Module that has the formats."""
    time_limit_s: float = TIME_LIMIT_S


def fuzz(formats: Sequence[str], runs: Iterable[int], plan: Plan) -> dict[str, Tally]:
    """Damage and read files.

    Args:
        formats: names in FORMATS of the catalogue.
        runs: numbers of the mutations, the same for every format.
        plan: the rest.
    """
    tallies = {name: Tally() for name in formats}
    with tempfile.TemporaryDirectory() as folder:
        waiting = [(name, run) for run in runs for name in formats]
        while waiting:
            waiting = waiting[_work(waiting, plan, Path(folder), tallies) :]
    return tallies


def _work(waiting: list[tuple[str, int]], plan: Plan, folder: Path, tallies: dict[str, Tally]) -> int:
    """Give files to one worker until it is through or has to be replaced. Returns how many it has dealt with."""
    command = [sys.executable, __file__, "--seed", str(plan.seed), "--worker", plan.catalogue, "--folder", str(folder)]
    worker = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True, env=_environment()
    )
    assert worker.stdin is not None
    assert worker.stdout is not None
    answers = _lines_of(worker.stdout)
    try:
        assert answers.get(timeout=120) == "ready\n"
        for done, (name, run) in enumerate(waiting):
            worker.stdin.write(json.dumps([name, run]) + "\n")
            worker.stdin.flush()
            outcome, detail = _answer(answers, worker, plan.time_limit_s)
            tallies[name].counts[outcome] += 1
            if outcome not in (READ, REFUSED):
                tallies[name].failures.append(f"{name}, seed {plan.seed}, run {run}: {outcome}: {detail}")
                if plan.keep is not None:
                    shutil.copytree(folder / "case", plan.keep / f"{name.replace(' ', '_')}_{plan.seed}_{run}")
            if outcome in ("hang", "death"):
                return done + 1
        return len(waiting)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(worker.pid, signal.SIGKILL)
        worker.wait()
        with contextlib.suppress(BrokenPipeError):
            worker.stdin.close()


def _answer(answers: queue.Queue[str], worker: subprocess.Popen[str], time_limit_s: float) -> tuple[str, str]:
    try:
        line = answers.get(timeout=time_limit_s)
    except queue.Empty:
        return "hang", f"longer than {time_limit_s:.0f} s"
    if not line:
        return "death", f"exit code {worker.wait()}"
    outcome, detail = json.loads(line)
    return outcome, detail


def _lines_of(stream: IO[str]) -> queue.Queue[str]:
    """The lines as they come, then an empty one."""
    lines: queue.Queue[str] = queue.Queue()

    def forward() -> None:
        with stream:
            for line in stream:
                lines.put(line)
        lines.put("")

    threading.Thread(target=forward, daemon=True).start()
    return lines


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path), "OPENBLAS_NUM_THREADS": "1"}


def _serve(catalogue: str, seed: int, folder: Path) -> None:
    """The worker: a line in names format and run, a line out says what came of it."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT_BYTES, MEMORY_LIMIT_BYTES))
    formats: dict[str, Format] = importlib.import_module(catalogue).FORMATS
    pristine: dict[str, Path] = {}
    warnings.simplefilter("ignore")
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        name, run = json.loads(line)
        file_format = formats[name]
        if name not in pristine:
            pristine[name] = folder / name.replace(" ", "_")
            if not pristine[name].exists():
                pristine[name].mkdir()
                file_format.make(pristine[name])
        case = folder / "case"
        shutil.rmtree(case, ignore_errors=True)
        shutil.copytree(pristine[name], case)
        print(json.dumps(_outcome(file_format, case, run, seed)), file=answers, flush=True)


def _outcome(file_format: Format, case: Path, run: int, seed: int) -> tuple[str, str]:
    rng = np.random.default_rng([seed, run, zlib.crc32(file_format.name.encode())])
    files = sorted(path for path in case.rglob("*") if path.is_file())
    path = files[int(rng.integers(len(files)))]
    way = mutate(rng, path, file_format.kind)
    try:
        file_format.read(case)
        return READ, way
    except np.linalg.LinAlgError as error:  # which is a ValueError, and nobody's fault but ours
        return "wrong exception", f"{way}: LinAlgError: {error}"
    except (ValueError, OSError) as error:
        said = f"{way}: {type(error).__name__}: {str(error)[:300]}"
        # One file may name another that it goes with, or one that is not there.
        if f"{case}{os.sep}" not in str(error) and path.name not in str(error) and f"{case}: " not in str(error):
            return "unnamed", said
        return (REFUSED, way) if len(str(error)) <= MAX_MESSAGE else ("long", said)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        return "wrong exception", f"{way}: {type(error).__name__} at {place}: {str(error)[:200]}"


def table(tallies: dict[str, Tally]) -> str:
    """One row per format, in Markdown."""
    head = ("format", "files", *OUTCOMES)
    rows: list[list[Any]] = [
        [name, tally.counts.total(), *(tally.counts[each] for each in OUTCOMES)] for name, tally in tallies.items()
    ]
    rows.append(["all", *(sum(row[i] for row in rows) for i in range(1, len(head)))])
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000, help="files in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first run of each format")
    parser.add_argument("--formats", nargs="*", help="names of formats; by default all")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        _serve(options.worker, options.seed, options.folder)
        return 0
    formats = options.formats or list(FORMATS)
    keep = Path(tempfile.mkdtemp(prefix="fuzz_"))
    runs = range(options.first, options.first - (-options.runs // len(formats)))
    tallies = fuzz(formats, runs, Plan(options.seed, keep))
    failures = [failure for tally in tallies.values() for failure in tally.failures]
    report = [table(tallies), *failures, f"{len(failures)} failures; their files are in {keep}", ""]
    sys.stdout.write("\n".join(report))
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
