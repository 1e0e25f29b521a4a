"""Hands and faces: errors against the truth by part, and the time that they take beside a body of 17 joints.

``python whole_bodies.py [--frames 150] [--clips cmu_02_05 ...] [--online]`` prints Markdown tables. Ratios of
processor time are of runs in turn. Bodies move as in motion capture; hands and faces are made
(fgpose_benchmarks.synthetic.whole_body).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator

import numpy as np

import fgpose
from fgpose.estimation.evidence.gather import gather
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    embedded_motion,
    ring_rig,
    simulate,
)
from fgpose_benchmarks.synthetic.whole_body import simulate_whole_body, whole_body_of

_OCCLUSIONS = {"clean": NO_OCCLUSION, "three of four views occluded": Occlusion()}
_WARM_UP_FRAMES = 50
_RUNS = 3


def _scene(clip: str, n_frames: int, skeleton: str, occlusion: Occlusion) -> Scene:
    motion_m, fps = embedded_motion(clip)
    of = fgpose.load_skeleton(skeleton)
    truth_m = whole_body_of(motion_m[:n_frames], fps, of)
    return simulate_whole_body(truth_m, of, ring_rig(), fps, DetectionNoise(), occlusion)


def _body(clip: str, n_frames: int, occlusion: Occlusion) -> Scene:
    motion_m, fps = embedded_motion(clip)
    return simulate(
        motion_m[:n_frames], fgpose.load_skeleton("h36m_17"), ring_rig(), fps, DetectionNoise(), occlusion, 0
    )


def _errors(clips: list[str], n_frames: int) -> Iterator[str]:
    """Rows of mean errors in mm, and of the share of them within the 90 % ellipsoids."""
    yield "| | cameras | body | left hand | right hand | face |"
    yield "|---|---:|---:|---:|---:|---:|"
    for name, occlusion in _OCCLUSIONS.items():
        scenes = [_scene(clip, n_frames, "coco_wholebody_133", occlusion) for clip in clips]
        for n_cameras in (4, 3, 2):
            cells = []
            for joints in _joints_of_parts(scenes[0].observations.skeleton):
                cells.append([_cell(scene, n_cameras, joints) for scene in scenes])
            shown = " | ".join(
                f"{alone:.1f} → {smoothed:.1f} ({within:.0f} %)"
                for alone, smoothed, within in (np.mean(of_part, axis=0) for of_part in cells)
            )
            yield f"| {name} | {n_cameras} | {shown} |"


_found: dict[tuple[int, int], tuple[fgpose.Trajectory, np.ndarray]] = {}


def _cell(scene: Scene, n_cameras: int, joints: list[int]) -> tuple[float, float, float]:
    """Mean error triangulated and smoothed, mm, and percent within the 90 % ellipsoid."""
    names, key = scene.rig.names[:n_cameras], (id(scene), n_cameras)
    if key not in _found:
        observations, rig = scene.observations.subset(names), scene.rig.subset(names)
        _found[key] = fgpose.smooth(observations, rig), gather(observations, rig, fgpose.Config()).guess_m
    smoothed, triangulated_m = _found[key]
    assert smoothed.covariance_m2 is not None
    away_m = (smoothed.positions_m - scene.truth_m)[:, joints]
    alone_m = np.linalg.norm((triangulated_m - scene.truth_m)[:, joints], axis=-1)
    whitened = np.linalg.solve(smoothed.covariance_m2[:, joints], away_m[..., None])[..., 0]
    within = np.sum(away_m * whitened, axis=-1) < 6.25  # chi-squared of three degrees of freedom
    return (
        1e3 * float(np.nanmean(alone_m)),
        1e3 * float(np.nanmean(np.linalg.norm(away_m, axis=-1))),
        100 * within.mean(),
    )


def _joints_of_parts(skeleton: fgpose.Skeleton) -> list[list[int]]:
    return [list(skeleton.body), *(list(part.joints) for part in skeleton.parts)]


def _cpu_s(work: Callable[[], object]) -> float:
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


def _batch_ratio(clip: str, n_frames: int, occlusion: Occlusion) -> float:
    """Processor time of 133 joints over that of 17; the median of runs in turn."""
    whole, body = _scene(clip, n_frames, "coco_wholebody_133", occlusion), _body(clip, n_frames, occlusion)
    ratios = [
        _cpu_s(lambda: fgpose.smooth(whole.observations, whole.rig))
        / _cpu_s(lambda: fgpose.smooth(body.observations, body.rig))
        for _ in range(_RUNS)
    ]
    return float(np.median(ratios))


def _online_ms(scene: Scene) -> np.ndarray:
    """Median and 99 % of the processor time of an update by the window solver, tidied between images as by
    `fgpose live`."""
    estimator = fgpose.Estimator(scene.rig, scene.observations.skeleton, fgpose.Config(online={"solver": "window"}))
    times_s = []
    for frame in range(scene.observations.n_frames):
        image = scene.observations.frames(slice(frame, frame + 1))
        times_s.append(_cpu_s(lambda image=image: estimator.update(image)))
        estimator.tidy()
    return 1e3 * np.percentile(times_s[_WARM_UP_FRAMES:], (50, 99))


def _main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--frames", type=int, default=150)
    arguments.add_argument("--clips", nargs="+", default=["cmu_02_05"])
    arguments.add_argument("--online", action="store_true", help="only the time of an update")
    given = arguments.parse_args()
    for row in () if given.online else _errors(given.clips, given.frames):
        print(row, flush=True)
    for name, occlusion in _OCCLUSIONS.items():
        clip = given.clips[0]
        if not given.online:
            print(f"batch, 133 joints over 17, {name}: {_batch_ratio(clip, given.frames, occlusion):.1f}", flush=True)
        hands = _online_ms(_scene(clip, given.frames, "holistic_75", occlusion))
        body = _online_ms(_body(clip, given.frames, occlusion))
        print(
            f"online, 75 joints, {name}: {hands.round(1)} ms (median, 99 %), {(hands / body).round(1)} times 17 joints"
        )


if __name__ == "__main__":
    _main()
