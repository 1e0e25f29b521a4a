"""What a return costs online: identity switches per person who comes back, on the clips of the people benchmark.

``python benchmarks/returns.py`` follows people as ``Tracker`` does, without the estimators: who is who does not depend
on them. It does so as it is; without recognising anybody at birth (in the update in which they are confirmed); and
without recognising anybody. Each is counted as people are called at the time, and by the numbers that are said later.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from unittest.mock import patch

import numpy as np
from jaxtyping import Int
from rich.progress import track

from fgpose.assessment.people import evaluate_people, revised
from fgpose.association.follow import Follower
from fgpose.association.track import Track
from fgpose.config import Config
from fgpose_benchmarks.people.recording import PeopleRecording, trajectories
from fgpose_benchmarks.people.variants import TEST_CLIPS, VARIANTS, record

_MAY_BE = Track.may_be_recognised
WAYS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "as it is": nullcontext,
    "not at birth": lambda: patch.object(
        Track, "may_be_recognised", lambda own, now_s: now_s > own.confirmed_s and _MAY_BE(own, now_s)
    ),
    "nobody": lambda: patch.object(Track, "may_be_recognised", lambda own, now_s: False),
}


def counted(recording: PeopleRecording) -> Int[np.ndarray, " 5"]:
    """Switches, those by revised numbers, returns, and how many were recognised at birth, and later."""
    skeleton = recording.observations.skeleton
    follower = Follower(recording.rig, skeleton, Config().tracking)
    poses = []
    for _, images in recording.images():
        follower.see(images)
        poses.append({each.person: each.pose.positions_m[0] for each in follower.tracks if each.is_confirmed})
    time_s = recording.frames.frame_time_s
    people = trajectories(skeleton, time_s, poses)
    found, final = (
        evaluate_people(each, recording.truth, time_s=time_s) for each in (people, revised(people, follower.events))
    )
    confirmed_s = {event.person: event.time_s for event in follower.events if event.what == "confirmed"}
    recognised = [event for event in follower.events if event.what == "recognised"]
    at_birth = sum(event.time_s == confirmed_s[event.person] for event in recognised)
    return np.array([found.switches, final.switches, len(found.returns), at_birth, len(recognised) - at_birth])


def main() -> None:
    """Print a line for each way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", default=[variant.name for variant in VARIANTS])
    wanted = parser.parse_args().variants
    sums = {way: np.zeros(5, dtype=int) for way in WAYS}
    pairs = [(variant, clip) for variant in VARIANTS if variant.name in wanted for clip in TEST_CLIPS]
    for variant, clip in track(pairs, "following", transient=True):
        recording = record(variant, clip)
        for way, changed in WAYS.items():
            with changed():
                sums[way] += counted(recording)
    print("| recognised | returns | at birth | later | switches | per return | revised | per return |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for way, (switches, final, returns, at_birth, later) in sums.items():
        per = [f"{count} | {count / returns:.2f}" for count in (switches, final)]
        print(f"| {way} | {returns} | {at_birth} | {later} | {per[0]} | {per[1]} |")


if __name__ == "__main__":
    main()
