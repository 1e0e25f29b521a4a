"""Writing and showing results, in one way for all commands."""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.finding import Code
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.up_axis import UpChoice, WorldUp, nearest_axis
from fgpose.io.atomic import NotWrittenError, check_replaceable, check_writable, not_written
from fgpose.io.made_by import made_by, refuse_inputs, refuse_others
from fgpose.io.origin import Origin
from fgpose.io.trajectories import check_output, people_paths, save_people
from fgpose.io.trajectories.upright import resolved_up
from fgpose.kinematics.vertical import find_up
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline.result import Result, show
from fgpose.pipeline.source import AnySource
from fgpose.sampling import thinning
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory
from fgpose.viewer import Recording, has_rerun, open_recording

Format = Literal["parquet", "npz", "csv", "trc", "c3d", "rrd"]
Display = Callable[[Result, Recording], None]
# Of one person in four cameras, with three results to compare, they take 170 MB.
_MOST_SHOWN = 20_000


class OutputError(NotWrittenError):
    """Some of the files could not be written; the others were."""

    def __init__(self, failed: Mapping[Path | str, Exception], written: tuple[Path, ...]) -> None:
        super().__init__("; ".join(_said(target, error) for target, error in failed.items()))
        self.failed = failed
        """Why, by file; "the viewer" for what was shown live."""
        self.written = written


def _said(target: Path | str, error: Exception) -> str:
    if isinstance(error, NotWrittenError):
        return str(error)
    if str(error).startswith(f"{target}:"):
        return f"cannot write {error}"
    return str(not_written(target, error if str(error) else type(error).__name__))


