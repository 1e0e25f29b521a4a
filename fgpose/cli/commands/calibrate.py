"""Calibrating cameras from the people in their videos, or with a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from fgpose.cli.boards import BoardOptions, print_board_calibration, print_board_lenses
from fgpose.cli.commands.detect import NetworkOptions, quieten_decoder
from fgpose.cli.console import new_console
from fgpose.cli.delivery import look_at
from fgpose.cli.from_people import FromPeopleOptions, parse_size, print_calibrated, say_not_written
from fgpose.cli.pictures import show_board_images, show_walk_images

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration.bumped import BumpedRig
    from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
    from fgpose.geometry.camera import CameraRig
    from fgpose.monocular.clips import Clip
    from fgpose.monocular.detected import Detected
    from fgpose.people_observations import PeopleObservations

FAILED = 1
"""Exit code when the calibration has failed."""

_RECORDING = (
    "Folder with one video per camera (cam01.mp4), or with one folder of images for each; or detected joints: a folder "
    "that holds for each camera a folder of JSON files (OpenPose, MMPose) or one file (MMPose, COCO, MeTRAbs), or one "
    "file of fgpose (npz, parquet)."
)
_SKELETON = (
    "What detected joints are, where they do not say it: a name that fgpose skeletons lists (body_25, coco_17, "
    "halpe_26; with hands openpose_67, coco_wholebody_133, halpe_136), or your own TOML file. Of videos it is needed "
    "for metrabs only."
)
_FROM = (
    "A calibration that was right until somebody bumped a camera: says which camera was moved and by how much, and "
    "keeps the others."
)
_FORMAT = (
    "auto: npz for .npz, pose2sim for .toml. aniposelib, caliscope: TOML as these read it. easymocap: a folder with "
    "intri.yml and extri.yml."
)


@dataclass(frozen=True, kw_only=True)
class RecordingToCalibrate(FromPeopleOptions):
    """What the cameras recorded, and where the calibration goes."""

    recording: Annotated[Positional[Path], arg(metavar="RECORDING", help=_RECORDING)]
    from_rig: Annotated[
        Path | None, arg(name="from", metavar="FILE", help=_FROM, help_behavior_hint="(default: none)")
    ] = None
    output: Annotated[Path, arg(metavar="FILE", aliases=("-o",))] = Path("rig.toml")
    """The calibration that is written. The scene is beside it, with the extension .rrd."""
    format: Annotated[Literal["auto", "npz", "pose2sim", "aniposelib", "caliscope", "easymocap"], arg(help=_FORMAT)] = (
        "auto"
    )
    rrd: bool = True
    """Write the scene for the viewer."""
    images: bool = True
    """Show the images in it, shrunk to at most 640 px."""
    fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: of the videos)")] = None
    """Frames per second; needed for keypoints without times and for images."""
    cameras: Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(default: all)")] = ()
    """Use these cameras only, the first of them for the origin and the clock."""
    size: Annotated[str | None, arg(metavar="WxH", help_behavior_hint="(default: as the intrinsics say)")] = None
    """Width and height of the images that keypoints were detected in, as 1920x1080."""
    frames: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Use only this many images of each video."""
    points3d_unit: Literal["mm", "m"] = "mm"
    """Unit of the 3D joints of each view, where the keypoints have them."""


