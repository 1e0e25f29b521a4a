"""Processor time of the live system by its stages: what the processes say of themselves, each second.

Whatever Python starts with ``environment`` writes, each second and when it ends, what its threads have taken, and
functions that are stages of their own within a thread.
"""

from __future__ import annotations

import atexit
import json
import os
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import timed_calls
from timed_calls import timed

_INTERVAL_S = 1.0
_CALLS: defaultdict[str, float] = defaultdict(float)
# Of what each process does, by what it was started for.
_ROLES = {"camera_server": "cameras", "diagnosis_process": "diagnosis", "estimator_process": "estimators"}
_READING, _LOOKING = "camera ", "fgpose detector "
STAGES = (
    "receiving: network, RTSP",
    "decoding",
    "times and faults of the images",
    "to RGB",
    "network",
    "rest of the cameras' processes",
    "tracker",
    "outputs",
    "rest of the main process",
    "diagnosis",
    "estimators",
)


def environment(folder: Path) -> dict[str, str]:
    """For a process; it and those that it starts write into the folder."""
    return timed_calls.environment("timed_stages", folder)


def taken_s(folder: Path, from_s: float, to_s: float) -> dict[str, float]:
    """Processor time of each stage between two Unix times."""
    total = dict.fromkeys(STAGES, 0.0)
    for path in folder.glob("times_*.jsonl"):
        lines = [json.loads(line) for line in path.read_text().splitlines() if line.endswith("}")]
        before, until = (_of_stages(_last_until(lines, at_s)) for at_s in (from_s, to_s))
        for stage, seconds in until.items():
            total[stage] += seconds - before.get(stage, 0.0)
    return total


def _last_until(lines: list[dict[str, Any]], at_s: float) -> dict[str, Any] | None:
    return next((line for line in reversed(lines) if line["at_s"] <= at_s), None)


def _of_stages(line: dict[str, Any] | None) -> dict[str, float]:
    if line is None:
        return {}
    role, threads, calls = line["role"], line["threads"], defaultdict(float, line["calls"])
    if role not in ("cameras", "main"):
        return {role: line["all_s"]}
    if role == "main":
        tracker_s = threads.get("MainThread", 0.0) - calls["outputs"]
        outputs_s = calls["outputs"] + _sum(seconds for name, seconds in threads.items() if "recorder" in name)
        return {
            "tracker": tracker_s,
            "outputs": outputs_s,
            "rest of the main process": line["all_s"] - tracker_s - outputs_s,
        }
    reading_s, looking_s = (
        _sum(seconds for name, seconds in threads.items() if name.startswith(beginning))
        for beginning in (_READING, _LOOKING)
    )
    return {
        "receiving: network, RTSP": reading_s - calls["decoding"] - calls["times and faults of the images"],
        "decoding": calls["decoding"],
        "times and faults of the images": calls["times and faults of the images"],
        "to RGB": calls["to RGB"],
        "network": looking_s - calls["to RGB"],
        "rest of the cameras' processes": line["all_s"] - reading_s - looking_s,
    }


def _sum(seconds: Iterable[float]) -> float:
    return sum(seconds, 0.0)


def install() -> None:
    """In a process: from now on write what was taken so far."""
    from fgpose.live.cameras.camera import LiveCamera
    from fgpose.live.sources.decoded import DecodedPicture
    from fgpose.live.sources.packets import PacketDecoder
    from fgpose.live.system import LiveSystem

    PacketDecoder.decode = timed(PacketDecoder.decode, "decoding", _CALLS)
    LiveCamera.receive = timed(LiveCamera.receive, "times and faults of the images", _CALLS)
    DecodedPicture.rgb = timed(DecodedPicture.rgb, "to RGB", _CALLS)
    LiveSystem._give_frame = timed(LiveSystem._give_frame, "outputs", _CALLS)
    started_as = " ".join(sys.orig_argv)
    role = next((role for module, role in _ROLES.items() if module in started_as), "main")
    path, ended = timed_calls.folder_of_times() / f"times_{os.getpid()}.jsonl", threading.Event()

    def say() -> None:
        line = {
            "at_s": time.time(),
            "role": role,
            "all_s": time.process_time(),
            "threads": _of_threads(),
            "calls": dict(_CALLS),
        }
        with path.open("a") as file:
            file.write(json.dumps(line) + "\n")

    def go_on() -> None:
        while not ended.wait(_INTERVAL_S):
            say()

    atexit.register(say)
    threading.Thread(target=go_on, name="timed stages", daemon=True).start()


def _of_threads() -> dict[str, float]:
    """Processor time of the threads of Python, by their names."""
    taken: defaultdict[str, float] = defaultdict(float)
    for thread in threading.enumerate():
        try:
            spent_ns = Path(f"/proc/self/task/{thread.native_id}/schedstat").read_text().split()[0]
        except OSError:  # it has ended
            continue
        taken[thread.name] += 1e-9 * int(spent_ns)
    return dict(taken)
