"""Stage 1 on the command line: from videos to the joints that each camera saw."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from jaxtyping import Bool, Shaped
from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.cli.console import new_console, new_table, print_written, progress_bar
from fgpose.cli.options import CameraChoice, DeviceChoice, WantedOptions, checked_frames
from fgpose.io.names import recording_name
from fgpose.monocular.networks.devices import Device
from fgpose.observations import check_confidence

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.geometry.camera import CameraRig
    from fgpose.monocular.detected import Detected
    from fgpose.monocular.network import Network
    from fgpose.monocular.sources import Sources
    from fgpose.observations import Observations
    from fgpose.people_observations import PeopleObservations
    from fgpose.pipeline import AnySource, Outputs

# As help and not as docstrings: tyro keeps the line breaks of the latter.
_VIDEOS = (
    "Folder with one video per camera (cam01.mp4), or one folder per camera with its images. They begin at the same "
    "time, or as the calibration says (time_offset_s). Names are those of the calibration; case, underscores, hyphens "
    "and blanks do not count."
)
_FPS = (
    "Frames per second, of images: number n in a file's name is at n / fps. For videos it overrides what they say; "
    "they may have different rates."
)
_MODEL = (
    "blazepose-lite, blazepose-full or blazepose-heavy, the faster first, which are fetched at the first use; or an "
    "ONNX file, see --network."
)


@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Which network looks at images, and where what it finds is kept."""

    model: Annotated[str, arg(metavar="NAME|FILE", help=_MODEL)] = "blazepose-full"
    network: Literal["blazepose", "rtmpose", "rtmw3d", "metrabs"] = "blazepose"
    """Kind of network of the ONNX file given as --model."""
    detector: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: that of blazepose)")] = None
    """ONNX file that finds the people: YOLOX, needed for every network but blazepose."""
    skeleton: Annotated[str | None, arg(metavar="NAME|FILE", help_behavior_hint="(default: of the network)")] = None
    """Skeleton of the joints of a metrabs file."""
    max_people: Annotated[int, arg(metavar="N")] = 8
    """How many people to find in each image at most. More take longer; fewer than there are, and some are not
    estimated, or the one who is chosen is somebody else in some images."""
    device: DeviceChoice = None
    """Where the network runs; fgpose models list shows what is there, and what auto takes."""
    jobs: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one for each core)")] = None
    """How many cameras to work on at the same time."""
    cache: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: ~/.cache/fgpose/detections)")] = (
        None
    )
    """Where detections are kept, so that another run does not need the network again."""
    no_cache: Annotated[bool, FlagCreatePairsOff] = False
    """Neither keep detections nor use those that were kept."""

    @property
    def usual_device(self) -> Device:
        """Where the network runs if nothing else is said."""
        return "auto"

    def detect_in(self, sources: Sources, frames: int | None, console: Console) -> Detected:
        """All people in all images, with a progress bar."""
        from fgpose.monocular.detection import detect

        cache, network = self._cache_folder(), self.open_network()
        try:
            with progress_bar("detecting", "images") as progress:
                detected = detect(sources, network, cache=cache, jobs=self.jobs, frames=frames, progress=progress)
        except BaseException as error:
            if cache is not None:
                error.add_note(f"detections so far are kept in {cache}; the same command goes on from there")
            raise
        print_detected(console, detected, cache)
        return detected

    def open_network(self) -> Network:
        """The network, fetched if need be."""
        from fgpose.monocular.networks import open_network

        with new_console(stderr=True).status("opening the network") as status:
            return open_network(
                self.model,
                kind=self.network,
                detector=self.detector,
                skeleton=self.skeleton,
                max_people=self.max_people,
                device=self.device or self.usual_device,
                progress=status.update,
            )

    def _cache_folder(self) -> Path | None:
        from fgpose.monocular.downloads.cache import cache_folder

        return None if self.no_cache else self.cache or cache_folder() / "detections"


