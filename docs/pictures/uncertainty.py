"""Covariance ellipses of a person, from above: two cameras leave them long along their rays, four make them round.

python docs/pictures/uncertainty.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from drawing import BLUE, GREY, VERMILLION, draw_ellipse, make_plain, new_figure, save

import fgpose
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

FPS, FRAME = 50.0, 50
_SHARE = 0.9


def main(folder: Path | None = None) -> None:
    """Draw uncertainty.svg.

    Args:
        folder: where it goes; default: docs/concepts.
    """
    skeleton = fgpose.load_skeleton("h36m_17")
    truth_m = walking(100, FPS, skeleton)
    narrow = ring_rig(12).subset(("ring_0", "ring_1"))  # 30 degrees apart
    figure = new_figure(8.4, 4.4, "A person who walks, from above: 90 % covariance ellipses and true joints")
    printed = []
    for axes, own in zip(figure.subplots(1, 2), (narrow, ring_rig()), strict=True):
        seen = simulate(truth_m, skeleton, own, FPS, DetectionNoise(), NO_OCCLUSION, seed=1).observations
        trajectory = fgpose.smooth(seen, own)
        assert trajectory.covariance_m2 is not None
        middle_m = truth_m[FRAME, :, :2].mean(axis=0)
        for joint in range(skeleton.n_joints):
            ellipse = trajectory.positions_m[FRAME, joint, :2], trajectory.covariance_m2[FRAME, joint, :2, :2]
            draw_ellipse(axes, *ellipse, _SHARE, facecolor=BLUE, alpha=0.25, edgecolor=BLUE)
        axes.plot(*truth_m[FRAME, :, :2].T, "+", color=VERMILLION, markersize=6)
        for camera in own.cameras:
            direction = camera.position_m[:2] - middle_m
            start = middle_m + 0.34 * direction / np.linalg.norm(direction)
            axes.annotate(
                "",
                middle_m + 0.48 * direction / np.linalg.norm(direction),
                start,
                arrowprops={"arrowstyle": "<|-", "color": GREY},
            )
        axes.set(
            xlim=middle_m[0] + np.array([-0.5, 0.5]),
            ylim=middle_m[1] + np.array([-0.5, 0.5]),
            aspect="equal",
            xlabel="x (m)",
            ylabel="y (m)",
        )
        sigma_mm = 1000 * np.sqrt(np.trace(trajectory.covariance_m2[FRAME], axis1=1, axis2=2) / 3).mean()
        make_plain(axes, f"{own.n_cameras} cameras: mean standard deviation {sigma_mm:.0f} mm", "both")
        printed.append(f"{own.n_cameras} cameras {sigma_mm:.1f} mm")
    print(f"wrote {save(figure, 'uncertainty', folder)}: {', '.join(printed)}")


if __name__ == "__main__":
    tyro.cli(main)
