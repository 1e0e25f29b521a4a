"""Several people frame by frame, as a live system would, and in the viewer while it happens.

What one learns: the loop around fgpose.Tracker, whose every update returns the people who are there now, and how each
update is shown. With --live, connect with the printed command while it runs; the .rrd file has the same.

    python examples/11_several_people_live.py --live
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import tyro

import fgpose
from fgpose.viewer import open_people_recording
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)


def film(n_people: int, n_cameras: int, duration_s: float) -> CrowdScene:
    """People who walk and work in one room, at 30 Hz."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a"), embedded_motion("cmu_02_10")]
    motion = crowd_motion(n_people, int(30 * duration_s), 30.0, walks, works, seed=1)
    rig = ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), seed=1)


def live_images(scene: CrowdScene) -> Iterator[list[fgpose.people.Detections]]:
    """In a live system: whatever the cameras saw since the last time."""
    for _, images in groupby(scene.observations.images, key=lambda image: image.time_s):
        yield list(images)


def main(
    people: int = 3,
    cameras: int = 4,
    duration_s: float = 8.0,
    live: bool = False,
    output: Path = Path("out/people_live.rrd"),
) -> None:
    """Follow people as the cameras' images come.

    Args:
        people: in the room.
        cameras: around it.
        duration_s: how long.
        live: let viewers connect meanwhile.
        output: the .rrd file.
    """
    scene = film(people, cameras, duration_s)
    skeleton = scene.observations.skeleton
    recording = open_people_recording(output, scene.rig, skeleton, live=live, port=0)
    with recording, fgpose.Tracker(scene.rig, skeleton) as tracker:
        if live:
            print(f"rerun {recording.viewer_url}")
        for frame, images in enumerate(live_images(scene)):
            here = tracker.update(images)
            events = tracker.events()
            recording.log_tracked(frame, images, here, events)
            for event in events:
                print(f"{event.time_s:5.2f} s  person {event.person} {event.what}: {event.reason}")
            if frame % 30 == 0:
                hips = [f"{tracked.person} at {tracked.estimate['pelvis'].round(2)} m" for tracked in here]
                print(f"{images[0].time_s:5.2f} s  here: {', '.join(hips) or 'nobody yet'}")
    print(f"wrote {output}")


if __name__ == "__main__":
    tyro.cli(main)
