"""What the pictures of the concepts have in common: where they go, and that they are the same at every drawing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from fgpose_benchmarks.comparison.plot_style import BLUE, GREY, PALE, VERMILLION, make_plain, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    import fgpose

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "PALE",
    "VERMILLION",
    "draw_ellipse",
    "draw_rig",
    "make_plain",
    "new_figure",
    "save",
]

GREEN = "#009e73"
_CONCEPTS = Path(__file__).parents[1] / "concepts"


def save(figure: Figure, name: str, folder: Path | None) -> Path:
    """As SVG into a folder, docs/concepts by default; without the date, so that only changes are changes."""
    import matplotlib

    path = (folder or _CONCEPTS) / f"{name}.svg"
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(path, metadata={"Date": None})
    return path


def draw_ellipse(
    axes: Axes, centre: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"], share: float, **look: Any
) -> None:
    """The ellipse that holds a normal variable of the plane with this probability."""
    from matplotlib.patches import Ellipse

    variances, directions = np.linalg.eigh(covariance)
    # The squared distance of a normal variable of two dimensions is exponential.
    width, height = 2 * np.sqrt(-2 * np.log(1 - share) * variances)
    angle_deg = np.rad2deg(np.arctan2(directions[1, 0], directions[0, 0]))
    axes.add_patch(Ellipse((float(centre[0]), float(centre[1])), width, height, angle=float(angle_deg), **look))


def draw_rig(axes: Axes, rig: fgpose.CameraRig, colour: str, length_m: float = 0.5) -> None:
    """Cameras from above: a dot, and a line along the viewing direction."""
    for camera in rig.cameras:
        x, y, _ = camera.position_m
        dx, dy = length_m * camera.world_T_camera[:2, 2]
        axes.plot([x, x + dx], [y, y + dy], color=colour, linewidth=1.5)
        axes.plot(x, y, "o", color=colour, markersize=5)
