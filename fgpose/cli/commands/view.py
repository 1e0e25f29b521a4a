"""Looking at results: in the Rerun viewer, and as films."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.child_process import run_program
from fgpose.cli.console import new_console, print_written, progress_bar
from fgpose.cli.options import CameraChoice
from fgpose.cli.viewers import WebAddress, has_display, rerun_program, warn_if_others_reach
from fgpose.geometry.up_axis import UpChoice
from fgpose.plain_files import naming, open_plain
from fgpose.sampling import TimeRange

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig
    from fgpose.io.origin import Origin
    from fgpose.trajectory import Trajectory

_RRD_START = b"RRF"
_GRID_WIDTH_PX = 1920


@dataclass(frozen=True, kw_only=True)
class View:
    """Open the Rerun viewer on a .rrd file or on a result.

    Example: fgpose view out/demo.rrd; or, of a long recording, fgpose view out/pose.parquet --from 600 --to 660
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """A .rrd file, or a trajectory file in any of the formats that fgpose writes."""
    from_s: Annotated[float | None, arg(name="from", metavar="S", help_behavior_hint="(default: beginning)")] = None
    """Show only what is later: a time of the recording, seconds; of live recordings since their beginning.
    Frames of a trajectory file are then counted from there."""
    to_s: Annotated[float | None, arg(name="to", metavar="S", help_behavior_hint="(default: end)")] = None
    """Show only what is earlier."""
    web: bool = False
    """Show it in a browser instead of a window of its own. Ctrl-C ends."""
    host: str = "127.0.0.1"
    """Address of this computer at which --web serves it; 0.0.0.0 lets everybody in the network see it."""
    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Calibration of the cameras, to be shown with a trajectory file."""
    world_up: UpChoice = "auto"
    """What is up in the world of a trajectory file, or of its cameras: +x, -x, +y, -y, +z or -z; auto: as its format
    says, unless people and cameras stand otherwise."""

    def run(self) -> None:
        with open_plain(self.file) as file:
            is_rrd = file.read(len(_RRD_START)) == _RRD_START
        if is_rrd and self.from_s is None and self.to_s is None:
            self._open(self.file)
            return
        wanted = _time_range(self.from_s, self.to_s)
        with tempfile.TemporaryDirectory(prefix="fgpose-") as folder:
            self._open(self._rrd_part(wanted, Path(folder)) if is_rrd else self._made_rrd(wanted, Path(folder)))

    def _rrd_part(self, wanted: TimeRange, folder: Path) -> Path:
        rerun_program()  # says how to install it
        from fgpose.viewer.rerun.rrd_part import rrd_part

        return rrd_part(self.file, wanted, folder)

    def _made_rrd(self, wanted: TimeRange, folder: Path) -> Path:
        """A .rrd file of a trajectory file."""
        from fgpose.io.calibration import load_rig
        from fgpose.io.trajectories import load_upright
        from fgpose.pipeline import Outputs
        from fgpose.viewer.onlooker import with_rig

        given = load_rig(self.rig) if self.rig is not None else None
        people, up_R_world = load_upright(self.file, self.world_up, given)
        with naming(self.file):
            people = _between(people, wanted)
        skeleton = next(iter(people.values())).skeleton
        rig, people = with_rig(given.turned(up_R_world) if given is not None else None, people)
        outputs = Outputs(folder, self.file.stem, ("rrd",), "z")
        time_s = np.unique(np.concatenate([each.time_s for each in people.values()]))
        alone = (self.file.stem,) if len(people) == 1 else None
        every = outputs.shown_every(time_s)
        if every > 1:
            new_console(stderr=True).print(
                f"one frame in {every} of {len(time_s)} is shown; --from and --to show all frames of a part"
            )
        with outputs.open_recording(rig, skeleton, alone, time_s) as recording:
            for person, trajectory in people.items():
                if alone:
                    recording.log_trajectory(self.file.stem, trajectory)
                else:
                    recording.log_person(person, trajectory, int(np.searchsorted(time_s, trajectory.time_s[0])))
        return outputs.rrd

    def _open(self, path: Path) -> None:
        if not self.web and not has_display():
            raise OSError(
                f"no display to open a window on. In a browser: fgpose view {self.file} --web. "
                "Or copy the .rrd file to a computer with a display and open it there with rerun"
            )
        # Without --bind Rerun listens at all addresses, a window too.
        code = self._serve(path) if self.web else run_program([rerun_program(), str(path), "--bind", "127.0.0.1"])
        if code:
            raise OSError(f"the viewer ended with code {code}")

    def _serve(self, path: Path) -> int:
        """To browsers, until Ctrl-C. That is how it ends, so it is not an error."""
        program = rerun_program()
        warn_if_others_reach(self.host, "--host", "the recording, with its pictures")
        served = WebAddress.free(self.host)
        ports = ["--port", str(served.data_port), "--web-viewer-port", str(served.page_port)]
        try:
            with served.said_when_reached():
                return run_program([program, str(path), "--bind", self.host, "--web-viewer", *ports])
        except KeyboardInterrupt:
            return 0


def _time_range(from_s: float | None, to_s: float | None) -> TimeRange:
    """None: from the beginning, to the end."""
    return TimeRange(-np.inf if from_s is None else from_s, np.inf if to_s is None else to_s)


def _between(people: dict[int, Trajectory], wanted: TimeRange) -> dict[int, Trajectory]:
    """Those who are there in that time, in its frames. Raises ValueError if no frame is."""
    wanted.of(np.unique(np.concatenate([each.time_s for each in people.values()])))
    there = {n: wanted.contains(each.time_s) for n, each in people.items()}
    return {n: each.frames(there[n]) for n, each in people.items() if there[n].any()}


@dataclass(frozen=True, kw_only=True)
class Overlay(CameraChoice):
    """Draw a result into the videos that it was made from.

    Skeletons, and an ellipse in which each joint is with 95 %. Each person has a colour and, if there are several, a
    number. Joints that are predicted, because fewer than two cameras see them, are hollow, and their bones dashed. All
    cameras are in one film, side by side at the rate of the fastest; with --each every camera has its own, at the times
    of its images.

    Example: fgpose overlay out/pose.parquet videos/ -o overlay.mp4
    """

    file: Annotated[Positional[Path], arg(metavar="RESULT")]
    """The result: a trajectory file in any of the formats that fgpose writes."""
    videos: Annotated[Positional[Path], arg(metavar="VIDEOS")]
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
        from fgpose.io.made_by import check_result
        from fgpose.io.trajectories import load_origin, load_upright
        from fgpose.monocular.common_times import CommonTimes
        from fgpose.monocular.sources import open_sources
        from fgpose.overlay.drawing import Drawing
        from fgpose.overlay.film import check_films, film_of_all, film_of_each, shown
        from fgpose.pipeline.origin import warn_of_other_videos

        check_films()
        if self.output.suffix.lower() != ".mp4":
            raise ValueError(f"{self.output}: a film is written as .mp4")
        if self.width_px is not None and self.width_px < 2:
            raise ValueError(f"--width must be 2 px at least, got {self.width_px}")
        wanted = _time_range(self.from_s, self.to_s)
        if self.file.is_dir() and self.videos.is_file():
            raise ValueError(
                f"{self.file} is a folder; first comes the result, then the videos: "
                f"fgpose overlay {self.videos} {self.file}"
            )
        origin = load_origin(self.file)
        rig = self._rig(origin)
        people, up_R_world = load_upright(self.file, self.world_up, rig)
        # A result may be of some of the cameras that filmed.
        cameras = self.cameras or (rig.names if self.rig is None else ())
        sources = open_sources(self.videos, rig.turned(up_R_world), fps=self.fps, cameras=cameras)
        warn_of_other_videos(origin, sources.clips)
        paths = [self.output.with_stem(f"{self.output.stem}_{name}") for name in sources.rig.names]
        paths = paths if self.each else [self.output]
        for path in paths:
            check_result(path, "overlay", (self.file, self.rig, *(clip.path for clip in sources.clips)))
        views = shown(sources, people)
        with naming(self.file):
            CommonTimes.of(people, [view.taken_s for view in views], sources.fps).check(self.file, wanted)
        skeleton = next(iter(people.values())).skeleton
        drawing = Drawing(skeleton, ellipses=self.ellipses, numbers=len(people) > 1)
        with progress_bar("drawing", "images") as progress:
            if self.each:
                film_of_each(views, paths, drawing, wanted, self.width_px, progress)
            else:
                film_of_all(views, self.output, drawing, wanted, self.width_px or _GRID_WIDTH_PX, progress)
        print_written(new_console(), *paths)

    def _rig(self, origin: Origin | None) -> CameraRig:
        from fgpose.io.calibration import load_rig

        if self.rig is not None:
            return load_rig(self.rig, unit=self.unit)
        if origin is None or origin.rig is None:
            raise ValueError(f"{self.file} does not hold the calibration of its cameras; give it with --rig")
        return origin.rig