@dataclass(frozen=True)
class Outputs:
    """Where results go: folder/name.format, or folder/name_trajectory.format when a run can give several.

    Raises:
        ValueError: the name would hide files, or put them elsewhere.
    """

    folder: Path
    name: str
    formats: tuple[Format, ...]
    world_up: UpChoice | WorldUp = "auto"
    """What is up in the world, for TRC, C3D and the viewer; auto: as bodies and cameras stand."""
    live_port: int | None = None
    """Where viewers can connect; 0 takes any free port. None: they cannot."""
    rrd_fps: float | None = None
    """Frames per second that the viewer shows, about; None: all, but of a long recording 20,000 at most."""
    image_fps: float | None = None
    """Images per second of each camera that it shows, about; None: those of all frames that are shown."""
    image_width_px: int | None = 640
    """To how much at most the images in the viewer are shrunk; see open_recording."""
    step: str = ""
    """The command that writes them, which does not replace what another has written; empty: anything is replaced."""
    source: Path | None = None
    """The recording that they are made from: results of another are not replaced either."""
    shown_as: str = ""
    """End of the name of the .rrd file, as that of a trajectory."""

    def __post_init__(self) -> None:
        if not self.name or self.name.startswith(".") or Path(self.name).name != self.name:
            raise ValueError(
                f"{self.name!r} is no name of result files: a word is, without a point before it and without /"
            )
        for option, fps in (("rrd-fps", self.rrd_fps), ("image-fps", self.image_fps)):
            if fps is not None and not 0 < fps < math.inf:
                raise ValueError(f"--{option} must be positive, got {fps:g}")

    def path(self, file_format: Format, trajectory: str = "") -> Path:
        return self.folder / f"{self.name}{'_' if trajectory else ''}{trajectory}.{file_format}"

    @property
    def calibration(self) -> Path:
        """Where a calibration that results goes."""
        return self.folder / f"{self.name}_calibration.toml"

    @property
    def unfinished(self) -> Path:
        """Folder of what a run has solved, until its results are written."""
        return self.folder / f".{self.name}_unfinished"

    @property
    def rrd(self) -> Path:
        """The file for the viewer."""
        return self.path("rrd", self.shown_as)

    @property
    def shown(self) -> bool:
        """Whether anything is made for the viewer."""
        return "rrd" in self.formats or self.live_port is not None

    def check(self, saved: tuple[str, ...], inputs: tuple[Path, ...] = (), *, calibration: bool = False) -> None:
        """Make sure, before any work is done, that everything can be written; the folder is made.

        Args:
            saved: names of the trajectories that will be saved (Result.saved).
            inputs: files that must not be overwritten.
            calibration: whether a calibration will result.

        Raises:
            ValueError: a result would replace an input, or what another command made, or the same from another
                recording.
            OSError: the folder cannot be written into, or what has the name of a result is no plain file.
            ImportError: the package that a format needs is not installed.
        """
        check_writable(self.folder)
        if self.shown:
            _require_rerun()
        trajectories = self.trajectory_paths(saved)
        for path in trajectories:
            check_output(path)
        others = [*([self.rrd] if "rrd" in self.formats else []), *([self.calibration] if calibration else [])]
        for path in (*trajectories, *others):
            check_replaceable(path)
            refuse_inputs([path], inputs, "choose another output folder or name")
        if self.step:
            of_people = (each for path in trajectories for each in _of_single_people(path))
            remedy = f"give another name or folder, as --name {self.name}_{self.step} or -o FOLDER, or remove it"
            refuse_others((*trajectories, *others, *of_people), self.step, self.source, remedy)

    def origin(self, known: Origin | None) -> Origin | None:
        """What is known of the origin of a result, with the command that writes it."""
        return replace(known or Origin(), step=self.step) if self.step else known

    def trajectory_paths(self, saved: tuple[str, ...]) -> dict[Path, str]:
        """The files of the trajectories to be saved, and which one each is of."""
        return {
            self.path(file_format, name if len(saved) > 1 else ""): name
            for file_format in self.formats
            if file_format != "rrd"
            for name in saved
        }

    def shown_every(self, time_s: Float[np.ndarray, " frame"]) -> int:
        """Of how many frames of a recording with these times the viewer shows one."""
        return thinning(time_s, self.rrd_fps, _MOST_SHOWN)

    def compared_every(self, time_s: Float[np.ndarray, " frame"]) -> int:
        """Of how many frames one is compared in the viewer with what each frame alone gives: all, but of a long
        recording those that are shown; 0 if nothing is."""
        if not self.shown:
            return 0
        return self.shown_every(time_s) if len(time_s) > _MOST_SHOWN else 1

    def open_viewer(self, source: AnySource, trajectories: tuple[str, ...]) -> Recording:
        """See open_recording; for the results of these names of one person, or for everybody, as the source is."""
        seen = source.observations
        compared = None if isinstance(seen, PeopleObservations) else trajectories
        return self.open_recording(source.rig, seen.skeleton, compared, seen.frame_time_s)

    def open_recording(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        trajectories: tuple[str, ...] | None,
        time_s: Float[np.ndarray, " frame"],
    ) -> Recording:
        """The .rrd file if that is among the formats, and what viewers connect to if they can.

        Args:
            rig: the cameras.
            skeleton: the joints.
            trajectories: names of one person's results that will be compared, the most important last; None: people
                are shown.
            time_s: of all frames that it will have.

        Raises:
            ImportError: Rerun is not installed.
            OSError: the port is taken, or the file cannot be written.
        """
        # Before anybody is estimated only the cameras tell.
        every = self.shown_every(time_s)
        world_up = find_up((), rig).world_up if self.world_up == "auto" else self.world_up
        return open_recording(
            self.rrd if "rrd" in self.formats else None,
            rig,
            skeleton,
            trajectories,
            n_frames=len(time_s),
            every=every,
            images_every=every * thinning(time_s[::every], self.image_fps, len(time_s)),
            live=self.live_port is not None,
            port=self.live_port or 0,
            up=nearest_axis(world_up),
            image_width_px=self.image_width_px,
            made_by=self.step,
        )

    def standing(self, people: Collection[Trajectory], rig: CameraRig, diagnosis: Diagnosis | None) -> Outputs:
        """The same, with what is up as these people and cameras stand, if that is to be found.

        Warns:
            UserWarning: it is another axis than z, or in doubt, and the diagnosis does not tell of it.
        """
        if self.world_up == "auto" and diagnosis is not None and diagnosis.tells_of(Code.WORLD_UP):
            return replace(self, world_up=find_up(people, rig).world_up)
        return replace(self, world_up=resolved_up(people, self.world_up, self.folder / self.name, rig))


