"""Which methods the pictures of the benchmark show, and how: few, in colours that the colour-blind tell apart."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from fgpose_benchmarks.comparison.summary import Summaries, methods_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREY = "#666666"
PALE = "#dddddd"
BLUE = "#0072b2"
VERMILLION = "#d55e00"
SELF_CALIBRATED = "fgpose batch, self-calibrated"


@dataclass(frozen=True)
class Look:
    """Of one method; the colours are those of Okabe and Ito (2008)."""

    colour: str
    marker: str
    style: str = "-"
    width_pt: float = 1.4


_NAMED = {
    "the paper's method": Look(VERMILLION, "s"),
    "fgpose online, lag 0.2 s": Look("#009e73", "o", width_pt=2.0),
    "fgpose batch": Look(BLUE, "o", width_pt=2.6),
    SELF_CALIBRATED: Look(BLUE, "h", "--"),
}
_ALWAYS = tuple(name for name in _NAMED if name != SELF_CALIBRATED)
_BEST_OF = {
    "per-frame": Look("#e69f00", "^"),
    "linear": Look("#56b4e9", "v"),
    "peer": Look("#cc79a7", "D"),
    "file": Look("#999999", "P"),
    "oracle": Look("#000000", "x", "--"),
}


def shown(summaries: Summaries, variants: Sequence[str], also: Iterable[str] = ()) -> dict[str, Look]:
    """The methods to draw, worst first: the best of each group, and those with a look of their own.

    Only methods that have an error on each of these variants; best is the lowest mean of their MPJPE over the variants.

    Args:
        also: names to show beside those that every picture shows.
    """
    groups = methods_of(summaries)
    errors_mm = {method: _mean_mm(summaries, method, variants) for method in groups}
    known = sorted((method for method in groups if np.isfinite(errors_mm[method])), key=errors_mm.__getitem__)
    styles: dict[str, Look] = {}
    for group, look in _BEST_OF.items():
        styles |= dict.fromkeys([method for method in known if groups[method] == group][:1], look)
    styles |= {method: _NAMED[method] for method in (*_ALWAYS, *also) if method in known}
    return {method: styles[method] for method in reversed(known) if method in styles}


def _mean_mm(summaries: Summaries, method: str, variants: Sequence[str]) -> float:
    """Mean over the variants; NaN where the method has no error on one."""
    entries = [summaries.get((variant, method)) for variant in variants]
    return float(np.mean([np.nan if entry is None else entry.mean("mpjpe_mm") for entry in entries]))


def new_figure(width_in: float, height_in: float, title: str) -> Figure:
    """A figure that no window and no global state of matplotlib knows of."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return figure


def make_plain(axes: Axes, subtitle: str, grid: Literal["x", "y", "both"]) -> None:
    """What all axes have in common."""
    axes.set_title(subtitle, loc="left", fontsize=9, color=GREY)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    axes.grid(axis=grid, color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
