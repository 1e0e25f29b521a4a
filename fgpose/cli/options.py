"""Options that several commands share. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

from tyro.conf import Positional, arg

from fgpose.config import Config
from fgpose.geometry.up_axis import UpChoice
from fgpose.io.names import recording_name
from fgpose.parameters import Device

if TYPE_CHECKING:
    from fgpose.association.chosen_person import PersonRegion
    from fgpose.calibration.moved_views import Recording
    from fgpose.pipeline import AnySource, Outputs, Source

Format = Literal["parquet", "npz", "csv", "trc", "c3d", "rrd"]
DEFAULT_FORMATS: tuple[Format, ...] = ("parquet", "trc", "rrd")
"""What is written; the last only where Rerun is installed."""

# As help and not as docstrings: tyro keeps the line breaks of the latter.
_KEYPOINTS = (
    "Detected joints: a folder that holds for each camera a folder of JSON files (OpenPose, MMPose) or one file "
    "(MMPose, COCO, AlphaPose, DeepLabCut, MeTRAbs), or either of SAM 3D Body or NLF; or a file of fgpose or FreeMoCap."
)
_SKELETON = (
    "What the joints are, where the keypoints do not say it: a name that fgpose skeletons lists (body_25, coco_17, "
    "halpe_26), or your own TOML file."
)
_PEOPLE = (
    "all: everybody, told apart. 1: the main person, who is seen most or, of those seen about as much, nearest to the "
    "cameras. auto: all where there are several."
)
# tyro would list None among the choices.
_DEVICE = arg(
    metavar=f"{{{','.join(get_args(Device))}}}", help_behavior_hint="(default: auto, or monocular.device of --config)"
)
DeviceChoice = Annotated[Device | None, _DEVICE]
"""Where networks run; None: not said."""
_MIN_CONFIDENCE = "Detections of less confidence are taken for missing."
_REGION = "Estimate one person: the one in this box in the first image of a camera, pixels, as cam01:400,200,300,900."


@dataclass(frozen=True, kw_only=True)
class RigOption:
    """The calibration that a command needs."""

    rig: Annotated[Path, arg(metavar="FILE")]
    """Calibration of the cameras: Pose2Sim, aniposelib or caliscope TOML, Qualisys .qca.txt, Vicon .xcp, OpenCV YAML,
    OpenCap pickles, bioCV .calib, JSON, fgpose npz."""


@dataclass(frozen=True, kw_only=True)
class CameraChoice:
    """Which cameras of a calibration are used, and in which unit it is."""

    unit: Annotated[str, arg(metavar="UNIT")] = "auto"
    """Unit of the lengths in the calibration file: m, dm, cm, mm, inch, ft, or how many metres it is (0.054: squares of
    a board of 54 mm); auto takes what the format prescribes."""
    cameras: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Use these cameras only."""