def _of_single_people(path: Path) -> Iterator[Path]:
    """The files beside it that an earlier run wrote for each of several people; none of a table, which holds everybody.
    What has a table of its own is a result of that name."""
    if people_paths(path, (0, 1)) == (path,):
        return iter(())
    numbered = re.compile(rf"{re.escape(path.stem)}_person\d+{re.escape(path.suffix)}")
    beside = path.parent.glob(f"{glob.escape(path.stem)}_person*{path.suffix}")
    return (file for file in beside if numbered.fullmatch(file.name) and not file.with_suffix(".parquet").exists())


def _require_rerun() -> None:
    if not has_rerun():
        raise ImportError(
            "a .rrd file needs Rerun: pip install 'fgpose[viewer]'; or leave rrd out: --formats parquet trc"
        )


def write_outputs(
    result: Result, outputs: Outputs, viewer: Recording | None = None, display: Display = show
) -> tuple[Path, ...]:
    """Write a result in every format wanted and show it; each file appears whole or not at all. Of several people all
    are in one parquet file, and each has files of their own in the other formats (see save_people).

    Args:
        result: of a run.
        outputs: where it goes.
        viewer: a recording that is open already, with its .rrd file, and stays open; by default one is made.
        display: how the result is shown in it.

    Returns:
        The files; without the .rrd file of a recording that stays open.

    Raises:
        OutputError: a file could not be written, whatever the reason. All others were.
    """
    outputs = outputs.standing(result.main.values(), result.rig, result.diagnosis)
    origin, time_s = outputs.origin(result.origin), result.frame_time_s
    paths = outputs.trajectory_paths(result.saved).items()
    people = {path: result.trajectories[name] for path, name in paths if name in result.trajectories}
    writers: dict[Path | str, Callable[[], object]] = {
        path: partial(save_people, of_path, path, outputs.world_up, time_s, origin) for path, of_path in people.items()
    }
    if outputs.rrd.is_file() and "rrd" in outputs.formats and viewer is None:
        # It is written last: a run that is killed before would leave the one of another run beside the new files.
        outputs.rrd.unlink()
    written = write_all(writers | _viewer_writers(result, outputs, viewer, display))
    files = {target: people_paths(target, people[target]) if target in people else [target] for target in written}
    for target in people.keys() & files.keys():
        _remove_earlier(target, files[target], outputs.step)
    return tuple(file for target in written for file in files[target])


def _remove_earlier(path: Path, files: Collection[Path], step: str) -> None:
    """Files of people that an earlier run of the same step found beside the files that were written now."""
    for earlier in {path, *_of_single_people(path)} - set(files):
        if step and earlier.is_file() and made_by(earlier) == step:
            earlier.unlink()


def write_all(writers: Mapping[Path | str, Callable[[], object]]) -> tuple[Path, ...]:
    """Call what writes each of several files, or shows something; where one fails the others are still called.

    Returns:
        The files.

    Raises:
        OutputError: at least one has failed.
    """
    written, failed = [], {}
    for target, write in writers.items():
        try:
            write()
        except Exception as error:  # Whatever it is: a result must not be lost because another cannot be written.
            failed[target] = error
        else:
            written += [target] if isinstance(target, Path) else []
        hand_back()
    if failed:
        raise OutputError(failed, tuple(written)) from next(iter(failed.values()))
    return tuple(written)


def _viewer_writers(
    result: Result, outputs: Outputs, viewer: Recording | None, display: Display
) -> dict[Path | str, Callable[[], object]]:
    """What shows a result: in the viewer, which stays open, else in the .rrd file if one is wanted."""
    if viewer is not None:
        return {"the viewer": partial(_show_or_discard, result, viewer, display)}

    def write() -> None:
        recording = outputs.open_viewer(replace(result.source, rig=result.rig), tuple(result.trajectories))
        _show_or_discard(result, recording, display)
        recording.close()

    return {outputs.rrd: write} if "rrd" in outputs.formats else {}


def _show_or_discard(result: Result, recording: Recording, display: Display) -> None:
    """Closing a recording that is shown by half would leave half a file."""
    try:
        display(result, recording)
    except BaseException:
        recording.discard()
        raise
