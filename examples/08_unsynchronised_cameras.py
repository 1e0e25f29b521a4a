"""Unsynchronised cameras: their time offsets from the motion alone, and how much the result improves.

What one learns: estimating the time offsets of the cameras, reading their standard deviations, smoothing with the rig
that carries them, and keeping that rig as a calibration file.

    python examples/08_unsynchronised_cameras.py --offsets-ms 40 -25 60
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from scipy.interpolate import CubicSpline

import fgpose
from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

FPS = 50.0


def error_mm(trajectory: fgpose.Trajectory, truth_m: np.ndarray) -> float:
    """Mean distance of the joints from their true positions at the times of the frames: the mean times at which the
    images were taken."""
    true_at_m = CubicSpline(np.arange(len(truth_m)) / FPS, truth_m)(trajectory.time_s)
    return 1000 * mpjpe_m(trajectory.positions_m, true_at_m)


def main(
    seconds: float = 4.0,
    offsets_ms: tuple[float, float, float] = (40.0, -25.0, 60.0),
    output: Path = Path("out/synchronised.toml"),
) -> None:
    """Estimate the offsets of a walk that is simulated, so that the truth is known.

    Args:
        seconds: how long the person walks.
        offsets_ms: how much later than it claims each camera but the first takes its images.
        output: where the calibration with the offsets goes; fgpose's commands take it as --rig.
    """
    skeleton, rig = fgpose.load_skeleton("h36m_17"), ring_rig()
    truth_m = walking(round(seconds * FPS), FPS, skeleton)
    true_offsets_s = np.array([0.0, *offsets_ms]) / 1000
    seen = simulate(truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=true_offsets_s)

    offsets = fgpose.calibration.estimate_time_offsets(seen.observations, rig)
    for name, true_s, estimated_s, sigma_s in zip(
        rig.names, true_offsets_s, offsets.offsets_s, offsets.sigma_s, strict=True
    ):
        print(f"{name}: true {1000 * true_s:5.1f} ms, estimated {1000 * estimated_s:5.1f} +/- {1000 * sigma_s:.1f} ms")

    # The rig carries the offsets; smooth and the online Estimator need nothing else.
    before, after = fgpose.smooth(seen.observations, rig), fgpose.smooth(seen.observations, offsets.rig)
    print(f"error as if they were synchronous: {error_mm(before, truth_m):.1f} mm")
    print(f"error with estimated time offsets: {error_mm(after, truth_m):.1f} mm")

    fgpose.save_rig(offsets.rig, output)
    print(f"wrote {output}: offsets of {np.round(1000 * fgpose.load_rig(output).time_offsets_s, 1)} ms")


if __name__ == "__main__":
    tyro.cli(main)
