"""Rows of one entity over time, built once from arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import rerun as rr
from jaxtyping import Float, Int, UInt8

from fgpose.trajectory import Status
from fgpose.viewer.rerun.palette import Colour

SIGMAS_90 = 2.5003
"""Radius of the ellipsoid that holds 90 % of a Gaussian in three dimensions, in sigmas: sqrt of chi2's quantile."""

TimeKind = Literal["duration", "timestamp"]
"""Seconds since any time, or since 1970."""


def set_times(stream: rr.RecordingStream, frame: int, time_s: float, kind: TimeKind) -> None:
    """When what is logged next was."""
    stream.set_time("frame", sequence=frame)
    if kind == "duration":
        stream.set_time("time", duration=time_s)
    else:
        stream.set_time("time", timestamp=time_s)


@dataclass(frozen=True, eq=False)
class Rows:
    """What one entity shows in each frame: ragged, as missing joints are left out."""

    path: str
    archetype: Any
    lengths: Int[np.ndarray, " row"]
    """How many instances (points, lines, values) each row has."""
    fields: dict[str, Any] = field(default_factory=dict)
    """The archetype's components, each flat over the instances of all rows."""
    frames: Int[np.ndarray, " row"] | None = None
    """Index of each row's frame, where there are fewer rows than frames."""

    @property
    def n_bytes(self) -> int:
        """About the memory that it takes in the recording."""
        return sum(values.nbytes for values in self.fields.values() if isinstance(values, np.ndarray))

    def send(
        self,
        stream: rr.RecordingStream,
        frame: Int[np.ndarray, " frame"],
        time_s: Float[np.ndarray, " frame"],
        kind: TimeKind = "duration",
    ) -> None:
        """Send all rows at once; one alone (live) so that Rerun joins it with those of other frames."""
        if self.frames is not None:
            frame, time_s = frame[self.frames], time_s[self.frames]
        if len(frame) == 0:
            return
        if len(frame) == 1:
            set_times(stream, int(frame[0]), float(time_s[0]), kind)
            stream.log(self.path, self.archetype.from_fields(**self.fields))
            return
        # As set_time rounds; TimeColumn alone would cut off.
        time_ns = np.round(1e9 * time_s)
        if kind == "duration":
            time = rr.TimeColumn("time", duration=time_ns.astype("timedelta64[ns]"))
        else:
            time = rr.TimeColumn("time", timestamp=time_ns.astype("datetime64[ns]"))
        indexes = [rr.TimeColumn("frame", sequence=frame), time]
        columns = self.archetype.columns(**self.fields).partition(self.lengths)
        stream.send_columns(self.path, indexes=indexes, columns=columns)


def point_rows(
    path: str,
    archetype: Any,
    positions: Float[np.ndarray, "frame joint dim"],
    colours: UInt8[np.ndarray, "frame joint 3"] | None = None,
    radii: Float[np.ndarray, "frame joint"] | None = None,
) -> Rows:
    """The joints that are known; a missing one is left out."""
    known = np.isfinite(positions).all(axis=-1)
    fields: dict[str, Any] = {"positions": positions[known], "keypoint_ids": np.nonzero(known)[1].astype(np.uint16)}
    if colours is not None:
        fields["colors"] = colours[known]
    if radii is not None:
        fields["radii"] = radii[known]
    return Rows(path, archetype, known.sum(axis=1), fields)


def bone_rows(
    path: str,
    positions_m: Float[np.ndarray, "frame joint 3"],
    bones: tuple[tuple[int, int], ...],
    colours: UInt8[np.ndarray, "frame bone 3"],
    radii: Float[np.ndarray, "frame bone"],
) -> Rows:
    """The bones both of whose joints are known."""
    strips = positions_m[:, np.array(bones, dtype=int).reshape(-1, 2)]
    known = np.isfinite(strips).all(axis=(-1, -2))
    fields = {"strips": strips[known], "colors": colours[known], "radii": radii[known]}
    return Rows(path, rr.LineStrips3D, known.sum(axis=1), fields)


def ellipsoid_rows(
    path: str, positions_m: Float[np.ndarray, "frame joint 3"], covariance_m2: Float[np.ndarray, "frame joint 3 3"]
) -> Rows:
    """The regions that hold a joint with a probability of 90 %."""
    known = np.isfinite(positions_m).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-1, -2))
    variances_m2, axes = np.linalg.eigh(covariance_m2[known])
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    fields = {
        "centers": positions_m[known],
        "half_sizes": SIGMAS_90 * np.sqrt(np.maximum(variances_m2, 0.0)),
        "quaternions": _quaternions_xyzw(axes),
    }
    return Rows(path, rr.Ellipsoids3D, known.sum(axis=1), fields)


def _quaternions_xyzw(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotations).as_quat() if len(rotations) else np.zeros((0, 4))


def scalar_rows(path: str, values: Float[np.ndarray, "frame ..."]) -> Rows:
    """One number per frame, or one per frame and series; NaN is a gap in the plot."""
    per_frame = int(np.prod(values.shape[1:]))
    return Rows(path, rr.Scalars, np.full(len(values), per_frame), {"scalars": values.reshape(-1)})


def status_rows(path: str, status: np.ndarray, before: int = Status.OBSERVED) -> Rows:
    """The status (T,) of a joint. Observed is shown as a gap: one sees at a glance when a joint was missing."""
    names = np.array(["" if each == Status.OBSERVED else each.name.lower() for each in sorted(Status)])
    return change_rows(path, names[status], str(names[before]))


def change_rows(path: str, states: np.ndarray, before: str = "") -> Rows:
    """The frames in which a state changes, and the new state.

    Args:
        path: of the entity.
        states: (T,) names; an empty one is a gap.
        before: that of the frame before the first.
    """
    changes = np.flatnonzero(states != np.concatenate([[before], states[:-1]]))
    fields = {"state": states[changes].tolist()}
    return Rows(path, rr.StateChange, np.ones(len(changes), dtype=int), fields, changes)


def log_rows(
    path: str, texts: list[str], levels: list[str], colours: list[Colour], frames: Int[np.ndarray, " text"]
) -> Rows:
    """Lines of a log, in the frames whose index is given."""
    fields = {"text": texts, "level": levels, "color": colours}
    return Rows(path, rr.TextLog, np.ones(len(texts), dtype=int), fields, frames)


def document_rows(path: str, texts: list[str]) -> Rows:
    """One Markdown page per frame."""
    fields = {"text": texts, "media_type": [rr.MediaType.MARKDOWN] * len(texts)}
    return Rows(path, rr.TextDocument, np.ones(len(texts), dtype=int), fields)