@dataclass(frozen=True, kw_only=True)
class VideoOptions(NetworkOptions, CameraChoice, WantedOptions):
    """Where videos are, and what is to be found in them."""

    videos: Annotated[Positional[Path], arg(metavar="VIDEOS", help=_VIDEOS)]
    fps: Annotated[float | None, arg(metavar="HZ", help=_FPS, help_behavior_hint="(default: of the videos)")] = None

    def sources(self) -> Sources:
        """The videos and their cameras."""
        raise NotImplementedError

    def with_rig(self, rig: Path) -> Sources:
        """The videos and the cameras of a calibration."""
        from fgpose.io.calibration import load_calibration_origin, load_rig
        from fgpose.monocular.sources import open_sources

        # It is needed when the result is written; if it is damaged, that is said before the work.
        load_calibration_origin(rig)
        return open_sources(self.videos, load_rig(rig, self.unit), fps=self.fps, cameras=self.cameras)

    def detect(self, console: Console) -> Detected:
        """All people in all images, with a progress bar. Everything is checked before the work begins."""
        quieten_decoder()
        check_confidence(self.min_confidence)  # before the work
        region = self.region
        sources = self.sources()
        if region is not None:
            sources.rig.subset([region.camera])
        return self.detect_in(sources, self.frames, console)

    def wanted(self, detected: Detected, console: Console) -> AnySource:
        """Everybody, or the wanted person as each camera saw them, with left and right corrected; prints what was
        found."""
        from fgpose.estimation.evidence.image_checks.flips import correct_flips
        from fgpose.people_observations import PeopleObservations
        from fgpose.pipeline import Source

        region = self.region
        succession = None
        if self.people != "1" and region is None:
            everybody = Source(detected.rig, detected.people).confident(self.min_confidence)
            everybody = everybody.first_frames(checked_frames(self.frames))
            wanted = everybody if self.people == "all" else everybody.one_or_all()
            if isinstance(wanted.observations, PeopleObservations):
                return wanted
            succession = wanted.succession
        followed = detected.follow(0 if region is None else region)
        one = Source.of_chosen(detected.rig, detected.people, followed.chosen).confident(self.min_confidence)
        one = one.first_frames(checked_frames(self.frames))
        corrected, flipped = correct_flips(one.observations, detected.rig)
        print_views(console, corrected, flipped, followed.problems[: corrected.n_frames])
        return replace(one, observations=corrected, succession=succession)


