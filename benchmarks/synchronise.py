"""How well fgpose.calibration.synchronise finds when the cameras of a rig began: `python benchmarks/synchronise.py`.

Takes of motion capture that is short for this purpose, each from another moment of a clip, through the synthetic rig
and the simulated network of the calibration from people (bias of 20 to 40 mm by direction), cameras of 30 and 25 Hz
that begin up to 2 s apart. A row takes a minute of one core. A start that is wrong by more than an image is wrong; what
is not decided is left out by the command, and counted as not found.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from fgpose.calibration.synchronisation import synchronise
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import embedded_motion, ring_rig
from fgpose_benchmarks.synthetic.crowd.motion import CrowdMotion
from fgpose_benchmarks.synthetic.uncalibrated import SimulatedClocks, SimulatedNetwork, WalkScene, film

CLIPS = ("cmu_01_04_a", "cmu_02_05", "cmu_03_03_b", "cmu_01_01_a", "cmu_02_07_a", "cmu_02_10", "cmu_03_03_a")
WRONG_S = 0.04


@dataclass(frozen=True)
class Case:
    """Takes of one kind."""

    name: str
    seconds: float
    n_cameras: int
    turned_deg: float = 0.0
    """RMS of the angle by which each camera of the rig is wrong."""
    on_the_spot: bool = False
    """The person's way over the floor is taken away: only limbs move."""


CASES = (
    Case("15 s, two cameras", 15.0, 2),
    Case("8 s", 8.0, 4),
    Case("8 s, on the spot", 8.0, 4, on_the_spot=True),
    Case("8 s, rig turned by 0.5°", 8.0, 4, turned_deg=0.5),
    Case("8 s, rig turned by 1.5°", 8.0, 4, turned_deg=1.5),
)


def take(case: Case, clip: str, seed: int) -> WalkScene:
    """Part of a clip, filmed."""
    rng = np.random.default_rng([seed, CLIPS.index(clip)])
    motion_m, fps = embedded_motion(clip)
    n_frames = round(case.seconds * fps)
    first = int(rng.integers(0, max(len(motion_m) - n_frames, 1)))
    motion_m = motion_m[first : first + n_frames].copy()
    over_floor_m = motion_m[:, :1, :2].copy()
    motion_m[..., :2] -= over_floor_m if case.on_the_spot else over_floor_m.mean(axis=0)
    motion = CrowdMotion(load_skeleton("h36m_17"), motion_m[None], fps)
    return film(
        motion, ring_rig(case.n_cameras), seed, SimulatedNetwork(), SimulatedClocks((30.0, 25.0), 2.0, 40.0, 145.0)
    )


def turned(rig: CameraRig, rms_deg: float, seed: int) -> CameraRig:
    """Each camera about an axis of its own."""
    rng, cameras = np.random.default_rng(seed), []
    for camera in rig.cameras:
        pose = camera.world_T_camera.copy()
        pose[:3, :3] @= Rotation.from_rotvec(np.radians(rms_deg) / np.sqrt(3) * rng.standard_normal(3)).as_matrix()
        cameras.append(replace(camera, world_T_camera=pose))
    return CameraRig(tuple(cameras))


def row(case: Case, n_seeds: int) -> str:
    """A line of the table."""
    errors_s, sigmas_s, n_all = [], [], 0
    for seed in range(n_seeds):
        for clip in CLIPS:
            scene = take(case, clip, seed)
            n_all += case.n_cameras - 1  # one is the clock of the others
            try:
                found = synchronise(scene.observations, turned(scene.rig, case.turned_deg, seed))
            except ValueError:
                continue
            error_s = found.rig.time_offsets_s - scene.rig.subset(found.rig.names).time_offsets_s
            errors_s += (error_s - error_s[0])[1:].tolist()
            sigmas_s += found.sigma_s[1:].tolist()
    size_s, sigma_s = np.abs(errors_s), np.array(sigmas_s)
    cells = (
        case.name,
        f"{100 * len(size_s) / n_all:.0f}",
        f"{int((size_s > WRONG_S).sum())} of {len(size_s)}",
        f"{1000 * np.median(size_s):.1f}",
        f"{1000 * np.quantile(size_s, 0.95):.1f}",
        f"{100 * np.mean(size_s < 2 * sigma_s):.0f}",
    )
    return f"| {' | '.join(cells)} |"


def main(seeds: int = 4) -> None:
    """Print the table.

    Args:
        seeds: takes of each clip.
    """
    sys.stdout.write("| take | found [%] | wrong by > 40 ms | median [ms] | 95 % [ms] | within 2 sigma [%] |\n")
    sys.stdout.write("|---|---:|---:|---:|---:|---:|\n")
    for case in CASES:
        sys.stdout.write(f"{row(case, seeds)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    tyro.cli(main)
