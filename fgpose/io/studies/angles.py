"""Joint angles of a recording as one long table, which a data set of many recordings can be made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from fgpose.io.tables import nullable, write_table

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Angles of one person."""

    names: tuple[str, ...]
    time_s: Float[np.ndarray, " frame"]
    angle_deg: Float[np.ndarray, "frame angle"]
    sigma_deg: Float[np.ndarray, "frame angle"]


def write_angles(people: Mapping[int, AngleTable], path: Path) -> None:
    """Write one row per person, frame and angle: time_s, person, angle (its name), angle_deg, sigma_deg; what is not
    known is null. Raises OSError, which names the file, if it cannot be written."""
    import pyarrow as pa

    tables = [_table(person, angles) for person, angles in people.items()]
    write_table(path, pa.concat_tables(tables).combine_chunks())


def _table(person: int, angles: AngleTable) -> pa.Table:
    import pyarrow as pa

    n_frames, n_angles = angles.angle_deg.shape
    name = np.tile(np.arange(n_angles, dtype=np.int32), n_frames)
    return pa.table(
        {
            "time_s": pa.array(np.repeat(np.asarray(angles.time_s, dtype=float), n_angles)),
            "person": pa.array(np.full(n_frames * n_angles, person, dtype=np.int32)),
            "angle": pa.DictionaryArray.from_arrays(name, list(angles.names)).cast(pa.string()),
            "angle_deg": nullable(angles.angle_deg.ravel()),
            "sigma_deg": nullable(angles.sigma_deg.ravel()),
        }
    )
