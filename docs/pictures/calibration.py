"""A rig that was found from a walker, beside the true one, and the verdicts of three walks.

python docs/pictures/calibration.py
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro
from drawing import BLUE, GREEN, GREY, PALE, VERMILLION, draw_ellipse, draw_rig, make_plain, new_figure, save

import fgpose
from fgpose_benchmarks.synthetic import film, ring_rig, walkers
from fgpose_benchmarks.synthetic.crowd.walkers import Behaviour, stature_m

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = {"good": GREEN, "coarse": "#e69f00", "failed": VERMILLION}
_FLOOR_M = (4.0, 4.0)
_ENLARGED = 10.0


def calibrated(behaviour: Behaviour, seconds: float) -> fgpose.calibration.CalibratedFromPeople:
    """What the cameras find from somebody who behaves so."""
    motion = walkers(_FLOOR_M, seconds, seed=0, behaviour=behaviour)
    scene = film(motion, ring_rig(4, 5.0, 2.3, size_px=(1920, 1080)), seed=0)
    stature = stature_m(motion.truth_m[0], motion.skeleton)
    return fgpose.calibration.calibrate_from_people(
        scene.observations, scene.intrinsics, stature_m=stature, synchronised=True
    )


def draw_verdict(axes: Axes, found: fgpose.calibration.CalibratedFromPeople, title: str) -> None:
    """Cameras with the ellipses of their places, the walk, and the verdict."""
    floor_m = np.nanmean(found.joints_m[..., :2], axis=1)
    axes.plot(*floor_m.T, color=PALE, linewidth=2, zorder=0)
    draw_rig(axes, found.rig, BLUE)
    for camera, sigma_m in zip(found.rig.cameras, found.sigmas.position_m, strict=True):
        # position_m is the root of the sum over three axes.
        covariance_m2 = np.eye(2) * (_ENLARGED * sigma_m) ** 2 / 3
        draw_ellipse(axes, camera.position_m[:2], covariance_m2, 0.9, facecolor=BLUE, alpha=0.2)
    grade = found.grade.value
    make_plain(axes, title, "both")
    axes.set(aspect="equal", xlim=(-3.5, 13.5), ylim=(-8.5, 8.5))
    axes.text(0.5, 1.12, grade, transform=axes.transAxes, ha="center", color=_COLOURS[grade], fontweight="bold")
    axes.tick_params(labelsize=8, colors=GREY)


def main(folder: Path | None = None) -> None:
    """Draw calibration.svg.

    Args:
        folder: where it goes; default: docs/concepts.
    """
    figure = new_figure(
        8.4, 3.8, f"Four cameras found from one person, from above (m); 90 % ellipses, {_ENLARGED:.0f} times enlarged"
    )
    walks: tuple[tuple[Behaviour, float, str], ...] = (
        ("walks", 20.0, "walks everywhere, 20 s"),
        ("line", 12.0, "walks on one line, 12 s"),
        ("stands", 8.0, "stands still, 8 s"),
    )
    for axes, (behaviour, seconds, title) in zip(figure.subplots(1, 3), walks, strict=True):
        found = calibrated(behaviour, seconds)
        draw_verdict(axes, found, title)
        print(f"{behaviour}: {found.grade.value}; place +/- {1000 * found.sigmas.position_m.max():.0f} mm")
        for finding in found.findings:
            print(f"  {finding.camera}: {finding.reason}; {finding.remedy}")
    print(f"wrote {save(figure, 'calibration', folder)}")


if __name__ == "__main__":
    tyro.cli(main)
