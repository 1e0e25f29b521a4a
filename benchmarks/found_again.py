"""How long a tracker that begins takes until it has found everybody who is there: the wait of fgpose.robot.assurance.

One or two simulated people walk and work before rings of three to five cameras. A tracker begins at many moments; the
time from its first image until it follows everybody whom two cameras have in their images is measured, to one image.

    python benchmarks/found_again.py
"""

from __future__ import annotations

import argparse
import itertools
import logging
from collections.abc import Iterator, Sequence

import numpy as np

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections
from fgpose_benchmarks.synthetic import (
    SimulatedClocks,
    SimulatedNetwork,
    WalkScene,
    film,
    positions_at,
    ring_rig,
    walkers,
)

_STARTS, _LONGEST_S, _NEAR_M = 12, 3.0, 0.3
_ROOM_M = (5.0, 5.0)


def scene(n_cameras: int, n_people: int, rate_hz: float, seed: int) -> WalkScene:
    """People before cameras that take images at one rate, each at its own time."""
    rig = ring_rig(n_cameras, 4.5, 2.5, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    motion = walkers(_ROOM_M, 2.0 * _STARTS + _LONGEST_S, seed, "walks", n_people)
    return film(motion, rig, seed, SimulatedNetwork(in_3d=False), SimulatedClocks(fps=(rate_hz,), max_start_s=0.0))


def moments(walk: WalkScene, from_s: float, rate_hz: float) -> Iterator[list[Detections]]:
    """Images that come together."""
    later = [image for image in walk.observations.images if from_s <= image.time_s < from_s + _LONGEST_S]
    later.sort(key=lambda image: image.time_s)
    for _, images in itertools.groupby(later, key=lambda image: round(image.time_s * rate_hz)):
        yield list(images)


def found_after_s(walk: WalkScene, from_s: float, rate_hz: float) -> float:
    """inf: somebody was not found in the longest time that is looked at."""
    config = fgpose.Config(tracking={"max_processes": 1})
    with fgpose.Tracker(walk.rig, walk.motion.skeleton, config) as tracker:
        begin_s = np.nan
        for images in moments(walk, from_s, rate_hz):
            people = tracker.update(images)
            now_s = images[-1].time_s
            begin_s = images[0].time_s if np.isnan(begin_s) else begin_s
            found_m = [np.nanmedian(each.estimate.positions_m, axis=0) for each in people]
            there = [np.median(m, axis=0) for m in _seen_m(walk, walk.rig, now_s)]
            if all(any(np.linalg.norm(m - each) < _NEAR_M for each in found_m) for m in there):
                return float(now_s - begin_s)
    return np.inf


def _seen_m(walk: WalkScene, rig: CameraRig, now_s: float) -> list[np.ndarray]:
    """Joints of everybody whom two cameras have in their images."""
    true_m = positions_at(walk.motion, walk.true_s(0, np.array([now_s])))[:, 0]
    people = [each_m for each_m in true_m if np.isfinite(each_m).all()]
    return [m for m in people if sum(_is_in_view(camera, m) for camera in rig.cameras) >= 2]


def _is_in_view(camera: fgpose.Camera, joints_m: np.ndarray) -> bool:
    px = camera.project(joints_m)
    return bool(np.mean(np.all((px >= 0) & (px < camera.size_px), axis=-1)) > 0.5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="scenes of each kind (default: 4)")
    seeds = parser.parse_args().seeds
    logging.disable(logging.WARNING)
    print("| cameras | people | images a second | starts | median [s] | 99 % [s] | longest [s] |")
    print("|---:|---:|---:|---:|---:|---:|---:|")
    every: list[float] = []
    for n_cameras, n_people, rate_hz in itertools.product((3, 4, 5), (1, 2), (8.0, 15.0, 30.0)):
        waits_s = []
        for seed in range(seeds):
            walk = scene(n_cameras, n_people, rate_hz, seed)
            waits_s += [found_after_s(walk, 2.0 * start + 0.1 * seed, rate_hz) for start in range(_STARTS)]
        every += waits_s
        print(f"| {n_cameras} | {n_people} | {rate_hz:g} | {_in_words(waits_s)}", flush=True)
    print(f"| all | | | {_in_words(every)}")


def _in_words(waits_s: Sequence[float]) -> str:
    median_s, late_s = np.quantile(waits_s, (0.5, 0.99), method="higher")
    return f"{len(waits_s)} | {median_s:.2f} | {late_s:.2f} | {max(waits_s):.2f} |"


if __name__ == "__main__":
    main()
