"""Observations that were corrected, of which only the frames that differ from those given take memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from fgpose.observations import Observations
from fgpose.sampling import parts_of


@dataclass(frozen=True, eq=False)
class Corrected:
    """The observations of a long recording, without a copy of most of them."""

    given: Observations
    is_other: Bool[np.ndarray, " frame"]
    others: Mapping[str, np.ndarray | None]
    """What stands in these frames, see Observations.per_detection."""

    @staticmethod
    def of(given: Observations, corrected: Observations) -> Corrected:
        """Of the same frames."""
        is_other = np.zeros(given.n_frames, dtype=bool)
        for part in parts_of(given.n_frames):
            now = corrected.frames(part).per_detection(np.asarray)
            for name, before in given.frames(part).per_detection(np.asarray).items():
                if before is not None:
                    differs = (before != now[name]) & ~(np.isnan(before) & np.isnan(now[name]))
                    is_other[part] |= differs.any(axis=tuple(range(1, differs.ndim)))
        return Corrected(given, is_other, corrected.per_detection(lambda array: array[is_other]))

    def frames(self, part: slice) -> Observations:
        """Some in a row, as Observations.frames."""
        some, is_other = self.given.frames(part), self.is_other[part]
        if not is_other.any():
            return some
        first = np.count_nonzero(self.is_other[: part.start])
        arrays = some.per_detection(np.copy)
        for name, others in self.others.items():
            if others is not None:
                arrays[name][is_other] = others[first : first + np.count_nonzero(is_other)]
        return replace(some, **arrays)
