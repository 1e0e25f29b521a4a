"""The figures of all sections in one style. Bokeh is imported here alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from fgpose.report.blocks import Plot
from fgpose.sampling import stretches

# Okabe and Ito (2008): told apart by the colour-blind.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d31", "#7b6bb2")
TIME_AXIS = "time"
"""Tag of figures whose x axis is the time of the recording: page.js links them."""
MAX_COLUMNS = 900  # of a picture of values over time: as many as a page has pixels
_ROW_PX, _LOW_ROW_PX, _MANY_ROWS = 22, 16, 20
_FRAME_PX = 64  # axis, labels and toolbar


Figure = Any
"""A figure of Bokeh. Its stubs reject much of what its documentation does."""
_BAR = {
    "width": 10,
    "padding": 4,
    "title_text_font_size": "11px",
    "title_text_font_style": "normal",
    "background_fill_color": None,
    "bar_line_color": None,
}
_PADDING = 0.05  # of the axis, beyond the values
_BORDER_PX = 64  # left of the axis: times of figures below each other are below each other
_BAND = {"fill_alpha": 0.22, "line_color": None}


def models() -> Any:
    """bokeh.models."""
    import bokeh.models

    return bokeh.models


def bins(n_frames: int, at_most: int = MAX_COLUMNS) -> np.ndarray:
    """First frame of each of the equal parts into which frames are gathered."""
    n_bins = min(n_frames, at_most)
    return np.unique(np.linspace(0, n_frames, n_bins + 1).astype(int)[:-1])


def gathered(values: Float[np.ndarray, " frame *row"], at_most: int = MAX_COLUMNS) -> Float[np.ndarray, " bin *row"]:
    """Means of the known values of parts of the frames; NaN where there is none."""
    first = bins(len(values), at_most)
    known = np.isfinite(values)
    total = np.add.reduceat(np.where(known, values, 0.0), first, axis=0)
    count = np.add.reduceat(known.astype(float), first, axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def largest(values: Float[np.ndarray, " frame *row"], at_most: int = MAX_COLUMNS) -> Float[np.ndarray, " bin *row"]:
    """Largest known values of parts of the frames; NaN where there is none."""
    found = np.maximum.reduceat(np.where(np.isfinite(values), values, -np.inf), bins(len(values), at_most), axis=0)
    return np.where(np.isfinite(found), found, np.nan)


def ramp(colours: Sequence[str], n: int) -> list[str]:
    """A palette of n colours through those given, evenly."""
    stops = np.array([[int(colour[at : at + 2], 16) for at in (1, 3, 5)] for colour in colours])
    at = np.linspace(0, len(stops) - 1, n)
    mixed = np.stack([np.interp(at, np.arange(len(stops)), stops[:, channel]) for channel in range(3)], axis=1)
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in mixed.round().astype(int).tolist()]


def time_figure(y_label: str, height_px: int = 260) -> Figure:
    """A figure over the time of the recording."""
    plot = plain_figure("time / s", y_label, height_px, "xpan,xbox_zoom,reset,save")
    plot.tags = [TIME_AXIS]
    return plot


def plain_figure(
    x_label: str, y_label: str, height_px: int, tools: str = "pan,box_zoom,reset,save", **options: Any
) -> Figure:
    """A figure in the style of the page, which sets the colours of its text."""
    import bokeh.plotting

    plotting: Any = bokeh.plotting
    plot = plotting.figure(
        height=height_px,
        sizing_mode="stretch_width",
        tools=tools,
        toolbar_location="above",
        x_axis_label=x_label,
        y_axis_label=y_label,
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        **options,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = plot.axis.major_label_text_font_size = "12px"
    plot.axis.minor_tick_line_color = None
    plot.xgrid.grid_line_color = None
    plot.ygrid.grid_line_alpha = 0.5
    # Room for half of the last number of the axis.
    plot.min_border_right = 14
    # A wheel over a figure scrolls the page.
    plot.toolbar.active_scroll = None
    plot.toolbar.active_drag = plot.select_one(models().BoxZoomTool)
    return plot


def heat_map(
    rows: Mapping[str, Float[np.ndarray, " frame"]],
    time_s: Float[np.ndarray, " frame"],
    palette: Sequence[str],
    limits: tuple[float, float],
    value: str,
    caption: str,
    *,
    counts: bool = False,
    columns: int = MAX_COLUMNS,
) -> Plot:
    """Values over time, a row for each name, the first on top.

    Args:
        rows: by name; NaN stays empty.
        time_s: of the frames.
        palette: from low to high.
        limits: values of its ends.
        value: what the values are, as a tooltip shows it: "share seen / %".
        counts: whether they are whole numbers from the lower limit to the upper.
        columns: parts of the time, of each of which the mean is shown.
    """
    height_px = (_ROW_PX if len(rows) <= _MANY_ROWS else _LOW_ROW_PX) * len(rows) + _FRAME_PX
    plot = time_figure("", max(height_px, 130))
    begin_s, width_s = extent_s(time_s)
    names = list(rows)[::-1]
    images = [gathered(rows[name], columns).astype(np.float32)[None] for name in names]
    places = {"y": [n - 0.46 for n in range(len(names))], "x": len(names) * [begin_s]}
    source = models().ColumnDataSource({"image": images, "name": names, **places})
    if counts:
        palette, limits = ramp(palette, int(limits[1] - limits[0]) + 1), (limits[0] - 0.5, limits[1] + 0.5)
    else:
        palette = ramp(palette, 64)
    mapper = models().LinearColorMapper(palette, low=limits[0], high=limits[1], nan_color="rgba(0, 0, 0, 0)")
    drawn = plot.image("image", "x", "y", dw=width_s, dh=0.92, color_mapper=mapper, source=source)
    label, _, unit = value.partition(" / ")
    tips = [("", "@name"), ("time", "$x{0.00} s"), (label, f"@image{{0.[00]}} {unit}")]
    plot.add_tools(models().HoverTool(renderers=[drawn], tooltips=tips))
    plot.x_range, plot.y_range = models().Range1d(begin_s, begin_s + width_s), models().Range1d(-0.6, len(names) - 0.4)
    plot.yaxis.ticker = list(range(len(names)))
    plot.yaxis.major_label_overrides = dict(enumerate(names))
    plot.ygrid.grid_line_color = None
    plot.yaxis.axis_line_color = plot.yaxis.major_tick_line_color = None
    plot.add_layout(colour_bar(mapper, value.removesuffix(" / ")), "right")
    return Plot(plot, caption, plot.height or 0)


def colour_bar(mapper: Any, title: str) -> Any:
    """What the colours mean; of few colours, each has a number."""
    whole = range(math.ceil(mapper.low), math.floor(mapper.high) + 1)
    ticker = models().FixedTicker(ticks=list(whole)) if len(mapper.palette) < 16 else models().BasicTicker()
    return models().ColorBar(color_mapper=mapper, title=title, ticker=ticker, **_BAR)


def extent_s(time_s: Float[np.ndarray, " frame"]) -> tuple[float, float]:
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    return float(time_s[0]), float(time_s[-1] - time_s[0]) + step_s


def share_time(plots: Sequence[Plot]) -> None:
    """Give all that are over time the same axis: from the first time of any to the last."""
    ranges = [plot.model.x_range for plot in plots if TIME_AXIS in plot.model.tags]
    if ranges:
        begin_s, end_s = min(each.start for each in ranges), max(each.end for each in ranges)
        for each in ranges:
            each.update(start=begin_s, end=end_s)


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
        legend_below(plot)
    return Plot(plot, caption, height_px, half)


def parts(known: Bool[np.ndarray, " bin"]) -> list[tuple[int, int]]:
    """First and one past the last of each run of at least two."""
    return [(first, last) for first, last in stretches(known) if last - first > 1]


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


def legend_below(plot: Figure) -> None:
    """Where it hides nothing; a click on a name hides what it names."""
    (legend,) = plot.legend
    legend.location = "left"
    legend.click_policy = "hide"
    legend.ncols = 6
    legend.orientation = "horizontal"
    legend.label_text_font_size = "12px"
    legend.border_line_color = legend.background_fill_color = None
    legend.padding = legend.margin = 2
    plot.add_layout(legend, "below")
