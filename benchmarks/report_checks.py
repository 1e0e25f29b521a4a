"""False alarms and detections of every suspicion of a report: `python benchmarks/report_checks.py`.

A seed takes 80 s of one core.

Rows of the table are suspicions, columns are kinds of recordings; a cell is the share, in per cent, of the recordings
of the kind in which the suspicion was raised. Of a fault in one camera, a suspicion of another is not counted, so wrong
accusations do not show there. --words prints what is counted. What is raised on clean recordings is a false alarm; on
occluded ones gaps and hallucinations come from the occluders. Nobody knows whether the real recordings are without
fault; they are one man before one rig, by two networks, whole and in halves: one recording rather than six.

Recordings are the tuning clips of the benchmark, repeated to and fro to LEAST_S seconds, seen by four cameras, with
--seeds of noise each. Faults are planted in the clean recordings. At the end, of the motion capture itself: the largest
change of velocity of a joint over the usual one, and the largest speeds, at several rates: what limits of jumps have to
leave alone.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import fgpose
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.report import FinishedRecording
from fgpose.report.checks import CHECKS
from fgpose.report.series import known_quantile
from fgpose.synthetic import NO_OCCLUSION, DetectionNoise, Occlusion, embedded_motion, ring_rig, simulate

CLIPS = ("cmu_01_04_a", "cmu_02_01_short", "cmu_02_05", "cmu_03_03_b")
"""The tuning clips: climbing, walking, punching, over obstacles."""
ALL_CLIPS = (*CLIPS, "cmu_01_01_a", "cmu_02_07_a", "cmu_02_10", "cmu_03_03_a", "cmu_02_03_short")
LEAST_S = 8.0  # lags need five blocks of a second
FAULTY = 1  # the camera in which a fault is
RATES_HZ = (25.0, 50.0, 100.0)


@dataclass(frozen=True)
class Seen:
    """What the estimator is given."""

    observations: Observations
    rig: CameraRig
    camera: str = ""
    """That the fault is in; empty: in none, or in all."""


def seen_clip(clip: str, seed: int, occlusion: Occlusion = NO_OCCLUSION, *, late_s: float = 0.0) -> Seen:
    """Four cameras on a clip."""
    clip_m, fps = embedded_motion(clip)
    motion_m, rig = _to_and_fro(clip_m, fps), ring_rig()
    offsets_s = np.zeros(rig.n_cameras)
    offsets_s[FAULTY] = late_s
    skeleton = fgpose.load_skeleton("h36m_17")
    scene = simulate(motion_m, skeleton, rig, fps, DetectionNoise(), occlusion, seed, offsets_s)
    return Seen(scene.observations, rig)


def _to_and_fro(clip_m: Float[np.ndarray, "frame joint 3"], fps: float) -> Float[np.ndarray, "long_frame joint 3"]:
    """At least LEAST_S, and at most twice that. A short clip is played to and fro with a phase that is a cosine:
    nothing stops within a frame; in its middle it runs pi/2 times as fast as it was recorded."""
    n_frames, last = max(round(LEAST_S * fps), len(clip_m)), len(clip_m) - 1
    if n_frames == len(clip_m):
        return clip_m[: round(2 * LEAST_S * fps)]
    phase = last / 2 * (1 - np.cos(np.pi * np.arange(n_frames) / last))
    return np.asarray(CubicSpline(np.arange(len(clip_m)), clip_m)(phase))


def turned(seen: Seen, angle_deg: float, rng: np.random.Generator) -> Seen:
    """A camera turned about its centre since the calibration."""
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    cameras = list(seen.rig.cameras)
    world_T_camera = cameras[FAULTY].world_T_camera.copy()
    world_T_camera[:3, :3] = turn @ world_T_camera[:3, :3]
    cameras[FAULTY] = replace(cameras[FAULTY], world_T_camera=world_T_camera)
    return Seen(seen.observations, CameraRig(tuple(cameras)), cameras[FAULTY].name)


def swapped(seen: Seen) -> Seen:
    """Left and right exchanged in one view for 2 s."""
    left, right = np.array(seen.observations.skeleton.left_right).T
    order = np.arange(seen.observations.skeleton.n_joints)
    order[left], order[right] = right, left
    during = _during(seen.observations, 2.0)
    points_px = seen.observations.points2d_px.copy()
    points_px[during, FAULTY] = points_px[during, FAULTY][:, order]
    return Seen(replace(seen.observations, points2d_px=points_px), seen.rig, seen.rig.names[FAULTY])


def absent(seen: Seen) -> Seen:
    """A camera that sees nothing in the first 55 % of the time: a little more than half."""
    hidden = np.zeros(seen.observations.seen.shape, dtype=bool)
    hidden[: round(0.55 * len(hidden)), FAULTY] = True
    return Seen(_without(seen.observations, hidden), seen.rig, seen.rig.names[FAULTY])


def hidden_joint(seen: Seen) -> Seen:
    """A wrist that nobody sees for 3 s."""
    hidden = np.zeros(seen.observations.seen.shape, dtype=bool)
    hidden[_during(seen.observations, 3.0), :, seen.observations.skeleton.index("left_wrist")] = True
    return Seen(_without(seen.observations, hidden), seen.rig)


def wrong_rate(seen: Seen) -> Seen:
    """Frames that were taken at a quarter of the rate that is stated."""
    return Seen(replace(seen.observations, time_s=seen.observations.time_s / 4), seen.rig)


def displaced_knee(seen: Seen) -> Seen:
    """A view that draws the left knee 8 cm down the shin, as under a coat, always and confidently."""
    skeleton, points_px = seen.observations.skeleton, seen.observations.points2d_px.copy()
    knee, ankle = skeleton.index("left_knee"), skeleton.index("left_ankle")
    points_px[:, FAULTY, knee] += 0.2 * (points_px[:, FAULTY, ankle] - points_px[:, FAULTY, knee])
    return Seen(replace(seen.observations, points2d_px=points_px), seen.rig, seen.rig.names[FAULTY])


def mixed(seen: Seen, other: Seen) -> Seen:
    """From the middle on, detections of a body about 2 m away in all views. It has the same motion and bones as the
    first, and no noise: only the change of place can give it away."""
    points_px, n_frames = seen.observations.points2d_px.copy(), seen.observations.n_frames
    moved = CameraRig(tuple(_moved(camera) for camera in seen.rig.cameras))
    trajectory_m = fgpose.smooth(other.observations, moved).positions_m
    half = n_frames // 2
    points_px[half:] = seen.rig.project(trajectory_m)[half:n_frames]
    return Seen(replace(seen.observations, points2d_px=points_px), seen.rig)


def _moved(camera: fgpose.Camera) -> fgpose.Camera:
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[0, 3] += 2.0
    return replace(camera, world_T_camera=world_T_camera)


def _during(observations: Observations, duration_s: float) -> np.ndarray:
    """Frames in the middle."""
    from_middle_s = observations.frame_time_s - observations.frame_time_s.mean()
    return np.abs(from_middle_s) < duration_s / 2


def _without(observations: Observations, hidden: np.ndarray) -> Observations:
    def blanked(array: np.ndarray) -> np.ndarray:
        return np.where(hidden.reshape(hidden.shape + (1,) * (array.ndim - 3)), np.nan, array)

    return replace(observations, **observations.per_detection(blanked))


Recordings = Callable[[str, int], Seen]
COLUMNS: dict[str, Recordings] = {
    "clean": seen_clip,
    "occluded": lambda clip, seed: seen_clip(clip, seed, Occlusion()),
    "turned 1°": lambda clip, seed: turned(seen_clip(clip, seed), 1.0, np.random.default_rng(seed)),
    "turned 3°": lambda clip, seed: turned(seen_clip(clip, seed), 3.0, np.random.default_rng(seed)),
    "50 ms late": lambda clip, seed: replace(seen_clip(clip, seed, late_s=0.05), camera=ring_rig().names[FAULTY]),
    "sides 2 s": lambda clip, seed: swapped(seen_clip(clip, seed)),
    "absent": lambda clip, seed: absent(seen_clip(clip, seed)),
    "joint 3 s": lambda clip, seed: hidden_joint(seen_clip(clip, seed)),
    "rate × 4": lambda clip, seed: wrong_rate(seen_clip(clip, seed)),
    "knee off": lambda clip, seed: displaced_knee(seen_clip(clip, seed)),
    "two people": lambda clip, seed: mixed(seen_clip(clip, seed), seen_clip(clip, seed + 100)),
}


def raised(seen: Seen) -> dict[str, list[str]]:
    """Names of the suspicions, with their words; of a fault in a camera, of those that name a camera only those that
    name this one."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that a window did not converge is one of the suspicions
        trajectory = fgpose.smooth(seen.observations, seen.rig)
    recording = FinishedRecording("benchmark", {0: trajectory}, seen.rig, {0: seen.observations})
    found: dict[str, list[str]] = {}
    for check in CHECKS:
        own = check(recording)
        if seen.camera and any(each.subject in seen.rig.names for each in own):
            own = [each for each in own if each.subject == seen.camera]
        if own:
            found[check.__name__] = [each.reason for each in own]
    return found


