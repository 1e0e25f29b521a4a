"""False alarms, detections and wrong accusations of every suspicion of a report: `python benchmarks/report_checks.py`.

    python benchmarks/report_checks.py --clips tuning --seeds 0         # three minutes of one core
    python benchmarks/report_checks.py --clips test --seeds 0 --only clean "rate × 2"
    python benchmarks/report_checks.py --seeds                          # the tables of what was measured before

Rows of the tables are suspicions, columns are kinds of recordings (planted_faults.py); a cell is the share, in per
cent, of the recordings of the kind in which the suspicion was raised. What is raised on recordings without a fault is a
false alarm; on occluded ones gaps are true, and hallucinations come from the occluders. Of a fault in one camera, the
share in which the suspicion names another camera stands behind it, in brackets: a wrong accusation. Nobody knows
whether the real recordings are without fault; they are one man before one rig, by two networks, whole and in halves:
one recording rather than six.

Limits of the checks may be chosen on the tuning clips only; of the test clips results are stated. What was measured is
kept in --out, one recording a line, and not measured again; delete the file after a change.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import fgpose
from fgpose.diagnosis.diagnose import RESULT_CHECKS
from fgpose.report import FinishedRecording
from planted_faults import FAULTLESS, FAULTY, TEST_CLIPS, TUNING_CLIPS, EstimatorInput, real_recordings

KINDS = {**FAULTLESS, **FAULTY}
Line = dict[str, str | list[str]]
"""What was raised of one recording: kind, clips, name, and the names of the suspicions that are right and wrong."""


def finished(seen: EstimatorInput) -> FinishedRecording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that a window did not converge is one of the suspicions
        trajectory = fgpose.smooth(seen.observations, seen.rig)
    return FinishedRecording("benchmark", {0: trajectory}, seen.rig, {0: seen.observations})


def raised(recording: FinishedRecording, faulty: str, words: bool) -> dict[str, list[str]]:
    """Names of the suspicions: those that may be right, and those that name another camera than that with the fault."""
    found: dict[str, list[str]] = {"right": [], "wrong": []}
    for check in RESULT_CHECKS:
        for suspicion in check(recording):
            accused = suspicion.subject if suspicion.subject in recording.camera_names else faulty
            kind = "wrong" if accused != faulty and faulty else "right"
            if check.__name__ not in found[kind]:
                found[kind].append(check.__name__)
            if words:
                sys.stdout.write(f"  {kind} {check.__name__}: {suspicion.reason}\n")
    return found


def wanted(options: argparse.Namespace) -> Iterable[tuple[str, str, str, Callable[[], EstimatorInput]]]:
    """Kind, clips, name and maker of the recordings that are asked for."""
    for clips, names in (("tuning", TUNING_CLIPS), ("test", TEST_CLIPS)):
        for kind in options.only if clips in options.clips else ():
            for seed in options.seeds:
                for clip in names:
                    yield kind, clips, f"{clip} {seed}", lambda k=kind, c=clip, s=seed: KINDS[k](c, s)
    if options.real:
        for number, seen in enumerate(real_recordings()):
            yield "real", "real", str(number), lambda each=seen: each


def table(lines: list[Line], kinds: list[str]) -> str:
    """One line per suspicion that was raised at all, one column per kind of recording; a dash is never."""
    of_kind = {kind: [line for line in lines if line["kind"] == kind] for kind in kinds}
    of_kind = {kind: own for kind, own in of_kind.items() if own}
    heads = [f"{kind} ({len(own)})" for kind, own in of_kind.items()]
    rows = [f"| suspicion (recordings) | {' | '.join(heads)} |", "|---|" + "---:|" * len(heads)]
    for check in RESULT_CHECKS:
        cells = [_cell(own, check.__name__) for own in of_kind.values()]
        if any(cell != "–" for cell in cells):
            rows.append(f"| {check.__name__} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _cell(lines: list[Line], check: str) -> str:
    right, wrong = (100 * sum(check in line[kind] for line in lines) / len(lines) for kind in ("right", "wrong"))
    return (f"{right:.0f}" if right else "–") + (f" ({wrong:.0f})" if wrong else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[0], help="of noise and faults, of each clip")
    parser.add_argument("--clips", nargs="+", default=["tuning", "test"], choices=["tuning", "test"])
    parser.add_argument(
        "--only",
        nargs="+",
        default=list(KINDS),
        choices=list(KINDS),
        metavar="KIND",
        help="these kinds: " + "; ".join(KINDS),
    )
    parser.add_argument("--real", action="store_true", help="the real recordings that come with fgpose too")
    parser.add_argument("--words", action="store_true", help="print every suspicion in its words")
    parser.add_argument("--out", type=Path, default=Path("out/report_checks.jsonl"), help="what was measured")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines: list[Line] = (
        [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    )
    known = {(line["kind"], line["name"]) for line in lines}
    with options.out.open("a") as file:
        for kind, clips, name, make in wanted(options):
            if (kind, name) in known:
                continue
            if options.words:
                sys.stdout.write(f"{kind}, {name}\n")
            seen = make()
            found = raised(finished(seen), seen.camera, options.words)
            lines.append({"kind": kind, "clips": clips, "name": name} | found)
            file.write(json.dumps(lines[-1]) + "\n")
            file.flush()
    for clips in ("tuning", "test", "real"):
        own = [line for line in lines if line["clips"] == clips]
        for kinds in ([*FAULTLESS, "real"], list(FAULTY)):
            if any(line["kind"] in kinds for line in own):
                sys.stdout.write(f"\nPer cent of the recordings, {clips} clips\n\n{table(own, kinds)}\n")


if __name__ == "__main__":
    main()
