"""The study file: which recordings there are, what is done with each, and with what."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from fgpose.config import Config, checked_fields, parse_toml
from fgpose.geometry.up_axis import UpChoice
from fgpose.monocular.networks.devices import Device
from fgpose.plain_files import naming, read_settings
from fgpose.study.pattern import Pattern

Calibrate = Literal["given", "refine", "refine-poses", "refine-clocks", "people"]
Format = Literal["trc", "c3d", "mot", "bvh", "npz", "csv"]


@dataclass(frozen=True)
class Data:
    """Where the recordings are. Paths are relative to the study file."""

    layout: Literal["folders", "pose2sim"] = "folders"
    """folders: as the patterns say. pose2sim: every folder below root that has one of Pose2Sim's names for keypoints
    or videos is a trial; the folder that has the calibration is its session, what lies between is the subject."""
    root: str = "."
    keypoints: tuple[str, ...] = ()
    """Patterns with {subject}, {session}, {trial} and *. In pose2sim: names of the folder, the preferred first."""
    videos: tuple[str, ...] = ()
    """The same for folders of videos, instead of keypoints."""
    calibration: str = ""
    """Pattern of the calibration, with names of the recording. In pose2sim it is found by itself."""
    skeleton: str = ""
    """What the joints of the keypoints are: a name, or a TOML file; not needed where each file says it. Of videos it is
    that of the network."""
    fps: float | None = None
    """Frames per second, where the files do not say."""
    unit: str = "auto"
    """Of the lengths in the calibrations: m, cm, mm, inch, or how many metres it is, as a text."""
    points3d_frame: Literal["camera", "world"] = "camera"
    points3d_unit: Literal["mm", "m"] = "mm"
    cameras: tuple[str, ...] = ()
    """Use these only; all by default."""
    min_confidence: float = 0.0
    """Detections of less confidence are taken for missing."""
    exclude: tuple[str, ...] = ()
    """Patterns of subject/session/trial that are left out, as "S03/*/*"."""
    events: str = ""
    """CSV or TSV table with a column event, a column time_s and some of subject, session, trial."""


@dataclass(frozen=True)
class StudySteps:
    """What is done with each recording."""

    calibrate: Calibrate = "given"
    """given: the calibration is used as it is. refine: camera poses and clocks are refined on each recording;
    refine-poses, refine-clocks: one of them. people: the cameras are calibrated from the people in it."""
    people: Literal["auto", "all", "1"] = "auto"
    """all: tell everybody apart. 1: the person who is seen most. auto: all where an image shows more than one."""
    angles: bool = True
    """Joint angles, speeds and heights."""
    report: bool = False
    """A page (HTML) of each recording, about 1 MB; `fgpose report` makes those that are missing."""
    formats: tuple[Format, ...] = ("trc",)
    """Written beside the parquet files: trc and mot for OpenSim, bvh for Blender, c3d with segment rotations, csv for
    spreadsheets."""
    synchronise: bool = False
    """The cameras were started by hand: when each began is found in every recording, from the motion. Where people
    calibrate the cameras it is always."""
    world_up: UpChoice = "auto"
    """Axis of the calibration's world that points up; auto: as people and cameras of each recording stand."""


@dataclass(frozen=True)
class DetectionSettings:
    """The network that looks at videos."""

    model: str = "blazepose-full"
    network: Literal["blazepose", "rtmpose", "rtmw3d", "metrabs"] = "blazepose"
    detector: str = ""
    max_people: int = 8
    device: Device | None = None
    """Where it runs: cpu, or what fgpose models list shows on every machine of the study. By default as
    parameters.monocular.device."""


@dataclass(frozen=True)
class FromPeople:
    """What is known where the cameras are calibrated from people."""

    intrinsics: str = ""
    """Calibration with a board; by default focal lengths are estimated."""
    trial: str = ""
    """The trial of each session on which its cameras are calibrated, as "walk" or "walk*": the first that matches. The
    other trials have its cameras, and starts of their own. By default each recording calibrates its own cameras."""
    stature_m: float | None = None
    """Of whoever walks there."""
    synchronised: bool = False
    """All cameras begin each recording at the same moment."""


@dataclass(frozen=True)
class Resources:
    """What the study may use."""

    workers: int | None = None
    """Processes on this machine; by default one for each core."""
    memory_gb: float | None = None
    """Of each worker. One that takes more is stopped and its recording tried once more, then given up. By default the
    machine's memory is divided among its cores."""


@dataclass(frozen=True, kw_only=True)
class _Tables:
    """The tables of the file."""

    data: Data = Data()
    steps: StudySteps = StudySteps()
    detect: DetectionSettings = DetectionSettings()
    from_people: FromPeople = FromPeople()
    resources: Resources = Resources()
    parameters: Config = field(default_factory=Config)


