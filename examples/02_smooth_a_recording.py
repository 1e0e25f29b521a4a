"""Real detections of four cameras, each frame alone and then as one motion; the result as a file.

What one learns: where recordings come from (fgpose.files.load_recording, or fgpose.load_rig and
fgpose.load_observations for your own), the two batch methods, what smoothing changes in numbers, and how to save it.

    python examples/02_smooth_a_recording.py --output out/balance.parquet
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro

import fgpose
from fgpose.assessment.metrics import jitter_mps3


def bone_spread_mm(trajectory: fgpose.Trajectory) -> float:
    """Standard deviation of a bone's length over time, mean over the bones: a rigid body has none."""
    lengths_m = trajectory.skeleton.bone_lengths(trajectory.positions_m)
    return 1000 * float(np.nanmean(np.nanstd(lengths_m, axis=0)))


def describe(name: str, trajectory: fgpose.Trajectory) -> None:
    assert trajectory.residual_px is not None
    print(
        f"{name:18} jitter {jitter_mps3(trajectory.positions_m, trajectory.time_s):8.1f} m/s^3,"
        f" bone spread {bone_spread_mm(trajectory):5.1f} mm,"
        f" reprojection error {np.nanmedian(trajectory.residual_px):5.1f} px"
    )


def main(frames: int = 100, output: Path = Path("out/balance.parquet")) -> None:
    """Smooth a recording.

    Args:
        frames: how many of the recording's frames.
        output: where the trajectory goes; the extension is the format: .parquet, .npz, .trc, .c3d.
    """
    rig, observations = fgpose.files.load_recording("balance_openpose")
    observations = observations.frames(slice(0, frames))
    print(f"{observations.n_frames} frames, {rig.n_cameras} cameras, {observations.skeleton.name}")

    describe("each frame alone", fgpose.refine(observations, rig))
    smoothed = fgpose.smooth(observations, rig)
    describe("one motion", smoothed)
    print(f"observed joints: {100 * smoothed.status_share(fgpose.Status.OBSERVED):.1f} %")

    fgpose.save_trajectory(smoothed, output)
    again = fgpose.load_trajectory(output)
    print(f"wrote {output}: {again.n_frames} frames of {again.skeleton.n_joints} joints")


if __name__ == "__main__":
    tyro.cli(main)
