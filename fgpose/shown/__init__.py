"""How what a user holds shows itself and leaves for other tools.

The classes of the lower floors have the methods, fgpose.notebook does the work. It needs what lies between, tables and
viewer, and is imported when a method is called: this is the one module that asks for something above it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from fgpose.geometry.camera import CameraRig

Form = Literal["long", "wide"]
"""Of a table. long: one row for each frame and joint, or angle; wide: one row for each frame."""


class Shown:
    """Shows itself in a few lines, and in Jupyter as a table with a picture."""

    def __repr__(self) -> str:
        from fgpose.notebook.summaries import summary

        return summary(self).text()

    def _repr_html_(self) -> str:
        from fgpose.notebook.html import html
        from fgpose.notebook.summaries import summary

        return html(summary(self))


def by_names(wanted: object) -> list[str]:
    """What is asked for by several names. Raises TypeError for anything else, as the number of a frame."""
    names = list(wanted) if isinstance(wanted, list | tuple) else [wanted]
    if not all(isinstance(each, str) for each in names):
        frame = f"[{wanted}:{wanted + 1}]" if isinstance(wanted, int) else "[0:1]"
        raise TypeError(
            f"joints and angles are taken by name, frames as a slice, {frame}, or as .frames(mask); got {wanted!r:.40}"
        )
    return cast("list[str]", names)


class OverTime(Shown):
    """Numbers by name over time, which other tools read and plot."""

    def __len__(self) -> int:
        """The number of frames."""
        return len(cast(Any, self).time_s)

    def to_pandas(self, form: Form = "long") -> pd.DataFrame:
        """A pandas table, with the columns of to_csv.

        Raises:
            ImportError: pandas is not installed; the message says how to.
        """
        from fgpose.notebook.tables import pandas_table

        return pandas_table(cast(Any, self), form)

    def to_csv(self, path: str | Path, form: Form = "long") -> None:
        """Write a table as CSV; the file appears whole or not at all.

        Args:
            path: the file.
            form: long: one row for each frame and joint, or angle, with the columns that files of fgpose have.
                wide: one row for each frame, with frame, time_s and for each joint left_wrist_x_m, left_wrist_sigma_x_m
                and so on, or for each angle left_knee_flexion_deg and left_knee_flexion_sigma_deg.

        Raises:
            OSError: the file cannot be written.
        """
        from fgpose.notebook.tables import write_table_as_csv

        write_table_as_csv(cast(Any, self), Path(path), form)

    def plot(self, names: str | list[str] | tuple[str, ...] | None = None) -> np.ndarray:
        """Plot over time with matplotlib, in bands of two standard deviations.

        Args:
            names: of joints, or of angles; None: all.

        Returns:
            The axes: of a trajectory x, y and z, of angles one.

        Raises:
            ValueError: a name is unknown.
            ImportError: matplotlib is not installed; the message says how to.
        """
        from fgpose.notebook.plots import plot

        return plot(self, [names] if isinstance(names, str) else names)


class Motion(OverTime):
    """Joints over time, which the viewer shows too."""

    def show(self, rig: CameraRig | None = None, height_px: int = 600) -> Any:
        """Show it in a notebook: Rerun's viewer as a widget, with skeleton, covariances and errors. Of more than 5,000
        frames so many are shown, evenly spread.

        Args:
            rig: the cameras, to be shown too; None: none.
            height_px: of the widget, which is as wide as the notebook.

        Returns:
            The widget, which the notebook displays where it is the last of a cell.

        Raises:
            ImportError: Rerun or its widget is not installed; the message says how to.
            ValueError: there is no frame.
            TypeError: the rig is none.
        """
        from fgpose.notebook.viewer import show

        return show(cast(Any, self), rig, height_px)
