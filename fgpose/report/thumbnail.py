"""A recording as a picture of a line's height: the way over the floor, and how much was seen when."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.series import root_m
from fgpose.report.camera_sections import SEEN_PALETTE
from fgpose.report.plots import gathered, ramp

_WIDTH, _EXTENT, _STRIP, _HEIGHT = 72, 40, 110, 40  # pixels: of the way, of its length in words, of the strip
_EDGE = 3  # pixels around the way
_WAY_POINTS, _BINS = 60, 60
_LEVELS = ramp(SEEN_PALETTE, 9)


def thumbnail(recording: FinishedRecording) -> str:
    """As SVG: the way of the hips of the main person from above, turned so that it fills the picture, and how far it
    reaches; then the share of joints that two cameras see, over time."""
    trajectory = recording.main
    way_m = gathered(root_m(trajectory), _WAY_POINTS)[:, :2]
    way, reach_m = _way(way_m[np.isfinite(way_m).all(axis=1)])
    strip = _strip(gathered(trajectory.observed.mean(axis=1), _BINS))
    seen = float(trajectory.observed.mean())
    size = f'width="{_WIDTH + _EXTENT + _STRIP}" height="{_HEIGHT}"'
    reach = f"{reach_m:.1f} m" if reach_m >= 1 else f"{100 * reach_m:.0f} cm"
    label = f"way over the floor, {reach}; {100 * seen:.0f} % of the joints seen by two cameras"
    words = f'<text x="{_WIDTH + 2}" y="24" font-size="11" fill="currentColor">{reach}</text>'
    return f'<svg {size} role="img" aria-label="{label}"><title>{label}</title>{way}{words}{strip}</svg>'


def _way(way_m: Float[np.ndarray, "point 2"]) -> tuple[str, float]:
    """A line that ends in a dot, and how far it reaches along its longer side, metres."""
    if len(way_m) < 2:
        return "", 0.0
    centred_m = way_m - way_m.mean(axis=0)
    _, _, directions = np.linalg.svd(centred_m, full_matrices=False)
    turned_m = centred_m @ directions.T
    low_m, high_m = turned_m.min(axis=0), turned_m.max(axis=0)
    room = np.array([_WIDTH, _HEIGHT], dtype=float) - 2 * _EDGE
    scale = float((room / np.maximum(high_m - low_m, 1e-3)).min())
    places = (turned_m - (low_m + high_m) / 2) * scale * (1, -1) + (_WIDTH / 2, _HEIGHT / 2)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places.tolist())
    x, y = places[-1].tolist()
    line = f'<polyline points="{points}" fill="none" style="stroke:var(--accent,#0b6e86)" stroke-width="1.5"/>'
    return f'{line}<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="#d55e00"/>', float((high_m - low_m).max())


def _strip(share: Float[np.ndarray, " bin"]) -> str:
    """Runs of equal colour as rectangles."""
    level = np.round(np.nan_to_num(share) * (len(_LEVELS) - 1)).astype(int)
    first = np.flatnonzero(np.diff(level, prepend=-1))
    width = _STRIP / len(level)
    ends = [*first[1:].tolist(), len(level)]
    return "".join(
        f'<rect x="{_WIDTH + _EXTENT + start * width:.1f}" y="14" width="{(end - start) * width:.1f}" height="12" '
        f'fill="{_LEVELS[level[start]]}"/>'
        for start, end in zip(first.tolist(), ends, strict=True)
    )
