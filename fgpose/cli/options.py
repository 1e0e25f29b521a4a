"""Options that several commands share. The docstrings are what --help prints."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from fgpose.config import Config

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.pipeline import Outputs, Progress, Source

Format = Literal["parquet", "npz", "trc", "c3d", "rrd"]

# As help and not as docstrings: tyro keeps the line breaks of the latter.
_KEYPOINTS = (
    "Detected joints: a folder that holds for each camera a folder of JSON files (OpenPose, MMPose) or one file "
    "(MMPose, COCO, MeTRAbs); or one file of fgpose (npz, parquet)."
)
_SKELETON = (
    "What the joints are: body_25, body_25b, coco_17, halpe_26, h36m_17, h36m_17_lt, blazepose_33, smpl_24, or your "
    "own TOML file."
)


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """Where a recording is, and its skeleton, rate and units."""

    keypoints: Annotated[Positional[Path], arg(help=_KEYPOINTS)]
    rig: Annotated[Path, arg(metavar="FILE")]
    """Calibration of the cameras: Pose2Sim or aniposelib TOML, Qualisys .qca.txt, OpenCV YAML, fgpose npz."""
    skeleton: Annotated[str, arg(metavar="NAME|FILE", help=_SKELETON)]
    fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: from the file)")] = None
    """Frames per second. Needed unless the keypoints file contains times."""
    unit: Literal["auto", "m", "mm"] = "auto"
    """Unit of the lengths in the calibration file; auto takes what its format prescribes."""
    points3d_frame: Literal["camera", "world"] = "camera"
    """Frame of the 3D joints of each view, where the keypoints have them."""
    points3d_unit: Literal["mm", "m"] = "mm"
    """Unit of the 3D joints of each view, where the keypoints have them."""
    cameras: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Use these cameras only."""
    frames: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Use only this many frames, from the beginning."""

    def load(self) -> Source:
        """Read the recording. Raises ValueError and OSError as pipeline.load_source."""
        from fgpose.pipeline import load_source

        source = load_source(
            self.keypoints,
            self.rig,
            self.skeleton,
            cameras=self.cameras,
            fps=self.fps,
            unit=self.unit,
            points3d_frame=self.points3d_frame,
            points3d_unit=self.points3d_unit,
        )
        return first_frames(source, self.frames)


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go."""

    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))] = Path("out")
    """Folder for the results; it is made if it is absent."""
    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: that of the input)")] = None
    """Name of the result files, without extension."""
    formats: tuple[Format, ...] = ("parquet", "trc", "rrd")
    """What to write: parquet and npz keep everything, trc (OpenSim) and c3d keep positions, rrd is for the viewer."""
    world_up: Literal["z", "y"] = "z"
    """Axis of the calibration's world that points up."""
    live: bool = False
    """Let viewers connect while it runs (it says how) and until you press Ctrl-C. Opens no window."""
    port: Annotated[int, arg(metavar="PORT")] = 9876
    """Where viewers connect with --live; 0 takes any free one."""

    def outputs(self, source: Path) -> Outputs:
        from fgpose.pipeline import Outputs

        # dict: each format once.
        formats = tuple(dict.fromkeys(self.formats))
        port = self.port if self.live else None
        name = self.name or Path(os.path.realpath(source)).stem
        return Outputs(self.output, name, formats, self.world_up, port)


@dataclass(frozen=True, kw_only=True)
class ParameterOptions(OutputOptions):
    """How the motion is estimated."""

    config: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """TOML file of parameters, as those in configs/. Options given here override what it says."""
    parameters: Annotated[Config, arg(name="")] = field(default_factory=Config)
    """All parameters, with their units."""
    refine_calibration: bool = False
    """First refine the poses of the cameras on the person (--calibration.*). Writes the new calibration as
    NAME_calibration.toml."""
    estimate_time_offsets: bool = False
    """First estimate the time offset of each camera from the motion. The offsets are written with the calibration, as
    NAME_calibration.toml. With --refine-calibration both are estimated together."""


def first_frames(source: Source, frames: int | None) -> Source:
    """The beginning of a recording. Raises ValueError unless the number is positive."""
    from fgpose.pipeline import Source

    if frames is None:
        return source
    if frames < 1:
        raise ValueError(f"--frames must be at least 1, got {frames}")
    return Source(source.rig, source.observations.frames(slice(0, frames)))


def new_console(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: file names in brackets are no markup."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False)


@contextmanager
def progress_bar(task: str, unit: str = "frames") -> Iterator[Progress]:
    """A progress bar on stderr, so that what is printed can be piped."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<18}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*columns, console=new_console(stderr=True)) as bar:
        number = bar.add_task(task, total=None)
        yield lambda done, total: bar.update(number, completed=done, total=total)
