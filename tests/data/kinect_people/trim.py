"""Makes recordings of this folder from those of KinectMultiTrack: python trim.py Study_20.csv ..."""

from __future__ import annotations

import csv
import gzip
import re
import sys
from itertools import groupby
from pathlib import Path

SCENARIO = "4"
LEFT_OUT = ("HandTip", "Thumb")  # hardly more than noise


def called(joint: str) -> str:
    """ElbowLeft as left_elbow."""
    *parts, last = (part.lower() for part in re.findall("[A-Z][a-z]+", joint))
    return "_".join([last, *parts] if last in ("left", "right") else [*parts, last])


def of_image(row: dict[str, str]) -> tuple[str, str]:
    return row["Tracker_Time"], row["Kinect_Id"]


def trim(path: Path) -> None:
    """One scenario, without images that were repeated, in whole millimetres."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file, skipinitialspace=True) if row["Scenario_Id"] == SCENARIO]
    axes = [name for name in rows[0] if name and name[-2:] in ("_X", "_Y", "_Z") and not name.startswith(LEFT_OUT)]
    kinects, begin_ms = sorted({row["Kinect_Id"] for row in rows}), int(rows[0]["Tracker_Time"])
    last: dict[str, list[list[str]]] = {}
    lines = [["time_ms", "kinect", "person_id", *(f"{called(name[:-2])}_{name[-1].lower()}_mm" for name in axes)]]
    rows.sort(key=of_image)
    for (time, kinect), image in groupby(rows, key=of_image):
        people = [[row["Person_Id"], *(f"{1000 * float(row[name]):.0f}" for name in axes)] for row in image]
        if people != last.get(kinect):
            lines += [[str(int(time) - begin_ms), str(kinects.index(kinect)), *person] for person in people]
        last[kinect] = people
    text = "\n".join(",".join(line) for line in lines) + "\n"
    name = path.stem.lower().replace("study", "recording") + ".csv.gz"
    Path(__file__).with_name(name).write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    for name in sys.argv[1:]:
        trim(Path(name))
