"""Cameras whose images are later than they claim, and what the motion tells of it.

python docs/pictures/clocks.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from drawing import BLUE, GREY, VERMILLION, make_plain, new_figure, save
from jaxtyping import Float

import fgpose
from fgpose.assessment.metrics import mpjpe_m
from fgpose_benchmarks.human36m.workcell import at_times
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

FPS = 50.0
LATE_MS = np.array([0.0, 33.0, -13.0, 52.0])
_SHOWN_MS = 130.0
STAMPED = "#a0a0a0"  # seen beside the colours on white


def main(folder: Path | None = None) -> None:
    """Draw clocks.svg.

    Args:
        folder: where it goes; default: docs/concepts.
    """
    skeleton, rig = fgpose.load_skeleton("h36m_17"), ring_rig()
    truth_m = walking(round(4 * FPS), FPS, skeleton)
    seen = simulate(
        truth_m, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=0, offsets_s=LATE_MS / 1000
    ).observations
    offsets = fgpose.calibration.estimate_time_offsets(seen, rig)
    errors_mm = [_error_mm(fgpose.smooth(seen, each), truth_m) for each in (rig, offsets.rig)]

    figure = new_figure(8.4, 3.6, "Four cameras of 50 Hz that claim to be synchronous")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[3, 2])
    stamps_ms = np.arange(-2, 9) * 1000 / FPS
    for row, late_ms in enumerate(LATE_MS):
        left.plot(stamps_ms, np.full(len(stamps_ms), row), "|", color=STAMPED, markersize=16, markeredgewidth=1.5)
        left.plot(stamps_ms + late_ms, np.full(len(stamps_ms), row), "|", color=VERMILLION, markersize=16)
        left.annotate("", (40 + late_ms, row - 0.28), (40, row - 0.28), arrowprops={"arrowstyle": "->", "color": GREY})
    left.plot([], [], "|", color=STAMPED, markersize=10, markeredgewidth=1.5, label="as stamped")
    left.plot([], [], "|", color=VERMILLION, markersize=10, label="really taken")
    left.set(xlim=(0, _SHOWN_MS), xlabel="Time (ms)", ylim=(-0.7, 4.5))  # the legends are above the cameras
    left.set_yticks(range(4), [f"camera {row + 1}" for row in range(4)])
    make_plain(left, "When images are taken", "x")
    left.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)
    right.plot(LATE_MS, range(4), "|", color=VERMILLION, markersize=22, label="true")
    right.errorbar(
        1000 * offsets.offsets_s,
        range(4),
        xerr=2000 * offsets.sigma_s,
        fmt="o",
        color=BLUE,
        capsize=3,
        label="estimated, two sigma",
    )
    right.set(xlabel="Time offset (ms)")
    make_plain(right, f"From the motion: error {errors_mm[0]:.1f} → {errors_mm[1]:.1f} mm", "x")
    right.legend(loc="upper left", fontsize=8, frameon=False, markerscale=0.5, ncols=2)
    off_ms = np.abs(1000 * offsets.offsets_s - LATE_MS).max()
    print(
        f"wrote {save(figure, 'clocks', folder)}: off by at most {off_ms:.1f} ms, "
        f"error {errors_mm[0]:.1f} mm, then {errors_mm[1]:.1f} mm"
    )


def _error_mm(result: fgpose.Trajectory, truth_m: Float[np.ndarray, "frame joint 3"]) -> float:
    """To where somebody is at the time of each frame: when its images were taken, on average."""
    status = np.full(truth_m.shape[:2], fgpose.Status.OBSERVED)
    truth = fgpose.Trajectory(result.skeleton, np.arange(len(truth_m)) / FPS, truth_m, status)
    return 1000 * mpjpe_m(result.positions_m, at_times(truth, result.time_s).positions_m)


if __name__ == "__main__":
    tyro.cli(main)