@dataclass(frozen=True, kw_only=True)
class Detect(VideoOptions):
    """Detect the joints of people in videos, and nothing else.

    Writes NAME.parquet: for each image, person and joint the pixels, the confidence, the absolute 3D joint that the
    view alone gives, and its covariance. fgpose smooth, track, refine and info read it. If a video has another size
    than its calibration, the calibration for this size is written as NAME_calibration.toml: use it in these commands.
    Without a calibration there are pixels and confidences of everybody only, from which fgpose calibrate finds one.

    Example: fgpose detect videos/ --rig Calib.qca.txt, then fgpose smooth detections/videos.parquet --rig
    Calib.qca.txt
    """

    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none, and no 3D)")] = None
    """Calibration of the cameras, in any format that fgpose smooth reads."""
    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))] = Path("detections")
    """Folder for the results; it is made if it is absent. What another command left there is not replaced."""
    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: that of the videos)")] = None
    """Name of the result files, without extension."""
    formats: Annotated[tuple[Literal["parquet", "npz"], ...], arg(metavar="FORMAT ...")] = ("parquet",)
    """parquet is a table that any data tool reads, npz is for NumPy."""

    def sources(self) -> Sources:
        if self.rig is not None:
            return self.with_rig(self.rig)
        from fgpose.geometry.intrinsics import guessed_intrinsics
        from fgpose.monocular.sources import Sources, find_clips

        if self.people == "1" or self.person_region is not None:
            raise ValueError(
                "who is the same in all cameras is told by their places: give --rig, or leave out the person"
            )
        clips = find_clips(self.videos, fps=self.fps, cameras=self.cameras)
        names, sizes_px = zip(*((clip.name, clip.size_px) for clip in clips), strict=True)
        return Sources(guessed_intrinsics(names, sizes_px), clips)

    def run(self) -> None:
        from fgpose.io.keypoints import save_observations, save_people_observations
        from fgpose.people_observations import PeopleObservations
        from fgpose.pipeline import Outputs, write_all

        console = new_console()
        # dict: each format once.
        name = self.name or recording_name(self.videos)
        outputs = Outputs(self.output, name, tuple(dict.fromkeys(self.formats)), step="detect")
        outputs.check(("detected",), () if self.rig is None else (self.rig,))
        detected = self.detect(console)
        seen = self.wanted(detected, console).observations if self.rig else self._pixels(detected)
        if isinstance(seen, PeopleObservations):
            n_images, n_people = len(seen.images), sum(image.n_people for image in seen.images)
            console.print(f"{n_people} detections of people in {n_images} images, up to {seen.n_most} in one")
            save: Callable[[Path], object] = partial(save_people_observations, seen)
        else:
            save = partial(save_observations, seen)
        writers: dict[Path | str, Callable[[], object]] = {
            path: partial(save, path) for path in outputs.trajectory_paths(("detected",))
        }
        if self.rig is not None and self._has_other_sizes(detected.rig, self.rig):
            writers[outputs.calibration] = partial(self._save_calibration, detected.rig, self.rig, outputs)
        print_written(console, *write_all(writers))

    def _pixels(self, detected: Detected) -> PeopleObservations:
        """Everybody, by the pixels alone: where a view is in the world is not known."""
        from fgpose.pipeline import Source

        images = (replace(image, points3d_m=None, covariance3d_m2=None) for image in detected.people.images)
        pixels = Source(detected.rig, replace(detected.people, images=tuple(images))).confident(self.min_confidence)
        return pixels.first_frames(checked_frames(self.frames)).observations

    def _has_other_sizes(self, rig: CameraRig, path: Path) -> bool:
        from fgpose.io.calibration import load_rig

        calibrated = load_rig(path, self.unit).subset(rig.names)
        return any(a.size_px != b.size_px for a, b in zip(calibrated.cameras, rig.cameras, strict=True))

    def _save_calibration(self, rig: CameraRig, path: Path, outputs: Outputs) -> None:
        from fgpose.io.calibration import load_calibration_origin, save_rig

        outputs.check((), (path,), calibration=True)
        known = load_calibration_origin(path).subset(rig.names)
        save_rig(rig, outputs.calibration, origin=replace(known, step=outputs.step))


def print_detected(console: Console, detected: Detected, cache: Path | None) -> None:
    """How many images there were, and how many came from the cache."""
    n_known = detected.n_images - detected.n_new_images
    known = f", {n_known} of them known from {cache}" if n_known else ""
    console.print(f"{detected.n_images} images of {detected.rig.n_cameras} cameras{known}", soft_wrap=True)


def print_views(
    console: Console,
    observations: Observations,
    flipped: Bool[np.ndarray, "frame camera joint"],
    problems: Shaped[np.ndarray, "frame camera"],
) -> None:
    """For each camera: in how many frames it saw the person, in how many left and right were exchanged, and why 3D is
    missing or uncertain."""
    table = new_table("", *observations.camera_names)
    n_seen = observations.seen.any(axis=-1).sum(axis=0)
    table.add_row(f"seen, of {observations.n_frames} frames", *map(str, n_seen.tolist()))
    table.add_row("left and right exchanged, corrected", *map(str, flipped.any(axis=2).sum(axis=0).tolist()))
    kinds = [[problem.partition(":")[0] for problem in of_camera] for of_camera in problems.T.tolist()]
    for kind in sorted({kind for of_camera in kinds for kind in of_camera if kind}):
        table.add_row(f"3D missing or uncertain: {kind}", *(str(of_camera.count(kind)) for of_camera in kinds))
    console.print(table)


def quieten_decoder() -> None:
    """Silence FFmpeg and OpenCV on stderr: fgpose reports the same errors in one line. Their own variables override
    this."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
