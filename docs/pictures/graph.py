"""The factor graph of one arm, two cameras and three frames: the factors that fgpose makes, each drawn once.

python docs/pictures/graph.py
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import gtsam
import numpy as np
import tyro
from drawing import BLUE, GREEN, GREY, VERMILLION, new_figure, save

import fgpose
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.factors.kinds import factors_of
from fgpose.estimation.keys import length_key, position_key, velocity_key
from fgpose.estimation.segment import Segment
from fgpose_benchmarks.synthetic import ring_rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ARM = fgpose.Skeleton("arm", ("shoulder", "elbow", "wrist"), ((0, 1), (1, 2)), (0,), ())
N_FRAMES = 3
_COLOURS = {"Projections": VERMILLION, "SharedLengths": GREEN, "Motions": BLUE}
_NAMES = {"Projections": "reprojection", "SharedLengths": "bone length", "Motions": "constant velocity"}


def recorded() -> Segment:
    """Three frames of an arm that swings, as two cameras see it."""
    rig, time_s = ring_rig().subset(("ring_0", "ring_1")), np.arange(N_FRAMES) / 30
    elbow_m, wrist_m = np.array([0.0, 0.02, 1.2]), np.array([0.25, 0.05, 1.15])
    at_rest_m = np.stack([np.array([0.0, 0.0, 1.45]), elbow_m, wrist_m])
    truth_m = at_rest_m + time_s[:, None, None] * np.array([[0.0], [0.5], [1.0]]) * np.array([0.0, 1.0, 0.0])
    points_px = rig.project(truth_m)
    observations = fgpose.Observations(
        skeleton=ARM,
        camera_names=rig.names,
        time_s=time_s,
        points2d_px=points_px,
        confidence=np.ones(points_px.shape[:3]),
    )
    config = fgpose.Config()
    return Segment.of_recording(gather(observations, rig, config), rig, ARM, config)


def places() -> dict[int, tuple[float, float]]:
    """Where each variable is drawn: time to the right, joints one below the other, lengths on the left."""
    variables: dict[int, tuple[float, float]] = {}
    for frame in range(N_FRAMES):
        for joint in range(ARM.n_joints):
            variables[position_key(joint, frame)] = (3.0 * frame, -2.0 * joint)
            variables[velocity_key(joint, frame)] = (3.0 * frame + 0.9, -2.0 * joint - 0.75)
    variables |= {length_key(length): (-2.2, -1.0 - 2.0 * length) for length in range(ARM.n_lengths)}
    return variables


def draw_factor(axes: Axes, kind: str, ends: list[tuple[float, float]], nth: int) -> None:
    """A square, and a line to each of its variables; projections hang above their joint, one for each camera."""
    colour = _COLOURS.get(kind, GREY)
    middle = np.mean(ends, axis=0)
    if len(ends) == 1:
        middle = np.add(ends[0], (-0.55 + 0.45 * nth, 0.62))
    elif kind == "SharedLengths":
        middle = np.mean(ends[:2], axis=0) - np.array([0.35, 0.0])
    for x, y in ends:
        axes.plot([middle[0], x], [middle[1], y], color=colour, linewidth=1.0, zorder=1)
    axes.plot(*middle, "s", color=colour, markersize=7, zorder=3)


def draw_variables(axes: Axes, variables: dict[int, tuple[float, float]]) -> None:
    """Circles with what they stand for."""
    for key, (x, y) in variables.items():
        kind, number = chr(gtsam.symbolChr(key)), gtsam.symbolIndex(key)
        size = {"x": 19, "v": 13, "l": 19}[kind]
        axes.plot(x, y, "o", color="white", markeredgecolor="black", markersize=size, zorder=2)
        label = f"${kind}$" if kind != "l" else f"$l_{number}$"
        axes.text(x, y - 0.02, label, ha="center", va="center", fontsize=10 if kind != "v" else 8, zorder=4)


def main(folder: Path | None = None) -> None:
    """Draw graph.svg.

    Args:
        folder: where it goes; default: docs/concepts.
    """
    variables = places()
    figure = new_figure(8.4, 4.6, "One arm, two cameras, three frames: the graph that is solved")
    axes = figure.subplots()
    counts: dict[str, int] = {}
    hanging: dict[int, int] = {}
    segment = recorded()
    for table in factors_of(segment):
        kind = type(table).__name__
        for factor in table.graph_factors(segment.keys):
            keys = list(factor.keys())
            known = [variables[key] for key in keys if key in variables]
            nth = hanging.get(keys[0], 0) if len(keys) == 1 else 0
            hanging[keys[0]] = nth + (len(keys) == 1)
            counts[kind] = counts.get(kind, 0) + 1
            if kind in _COLOURS:
                draw_factor(axes, kind, known, nth)
    draw_variables(axes, variables)
    for kind, count in counts.items():
        if kind in _COLOURS:
            axes.plot([], [], "s", color=_COLOURS[kind], label=f"{_NAMES[kind]} ({count})")
    for joint, name in enumerate(ARM.joints):
        axes.text(3.0 * N_FRAMES - 1.1, -2.0 * joint, name, va="center", fontsize=10, color=GREY)
    for frame in range(N_FRAMES):
        axes.text(3.0 * frame, 1.35, f"frame {frame}", ha="center", fontsize=10, color=GREY)
    axes.set(xlim=(-3.0, 9.2), ylim=(-5.3, 1.7), aspect="equal")
    axes.axis("off")
    figure.legend(loc="outside lower left", ncols=3, frameon=False, fontsize=9)
    print(f"wrote {save(figure, 'graph', folder)}: {counts}")


if __name__ == "__main__":
    tyro.cli(main)
