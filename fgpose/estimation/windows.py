"""Windows in which a long recording is solved: each overlaps its neighbours and contributes its middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

# If the last window would be shorter than this share of a window, its frames join the window before.
_LEAST_REST = 0.25


@dataclass(frozen=True)
class Window:
    """Frames of a recording."""

    solved: slice
    """The frames that are solved together."""
    contributed: slice
    """The frames that the result takes from this window."""

    @property
    def contributed_of_solved(self) -> slice:
        """The same, counted from the first solved frame."""
        return slice(self.contributed.start - self.solved.start, self.contributed.stop - self.solved.start)


def cut_windows(time_s: Float[np.ndarray, " frame"], window_s: float, overlap_s: float) -> list[Window]:
    """Windows of about window_s that cover the recording; each sees overlap_s beyond the frames that it contributes."""
    duration_s = time_s[-1] - time_s[0]
    count = max(1, int(np.ceil(duration_s / window_s - _LEAST_REST)))
    # Only those with frames beside them: with nanoseconds taken for seconds there are a thousand million others.
    passed = (time_s - time_s[0]) * count / max(duration_s, 1e-9)
    numbers = np.unique(np.concatenate([np.floor(passed), np.ceil(passed)]))
    numbers = numbers[(numbers >= 1) & (numbers < count)]
    cuts = np.searchsorted(time_s, time_s[0] + numbers * duration_s / count)
    edges = np.unique([0, *cuts.tolist(), len(time_s)])
    windows = []
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        before = int(np.searchsorted(time_s, time_s[start] - overlap_s)) if start else 0
        after = int(np.searchsorted(time_s, time_s[stop - 1] + overlap_s, side="right"))
        windows.append(Window(slice(before, after), slice(start, stop)))
    return windows
