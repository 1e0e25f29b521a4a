"""A recording as a picture of a line's height: the way over the floor, and how much was seen when."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.report.camera_sections import SEEN_PALETTE
from fgpose.report.finished import FinishedRecording
from fgpose.report.plots import gathered, ramp
from fgpose.report.series import root_m

_SIDE, _STRIP, _HEIGHT = 34, 120, 34  # pixels
_WAY_POINTS, _BINS = 40, 60
_LEVELS = ramp(SEEN_PALETTE, 9)


def thumbnail(recording: FinishedRecording) -> str:
    """As SVG: left the way of the hips of the main person, right the share of joints that two cameras see, over time,
    above it sigma relative to its median."""
    trajectory = recording.main
    across, along, _ = recording.axes
    way = _path(gathered(root_m(trajectory), _WAY_POINTS)[:, [across, along]])
    strip = _strip(gathered(trajectory.observed.mean(axis=1), _BINS))
    seen = float(trajectory.observed.mean())
    size = f'width="{_SIDE + 6 + _STRIP}" height="{_HEIGHT}"'
    label = f"way over the floor; {seen:.0%} of the joints seen by two cameras"
    return f'<svg {size} role="img" aria-label="{label}"><title>{label}</title>{way}{strip}</svg>'


def _path(way_m: Float[np.ndarray, "point 2"]) -> str:
    known = way_m[np.isfinite(way_m).all(axis=1)]
    if len(known) < 2:
        return ""
    low, extent = known.min(axis=0), max(float(np.ptp(known, axis=0).max()), 0.5)
    places = 3 + (known - low) / extent * (_SIDE - 6)
    points = " ".join(f"{x:.0f},{_SIDE - y:.0f}" for x, y in places.tolist())
    x, y = places[-1].tolist()
    dot = f'<circle cx="{x:.0f}" cy="{_SIDE - y:.0f}" r="2" fill="#d55e00"/>'
    return f'<polyline points="{points}" fill="none" stroke="#0b6e86" stroke-width="1.2"/>{dot}'


def _strip(share: Float[np.ndarray, " bin"]) -> str:
    """Runs of equal colour as rectangles."""
    level = np.round(np.nan_to_num(share) * (len(_LEVELS) - 1)).astype(int)
    first = np.flatnonzero(np.diff(level, prepend=-1))
    width = _STRIP / len(level)
    ends = [*first[1:].tolist(), len(level)]
    return "".join(
        f'<rect x="{_SIDE + 6 + start * width:.1f}" y="11" width="{(end - start) * width:.1f}" height="12" '
        f'fill="{_LEVELS[level[start]]}"/>'
        for start, end in zip(first.tolist(), ends, strict=True)
    )
