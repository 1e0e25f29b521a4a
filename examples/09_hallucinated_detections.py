"""Which detections are hallucinated: what the hidden Markov model of visibility says, beside the truth.

What one learns: reading the posterior of each detection, switching the model off, and what that does to a joint.
Needs fgpose-benchmarks. Makes a figure of the documentation:

    python examples/09_hallucinated_detections.py --output docs/visibility.png
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro
from jaxtyping import Bool, Float

import fgpose
from fgpose_benchmarks.accuracy.variants import find_variant, record
from fgpose_benchmarks.comparison.plot_style import BLUE, GREY, PALE, VERMILLION, make_plain, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOP_PX = 110.0


def draw_camera(
    axes: Axes,
    time_s: Float[np.ndarray, " frame"],
    residual_px: Float[np.ndarray, " frame"],
    probability: Float[np.ndarray, " frame"],
    hallucinated: Bool[np.ndarray, " frame"],
) -> None:
    """Residual against the left axis, probability against the right one."""
    shade: dict[str, Any] = {"color": PALE, "linewidth": 0, "label": "truth: hallucinated"}
    axes.fill_between(time_s, 0, TOP_PX, where=hallucinated, step="mid", **shade)
    axes.plot(time_s, residual_px, color=GREY, linewidth=1.0, label="residual (left)")
    axes.plot(time_s, 100 * probability, color=BLUE, linewidth=1.8, label="posterior of visible (right)")
    axes.set_ylim(0, TOP_PX)
    axes.set_yticks([0, 50, 100], ["0", "50", "100 px"])
    right = axes.twinx()
    right.set_ylim(0, TOP_PX / 100)
    right.set_yticks([0, 0.5, 1])
    right.tick_params(labelsize=9, labelcolor=BLUE)
    right.spines[["top", "right"]].set_visible(False)


def main(clip: str = "cmu_02_07_a", joint: str = "left_elbow", output: Path = Path("out/visibility.png")) -> None:
    """Smooth an occluded recording with the model and without, and draw one joint.

    Args:
        clip: one of the motions of the benchmark.
        joint: of the skeleton h36m_17.
        output: where the figure goes.
    """
    recording = record(find_variant("occluded"), clip)
    observations, rig = recording.observations, recording.rig
    index, name = observations.skeleton.index(joint), joint.replace("_", " ")
    configs = {model: fgpose.Config(visibility={"model": model}) for model in ("markov", "none")}
    trajectories = {model: fgpose.smooth(observations, rig, config) for model, config in configs.items()}
    markov, hallucinated = trajectories["markov"], recording.occluded & observations.seen
    visible = markov.visibility
    assert visible is not None
    of_visible, of_hallucinated = np.nanmean(visible[~recording.occluded]), np.mean(visible[hallucinated])
    print(f"mean posterior of visible: visible joints {of_visible:.2f}, hallucinated ones {of_hallucinated:.2f}")

    figure = new_figure(8.0, 6.4, f"Is the {name} visible or hallucinated?")
    *panes, below = figure.subplots(rig.n_cameras + 1, 1, sharex=True, height_ratios=[1] * rig.n_cameras + [1.8])
    assert markov.residual_px is not None
    for c, axes in enumerate(panes):
        draw_camera(axes, markov.time_s, *(of[:, c, index] for of in (markov.residual_px, visible, hallucinated)))
        make_plain(axes, f"Camera {c + 1}", "x")
    for (model, trajectory), colour in zip(trajectories.items(), (BLUE, VERMILLION), strict=True):
        error_mm = 1000 * np.linalg.norm(trajectory.positions_m - recording.truth_m, axis=-1)
        print(f"{model}: mean error of all joints {error_mm.mean():.1f} mm, {name} {error_mm[:, index].mean():.1f} mm")
        below.plot(markov.time_s, error_mm[:, index], color=colour, linewidth=1.8, label=f"visibility.model {model}")
    below.set(xlim=markov.time_s[[0, -1]], ylim=(0, None), xlabel="Time (s)")
    make_plain(below, f"Error of the {name} (mm)", "both")
    below.legend(fontsize=9, frameon=False)
    figure.legend(*panes[0].get_legend_handles_labels(), loc="outside lower left", ncols=3, fontsize=9, frameon=False)
    output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(output, dpi=150)
    print(f"wrote {output}")


if __name__ == "__main__":
    tyro.cli(main)
