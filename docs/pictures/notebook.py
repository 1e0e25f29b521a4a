"""What a trajectory shows of itself in a notebook: some poses of the recording that comes with fgpose."""

from __future__ import annotations

from pathlib import Path

import fgpose
from fgpose.notebook.picture import strip

_START = Path(__file__).parents[1] / "start"


def main(folder: Path | None = None) -> None:
    """As SVG into a folder, docs/start by default."""
    rig, observations = fgpose.files.load_recording("balance_openpose")
    trajectory = fgpose.smooth(observations.crop(0.0, 1.0), rig)
    path = (folder or _START) / "notebook.svg"
    path.write_text(strip(trajectory) + "\n", encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
