"""Images that are given together: those that were taken together are one frame."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.changing_rig import TOGETHER_S
from fgpose.observations import Observations


def taken_together(taken_s: Float[np.ndarray, " camera"], step_s: float) -> Bool[np.ndarray, " camera"]:
    """Which images were taken so near each other that the motion between them is known: the most that were, of as many
    the first.

    Args:
        taken_s: when each camera took its image; NaN: there is none.
        step_s: from image to image of a camera. Within one, images are of one frame, however slow cameras are.
    """
    apart_s = taken_s[None, :] - taken_s[:, None]
    within = (apart_s >= 0) & (apart_s <= max(TOGETHER_S, step_s))
    count = within.sum(axis=1)
    first = np.lexsort((taken_s, -count))[0]
    return within[first]


class OneMoment:
    """Leaves images out that were not taken with the others of their frame, and says so once for each camera."""

    def __init__(self, camera_names: Sequence[str]) -> None:
        self._names = camera_names
        self._told_of: set[str] = set()

    def of(
        self, frame: Observations, taken_s: Float[np.ndarray, " camera"], step_s: float
    ) -> tuple[Observations, Float[np.ndarray, " camera"]]:
        """A frame of all cameras, and when each took its image (NaN: there is none), without those images."""
        left_out = np.isfinite(taken_s) & ~taken_together(taken_s, step_s)
        if not left_out.any():
            return frame, taken_s
        kept_s = np.where(left_out, np.nan, taken_s)
        self.warn({name: taken_s[c] - np.nanmean(kept_s) for c, name in enumerate(self._names) if left_out[c]})
        where = np.broadcast_to(left_out[None, :, None], frame.confidence.shape)
        return replace(frame.without(where), time_s=kept_s[None]), kept_s

    def warn(self, apart_s: dict[str, float]) -> None:
        """Of cameras whose images are left out: by how much later than the others they were taken.

        Warns:
            UserWarning: it was not said before.
        """
        for name, by_s in apart_s.items():
            if name not in self._told_of:
                self._told_of.add(name)
                warnings.warn(
                    f"images that are given together were taken far apart: those of camera {name} {abs(by_s):.3g} s "
                    f"{'after' if by_s > 0 else 'before'} the others, and are left out, as the motion in between is "
                    "not known. Is its clock wrong, or were images put together that are not of one moment?",
                    UserWarning,
                    stacklevel=6,
                )
