"""Simulated recordings of motion capture in which one thing is wrong, or nothing: what report_checks.py measures on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose_benchmarks.accuracy.families import find_variant
from fgpose_benchmarks.synthetic import NO_OCCLUSION, Occlusion, embedded_motion, real_errors, ring_rig, simulate

TUNING_CLIPS = ("cmu_01_04_a", "cmu_02_01_short", "cmu_02_05", "cmu_03_03_b")
"""Climbing, walking, punching, over obstacles."""
TEST_CLIPS = ("cmu_01_01_a", "cmu_02_07_a", "cmu_02_10", "cmu_03_03_a", "cmu_02_03_short")
"""Jumping, swordplay, washing, over obstacles, running: no limit of a check was chosen on them, but that of falls, as
there is no other clip with jumps."""
LEAST_S = 8.0  # lags need five blocks of a second
RING = ring_rig()


@dataclass(frozen=True)
class EstimatorInput:
    """What the estimator is given."""

    observations: Observations
    rig: CameraRig
    camera: str = ""
    """That the fault is in; empty: in none, or in all."""


def seen_clip(
    clip: str,
    seed: int,
    occlusion: Occlusion = NO_OCCLUSION,
    *,
    variant: str = "clean",
    fps: float | None = None,
    late_s: float = 0.0,
    drift: float = 0.0,
) -> EstimatorInput:
    """Four cameras on a clip.

    Args:
        clip: name of the motion.
        seed: of the noise.
        occlusion: of all views.
        variant: of the open benchmark, whose noise, or whose sources of real errors, are taken.
        fps: of all cameras; None: that of the clip.
        late_s: of the faulty camera.
        drift: how much slower than the others the faulty camera takes its images, which is not told; in the middle of
            the recording it is on time.
    """
    skeleton, kind = fgpose.load_skeleton("h36m_17"), find_variant(variant)
    clip_m, fps, motion_s = _to_and_fro(*embedded_motion(clip), fps)
    from_middle_s = motion_s - motion_s.mean()
    true_s = motion_s.mean() + from_middle_s * (1 + drift)
    rng = np.random.default_rng(seed + 1000)
    real = real_errors(rng, len(motion_s), RING.n_cameras, skeleton, fps, kind.real) if kind.real else None
    offsets_s = np.zeros(RING.n_cameras)
    offsets_s[faulty(seed)] = late_s
    scenes = [
        simulate(clip_m(seen_s), skeleton, RING, fps, kind.noise, occlusion, seed, offsets_s, real).observations
        for seen_s in ([motion_s, true_s] if drift else [motion_s])
    ]
    points_px = scenes[0].points2d_px.copy()
    points_px[:, faulty(seed)] = scenes[-1].points2d_px[:, faulty(seed)]
    camera = RING.names[faulty(seed)] if late_s or drift else ""
    return EstimatorInput(replace(scenes[0], points2d_px=points_px), RING, camera)


def faulty(seed: int) -> int:
    """The camera in which a fault is."""
    return (seed + 1) % RING.n_cameras


def _to_and_fro(
    clip_m: Float[np.ndarray, "frame joint 3"], clip_fps: float, fps: float | None
) -> tuple[
    Callable[[Float[np.ndarray, " time"]], Float[np.ndarray, "time joint 3"]], float, Float[np.ndarray, " time"]
]:
    """Joints by time, the rate, and times of frames: at least LEAST_S, and at most twice that. A short clip is played
    to and fro with a phase that is a cosine: nothing stops within a frame; in its middle it runs pi/2 times as fast as
    it was recorded, so that a jump in it would not fall as it should."""
    last_s, fps = (len(clip_m) - 1) / clip_fps, fps or clip_fps
    spline = CubicSpline(np.arange(len(clip_m)) / clip_fps, clip_m)
    times_s = np.arange(round(min(max(LEAST_S, last_s), 2 * LEAST_S) * fps)) / fps

    def motion_m(time_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, "time joint 3"]:
        if last_s >= LEAST_S:
            return np.asarray(spline(np.clip(time_s, 0, last_s)))
        return np.asarray(spline(last_s / 2 * (1 - np.cos(np.pi * time_s / last_s))))

    return motion_m, fps, times_s


def turned(seen: EstimatorInput, angle_deg: float, seed: int) -> EstimatorInput:
    """A camera turned about its centre since the calibration."""
    axis, cameras = np.random.default_rng(seed).standard_normal(3), list(seen.rig.cameras)
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    camera = cameras[faulty(seed)]
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[:3, :3] = turn @ world_T_camera[:3, :3]
    cameras[faulty(seed)] = replace(camera, world_T_camera=world_T_camera)
    return EstimatorInput(seen.observations, CameraRig(tuple(cameras)), camera.name)


def swapped(seen: EstimatorInput, seed: int, *, everywhere: bool = False) -> EstimatorInput:
    """Left and right exchanged for 2 s, in one view or in all."""
    points_px = seen.observations.points2d_px.copy()
    during = np.flatnonzero(_during(seen.observations, 2.0))
    views = range(RING.n_cameras) if everywhere else [faulty(seed)]
    for view in views:
        points_px[during, view] = points_px[during, view][:, seen.observations.skeleton.mirror]
    return _with_points(seen, points_px, "" if everywhere else RING.names[faulty(seed)])


def swapped_pair(seen: EstimatorInput, seed: int) -> EstimatorInput:
    """Left and right ankle exchanged in one view for 2 s: nothing else is turned."""
    points_px, skeleton = seen.observations.points2d_px.copy(), seen.observations.skeleton
    during, pair = _during(seen.observations, 2.0), [skeleton.index("left_ankle"), skeleton.index("right_ankle")]
    view = points_px[during, faulty(seed)]
    view[:, pair] = view[:, pair[::-1]]
    points_px[during, faulty(seed)] = view
    return _with_points(seen, points_px, RING.names[faulty(seed)])


def other_rig(seen: EstimatorInput, seed: int) -> EstimatorInput:
    """All cameras turned by 3 degrees since the calibration, each about another axis."""
    for camera in range(RING.n_cameras):
        seen = turned(seen, 3.0, seed + camera)
    return replace(seen, camera="")


def absent(seen: EstimatorInput, seed: int) -> EstimatorInput:
    """A camera that sees nothing in the first 55 % of the time: a little more than half."""
    hidden = np.zeros(seen.observations.seen.shape, dtype=bool)
    hidden[: round(0.55 * len(hidden)), faulty(seed)] = True
    return EstimatorInput(seen.observations.without(hidden), seen.rig, RING.names[faulty(seed)])


def hidden_joint(seen: EstimatorInput) -> EstimatorInput:
    """A wrist that nobody sees for 3 s."""
    hidden = np.zeros(seen.observations.seen.shape, dtype=bool)
    hidden[_during(seen.observations, 3.0), :, seen.observations.skeleton.index("left_wrist")] = True
    return EstimatorInput(seen.observations.without(hidden), seen.rig)


def wrong_rate(seen: EstimatorInput, factor: float) -> EstimatorInput:
    """All cameras are said to be so many times as fast as they are."""
    return EstimatorInput(replace(seen.observations, time_s=seen.observations.time_s / factor), seen.rig)


def displaced_knee(seen: EstimatorInput, seed: int) -> EstimatorInput:
    """A view that draws the left knee 8 cm down the shin, as under a coat, always and confidently."""
    skeleton, points_px = seen.observations.skeleton, seen.observations.points2d_px.copy()
    knee, ankle = skeleton.index("left_knee"), skeleton.index("left_ankle")
    view = points_px[:, faulty(seed)]
    view[:, knee] += 0.2 * (view[:, ankle] - view[:, knee])
    return _with_points(seen, points_px, RING.names[faulty(seed)])


def wrong_wrist(seen: EstimatorInput) -> EstimatorInput:
    """A wrist that all views see at the ankle of its side for a second, confidently."""
    skeleton, points_px = seen.observations.skeleton, seen.observations.points2d_px.copy()
    during = _during(seen.observations, 1.0)
    points_px[during, :, skeleton.index("left_wrist")] = points_px[during, :, skeleton.index("left_ankle")]
    return _with_points(seen, points_px)


def mixed(seen: EstimatorInput, other: EstimatorInput, away_m: float) -> EstimatorInput:
    """From the middle on, detections of a body so far away in all views, with the same motion and bones: only the
    change of place can give it away."""
    points_px, n_frames = seen.observations.points2d_px.copy(), seen.observations.n_frames
    moved = CameraRig(tuple(_moved(camera, away_m) for camera in seen.rig.cameras))
    trajectory_m = fgpose.smooth(other.observations, moved).positions_m
    noise_px = other.observations.points2d_px - moved.project(trajectory_m)
    half = n_frames // 2
    points_px[half:] = (seen.rig.project(trajectory_m) + noise_px)[half:n_frames]
    return _with_points(seen, points_px)


def _moved(camera: fgpose.Camera, away_m: float) -> fgpose.Camera:
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[0, 3] += away_m
    return replace(camera, world_T_camera=world_T_camera)


def _during(observations: Observations, duration_s: float) -> Bool[np.ndarray, " frame"]:
    """Frames in the middle."""
    from_middle_s = observations.frame_time_s - observations.frame_time_s.mean()
    return np.abs(from_middle_s) < duration_s / 2


def _with_points(
    seen: EstimatorInput, points_px: Float[np.ndarray, "frame camera joint 2"], camera: str = ""
) -> EstimatorInput:
    return EstimatorInput(replace(seen.observations, points2d_px=points_px), seen.rig, camera)


Recordings = Callable[[str, int], EstimatorInput]
FAULTLESS: dict[str, Recordings] = {
    "clean": seen_clip,
    "occluded": lambda clip, seed: seen_clip(clip, seed, Occlusion()),
    "real errors": lambda clip, seed: seen_clip(clip, seed, variant="real"),
    "biased": lambda clip, seed: seen_clip(clip, seed, variant="biased_60hz"),
    "15 Hz": lambda clip, seed: seen_clip(clip, seed, fps=15.0),
    "120 Hz": lambda clip, seed: seen_clip(clip, seed, variant="precise_120hz", fps=120.0),
}
"""Recordings in which no camera, clock or detector is worse than it has to be."""
FAULTY: dict[str, Recordings] = {
    "turned 1°": lambda clip, seed: turned(seen_clip(clip, seed), 1.0, seed),
    "turned 3°": lambda clip, seed: turned(seen_clip(clip, seed), 3.0, seed),
    "all 3°": lambda clip, seed: other_rig(seen_clip(clip, seed), seed),
    "50 ms late": lambda clip, seed: seen_clip(clip, seed, late_s=0.05),
    "1 % slow": lambda clip, seed: seen_clip(clip, seed, drift=0.01),
    "sides, view": lambda clip, seed: swapped(seen_clip(clip, seed), seed),
    "sides, all": lambda clip, seed: swapped(seen_clip(clip, seed), seed, everywhere=True),
    "ankles, view": lambda clip, seed: swapped_pair(seen_clip(clip, seed), seed),
    "absent": lambda clip, seed: absent(seen_clip(clip, seed), seed),
    "joint 3 s": lambda clip, seed: hidden_joint(seen_clip(clip, seed)),
    "knee off": lambda clip, seed: displaced_knee(seen_clip(clip, seed), seed),
    "wrist off": lambda clip, seed: wrong_wrist(seen_clip(clip, seed)),
    "two people": lambda clip, seed: mixed(seen_clip(clip, seed), seen_clip(clip, seed + 100), 2.0),
    "two near": lambda clip, seed: mixed(seen_clip(clip, seed), seen_clip(clip, seed + 100), 0.7),
    "rate × 1.2": lambda clip, seed: wrong_rate(seen_clip(clip, seed), 1.2),
    "rate × 2": lambda clip, seed: wrong_rate(seen_clip(clip, seed), 2.0),
    "rate × 4": lambda clip, seed: wrong_rate(seen_clip(clip, seed), 4.0),
    "rate × 0.5": lambda clip, seed: wrong_rate(seen_clip(clip, seed), 0.5),
}
"""Faults planted in clean recordings, one at a time."""


def real_recordings() -> Iterator[EstimatorInput]:
    """Those that come with fgpose, whole and in halves: a part of a recording has no fault that the whole has not."""
    for name in fgpose.files.recordings():
        rig, observations = fgpose.files.load_recording(name)
        half = observations.n_frames // 2
        for frames in (slice(None), slice(half), slice(half, None)):
            yield EstimatorInput(observations.frames(frames), rig)
