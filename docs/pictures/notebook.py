"""What a motion, observations and a rig show of themselves in a notebook: those of the recording of fgpose."""

from __future__ import annotations

from pathlib import Path

import fgpose
from fgpose.notebook.picture import strip, views
from fgpose.notebook.rig_picture import from_above

_START = Path(__file__).parents[1] / "start"


def main(folder: Path | None = None) -> None:
    """As SVG into a folder, docs/start by default."""
    rig, observations = fgpose.files.load_recording("balance_openpose")
    trajectory = fgpose.smooth(observations.crop(0.0, 1.0), rig)
    pictures = {"": strip(trajectory), "_observations": views(observations), "_rig": from_above(rig)}
    for name, picture in pictures.items():
        path = (folder or _START) / f"notebook{name}.svg"
        path.write_text(picture + "\n", encoding="utf-8")
        print(path)


if __name__ == "__main__":
    main()
