"""The live system without any camera: simulated people in simulated cameras, and a consumer of its frames.

What one learns: what a live system is made of. A feed gives detections as they come and says how the cameras are;
LiveTracking follows people; LiveSystem publishes frames at a steady rate, whatever happens to a camera, here to the
last one, which fails. To use it, replace the feed by the CameraFeed of
fgpose.live.processes.camera_feed, and the consumer by yours.

    python examples/12_live_without_cameras.py --rrd out/live.rrd
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Collection
from pathlib import Path

import numpy as np
import tyro

import fgpose
from fgpose.io.live.recordings import RecordedImage
from fgpose.live.clock import Clock
from fgpose.live.frame import CameraState, CameraStatus, LiveFrame
from fgpose.live.outputs import ViewerOutput
from fgpose.live.processes.pending_detections import PendingDetections
from fgpose.live.system import LiveSystem
from fgpose.live.tracking.live_tracking import LiveTracking
from fgpose.live.tracking.observed import volume_points_m
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    CrowdPlan,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

RATE_HZ = 30.0
NETWORK_S = 0.02
"""From taking an image to having its detections."""
NOTICED_S = 0.5
"""After which a camera without images is lost."""


class Consumer:
    """What is done with the frames: here, to say once a second who is where. It neither waits nor raises."""

    said_s = 0.0

    def publish(self, frame: LiveFrame) -> None:
        if frame.published_s < self.said_s + 1.0:
            return
        self.said_s = frame.published_s
        people = [f"{each.person} {each.state.value} at {each.positions_m[0].round(2)} m" for each in frame.people]
        lost = [f"{camera.name} {camera.state.value}" for camera in frame.cameras if camera.state is not CameraState.OK]
        print(f"{1e3 * frame.age_s:.0f} ms old, {frame.observed_share:.0%} observed:", *people, *lost, sep="  ")


class SimulatedCameras:
    """A feed: the detections of a scene, each when it is due.

    Args:
        scene: what the cameras see.
        clock: of the live system. The scene begins now.
        fails_s: after which the last camera gives no image any more.
    """

    def __init__(self, scene: CrowdScene, clock: Clock, fails_s: float) -> None:
        self._names, self._clock, self.begin_s = scene.rig.names, clock, clock.now_s()
        images = [
            image for image in scene.observations.images if image.camera != self._names[-1] or image.time_s < fails_s
        ]
        self._waiting = deque(dataclasses.replace(image, time_s=self.begin_s + image.time_s) for image in images)
        self._image_s: dict[str, float] = {}
        self._arrivals = PendingDetections(self._names)
        """Where the tracker finds the newest: a computer that is too slow leaves images out."""

    def take(self, timeout_s: float) -> list[RecordedImage]:
        """The detections that are there, or wait for the next."""
        due_s = self._waiting[0].time_s + NETWORK_S if self._waiting else float("inf")
        self._clock.sleep(min(due_s - self._clock.now_s(), timeout_s))
        now_s = self._clock.now_s()
        while self._waiting and self._waiting[0].time_s + NETWORK_S <= now_s:
            image = self._waiting.popleft()
            self._image_s[image.camera] = image.time_s
            self._arrivals.put(RecordedImage(image, now_s))
        return self._arrivals.take(0.0)

    def statuses(self) -> tuple[CameraStatus, ...]:
        return tuple(map(self._status, self._names))

    def go_on(self, camera_names: Collection[str]) -> None:
        """Networks that look at images might look at the next ones now."""

    def _status(self, name: str) -> CameraStatus:
        image_s = self._image_s.get(name, self.begin_s)
        is_lost = self._clock.now_s() - image_s > NOTICED_S
        reason = f"no image for {NOTICED_S} s" if is_lost else ""
        state = CameraState.LOST if is_lost else CameraState.OK
        return CameraStatus(name, state, reason, image_s, n_lost=self._arrivals.n_left_out(name))


class Truth:
    """Another consumer: how far the people are from where they are."""

    def __init__(self, scene: CrowdScene, begin_s: float) -> None:
        self._scene, self._begin_s, self.errors_m = scene, begin_s, list[float]()

    def publish(self, frame: LiveFrame) -> None:
        if not frame.people:  # before the first image it has no time either
            return
        truth = self._scene.truth(np.array([frame.time_s - self._begin_s]))
        for person in frame.people:
            apart_m = [
                np.linalg.norm(person.positions_m - true.positions_m[0], axis=1).mean() for true in truth.values()
            ]
            # Beyond its end nobody is there in truth.
            self.errors_m += [min(apart_m)] if np.isfinite(apart_m).all() else []


def film(duration_s: float) -> CrowdScene:
    """Two people who walk and work in one room, in four cameras."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    plan = CrowdPlan(late_share=0.0, leaving_share=0.0, returning_share=0.0)
    motion = crowd_motion(2, int(RATE_HZ * duration_s), RATE_HZ, walks, works, 2, plan)
    rig = ring_rig(4, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), seed=2)


def main(duration_s: float = 6.0, rrd: Path | None = None) -> None:
    """Run the live system on simulated cameras.

    Args:
        duration_s: how long; the last camera fails after two thirds.
        rrd: file for the Rerun viewer.
    """
    scene, config = film(duration_s), fgpose.Config()
    skeleton = scene.observations.skeleton
    tracking = LiveTracking(scene.rig, skeleton, config, volume_points_m(scene.rig))
    viewers: list[ViewerOutput] = [] if rrd is None else [ViewerOutput(rrd, scene.rig, skeleton)]
    clock = Clock()
    feed = SimulatedCameras(scene, clock, fails_s=2 / 3 * duration_s)
    truth = Truth(scene, feed.begin_s)
    system = LiveSystem(feed, tracking, [Consumer(), truth, *viewers], [viewer.observe for viewer in viewers], clock)
    system.run(until_s=feed.begin_s + duration_s)
    for viewer in viewers:
        viewer.close()
    tracking.close()
    print(f"{system.report.n_frames} frames, {system.report.latency_ms(50.0):.0f} ms after the images (median)")
    print(f"mean error {1e3 * np.mean(truth.errors_m):.0f} mm")


if __name__ == "__main__":
    tyro.cli(main)
