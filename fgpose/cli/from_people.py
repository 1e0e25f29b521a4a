"""Calibration from people on the command line: what calibrate and run --calibrate share."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, UseAppendAction, arg

from fgpose.cli.console import new_console, new_table, print_written, progress_bar
from fgpose.plain_files import naming
from fgpose.shown.unknown_names import check_names

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.calibration.bumped import BumpedRig
    from fgpose.calibration.from_people.calibrate import Focal
    from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
    from fgpose.calibration.from_people.starts.starts import GivenStart
    from fgpose.geometry.camera import CameraRig
    from fgpose.monocular.clips import Clip
    from fgpose.monocular.sources import Sources
    from fgpose.people_observations import PeopleObservations

_INTRINSICS = (
    "Focal lengths, principal points and distortion: a calibration of any format (its poses are not used), the YAML, "
    "JSON, TOML or npz of a calibration with a board (camera_matrix, distortion_coefficients), or a folder with such a "
    "file for each camera. A file with one camera is for all."
)
_FOCAL = (
    "known: as given with --intrinsics or --focal-px. shared: unknown, the same for cameras whose images have the same "
    "size. each: unknown, for each camera another. auto: known if given, shared if all images have one size, else each."
)
_DISTANCE = "Measured distance between two cameras, from lens to lens, as: --distance cam1 cam3 4.20. May be repeated."
_MAX_DISTANCE_M = 100.0


@dataclass(frozen=True, kw_only=True)
class FromPeopleOptions:
    """What is known of the cameras and of the person who walks before them."""

    intrinsics: Annotated[Path | None, arg(metavar="FILE", help=_INTRINSICS, help_behavior_hint="(default: none)")] = (
        None
    )
    focal_px: Annotated[float | None, arg(metavar="PX", help_behavior_hint="(default: unknown)")] = None
    """Focal length of all cameras, pixels, where there is no file; the lenses are taken to have no distortion."""
    focal: Annotated[Literal["auto", "known", "shared", "each"], arg(help=_FOCAL)] = "auto"
    height: Annotated[float | None, arg(metavar="M", help_behavior_hint="(default: unknown)")] = None
    """Stature of the person who is seen most, metres, without shoes. Gives the scale."""
    distance: Annotated[
        UseAppendAction[tuple[tuple[str, str, float], ...]],
        arg(metavar="CAMERA CAMERA M", help=_DISTANCE, help_behavior_hint="(default: none)"),
    ] = ()
    synchronised: Annotated[bool, FlagCreatePairsOff] = False
    """All cameras began at the same time, and their clocks agree. Otherwise the starts are estimated."""
    sound: Annotated[bool, FlagCreatePairsOff] = False
    """Find the starts by the sound of the videos, where it is heard clearly, before the motion makes them exact."""

    @property
    def says_anything(self) -> bool:
        """Whether any of these options is given."""
        given = (
            self.intrinsics,
            self.focal_px,
            self.height,
            self.distance,
            self.synchronised,
            self.sound,
            self.focal != "auto",
        )
        return any(given)

    def check_options(self) -> None:
        """Raise ValueError for what cannot be, before any work."""
        if self.intrinsics is not None and self.focal_px is not None:
            raise ValueError("--intrinsics and --focal-px both say what the focal length is: leave one of them out")
        if self.sound and self.synchronised:
            raise ValueError("--synchronised and --sound both say when the cameras began: leave one of them out")
        if self.sound:
            from fgpose.monocular.sound import check_sound

            check_sound()
        if self.focal == "known" and self.intrinsics is None and self.focal_px is None:
            raise ValueError("--focal known needs --intrinsics or --focal-px")
        if self.focal_px is not None and not self.focal_px > 0:
            raise ValueError(f"--focal-px must be positive, got {self.focal_px:g}")
        if self.height is not None:
            from fgpose.calibration.from_people.world.scale import check_stature

            with naming("--height"):
                check_stature(self.height)
        for a, b, distance_m in self.distance:
            if a == b:
                raise ValueError(f"--distance {a} {b}: two different cameras are needed")
            if not 0 < distance_m <= _MAX_DISTANCE_M:
                raise ValueError(f"--distance {a} {b} {distance_m:g}: a distance is more than 0 and at most 100 metres")

    def cameras_of(self, names: Sequence[str], sizes_px: Sequence[tuple[int, int]]) -> CameraRig:
        """The intrinsics of cameras whose images have these sizes, without poses.

        Raises:
            ValueError: there are fewer than two cameras, one is not in the file, or --distance names another.
        """
        from fgpose.geometry.intrinsics import guessed_intrinsics
        from fgpose.io.calibration import load_intrinsics

        if len(names) < 2:
            raise ValueError(f"one camera ({', '.join(names)}) cannot be calibrated; two are needed")
        ends = [name for a, b, _ in self.distance for name in (a, b)]
        check_names(ends, names, "--distance: there is no camera", "there are")
        if self.intrinsics is not None:
            return load_intrinsics(self.intrinsics, names, sizes_px)
        return guessed_intrinsics(names, sizes_px, self.focal_px)

    def sources_of(self, clips: tuple[Clip, ...], frames: int | None) -> Sources:
        """The videos and their cameras, of which this many images are used.

        Raises:
            ValueError: as cameras_of; or all videos but one are too short to find when they begin.
        """
        from fgpose.calibration.from_people.walk import SHORT_S
        from fgpose.monocular.sources import Sources

        rig = self.cameras_of([clip.name for clip in clips], [clip.size_px for clip in clips])
        lasts_s = sorted(min(clip.n_images, frames or clip.n_images) / clip.fps for clip in clips)
        if not self.synchronised and lasts_s[-2] < SHORT_S:
            raise ValueError(
                f"videos of {lasts_s[-2]:.1f} s are too short to find when each of them begins; {SHORT_S:g} s are the "
                "least, half a minute is good. If all began at the same moment, say so with --synchronised"
            )
        return Sources(rig, clips)

    def heard(self, clips: Sequence[Clip], console: Console) -> dict[str, GivenStart]:
        """Starts of the videos by their sound, which are printed; none without --sound.

        Raises:
            ImportError: PyAV is not installed.
        """
        if not self.sound:
            return {}
        from fgpose.calibration.from_people.starts.starts import GivenStart
        from fgpose.monocular.sound import SIGMA_S, starts_by_sound

        starts = starts_by_sound(clips)
        told = ", ".join(f"{name} {start.offset_s:+.2f} s" for name, start in starts.items())
        silent = [clip.name for clip in clips if clip.name not in starts]
        unheard = f" Not heard clearly, by motion: {', '.join(silent)}." if silent else ""
        console.print(f"Starts by sound: {told or 'none'}.{unheard}", soft_wrap=True)
        return {name: GivenStart(start.offset_s, SIGMA_S) for name, start in starts.items()}

    def calibrated(
        self,
        people: PeopleObservations,
        intrinsics: CameraRig,
        path: Path,
        console: Console,
        starts: Mapping[str, GivenStart] | None = None,
    ) -> CalibratedFromPeople:
        """The result, with a progress bar; what was assumed of the focal lengths is printed. If there is none, it is
        said on stderr that the file was not written."""
        from fgpose.calibration.from_people.calibrate import calibrate_from_people

        focal = self._focal_of(intrinsics)
        if focal != "known":
            pairs = zip(intrinsics.names, intrinsics.focal_px.tolist(), strict=True)
            guesses = ", ".join(f"{name} {focal_px:.0f}" for name, focal_px in pairs)
            console.print(
                f"Focal lengths are estimated, {_alike(intrinsics, focal)}. They begin at {guesses} px.", soft_wrap=True
            )
        try:
            with progress_bar("calibrating", "steps") as progress:
                return calibrate_from_people(
                    people,
                    intrinsics,
                    focal=focal,
                    stature_m=self.height,
                    distances=self.distance,
                    synchronised=self.synchronised,
                    starts=starts,
                    progress=progress,
                )
        except ValueError:
            say_not_written(path)
            raise

    def _focal_of(self, intrinsics: CameraRig) -> Focal:
        if self.focal != "auto":
            return self.focal
        if self.intrinsics is not None or self.focal_px is not None:
            return "known"
        from fgpose.calibration.from_people.calibrate import unknown_focal

        return unknown_focal(intrinsics)


def _alike(intrinsics: CameraRig, focal: Focal) -> str:
    """Which cameras have one focal length, in words."""
    from fgpose.calibration.from_people.rig.walk_adjustment import lens_groups

    groups = lens_groups(intrinsics) if focal == "shared" else ()
    if len(groups) == 1:
        return "one for all cameras"
    if max(map(len, groups), default=1) == 1:
        return "one for each camera"
    alike = ", ".join(f"one for {' and '.join(intrinsics.names[c] for c in group)}" for group in groups)
    return f"{alike}, as their images have the same size"


def parse_size(text: str) -> tuple[int, int]:
    """Width and height from 1920x1080. Raises ValueError for anything else."""
    match = re.fullmatch(r"\s*(\d{2,5})\s*[xX×]\s*(\d{2,5})\s*", text)
    if match is None:
        raise ValueError(f"--size is width x height in pixels, as 1920x1080, got {text!r}")
    return int(match[1]), int(match[2])


def print_calibrated(
    console: Console, result: CalibratedFromPeople | BumpedRig[Any], written: Sequence[Path], output: Path
) -> bool:
    """A table of the cameras, how well all is known, the verdict with its reasons, and the files.

    Returns:
        Whether the calibration was written to the output; if not, that is said on stderr.
    """
    from fgpose.calibration.bumped import BumpedRig
    from fgpose.calibration.from_people.calibrated import Grade
    from fgpose.pipeline.calibration_report import bumped_rows, bumped_summary, camera_rows, summary, verdict

    is_bumped = isinstance(result, BumpedRig)
    rows = bumped_rows(result) if is_bumped else camera_rows(result)
    console.print(new_table("", *result.rig.names, rows=rows))
    lines = [bumped_summary(result)] if is_bumped else summary(result)
    for line in (*lines, *verdict(result.findings, result.grade)):
        console.print(line)
    print_written(console, *written)
    if result.grade is not Grade.FAILED:
        return True
    say_not_written(output)
    return False


def say_not_written(path: Path) -> None:
    """That a calibration has failed, on stderr."""
    new_console(stderr=True).print(f"fgpose: the calibration has failed; {path} was not written", soft_wrap=True)
