"""Curves over time, with bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from fgpose.report.blocks import Plot
from fgpose.report.plots import COLOURS, MAX_COLUMNS, Figure, bins, extent_s, gathered, largest, models, time_figure

_PADDING = 0.05  # of the axis, beyond the values
_BORDER_PX = 64  # left of the axis: times of figures below each other are below each other
_BAND = {"fill_alpha": 0.22, "line_color": None}


def lines(
    series: Mapping[str, Float[np.ndarray, " frame"]],
    time_s: Float[np.ndarray, " frame"],
    y_label: str,
    caption: str,
    *,
    height_px: int = 260,
    bands: Mapping[str, Float[np.ndarray, " frame"]] | None = None,
    shown: int = 8,
    from_zero: bool = False,
    peaks: bool = False,
    circular: bool = False,
    least_span: float = 0.0,
    half: bool = False,
    columns: int = MAX_COLUMNS,
) -> Plot:
    """Curves over time, a colour for each; a click on the legend hides one.

    Args:
        series: by name.
        time_s: of the frames.
        y_label: with the unit.
        bands: half the width of the band around each curve.
        shown: how many are not hidden at first.
        from_zero: whether the axis begins at zero.
        peaks: whether the largest of the gathered values is shown, not their mean.
        circular: whether they are angles in degrees that go on at -180 when they have reached 180.
        least_span: of the vertical axis, so that small errors do not look like large motions; with it the axis shows
            all of the curves, and their bands as wide as usual. By default it shows all there is.
        half: whether it takes half the width of the page.
        columns: parts of the time, of each of which one value is shown.
    """
    plot = time_figure(y_label, height_px)
    drawn = {name: _gathered(values, columns, peaks=peaks, circular=circular) for name, values in series.items()}
    half_widths = {name: gathered((bands or {})[name], columns) for name in drawn if name in (bands or {})}
    data = {f"y{n}": values for n, values in enumerate(drawn.values())} | {"t": gathered(time_s, columns)}
    # Single precision: 0.3 ms after an hour.
    source = models().ColumnDataSource({key: values.astype(np.float32) for key, values in data.items()})
    plot.min_border_left = _BORDER_PX
    renderers = []
    for n, name in enumerate(drawn):
        style = {"visible": n < shown} | ({"legend_label": name} if len(series) > 1 else {})
        colour = COLOURS[n % len(COLOURS)]
        if name in half_widths:
            _band(plot, data["t"], drawn[name], half_widths[name], fill_color=colour, **style)
        renderers.append(plot.line("t", f"y{n}", source=source, color=colour, line_width=1.6, name=name, **style))
    unit = y_label.rpartition(" / ")[2]
    tips = [("", "$name"), ("time", "$snap_x{0.00} s"), ("", f"$snap_y{{0.0[0]}} {unit}")]
    plot.add_tools(models().HoverTool(renderers=renderers, tooltips=tips, mode="mouse"))
    begin_s, width_s = extent_s(time_s)
    plot.x_range = models().Range1d(begin_s, begin_s + width_s)
    if least_span:
        low, high = _limits(list(drawn.values()), list(half_widths.values()), least_span)
        plot.y_range = models().Range1d(low, high)
    elif from_zero:
        plot.y_range.start = 0
    if len(series) > 1:
        _legend_below(plot)
    return Plot(plot, caption, height_px, half)


def parts(known: Bool[np.ndarray, " bin"]) -> list[tuple[int, int]]:
    """First and one past the last of each run of at least two."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int))).reshape(-1, 2)
    return [(first, last) for first, last in edges.tolist() if last - first > 1]


def _gathered(
    values: Float[np.ndarray, " frame"], columns: int, *, peaks: bool, circular: bool
) -> Float[np.ndarray, " bin"]:
    if circular:  # There is no mean of 179 and -179 degrees.
        return _broken(values[bins(len(values), columns)])
    return largest(values, columns) if peaks else gathered(values, columns)


def _broken(angle_deg: Float[np.ndarray, " bin"]) -> Float[np.ndarray, " bin"]:
    """With a gap where it goes on at the other end."""
    jumps = np.abs(np.diff(angle_deg, prepend=angle_deg[:1])) > 180
    return np.where(jumps, np.nan, angle_deg)


def _band(
    plot: Figure,
    time_s: Float[np.ndarray, " bin"],
    values: Float[np.ndarray, " bin"],
    half: Float[np.ndarray, " bin"],
    **style: object,
) -> None:
    """An area would go on over gaps: a patch for each part."""
    t, low, high = (each.astype(np.float32) for each in (time_s, values - half, values + half))
    runs = [slice(*run) for run in parts(np.isfinite(low))]
    xs = [np.concatenate([t[run], t[run][::-1]]) for run in runs]
    ys = [np.concatenate([low[run], high[run][::-1]]) for run in runs]
    plot.patches(xs, ys, **_BAND, **style)


def _limits(
    curves: Sequence[Float[np.ndarray, " bin"]], half_widths: Sequence[Float[np.ndarray, " bin"]], least_span: float
) -> tuple[float, float]:
    """Of an axis that shows the curves, and bands as wide as the median of the widest."""
    medians = [float(np.nanmedian(half)) for half in half_widths if np.isfinite(half).any()]
    known = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    low, high = (known.min(), known.max()) if known.size else (0.0, 0.0)
    low, high = low - max(medians, default=0.0), high + max(medians, default=0.0)
    missing = max(least_span - (high - low), 0.0) / 2 + _PADDING * max(least_span, high - low)
    return float(low - missing), float(high + missing)


def _legend_below(plot: Figure) -> None:
    (legend,) = plot.legend
    legend.location = "left"
    legend.click_policy = "hide"
    legend.ncols = 6
    legend.orientation = "horizontal"
    legend.label_text_font_size = "12px"
    legend.border_line_color = legend.background_fill_color = None
    legend.padding = legend.margin = 2
    plot.add_layout(legend, "below")
