"""Joints, angles and speeds over time, with what is known of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.kinematics.quantities import Quantities
from fgpose.trajectory import Trajectory

_SIGMAS = 2.0


@singledispatch
def plot(plotted: object, names: Sequence[str] | None = None) -> np.ndarray:
    """See OverTime.plot."""
    raise TypeError(f"{type(plotted).__name__} cannot be plotted")


@plot.register
def _(trajectory: Trajectory, names: Sequence[str] | None = None) -> np.ndarray:
    names = trajectory.skeleton.joints if names is None else names
    joints = [trajectory.skeleton.index(name) for name in names]
    figure, axes = _panels(3)
    covariance_m2 = trajectory.covariance_m2
    for axis, panel in enumerate(axes):
        unknown_m = np.full(trajectory.status.shape, np.nan)
        sigma_m = unknown_m if covariance_m2 is None else np.sqrt(covariance_m2[..., axis, axis])
        for name, joint in zip(names, joints, strict=True):
            _with_band(panel, trajectory.time_s, trajectory.positions_m[:, joint, axis], sigma_m[:, joint], name)
        panel.set_ylabel(f"{'xyz'[axis]} [m]")
    _finish(figure, axes)
    return axes


@plot.register
def _(quantities: Quantities, names: Sequence[str] | None = None) -> np.ndarray:
    names = quantities.names if names is None else names
    curves = {name: quantities[name] for name in names}
    sigma = np.full(quantities.value.shape, np.nan) if quantities.sigma is None else quantities.sigma
    figure, axes = _panels(1)
    for name, values in curves.items():
        _with_band(axes[0], quantities.time_s, values, sigma[:, quantities.names.index(name)], name)
    axes[0].set_ylabel(f"{quantities.kind} [{quantities.unit}]")
    _finish(figure, axes)
    return axes


def _panels(count: int) -> tuple[Any, np.ndarray]:
    try:
        from matplotlib import pyplot
    except ImportError:
        raise ImportError('plot() needs matplotlib: pip install "fgpose[notebook]"') from None
    figure, axes = pyplot.subplots(
        count, 1, sharex=True, squeeze=False, figsize=(9, 1.5 + 1.8 * count), layout="constrained"
    )
    return figure, axes[:, 0]


def _with_band(
    panel: Any,
    time_s: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, " frame"],
    sigma: Float[np.ndarray, " frame"],
    name: str,
) -> None:
    (line,) = panel.plot(time_s, values, linewidth=1.2, label=name)
    low, high = values - _SIGMAS * sigma, values + _SIGMAS * sigma
    panel.fill_between(time_s, low, high, color=line.get_color(), alpha=0.25, linewidth=0)


def _finish(figure: Any, axes: np.ndarray) -> None:
    axes[-1].set_xlabel("time [s]")
    axes[0].margins(x=0)
    handles, labels = axes[0].get_legend_handles_labels()
    if handles:
        # Beside the curves, which it never hides.
        figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize="small")
