"""Films with the estimated people drawn into the images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.cli.console import new_console, print_written, progress_bar
from fgpose.cli.options import CameraChoice
from fgpose.geometry.up_axis import UpChoice
from fgpose.io.atomic import check_replaceable
from fgpose.sampling import TimeRange

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig

_GRID_WIDTH_PX = 1920


@dataclass(frozen=True, kw_only=True)
class Overlay(CameraChoice):
    """Draw a result into the videos that it was made from: skeletons, and an ellipse in which each joint is with 95 %.

    Each person has a colour and, if there are several, a number. Joints that are predicted, because fewer than two
    cameras see them, are hollow, and their bones dashed. All cameras are in one film, side by side at the rate of the
    fastest; with --each every camera has its own, at the times of its images.

    Example: fgpose overlay out/pose.parquet videos/ -o overlay.mp4
    """

    file: Positional[Path]
    """The result: a trajectory file in any of the formats that fgpose writes."""
    videos: Positional[Path]
    """Folder with one video per camera (cam01.mp4), or one folder per camera with its images."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")] = Path("overlay.mp4")
    """The film, MP4 (H.264). With --each, NAME_CAMERA.mp4 of each camera."""
    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: the one in the result)")] = None
    """Calibration of the cameras. Parquet files of fgpose hold theirs."""
    each: Annotated[bool, FlagCreatePairsOff] = False
    """A film of each camera."""
    width_px: Annotated[
        int | None,
        arg(
            name="width",
            metavar="PX",
            help_behavior_hint=f"(default: {_GRID_WIDTH_PX}; with --each that of the images)",
        ),
    ] = None
    """Width of a film."""
    ellipses: bool = True
    """Show how well joints are known."""
    from_s: Annotated[float | None, arg(name="from", metavar="S", help_behavior_hint="(default: beginning)")] = None
    """Only what is later: a time of the result, seconds."""
    to_s: Annotated[float | None, arg(name="to", metavar="S", help_behavior_hint="(default: end)")] = None
    """Only what is earlier."""
    fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: of the videos)")] = None
    """Frames per second, of images; for videos it overrides what they say. As it was for the result."""
    world_up: UpChoice = "auto"
    """What is up in the world of the result, or of its cameras: +x, -x, +y, -y, +z or -z."""

    def run(self) -> None:
        from fgpose.io.trajectories import load_upright
        from fgpose.monocular.sources import open_sources
        from fgpose.overlay.drawing import Drawing
        from fgpose.overlay.film import check_films, film_of_all, film_of_each, shown

        check_films()
        if self.width_px is not None and self.width_px < 2:
            raise ValueError(f"--width must be 2 px at least, got {self.width_px}")
        wanted = TimeRange(-np.inf if self.from_s is None else self.from_s, np.inf if self.to_s is None else self.to_s)
        rig = self._rig()
        people, up_R_world = load_upright(self.file, self.world_up, rig)
        sources = open_sources(self.videos, rig.turned(up_R_world), fps=self.fps, cameras=self.cameras)
        paths = [self.output.with_stem(f"{self.output.stem}_{name}") for name in sources.rig.names]
        paths = paths if self.each else [self.output]
        for path in paths:
            check_replaceable(path)
        cameras = shown(sources, people)
        skeleton = next(iter(people.values())).skeleton
        drawing = Drawing(skeleton, ellipses=self.ellipses, numbers=len(people) > 1)
        with progress_bar("drawing", "images") as progress:
            if self.each:
                film_of_each(cameras, paths, drawing, wanted, self.width_px, progress)
            else:
                film_of_all(cameras, self.output, drawing, wanted, self.width_px or _GRID_WIDTH_PX, progress)
        print_written(new_console(), *paths)

    def _rig(self) -> CameraRig:
        from fgpose.io.calibration import load_rig
        from fgpose.io.trajectories import load_origin

        if self.rig is not None:
            return load_rig(self.rig, unit=self.unit)
        origin = load_origin(self.file)
        if origin is None or origin.rig is None:
            raise ValueError(f"{self.file} does not hold the calibration of its cameras; give it with --rig")
        return origin.rig
