"""A day of the live system, simulated: ``python benchmarks/live_soak.py``. Exit code 1 unless it holds.

Cameras, their clocks and states, tracker and outputs are those of ``fgpose live``, in one process, on a simulated
clock; images have small pictures, and detections in place of a network. People come and go, and each minute has a
fault (live_soak_plan.py). What the estimates are without faults is measured first, of the same people. The results are
written after every simulated hour.
"""

from __future__ import annotations

import faulthandler
import json
import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

import fgpose
from live_soak_plan import KINDS, SoakPlan
from live_soak_run import START_S, Comparison, FaultOutcome, LiveSoak, Usual
from simulated_visitors import SimulatedClip, made_clips, room_rig
from timing import resident_memory_mb

_VISIT_S = 12.0
# A simulated minute takes some seconds; the process ends if one takes this long.
_LOCKED_UP_S = 300.0
_CALM_ROUNDS = 2
_CONFIG = fgpose.Config(online={"lag_s": 0.3}, tracking={"max_processes": 2})
_MOST_GROWTH = 1.02
_MOST_NOTICED_S = 1.0
# Other delays of images and another history of the room change an estimate too: of a kind of fault by less than this.
_AS_GOOD = 1.05
_PUBLISHED_EVERY_S = 0.2


@dataclass(frozen=True)
class Minute:
    """This process at the end of a simulated minute."""

    memory_mb: float
    n_threads: int
    n_files: int
    cpu_s: float
    """Of the minute."""


@dataclass
class LiveSoakResult:
    """Of what was simulated so far."""

    hours: float
    seed: int
    rate_hz: float
    calm_error_mm: float
    """Without faults."""
    real_s: float = 0.0
    minutes: list[Minute] = field(default_factory=list)
    outcomes: list[FaultOutcome] = field(default_factory=list)
    alarms: list[str] = field(default_factory=list)
    """The first times that a camera without a fault was not ok."""
    n_alarms: int = 0
    n_others: int = 0
    """Frames times people who were not there."""
    n_scored: int = 0
    """Frames times people who were there."""
    longest_gap_s: float = 0.0
    """Between two frames."""
    n_tracker_failures: int = 0
    missed: list[str] = field(default_factory=list)
    """Criteria."""


def soak(hours: float, seed: int, rate_hz: float, done: Callable[[LiveSoakResult, int], None]) -> LiveSoakResult:
    """Simulate so many hours; done is called after each minute."""
    rig = room_rig()
    clips = made_clips(rig, _VISIT_S, rate_hz, seed)
    usual = _calm(clips, seed, rate_hz)
    calm_mm = 1e3 * float(np.nanmean(np.concatenate([each.error_m.ravel() for each in usual])))
    result = LiveSoakResult(hours, seed, rate_hz, calm_mm)
    run = LiveSoak(rig, clips, SoakPlan(clips, rig.names, rate_hz, START_S, seed), rate_hz, seed + 1, _CONFIG, usual)
    began_s = time.monotonic()
    try:
        for minute in range(round(60 * hours)):
            faulthandler.dump_traceback_later(_LOCKED_UP_S, exit=True)
            cpu_s = time.process_time()
            outcome = run.run_minute(minute)
            if outcome is not None:
                result.outcomes.append(outcome)
            result.minutes.append(_minute(time.process_time() - cpu_s))
            result.real_s = time.monotonic() - began_s
            result.alarms, result.n_alarms = run.alarms, run.n_alarms
            result.n_others, result.n_scored, result.longest_gap_s = run.n_others, run.n_scored, run.longest_gap_s
            result.n_tracker_failures = run.tracking.n_failures
            result.missed = missed(result)
            done(result, minute + 1)
    finally:
        faulthandler.cancel_dump_traceback_later()
        run.close()
    return result


def _calm(clips: list[SimulatedClip], seed: int, rate_hz: float) -> list[Usual]:
    """Each clip without faults, a few times."""
    rig = room_rig()
    run = LiveSoak(rig, clips, SoakPlan(clips, rig.names, rate_hz, START_S, seed, ()), rate_hz, seed, _CONFIG)
    for minute in range(_CALM_ROUNDS * len(clips)):
        run.run_minute(minute)
    run.close()
    return run.usual_of_clips()


def _minute(cpu_s: float) -> Minute:
    return Minute(resident_memory_mb(), threading.active_count(), len(os.listdir("/proc/self/fd")), cpu_s)


def growth(result: LiveSoakResult) -> float:
    """Median resident memory of the last tenth over that of the second; NaN: too short."""
    tenths = np.array_split(np.array([minute.memory_mb for minute in result.minutes]), 10)
    return float(np.median(tenths[-1]) / np.median(tenths[1])) if len(result.minutes) >= 10 else np.nan