@dataclass(frozen=True, kw_only=True)
class Calibrate(NetworkOptions, BoardOptions, RecordingToCalibrate):
    """Calibrate cameras from people who walk, or with a board.

    No board, no common start: one person walks for half a minute where all cameras look (docs/calibrate.md says how).
    Writes the rig, with the start of each camera (time_offset_s and start_s), and a scene for the viewer beside it;
    prints what is known of each camera and how well, and a verdict with reasons and remedies. The world has z up, the
    floor at z = 0 and its origin under the first camera. If the calibration fails, no rig is written and the exit code
    is 1; it is 2 if the input allows none.

    With --board the cameras are calibrated with a board instead, lenses included: lay it on the floor first, hold it
    near to each camera, all over its image and tilted, and where several cameras see it at once
    (docs/calibrate_board.md). Images of one number are of one moment, and videos synchronised unless --unsynchronised
    says that they were started by hand.

    With --from a rig that was right is corrected instead: the cameras that were bumped get new poses.

    Example: fgpose calibrate videos/ --intrinsics Lens.toml --height 1.78 -o rig.toml, then fgpose run videos/ --rig
    rig.toml
    """

    skeleton: Annotated[
        str | None, arg(metavar="NAME|FILE", help=_SKELETON, help_behavior_hint="(default: of the network)")
    ] = None

    def run(self) -> int:
        self._check()
        if self.board is not None:
            return self._with_board()
        return self._bumped() if self.from_rig is not None else self._from_nothing()

    def _check(self) -> None:
        """Everything that can be checked before any work is done."""
        from fgpose.io.atomic import check_replaceable, check_writable
        from fgpose.io.calibration import check_format
        from fgpose.io.made_by import refuse_inputs, refuse_others

        self.check_options()
        self.check_board()
        if self.board is not None and self._says_of_people:
            raise ValueError(
                "--board takes scale and lenses from the board: leave --from, --height, --distance, --focal, "
                "--focal-px, --sound, --skeleton and --size out"
            )
        if self.lenses_only and (self.output.suffix.lower() != ".toml" or self.format != "auto" or self.intrinsics):
            raise ValueError("--lenses-only finds lenses and writes a .toml: leave --format and --intrinsics out")
        check = check_writable if check_format(self.output, self.format) == "easymocap" else check_replaceable
        if check is check_replaceable and self.output.is_dir():
            raise ValueError(f"{self.output} is a folder, where a file is to be written")
        refuse_inputs([self.output], (self.recording, self.intrinsics, self.from_rig))
        if self.from_rig is not None and self.says_anything:
            raise ValueError(
                "--from takes lenses, scale and clocks from its rig: leave --intrinsics, --height, --synchronised and "
                "such out"
            )
        if self.size is not None:
            parse_size(self.size)
        if not self.recording.exists():
            raise FileNotFoundError(2, "no such file or folder", str(self.recording))
        others = [self._scene] if self._scene is not None else []
        refuse_others([self.output, *others], "calibrate", remedy="choose another with --output, or remove it")
        check(self.output)
        for path in others:
            check_replaceable(path)

    def _from_nothing(self) -> int:
        from fgpose.pipeline import write_calibration

        console = new_console()
        display, starts = None, None
        if self._has_videos():
            detected = self._detected(console)
            starts = self.heard(detected.sources.clips, console)
            people, intrinsics = detected.people, detected.rig
            display = partial(show_walk_images, detected) if self.images else None
        elif self.sound:
            raise ValueError(f"--sound needs videos, and {self.recording} has none")
        else:
            people, intrinsics = self._keypoints()
        result = self.calibrated(people, intrinsics, self.output, console, starts)
        written = write_calibration(result, self.output, self.format, self._scene, display)
        return self._ended(console, people, result, written)

    @property
    def _says_of_people(self) -> bool:
        skeleton = None if self.origin == "people" else self.skeleton
        given = (self.from_rig, self.height, self.distance, self.focal_px, self.sound, skeleton, self.size)
        return any(given) or self.focal != "auto"

    def _with_board(self) -> int:
        from fgpose.calibration.board.filmed import board_clips
        from fgpose.calibration.board.walker import level_from_people
        from fgpose.calibration.from_people.calibrated import Grade
        from fgpose.pipeline import write_board_calibration, write_board_lenses

        quieten_decoder()
        clips = board_clips(self.recording, self.fps, self.cameras)
        if self.frames is not None:
            clips = tuple(clip.first(self.frames) for clip in clips)
        if self.lenses_only:
            lenses = self.lenses_with_board(clips)
            written = write_board_lenses(lenses, self.output)
            print_board_lenses(new_console(), lenses, written)
            if not written:
                say_not_written(self.output)
            return 0 if written else FAILED
        detected = self._people_before(clips, new_console()) if self.origin == "people" else None
        result = self.calibrated_with_board(clips, self.intrinsics)
        if detected is not None:
            with new_console(stderr=True).status("following the walker"):
                result = level_from_people(result, detected)
        display = partial(show_board_images, clips, result.begins_s) if self.images else None
        written = write_board_calibration(result, self.output, self.format, self._scene, display)
        print_board_calibration(new_console(), result, written)
        if result.grade is Grade.FAILED:
            say_not_written(self.output)
            return FAILED
        return 0

    def _people_before(self, clips: tuple[Clip, ...], console: Console) -> Detected:
        """Who is in the images of the board. They are kept, and looked for first: if there is no network, no work is
        lost."""
        from fgpose.monocular.sources import Sources

        if len(clips) < 2:
            raise ValueError("--origin people needs two cameras: one does not tell where somebody walks")
        lenses = self.cameras_of([clip.name for clip in clips], [clip.size_px for clip in clips])
        return self.detect_in(Sources(lenses, clips), self.frames, console)

    def _detected(self, console: Console) -> Detected:
        """What cameras without poses saw of people."""
        from fgpose.monocular.sources import find_clips

        quieten_decoder()
        clips = find_clips(self.recording, fps=self.fps, cameras=self.cameras)
        return self.detect_in(self.sources_of(clips, self.frames), self.frames, console)

    def _has_videos(self) -> bool:
        """Or keypoints. Raises ValueError if it has neither."""
        from fgpose.io.keypoints import keypoint_cameras
        from fgpose.monocular.image_files import image_files
        from fgpose.monocular.sources import has_videos

        if has_videos(self.recording):
            return True
        if self.recording.is_dir() and image_files(self.recording):
            raise ValueError(
                f"{self.recording}: the images of one camera, and people tell of cameras that see them together: "
                "give the folder with a folder for each camera, or --board with --lenses-only for the lens alone"
            )
        try:
            keypoint_cameras(self.recording)
        except ValueError as error:
            raise ValueError(f"{error}; nor is there a video of a camera (cam01.mp4)") from None
        return False

    def _keypoints(self) -> tuple[PeopleObservations, CameraRig]:
        from fgpose.io.calibration import load_intrinsics
        from fgpose.io.keypoints import check_sizes, likely_sizes_px, load_uncalibrated

        people = load_uncalibrated(
            self.recording,
            self.skeleton,
            fps=self.fps,
            points3d_unit=self.points3d_unit,
            cameras=self.cameras,
            made_with=self._made_with(),
        )
        names = people.camera_names
        if not any(image.n_people for image in people.images):
            raise ValueError(f"{self.recording}: the keypoints have no joint in any camera")
        if self.size is not None:
            sizes_px = [parse_size(self.size)] * len(names)
        elif self.intrinsics is not None:
            sizes_px = [camera.size_px for camera in load_intrinsics(self.intrinsics, names).cameras]
        else:
            sizes_px = likely_sizes_px(people)
        intrinsics = self.cameras_of(names, sizes_px)
        check_sizes(people, intrinsics)
        return people, intrinsics

    def _made_with(self) -> CameraRig | None:
        """The calibration that gives the intrinsics, if it is one: detections of fgpose may have been made with it."""
        from fgpose.io.calibration import load_rig

        if self.intrinsics is None:
            return None
        try:
            return load_rig(self.intrinsics)
        except ValueError:
            return None

    def _bumped(self) -> int:
        from fgpose.calibration.bumped import refine_bumped
        from fgpose.io.calibration import load_calibration_origin, load_rig
        from fgpose.pipeline import write_bumped

        assert self.from_rig is not None
        known = load_calibration_origin(self.from_rig)
        console, display = new_console(), None
        if self._has_videos():
            detected = self._seen_by_rig(self.from_rig, console)
            people, rig = detected.people, detected.rig
            display = partial(show_walk_images, detected) if self.images else None
        else:
            people, rig = self._keypoints_of_rig(self.from_rig)
        with new_console(stderr=True).status("comparing the cameras"):
            bumped = refine_bumped(people, rig)
        # The clocks are those of the file again, which were put into the times of the images.
        given = load_rig(self.from_rig).subset(rig.names)
        written = write_bumped(bumped, given, self.output, self.format, self._scene, display, known)
        return self._ended(console, people, bumped, written)

    def _ended(
        self,
        console: Console,
        people: PeopleObservations,
        result: CalibratedFromPeople | BumpedRig[Any],
        written: Sequence[Path],
    ) -> int:
        """Says what came of it. Returns the exit code."""
        if not print_calibrated(console, result, written, self.output):
            return FAILED
        look_at(console, people, result.rig)
        return 0

    @property
    def _scene(self) -> Path | None:
        from fgpose.cli.viewers import can_write_rrd

        return self.output.with_suffix(".rrd") if self.rrd and not self.lenses_only and can_write_rrd() else None

    def _seen_by_rig(self, rig: Path, console: Console) -> Detected:
        """What the cameras of --from saw in videos."""
        from fgpose.io.calibration import load_rig
        from fgpose.monocular.sources import open_sources

        quieten_decoder()
        sources = open_sources(self.recording, load_rig(rig), fps=self.fps, cameras=self.cameras)
        return self.detect_in(sources, self.frames, console)

    def _keypoints_of_rig(self, rig: Path) -> tuple[PeopleObservations, CameraRig]:
        """What a detector saw in the images of the cameras of --from."""
        from fgpose.pipeline import load_source

        source = load_source(
            self.recording,
            rig,
            self.skeleton,
            cameras=self.cameras,
            fps=self.fps,
            points3d_unit=self.points3d_unit,
            people="all",
        )
        return source.observations, source.rig