def real_recordings() -> Iterator[Seen]:
    """Those that come with fgpose, whole and in halves: a part of a recording has no fault that the whole has not."""
    for name in fgpose.recordings():
        rig, observations = fgpose.load_recording(name)
        half = observations.n_frames // 2
        for frames in (slice(None), slice(half), slice(half, None)):
            yield Seen(observations.frames(frames), rig)


def table(shares: dict[str, dict[str, float]]) -> str:
    """One line per suspicion, one column per kind of recording; a dash is never."""
    lines = ["| suspicion | " + " | ".join(shares) + " |", "|---|" + "---:|" * len(shares)]
    for check in CHECKS:
        cells = [f"{100 * share:.0f}" if (share := own.get(check.__name__, 0.0)) else "–" for own in shares.values()]
        lines.append(f"| {check.__name__} | {' | '.join(cells)} |")
    return "\n".join(lines)


def motion_table() -> str:
    """What joints do in motion capture, without an estimator: the worst joint of each clip."""
    lines = ["| clip | rate / Hz | change of velocity / usual | joint / m/s | root / m/s | turn / °/s |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    for clip in ALL_CLIPS:
        clip_m, fps = embedded_motion(clip)
        for rate_hz in RATES_HZ:
            time_s = np.arange(int((len(clip_m) - 1) / fps * rate_hz)) / rate_hz
            motion_m = np.asarray(CubicSpline(np.arange(len(clip_m)) / fps, clip_m)(time_s))
            change_m = np.linalg.norm(np.diff(motion_m, 2, axis=0), axis=-1)
            ratio = (change_m.max(axis=0) / np.median(change_m, axis=0)).max()
            speed_mps = np.linalg.norm(np.diff(motion_m, axis=0), axis=-1) * rate_hz
            across_m = motion_m[:, 1, :2] - motion_m[:, 4, :2]
            angle = np.unwrap(np.arctan2(across_m[:, 1], across_m[:, 0]))
            turn_deg_s = known_quantile(np.abs(np.degrees(np.diff(angle))) * rate_hz, 1.0)
            numbers = f"{ratio:.0f} | {speed_mps.max():.1f} | {speed_mps[:, 0].max():.1f} | {turn_deg_s:.0f}"
            lines.append(f"| {clip} | {rate_hz:.0f} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1, help="of noise, of each clip")
    parser.add_argument("--only", nargs="+", default=list(COLUMNS), choices=list(COLUMNS), help="these columns")
    parser.add_argument("--words", action="store_true", help="print every suspicion in its words")
    options = parser.parse_args()
    kinds = {
        name: [(COLUMNS[name], clip, seed) for clip in CLIPS for seed in range(options.seeds)] for name in options.only
    }
    shares: dict[str, dict[str, float]] = {}
    for name, made in kinds.items():
        shares[name] = _shares(name, (make(clip, seed) for make, clip, seed in made), options.words)
    shares["real"] = _shares("real", real_recordings(), options.words)
    sys.stdout.write(f"\nPer cent of the recordings\n\n{table(shares)}\n\nMotion capture\n\n{motion_table()}\n")


def _shares(name: str, recordings: Iterator[Seen], words: bool) -> dict[str, float]:
    count, n_recordings = defaultdict(int), 0
    for n_recordings, seen in enumerate(recordings, start=1):
        for check, reasons in raised(seen).items():
            count[check] += 1
            if words:
                sys.stdout.writelines(f"{name} {n_recordings} {check}: {reason}\n" for reason in reasons)
    return {check: own / n_recordings for check, own in count.items()}


if __name__ == "__main__":
    main()
