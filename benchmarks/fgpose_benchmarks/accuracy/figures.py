"""Pictures of the benchmark, as PNG files: errors over the variants, errors of the joints, calibration."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from fgpose.io.atomic import write_bytes
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.comparison.plot_style import (
    BLUE,
    GREY,
    PALE,
    SELF_CALIBRATED,
    VERMILLION,
    Look,
    make_plain,
    new_figure,
    shown,
)
from fgpose_benchmarks.comparison.scores import COVERAGE_LEVELS, Score
from fgpose_benchmarks.comparison.summary import FEWEST_RECORDINGS, Interval, Summaries, variants_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 150  # sharp on a screen, and the files stay small
_STRIPE = "#f4f4f4"
_SKELETON = "h36m_17"
"""Of the open benchmark. Joints of scores with another number of joints go by their index."""
_OCCLUDED = "occluded"
_LABEL_SHARE = 0.055
"""Height of a line of text as a share of the height of the axes."""
_MARGIN = 0.15
"""Between the outer steps and the ends of the axis, as a share of the distance of two steps."""
_STEP_SPREAD = 0.12
"""How far apart the methods of one step are drawn, as a share of the distance of two steps."""
_ROW_SPREAD = 0.5
"""How far apart the methods of one joint are drawn, as a share of the distance of two joints."""
_CONSISTENT_POINTS = 5.0
"""How far a coverage may be from its nominal value and still be called consistent, percentage points."""


@dataclass(frozen=True)
class _Picture:
    file_name: str
    text: str
    """What it shows, for those who cannot see it."""
    draw: Callable[[Summaries], Figure | None]
    """None where the variants are not there."""


def write_figures(summaries: Summaries, folder: Path) -> dict[Path, str]:
    """Draw the pictures whose variants are there, as PNG files.

    Returns:
        What each file shows, by its path.

    Raises:
        ImportError: matplotlib is not installed; the message says how to.
        OSError: the folder cannot be written into.
    """
    written = {}
    for picture in _PICTURES:
        figure = picture.draw(summaries)
        if figure is not None:
            path = folder / picture.file_name
            content = io.BytesIO()
            figure.savefig(content, format=path.suffix.removeprefix("."), dpi=_DPI)
            write_bytes(path, content.getvalue())
            written[path] = picture.text
    return written


def error_against_cameras(summaries: Summaries) -> Figure | None:
    """Absolute MPJPE with 4, 3 and 2 cameras, occluded; None without these variants."""
    variants = {"4": _OCCLUDED, "3": "occluded_3_cameras", "2": "occluded_2_cameras"}
    return _error_lines(summaries, variants, "Error against the number of cameras, with occlusion", "Cameras")


def error_against_desynchronised_cameras(summaries: Summaries) -> Figure | None:
    """Absolute MPJPE with none to three cameras out of step; None without these variants."""
    steps = {"0": "clean", "1": "desync_1", "2": "desync_2", "3": "desync_3"}
    title = "Error against the number of cameras that are out of step"
    return _error_lines(summaries, steps, title, "Desynchronised cameras", also=(SELF_CALIBRATED,))


def _error_lines(
    summaries: Summaries, steps: Mapping[str, str], title: str, label: str, also: Iterable[str] = ()
) -> Figure | None:
    """One line for each method over the variants that steps names, in its order."""
    styles = shown(summaries, list(steps.values()), also)
    if not styles or not set(steps.values()) <= set(variants_of(summaries)):
        return None
    figure = new_figure(7.5, 4.4, title)
    axes = figure.subplots()
    places = np.arange(len(steps))
    lines = {
        method: [summaries[variant, method].interval("mpjpe_mm") for variant in steps.values()] for method in styles
    }
    # Beside one another, so that the bars can be told apart.
    shifts = dict(zip(lines, _spread(len(lines), _STEP_SPREAD), strict=True))
    for method, intervals in lines.items():
        _draw_line(axes, places + shifts[method], intervals, styles[method])
    axes.set_xticks(places, list(steps))
    axes.set_xlim(-_MARGIN, places[-1] + _MARGIN)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(label)
    axes.set_ylabel("Absolute MPJPE (mm)")
    make_plain(axes, _over_recordings(list(lines.values())), "y")
    _label_ends(axes, {m: (places[-1] + shifts[m], line[-1].value) for m, line in lines.items()}, styles)
    return figure


def _draw_line(axes: Axes, places: Float[np.ndarray, " step"], intervals: Sequence[Interval], look: Look) -> None:
    axes.errorbar(
        places,
        [interval.value for interval in intervals],
        # Rounding may put an interval without width past its mean; NaN (one recording) draws no bar.
        yerr=np.maximum([[i.value - i.low for i in intervals], [i.high - i.value for i in intervals]], 0.0),
        color=look.colour,
        marker=look.marker,
        markersize=5,
        linewidth=look.width_pt,
        linestyle=look.style,
        elinewidth=1.0,
    )


def _over_recordings(lines: Sequence[Sequence[Interval]]) -> str:
    counts = {interval.n_recordings for line in lines for interval in line}
    if counts == {1}:
        return "One recording"
    number = str(max(counts)) if len(counts) == 1 else f"{min(counts)} to {max(counts)}"
    bars = "95 % confidence" if max(counts) >= FEWEST_RECORDINGS else "from the best to the worst"
    return f"Mean over {number} recordings; bars: {bars}"


def _label_ends(axes: Axes, ends: Mapping[str, tuple[float, float]], styles: Mapping[str, Look]) -> None:
    """Names beside the ends of the lines, moved apart as little as possible."""
    methods = sorted(ends, key=lambda method: ends[method][1])
    bottom, top = axes.get_ylim()
    heights = _apart(np.array([ends[method][1] for method in methods]), _LABEL_SHARE * (top - bottom))
    for method, height in zip(methods, heights.tolist(), strict=True):
        colour = styles[method].colour
        axes.annotate(
            method,
            xy=ends[method],
            # Twice the margin of the axis: as far from its end as that is from the last step.
            xytext=(axes.get_xlim()[1] + _MARGIN, height),
            color=colour,
            fontsize=9,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 4},
        )


def _spread(n: int, width: float) -> Float[np.ndarray, " n"]:
    return np.linspace(-width / 2, width / 2, n) if n > 1 else np.zeros(n)


def _apart(ascending: Float[np.ndarray, " label"], gap: float) -> Float[np.ndarray, " label"]:
    """The values moved as little as possible (least squares) so that neighbours are at least a gap apart."""
    from scipy.optimize import isotonic_regression

    steps = gap * np.arange(len(ascending))
    return isotonic_regression(ascending - steps).x + steps


def error_of_joints(summaries: Summaries) -> Figure | None:
    """Mean absolute error of each joint, left and right together, occluded; None without this variant."""
    styles = shown(summaries, [_OCCLUDED])
    n_joints = max(
        (
            len(score.joint_mm)
            for method in styles
            for score in summaries[_OCCLUDED, method].scores
            if isinstance(score, Score)
        ),
        default=0,
    )
    if n_joints == 0:
        return None
    rows = _joint_rows(n_joints)
    figure = new_figure(7.5, 1.2 + 0.36 * len(rows), "Error of each joint, with occlusion")
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    for (method, look), shift in zip(styles.items(), _spread(len(styles), -_ROW_SPREAD), strict=True):
        means_mm = [summaries[_OCCLUDED, method].mean("joint_mm", joint) for joint in range(n_joints)]
        values_mm = [float(np.mean([means_mm[joint] for joint in joints])) for joints in rows.values()]
        axes.plot(
            values_mm, places + shift, look.marker, color=look.colour, markersize=5.5, label=method, linestyle="none"
        )
    axes.set_yticks(places, list(rows))
    axes.set_xlim(left=0.0)
    axes.set_xlabel("Absolute error (mm)")
    for place in places[::2]:
        axes.axhspan(place - 0.5, place + 0.5, color=_STRIPE, zorder=0)
    axes.set_ylim(-0.5, len(rows) - 0.5)
    sides = ", and over left and right" if len(rows) < n_joints else ""
    make_plain(axes, f"Mean over the recordings{sides}", "x")
    figure.legend(loc="outside right upper", fontsize=9, frameon=False)
    return figure


def _joint_rows(n_joints: int) -> dict[str, list[int]]:
    """Names of joints and where they are; left and right together."""
    skeleton = load_skeleton(_SKELETON)
    if n_joints != len(skeleton.joints):
        return {f"joint {joint}": [joint] for joint in range(n_joints)}
    rows: dict[str, list[int]] = {}
    for joint, name in enumerate(skeleton.joints):
        rows.setdefault(name.removeprefix("left_").removeprefix("right_").replace("_", " "), []).append(joint)
    return rows


def calibration_curves(summaries: Summaries) -> Figure | None:
    """Nominal against actual coverage, mean and range over the variants, one pane for each method that states
    covariances; None without such."""
    variants = variants_of(summaries)
    methods = [
        method
        for method in shown(summaries, variants, also=(SELF_CALIBRATED,))
        if np.isfinite(_coverages(summaries, method, "coverage")).any()
    ]
    if not methods:
        return None
    figure = new_figure(max(1.2 + 2.1 * len(methods), 6.0), 3.8, "Calibration: joints inside their ellipsoids")
    panes = figure.subplots(1, len(methods), sharex=True, sharey=True, squeeze=False)[0]
    series = {
        "coverage": ("all joints: mean and range of the variants", BLUE, 4.0),
        "coverage_occluded": ("occluded joints", VERMILLION, 1.2),
    }
    for axes, method in zip(panes, methods, strict=True):
        for number, (label, colour, width_pt) in series.items():
            _draw_coverage(axes, _coverages(summaries, method, number), label, colour, width_pt)
        make_plain(axes, method, "both")
        axes.set_xlabel("Nominal (%)")
    panes[0].set_ylabel("Actual (%)")
    for axes in panes:
        _draw_diagonal(axes)
    handles, labels = panes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower left", ncols=2, fontsize=9, frameon=False)
    return figure


def _coverages(summaries: Summaries, method: str, number: str) -> Float[np.ndarray, "variant level"]:
    """In percent, of the variants that have it."""
    levels = range(len(COVERAGE_LEVELS))
    entries = [summary for summary in summaries.values() if summary.method == method]
    shares = np.array([[100 * entry.mean(number, level) for level in levels] for entry in entries])
    return shares[np.isfinite(shares).all(axis=1)]


def _draw_coverage(
    axes: Axes, shares: Float[np.ndarray, "variant level"], label: str, colour: str, width_pt: float
) -> None:
    """Mean over the variants, and from the lowest to the highest."""
    if not len(shares):
        return
    nominal = 100 * np.array(COVERAGE_LEVELS)
    axes.plot(nominal, shares.mean(axis=0), "o-", color=colour, markersize=4, linewidth=1.0, label=label)
    axes.vlines(nominal, shares.min(axis=0), shares.max(axis=0), color=colour, linewidth=width_pt, alpha=0.6)


def _draw_diagonal(axes: Axes) -> None:
    """Where a consistent covariance lies. The axes begin below all that is drawn, at 40 % at the latest."""
    lowest = max(0.0, min(axes.get_ylim()[0], 40.0))
    ends = np.array([0.0, 110.0])
    band = (ends - _CONSISTENT_POINTS, ends + _CONSISTENT_POINTS)
    axes.fill_between(
        ends, *band, color=PALE, linewidth=0, label=f"consistent, ±{_CONSISTENT_POINTS:g} points", zorder=0
    )
    axes.plot(ends, ends, color=GREY, linewidth=0.8, zorder=0)
    axes.set_ylim(lowest, 102.0)
    axes.set_xlim(44.0, 102.0)
    axes.set_xticks(100 * np.array(COVERAGE_LEVELS))


_PICTURES = (
    _Picture("cameras.png", "Absolute MPJPE against the number of cameras, with occlusion", error_against_cameras),
    _Picture(
        "desynchronised.png",
        "Absolute MPJPE against the number of desynchronised cameras",
        error_against_desynchronised_cameras,
    ),
    _Picture("joints.png", "Absolute error of each joint, with occlusion", error_of_joints),
    _Picture(
        "calibration.png",
        "Share of joints inside their covariance ellipsoids against the nominal share, over the variants",
        calibration_curves,
    ),
)
