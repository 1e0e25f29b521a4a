"""Motion files of OpenSim, read."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def read_mot(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Coordinates by name, and the times."""
    lines = path.read_text().splitlines()
    names, *rows = (line.split("\t") for line in lines[lines.index("endheader") + 1 :])
    table = np.array(rows, dtype=float)
    return dict(zip(names[1:], table[:, 1:].T, strict=True)), table[:, 0]