@dataclass(frozen=True, kw_only=True)
class WantedOptions:
    """Whom and what of a recording is wanted."""

    min_confidence: Annotated[float, arg(metavar="0..1", help=_MIN_CONFIDENCE)] = 0.0
    frames: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Use only this many frames, from the beginning."""
    people: Annotated[Literal["auto", "all", "1"], arg(help=_PEOPLE)] = "auto"
    person_region: Annotated[
        str | None, arg(metavar="CAMERA:X,Y,W,H", help=_REGION, help_behavior_hint="(default: none)")
    ] = None

    @property
    def region(self) -> PersonRegion | None:
        """Where the wanted person is, if that was said. Raises ValueError if everybody is wanted too."""
        from fgpose.association.chosen_person import PersonRegion

        if self.person_region is None:
            return None
        if self.people == "all":
            raise ValueError("--person-region asks for one person, --people all for everybody: leave one of them out")
        return PersonRegion.parse(self.person_region)


@dataclass(frozen=True, kw_only=True)
class KeypointOptions(CameraChoice, RigOption):
    """Where the keypoints and the calibration of a recording are, and their skeleton, rate and units."""

    keypoints: Annotated[Positional[Path], arg(metavar="KEYPOINTS", help=_KEYPOINTS)]
    skeleton: Annotated[
        str | None, arg(metavar="NAME|FILE", help=_SKELETON, help_behavior_hint="(default: as the keypoints say)")
    ] = None
    fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: from the file)")] = None
    """Frames per second. Needed unless the keypoints file contains times."""


@dataclass(frozen=True, kw_only=True)
class RecordingOptions(KeypointOptions, WantedOptions):
    """Where a recording is, and what of it is wanted."""

    points3d_frame: Literal["camera", "world"] = "camera"
    """Frame of the 3D joints of each view, where the keypoints have them."""
    points3d_unit: Literal["mm", "m"] = "mm"
    """Unit of the 3D joints of each view, where the keypoints have them."""

    def load(self) -> AnySource:
        """Read the recording: of everybody, or of one person, as is wanted and as many as there are. Raises ValueError
        and OSError as pipeline.load_source."""
        from fgpose.cli.console import new_console
        from fgpose.pipeline import load_source

        names = ("cameras", "fps", "unit", "points3d_frame", "points3d_unit", "min_confidence")
        reading: dict[str, Any] = {name: getattr(self, name) for name in names}
        files = self.keypoints, self.rig, self.skeleton
        people, n_frames = self.region or self.people, checked_frames(self.frames)
        with new_console(stderr=True).status("reading the recording"):
            source = load_source(*files, people=people, n_frames=n_frames, **reading)
        return self.prepared(source)

    def prepared(self, source: Source[Recording]) -> Source[Recording]:
        """What is done with a recording before anything else."""
        return source


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go."""

    step: ClassVar[str] = ""
    """Name of the command; a result of another is not replaced."""
    name_ends: ClassVar[str] = ""
    """What is added to the name of the input to be that of the results."""
    rrd_ends: ClassVar[str] = ""
    """The same for the .rrd file."""

    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))] = Path("out")
    """Folder for the results. What another command or recording left there is not replaced."""
    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: that of the input)")] = None
    """Name of the result files, without extension."""
    formats: Annotated[tuple[Format, ...], arg(metavar="FORMAT ...")] = DEFAULT_FORMATS
    """What to write: parquet and npz keep everything, csv has the table of parquet for spreadsheets, trc (OpenSim) and
    c3d keep positions, rrd is for the viewer."""
    rrd_fps: Annotated[
        float | None, arg(metavar="HZ", help_behavior_hint="(default: all, of a long recording 20,000 frames)")
    ] = None
    """Frames per second in the .rrd file and with --live. fgpose view --from --to shows all frames of a part."""
    world_up: UpChoice = "auto"
    """What is up in the world of the calibration: +x, -x, +y, -y, +z or -z; auto: as people and cameras stand."""
    live: bool = False
    """Let viewers connect while it runs (it says how) and until you press Ctrl-C. Opens no window."""
    port: Annotated[int, arg(metavar="PORT")] = 9876
    """Where viewers connect with --live; 0 takes any free one."""

    def outputs(self, source: Path) -> Outputs:
        from fgpose.pipeline import Outputs

        # dict: each format once.
        formats = possible_formats(tuple(dict.fromkeys(self.formats)))
        port = self.port if self.live else None
        name = self.name or f"{recording_name(source)}{self.name_ends}"
        of_step = {"step": self.step, "source": source, "shown_as": self.rrd_ends, "rrd_fps": self.rrd_fps}
        return Outputs(self.output, name, formats, self.world_up, port, **of_step)


@dataclass(frozen=True, kw_only=True)
class ParameterOptions(OutputOptions):
    """How the motion is estimated."""

    config: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """TOML file of parameters, as those in configs/. Options given here override what it says."""
    parameters: Annotated[Config, arg(name="")] = field(default_factory=Config)
    """All parameters, with their units."""
    strict: bool = False
    """End with exit code 3 if the result is probably wrong. It is written all the same."""
    refine_calibration: bool = False
    """First refine the poses of the cameras on all people together, and write them as NAME_calibration.toml."""
    estimate_time_offsets: bool = False
    """First estimate the time offset of each camera from the motion of all people together, and with
    --refine-calibration the poses at once; it is written there too."""


def possible_formats(formats: tuple[Format, ...]) -> tuple[Format, ...]:
    """What can be written of the formats that nobody chose; those that somebody did choose stay.

    Warns:
        UserWarning: there will be no file for the viewer.
    """
    from fgpose.cli.viewers import can_write_rrd

    if formats != DEFAULT_FORMATS or can_write_rrd():
        return formats
    return tuple(each for each in formats if each != "rrd")


def checked_frames(frames: int | None) -> int | None:
    """How many frames are wanted. Raises ValueError unless the number is positive."""
    if frames is not None and frames < 1:
        raise ValueError(f"--frames must be at least 1, got {frames}")
    return frames