def missed(result: LiveSoakResult) -> list[str]:
    """The criteria that do not hold."""
    reasons = []
    if growth(result) > _MOST_GROWTH:
        reasons.append(f"memory grew to {growth(result):.3f} of what it was")
    if result.longest_gap_s > _PUBLISHED_EVERY_S:
        reasons.append(f"nothing was published for {result.longest_gap_s:.2f} s")
    if result.n_alarms:
        reasons.append(f"cameras without a fault were not ok in {result.n_alarms} frames: {result.alarms[0]}")
    n_injected = sum(outcome.kind == "tracker" for outcome in result.outcomes)
    if result.n_tracker_failures != n_injected:
        reasons.append(f"the tracker failed {result.n_tracker_failures} times, {n_injected} of them as a fault")
    for outcome in result.outcomes:
        name = f"{outcome.kind} at {outcome.begin_s:.1f} s"
        if outcome.noticed_s is None or outcome.noticed_s > _MOST_NOTICED_S:
            when = "never" if outcome.noticed_s is None else f"after {outcome.noticed_s:.2f} s"
            reasons.append(f"{name}: noticed {when}")
        if outcome.rejoined_s is None:
            reasons.append(f"{name}: not over")
    for kind in KINDS:
        after = together([outcome.after for outcome in result.outcomes if outcome.kind == kind])
        if after.error_mm > _AS_GOOD * after.usual_mm or after.n_missing > 0.01 * max(after.n, 1):
            reasons.append(f"{kind}: afterwards {_ratio(after)} of the error without it, {after.n_missing} missing")
    return reasons


def together(comparisons: list[Comparison]) -> Comparison:
    """Their sum."""
    total = Comparison()
    for each in comparisons:
        for name, value in vars(each).items():
            setattr(total, name, getattr(total, name) + value)
    return total


def table(result: LiveSoakResult) -> str:
    """One row for each kind of fault, in Markdown."""
    heads = (
        "fault",
        "times",
        "noticed, longest",
        "over, longest",
        "error during",
        "SD during",
        "error after",
        "people missed",
    )
    rows = [heads, ["---"] * len(heads)]
    for kind in KINDS:
        own = [outcome for outcome in result.outcomes if outcome.kind == kind]
        if not own:
            continue
        during, after = together([each.during for each in own]), together([each.after for each in own])
        longest = (_longest([each.noticed_s for each in own]), _longest([each.rejoined_s for each in own]))
        sigma = f"{during.sigma_mm / during.usual_sigma_mm:.2f}" if during.n else ""
        n_missing = f"{during.n_missing} + {after.n_missing} of {during.n + after.n}"
        rows.append([kind, str(len(own)), *longest, _ratio(during), sigma, _ratio(after), n_missing])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def summary(result: LiveSoakResult) -> str:
    """The rest of the figures."""
    memory_mb = [minute.memory_mb for minute in result.minutes]
    last = result.minutes[-1]
    return (
        f"{len(result.minutes) / 60:.1f} h simulated in {result.real_s / 3600:.2f} h; "
        f"memory {memory_mb[0]:.0f} to {memory_mb[-1]:.0f} MB, last tenth over second {growth(result):.4f}; "
        f"{last.n_threads} threads, {last.n_files} files; longest time between frames {result.longest_gap_s:.2f} s; "
        f"error without faults {result.calm_error_mm:.1f} mm; {result.n_others} people of {result.n_scored} not there"
    )


def _longest(times_s: list[float | None]) -> str:
    known = [time_s for time_s in times_s if time_s is not None]
    return f"{max(known):.2f} s" if len(known) == len(times_s) else f"never ({len(times_s) - len(known)})"


def _ratio(comparison: Comparison) -> str:
    return f"{comparison.error_mm / comparison.usual_mm:.3f}" if comparison.n else ""


def _write(result: LiveSoakResult, path: Path) -> None:
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(asdict(result), indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def main(hours: float = 24.0, seed: int = 1, rate_hz: float = 8.0, output: Path = Path("out/live_soak.json")) -> int:
    """Run the soak and print its table.

    Args:
        hours: simulated.
        seed: of people and faults.
        rate_hz: of the cameras.
        output: file of the results.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    logging.getLogger("fgpose.live").setLevel(logging.CRITICAL)
    columns = (
        TextColumn("simulated minutes"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=round(60 * hours))

        def done(result: LiveSoakResult, n_minutes: int) -> None:
            progress.update(task, completed=n_minutes)
            if n_minutes % 60 == 0:
                _write(result, output)

        result = soak(hours, seed, rate_hz, done)
    _write(result, output)
    print(table(result), summary(result), sep="\n\n")
    for reason in result.missed:
        print(f"missed: {reason}")
    return int(bool(result.missed))


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
