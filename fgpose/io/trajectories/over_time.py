"""What is known over time as a table: of trajectories, joint angles and speeds, long and wide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from fgpose.io.tables import FRAME, TIME_S, Column, nullable
from fgpose.io.trajectories.kinematics import quantities_table
from fgpose.io.trajectories.result_table import AXES, numbered, result_tables
from fgpose.kinematics.quantities import Quantities
from fgpose.trajectory import Trajectory

if TYPE_CHECKING:
    import pyarrow as pa
WIDE_RESULT = (
    FRAME,
    TIME_S,
    Column("<joint>_x_m <joint>_y_m <joint>_z_m", "m", "position"),
    Column(
        "<joint>_sigma_x_m <joint>_sigma_y_m <joint>_sigma_z_m",
        "m",
        "standard deviations, where there is a covariance",
    ),
)
WIDE_ANGLES = (
    FRAME,
    TIME_S,
    Column("<angle>_deg", "deg", "the angle"),
    Column("<angle>_sigma_deg", "deg", "its standard deviation"),
)
WIDE_SPEEDS = (
    FRAME,
    TIME_S,
    Column(
        "<joint>_speed_m_s",
        "m/s",
        "the speed, also of `centre`, the root of the body, over the two steps around a frame; not known in a gap "
        "and beside it, where frames are missing too",
    ),
)


def table_over_time(shown: Trajectory | Quantities, form: Literal["long", "wide"]) -> pa.Table:
    """One row for each frame and joint, angle or speed, as in the files of fgpose (long), or for each frame (wide).

    Raises:
        ValueError: the form is another.
    """
    match form:
        case "long":
            return quantities_table(shown) if isinstance(shown, Quantities) else _long(shown)
        case "wide":
            return _wide(shown)
    raise ValueError(f"a table is long or wide, not {form!r}")


def _long(trajectory: Trajectory) -> pa.Table:
    import pyarrow as pa

    tables = result_tables({0: trajectory}, {0: numbered(trajectory)})
    return pa.concat_tables(tables).unify_dictionaries()


def _wide(shown: Trajectory | Quantities) -> pa.Table:
    import pyarrow as pa

    time_s = np.asarray(shown.time_s, dtype=float)
    columns = {"frame": pa.array(numbered(shown).astype(np.int32)), "time_s": pa.array(time_s)}
    values = _of_quantities(shown) if isinstance(shown, Quantities) else _of_joints(shown)
    return pa.table(columns | {name: nullable(column) for name, column in values.items()})


def _of_joints(trajectory: Trajectory) -> dict[str, np.ndarray]:
    columns = {}
    for joint, name in enumerate(trajectory.skeleton.joints):
        columns |= {f"{name}_{each}_m": trajectory.positions_m[:, joint, axis] for axis, each in enumerate(AXES)}
        if trajectory.covariance_m2 is not None:
            sigma_m = np.sqrt(np.diagonal(trajectory.covariance_m2[:, joint], axis1=1, axis2=2))
            columns |= {f"{name}_sigma_{each}_m": sigma_m[:, axis] for axis, each in enumerate(AXES)}
    return columns


def _of_quantities(quantities: Quantities) -> dict[str, np.ndarray]:
    columns, sigma = {}, quantities.sigma
    for index, name in enumerate(quantities.names):
        columns[f"{name}_{quantities.suffix}"] = quantities.value[:, index]
        if sigma is not None:
            columns[f"{name}_sigma_{quantities.suffix}"] = sigma[:, index]
    return columns
