"""What angles and speeds have in common: numbers with a name each, over time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, TypeVar, cast, overload

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.sampling import TimeRange, forward, numbers_of_all, one_after_another
from fgpose.shown import OverTime, by_names
from fgpose.shown.unknown_names import did_you_mean

# In place of Self, which beartype takes in classes alone that it decorates as a whole.
_Own = TypeVar("_Own", bound="Quantities")


@dataclass(frozen=True, eq=False, repr=False)
class Quantities(OverTime):
    """Quantities of one kind over time. All its arrays have a row for each frame."""

    kind: ClassVar[str]
    """angle, speed."""
    unit: ClassVar[str]
    suffix: ClassVar[str]
    """The unit in the names of columns."""

    names: tuple[str, ...]
    time_s: Float[np.ndarray, " frame"]

    def __post_init__(self) -> None:
        shape = (len(self.time_s), len(self.names))
        for name, array in self._arrays().items():
            if name in ("time_s", "frame_numbers"):
                continue
            if array.shape != shape:
                raise ValueError(f"{name} must be {shape}, got {array.shape}")
            array.setflags(write=False)

    @property
    @abstractmethod
    def value(self) -> Float[np.ndarray, "frame name"]:
        """NaN = not known."""

    @property
    def sigma(self) -> Float[np.ndarray, "frame name"] | None:
        """Standard deviations; None: they are never known."""
        return None

    @property
    def numbered(self) -> Int[np.ndarray, " frame"] | None:
        """The numbers of the frames, those of the trajectory."""
        return cast(Any, self).frame_numbers

    def quantiles(self, shares: Sequence[float]) -> Float[np.ndarray, "share name"]:
        """Of each over time, NaN where it is never known.

        Args:
            shares: of the frames in which it is known, from 0 to 1.
        """
        quantiles = np.full((len(shares), len(self.names)), np.nan)
        for index, values in enumerate(self.value.T):
            known = values[np.isfinite(values)]
            if len(known):
                quantiles[:, index] = np.quantile(known, shares)
        return quantiles

    @overload
    def __getitem__(self, wanted: str) -> Float[np.ndarray, " frame"]: ...

    @overload
    def __getitem__(self, wanted: list[str] | tuple[str, ...]) -> Float[np.ndarray, "frame name"]: ...

    @overload
    def __getitem__(self: _Own, wanted: slice) -> _Own: ...

    def __getitem__(self: _Own, wanted: str | list[str] | tuple[str, ...] | slice) -> np.ndarray | _Own:
        """One by name, (T,), or several, (T, names); or some of the frames, as angles[100:200]. Raises ValueError for
        an unknown name or a negative step, TypeError for a number."""
        if isinstance(wanted, slice):
            return self.frames(wanted)
        if isinstance(wanted, str):
            return self.value[:, self._index(wanted)]
        return self.value[:, [self._index(name) for name in by_names(wanted)]]

    def _index(self, name: str) -> int:
        if name not in self.names:
            raise ValueError(
                f"there is no {self.kind} {name!r}{did_you_mean(name, self.names)}; there are {', '.join(self.names)}"
            )
        return self.names.index(name)

    def crop(self: _Own, begin_s: float, end_s: float) -> _Own:
        """The frames from one time to another, seconds, both included. Raises ValueError if there is none."""
        return self.frames(TimeRange(begin_s, end_s).of(self.time_s))

    @staticmethod
    def concatenate(parts: Sequence[_Own]) -> _Own:
        """Quantities one after the other as one; numbers of frames that do not go on are left out.

        Raises:
            ValueError: there is none, they are of other kinds or names, or one does not begin after the one before.
        """
        if not parts:
            raise ValueError("there is nothing to be concatenated")
        first = parts[0]
        for number, part in enumerate(parts):
            if type(part) is not type(first) or part.names != first.names:
                raise ValueError(f"{first.kind}s 0 and {number} are not of the same: they cannot be concatenated")
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in first._arrays()
            if name not in ("time_s", "frame_numbers")
        }
        joined["time_s"] = one_after_another([part.time_s for part in parts])
        return replace(first, frame_numbers=numbers_of_all([part.numbered for part in parts]), **joined)

    def frames(self: _Own, frames: slice | Bool[np.ndarray, " frame"]) -> _Own:
        """Some of the frames, as quantities of their own. Raises ValueError for a negative step."""
        return replace(self, **{name: array[forward(frames)] for name, array in self._arrays().items()})

    def _arrays(self) -> dict[str, np.ndarray]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