@dataclass(frozen=True, kw_only=True)
class _File(_Tables):
    """The keys of the file."""

    name: str = ""
    output: str = ""


@dataclass(frozen=True, kw_only=True)
class StudyDescription(_Tables):
    """A study, as its file describes it."""

    name: str
    root: Path
    """Absolute."""
    output: Path
    """Absolute."""
    base: Path = Path()
    """Folder of the study file, to which its other paths are relative."""
    file_name: str = ""
    """Of the study file."""

    def __post_init__(self) -> None:
        _check(self)

    def file(self, text: str) -> Path:
        """A path of the study file."""
        return self.base / text


def load_study(path: str | Path) -> StudyDescription:
    """A study from its TOML file. What it does not name keeps its default.

    Raises:
        ValueError: the file is not TOML, names an unknown key (the nearest known one is suggested), gives a value of a
            wrong kind, or what it says cannot be; the message names the file and the key.
        OSError: the file cannot be read.
    """
    path = Path(path)
    with naming(path):
        return study_of(parse_toml(read_settings(path)), path)


def study_of(table: dict[str, Any], path: Path) -> StudyDescription:
    """A study from the tables of a file at this path. Raises ValueError as load_study does."""
    if "scheduler" in (table.get("resources") or ()):
        # What it sends is unpickled, so that whoever wrote the file could run anything here.
        raise ValueError(
            "resources.scheduler: a study file cannot name a scheduler, which may run anything on this machine; leave "
            "it out, and if you trust that host, give it on the command line: --scheduler tls://host:8786"
        )
    given = _File(**checked_fields(_File, table, ""))
    base = path.absolute().parent
    name = given.name or path.stem
    return StudyDescription(
        name=name,
        root=(base / given.data.root).resolve(),
        output=(base / (given.output or f"out/{name}")).absolute(),
        base=base,
        file_name=path.name,
        **{table.name: getattr(given, table.name) for table in fields(_Tables)},
    )


def _check(study: StudyDescription) -> None:
    data, of_people = study.data, study.steps.calibrate == "people"
    if study.from_people.trial and not of_people:
        raise ValueError('from_people.trial goes with steps.calibrate = "people"')
    if study.steps.synchronise and of_people:
        raise ValueError(
            'steps.synchronise: where people calibrate the cameras (steps.calibrate = "people") their starts are found '
            "anyway; leave it out"
        )
    if data.keypoints and data.videos:
        raise ValueError("data.keypoints and data.videos: a study begins from one of them; leave the other out")
    if data.layout == "folders":
        _check_patterns(data, of_people)
    elif data.calibration:
        raise ValueError("data.calibration: the layout pose2sim finds it by itself; leave it out")
    _check_values(study)


def _check_values(study: StudyDescription) -> None:
    """What every recording would fail for."""
    from fgpose.calibration.from_people.world.scale import check_stature
    from fgpose.io.calibration.calibrated_view import metres_per_unit
    from fgpose.io.skeletons import load_skeleton
    from fgpose.observations import check_confidence

    with naming("data.min_confidence"):
        check_confidence(study.data.min_confidence)
    with naming("data.unit"):
        metres_per_unit(study.data.unit)
    if study.from_people.stature_m is not None:
        with naming("from_people.stature_m"):
            check_stature(study.from_people.stature_m)
    if study.data.skeleton:
        load_skeleton(skeleton_of(study))


def skeleton_of(study: StudyDescription) -> str | Path:
    """Name of the skeleton of keypoints, or its file."""
    file = study.file(study.data.skeleton)
    return file if file.is_file() else study.data.skeleton


def _check_patterns(data: Data, of_people: bool) -> None:
    patterns = data.keypoints or data.videos
    if not patterns:
        raise ValueError(
            'data.keypoints is missing: a pattern as "{subject}/{session}/{trial}.parquet"; or data.videos'
        )
    key = "keypoints" if data.keypoints else "videos"
    for text in patterns:
        known = Pattern.parse(text, f"data.{key}").placeholders
        if not known:
            raise ValueError(f"data.{key}: {text!r} has none of {{subject}}, {{session}}, {{trial}}")
        if data.calibration:
            unknown = Pattern.parse(data.calibration, "data.calibration").placeholders - known
            if unknown:
                raise ValueError(f"data.calibration: {{{min(unknown)}}} is not in data.{key} {text!r}")
    if not data.calibration and not of_people:
        raise ValueError(
            'data.calibration is missing: a pattern as "{subject}/{session}/Calib.toml"; or steps.calibrate = "people"'
        )
