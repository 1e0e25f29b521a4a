"""Time and memory of several people: live, in batch, and with people who come and go for long."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

import fgpose
from fgpose.association.follow import Sighting
from fgpose.association.recording import associate
from fgpose.estimation.evidence.gather import gather
from fgpose.people_observations import Detections
from fgpose_benchmarks.people.recording import PeopleRecording
from fgpose_benchmarks.people.variants import PeopleVariant, record
from metric import Metric
from timing import resident_memory_mb, timed

_WARM_UP = 60
"""Frames: by then everybody is confirmed and the processes run."""
_ROOM_S = 20.0  # after so long the room is empty for a moment, and everybody comes in anew


@cache
def _recording(n_people: int, n_cameras: int, duration_s: float) -> PeopleRecording:
    return record(PeopleVariant(f"{n_people}_{n_cameras}", "high cameras", n_people, n_cameras), "tuning_1", duration_s)


def live(duration_s: float) -> list[Metric]:
    """Latency of an update with the images of five cameras that show four people, with covariances; what of it is the
    association; and how it grows with the people, in one process."""
    metrics = []
    for n_processes, limits in ((2, (20.0, 40.0)), (1, (12.0, 22.0))):
        update_ms, associate_ms, people = _updates(_recording(4, 5, duration_s), n_processes)
        four = update_ms[people == 4]
        name = f"Tracker, 4 people, 5 cameras, {n_processes} processes"
        for what, percent, limit in zip(("median update", "99th percentile"), (50, 99), limits, strict=True):
            metrics.append(Metric(f"{name}: {what}", float(np.percentile(four, percent)), "ms", limit=limit))
    of_four = float(np.median(associate_ms[people == 4]))
    metrics.append(Metric("Tracker, 4 people, 5 cameras: median association", of_four, "ms", limit=3.0))
    per_person = {n: _per_person_ms(_recording(n, 5, duration_s)) for n in (2, 8)}
    metrics.append(Metric("Tracker: time per person, 8 people over 2", per_person[8] / per_person[2], "x", limit=1.3))
    return metrics


def _updates(recording: PeopleRecording, n_processes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each update after the first seconds: its time, that of the association in it, and the number of people."""
    config = fgpose.Config(tracking={"max_processes": n_processes})
    rows = []
    with fgpose.Tracker(recording.rig, recording.observations.skeleton, config) as tracker:
        see, associated_s = tracker._follower.see, 0.0

        def timed_see(images: Sequence[Detections]) -> list[Sighting]:
            nonlocal associated_s
            begin_s = time.perf_counter()
            sightings = see(images)
            associated_s = time.perf_counter() - begin_s
            return sightings

        tracker._follower.see = timed_see
        for _, images in recording.images():
            begin_s = time.perf_counter()
            people = tracker.update(images)
            rows.append((1e3 * (time.perf_counter() - begin_s), 1e3 * associated_s, len(people)))
    update_ms, associate_ms, n_people = np.array(rows[_WARM_UP:]).T
    return update_ms, associate_ms, n_people


def _per_person_ms(recording: PeopleRecording) -> float:
    update_ms, _, people = _updates(recording, 1)
    return float(np.median(update_ms[people > 0] / people[people > 0]))


def live_long(n_frames: int) -> list[Metric]:
    """Whether memory and time stay flat while people come and go: the last quarter against the second."""
    recording = _recording(3, 3, _ROOM_S)
    config = fgpose.Config(online={"lag_s": 0.2, "covariance": False}, tracking={"max_processes": 1})
    tracker = fgpose.Tracker(recording.rig, recording.observations.skeleton, config)
    rows, confirmed = [], 0
    for images in _again_and_again(recording, n_frames):
        timing, people = timed(lambda images=images: tracker.update(images), collect=False)
        confirmed += sum(event.what == "confirmed" for event in tracker.events())
        rows.append((resident_memory_mb(), 1e3 * timing.cpu_s / max(len(people), 1)))
    memory_mb, cpu_ms = (np.array_split(column, 4) for column in np.array(rows).T)
    name = f"Tracker, {n_frames} frames, {confirmed} times somebody comes, last quarter over second"
    return [
        Metric(f"{name}: resident memory", float(memory_mb[3].mean() / memory_mb[1].mean()), "x", limit=1.02),
        Metric(f"{name}: CPU per person", float(np.median(cpu_ms[3]) / np.median(cpu_ms[1])), "x", limit=1.1),
    ]


def _again_and_again(recording: PeopleRecording, n_frames: int) -> Iterator[list[Detections]]:
    """The same people enter an empty room again and again, three seconds after all are gone."""
    frames = [images for _, images in recording.images()]
    for frame in range(n_frames):
        round_number, at = divmod(frame, len(frames))
        later_s = round_number * (_ROOM_S + 3.0)
        yield [replace(image, time_s=image.time_s + later_s) for image in frames[at]]


def batch(duration_s: float, runs: int) -> list[Metric]:
    """smooth_people over the sum of smooth of each person alone, in turn."""
    recording = _recording(4, 5, duration_s)
    people, rig = recording.observations, recording.rig
    config = fgpose.Config(solver={"covariance": False})
    association, ratios = associate(people, rig), []
    alone = [association.of(person) for person in association.people]
    alone = [own.frames(gather(own, rig, config).present(config.tracking.coast_s)) for own in alone]
    for _ in range(runs):
        together, _ = timed(lambda: fgpose.smooth_people(people, rig, config))
        apart, _ = timed(lambda: [fgpose.smooth(own, rig, config) for own in alone])
        ratios.append((together.wall_s / apart.wall_s, together.cpu_s / apart.cpu_s))
    wall, cpu = np.median(ratios, axis=0)
    name = "smooth_people, 4 people, 5 cameras, over smooth of each alone"
    return [Metric(name, float(wall), "x", limit=1.3, cpu=float(cpu))]
