"""Trajectories, joint angles and speeds for other tools: as pandas tables, and as CSV."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fgpose.io.tables import write_csv
from fgpose.io.trajectories.over_time import table_over_time
from fgpose.kinematics.quantities import Quantities
from fgpose.trajectory import Trajectory

if TYPE_CHECKING:
    import pandas as pd

    from fgpose.shown import Form


def pandas_table(shown: Trajectory | Quantities, form: Form) -> pd.DataFrame:
    """See OverTime.to_pandas."""
    try:
        import pandas  # noqa: F401
    except ImportError:
        raise ImportError('to_pandas() needs pandas: pip install "fgpose[notebook]"') from None
    return table_over_time(shown, form).to_pandas()


def write_table_as_csv(shown: Trajectory | Quantities, path: Path, form: Form) -> None:
    """See OverTime.to_csv."""
    write_csv(path, [table_over_time(shown, form)])
