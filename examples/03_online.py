"""Frame by frame, as a live system would: one update per frame, the pose at once and a better one a moment later.

What one learns: the loop around fgpose.Estimator, that every update answers twice (the newest pose, and the one that is
one lag old, from all frames since), and how far both are from the batch result, which has seen all frames.

    python examples/03_online.py
"""

from __future__ import annotations

import numpy as np
import tyro

import fgpose


def distance_mm(positions_m: np.ndarray, reference_m: np.ndarray) -> float:
    """Median distance over all joints and frames."""
    return 1000 * float(np.nanmedian(np.linalg.norm(positions_m - reference_m, axis=-1)))


def main(frames: int = 100, lag_s: float = 0.5) -> None:
    """Estimate a recording online.

    Args:
        frames: how many of the recording's frames.
        lag_s: how far back a new image still changes the past, seconds.
    """
    rig, observations = fgpose.files.load_recording("balance_openpose")
    observations = observations.frames(slice(0, frames))
    estimator = fgpose.Estimator(rig, observations.skeleton, fgpose.Config(online={"lag_s": lag_s}))
    newest: list[fgpose.Estimate] = []
    lagged: list[fgpose.Estimate] = []
    for frame in observations:  # in a live system: whatever the cameras saw since the last time
        estimate = estimator.update(frame)
        newest.append(estimate)
        lagged += estimate.newly_smoothed
        if estimate.frame % 25 == 0:
            print(f"{estimate.time_s:5.2f} s  right wrist at {np.round(estimate['right_wrist'], 3)} m")

    batch_m = fgpose.smooth(observations, rig).positions_m
    print(f"updates: {len(newest)}, lagged results: {len(lagged)}")
    for name, estimates in (("newest", newest), (f"{lag_s:g} s later", lagged)):
        if estimates:
            online = fgpose.Trajectory.from_estimates(estimates)
            difference_mm = distance_mm(online.positions_m, batch_m[[estimate.frame for estimate in estimates]])
            print(f"{name:12} differs from the batch result by {difference_mm:.1f} mm (median)")


if __name__ == "__main__":
    tyro.cli(main)
