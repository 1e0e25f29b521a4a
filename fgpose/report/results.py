"""Finding and reading what a run has written."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.finding import Code, Finding
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import in_pieces, is_changing
from fgpose.geometry.up_axis import UpChoice, WorldUp
from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_rig
from fgpose.io.made_by import made_by
from fgpose.io.names import not_hidden
from fgpose.io.origin import InputFile, Origin
from fgpose.io.trajectories import READABLE, load_origin, load_upright
from fgpose.io.trajectories.kinematics import holds_kinematics
from fgpose.observations import Observations
from fgpose.plain_files import naming
from fgpose.report.sections.origin import facts_of, findings_of, without_home
from fgpose.report.used_detections import used_detections
from fgpose.trajectory import Trajectory

_RIGS = ("calibration.toml", "cameras.toml", "rig.toml")


def find_result(path: Path, name: str | None = None) -> Path:
    """The file of the trajectories: path itself, or in a folder the one of the run of that name. Joint angles that
    stand beside are none; a C3D has the points too, and can be named.

    Raises:
        ValueError: there is none, it holds joint angles alone, or there are several and no name; the message names the
            folder and what made each.
        OSError: the folder cannot be read.
    """
    if not path.is_dir():
        _refuse_angles(path)
        return path
    files, angles = _files(path)
    found = {run: file for run, file in _results(files).items() if run not in _NO_RESULTS}
    if name is not None:
        if name not in found and name in angles:
            _refuse_angles(angles[name])
            return angles[name]
        if name not in found:
            raise ValueError(f"{path}: there is no result {name}, only {', '.join(found) or 'none'}")
        return found[name]
    if len(found) != 1:
        named = (f"{run} ({told})" if (told := maker_text(file)) else run for run, file in found.items())
        what = f"results of {', '.join(named)}: say which (--name NAME)" if found else "no result of fgpose"
        raise ValueError(f"{path}: {what}")
    return next(iter(found.values()))


def maker_text(file: Path) -> str:
    """Which command made a result, to be read; empty where its file does not say it."""
    maker = made_by(file)
    return f"fgpose {maker}" if maker else ""


def _refuse_angles(file: Path) -> None:
    """Raise ValueError if it is a table of joint angles."""
    if file.suffix.lower() == ".parquet" and holds_kinematics(file):
        raise ValueError(f"{file} holds joint angles: a report is of the motion that they were made from")


def _files(folder: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    """Trajectories, and joint angles, by their names; of several formats one."""
    motions: dict[str, Path] = {}
    angles: dict[str, Path] = {}
    for extension in READABLE:
        for file in not_hidden(folder.glob(f"*{extension}")):
            (angles if holds_kinematics(file) else motions).setdefault(_without_person(file.stem), file)
    # Of other programs, a C3D with rotations is all that there is.
    return motions or {stem: file for stem, file in angles.items() if file.suffix.lower() == ".c3d"}, angles


def _results(files: Mapping[str, Path]) -> dict[str, Path]:
    """The most important trajectories of each run, by its name. Where fgpose track has left its own beside those of
    another command, both have names of their own."""
    of_runs: dict[str, dict[str, Path]] = {}
    for stem, file in files.items():
        run = _run_of(stem)
        of_runs.setdefault(run, {})[stem.removeprefix(run)] = file
    found = {}
    for run, kinds in of_runs.items():
        tracked = next((kind for kind in ("_smoothed", "_online") if kind in kinds), None)
        if "" in kinds:
            found[run] = kinds[""]
        if tracked is not None:
            found[f"{run}{tracked}" if "" in kinds else run] = kinds[tracked]
    return found


_NO_RESULTS = {"angles", "seen", "detected", "quality", "events"}
"""Files that stand beside the motion in the folder of a recording of a study."""


def _without_person(stem: str) -> str:
    head, _, person = stem.rpartition("_person")
    return head if head and person.isdigit() else stem


def _run_of(stem: str) -> str:
    stem = _without_person(stem)
    for kind in ("_smoothed", "_online"):
        stem = stem.removesuffix(kind)
    return stem


def load_finished(
    result: Path,
    *,
    title: str | None = None,
    rig: Path | None = None,
    keypoints: Path | None = None,
    fps: float | None = None,
    videos: Path | None = None,
    world_up: UpChoice = "auto",
    observed: bool = True,
) -> FinishedRecording:
    """Read the result of a run with what is known of its inputs.

    Args:
        result: file of the trajectories.
        title: how the recording is called, by default as the file.
        rig: file of the calibration; by default that which the result was made with, else one beside it.
        keypoints: what the cameras saw; by default what the result says it was made from, if that is still there.
        fps: of the keypoints, if their file has no times, and of folders of images.
        videos: folder of the videos; by default as of the keypoints.
        world_up: what is up in the world of the result; auto: as people and cameras stand. The recording is turned so
            that z is up.
        observed: whether what the cameras saw is looked for, if no keypoints are named.

    Raises:
        ValueError: a file is damaged, or they are not of one recording; the message names the file.
        OSError: a file cannot be read.
    """
    origin = load_origin(result) or Origin()
    rig_file, given, known = _calibration(result, rig, origin)
    people, given, axes = _upright(result, world_up, given)
    cameras = None if given is None else _rig_of(rig_file or result, given, next(iter(people.values())))
    known = known.subset(cameras.names) if cameras is not None else known
    origin = replace(origin, calibration=known)
    made_from = {"Result": str(result)} | facts_of(origin) | _named(Calibration=rig_file, Videos=videos, Axes=axes)
    if keypoints is not None:
        observations, made_from["Keypoints"] = _named_detections(keypoints, given, people, fps), str(keypoints)
    else:
        file = origin.input_file("Keypoints") if observed else None
        observations, problem = _still_there(file, given, people, fps or origin.fps)
        made_from |= {"Keypoints": f"{made_from['Keypoints']}. {problem}"} if problem else {}
    folder = Path(os.path.abspath(result)).parent
    with naming(result):
        return FinishedRecording(
            name=title or result.stem,
            people=people,
            rig=cameras,
            observations=observations,
            offset_sigma_s=known.offset_sigma_s,
            findings=findings_of(origin),
            calibrated=known.method,
            board_coverage=known.coverage,
            known_findings=_still_true(origin.findings, world_up),
            given_up=said_up(world_up),
            estimated=origin.estimated,
            events=origin.events,
            videos=videos or _videos(origin, cameras),
            images_hz=fps or origin.fps,
            made_from={what: without_home(said, folder) for what, said in made_from.items()},
        )


def _calibration(
    result: Path, wanted: Path | None, origin: Origin
) -> tuple[Path | None, CameraRig | None, CalibrationOrigin]:
    """The file that is wanted, or stands beside a result that does not have its rig; the rig, and where it is from."""
    file = wanted or (None if origin.rig is not None else _rig_beside(result))
    if file is None:
        return None, origin.rig, origin.calibration
    # Of another rig than the one that was used, what was found of it does not hold; its file may know of it itself.
    return file, load_rig(file), load_calibration_origin(file)


def _named_detections(
    keypoints: Path, rig: CameraRig | None, people: Mapping[int, Trajectory], fps: float | None
) -> Mapping[int, Observations]:
    if rig is None:
        raise ValueError(f"{keypoints}: keypoints are shown with a calibration (--rig FILE)")
    return used_detections(keypoints, rig, people, fps)


def _still_there(
    file: InputFile | None, rig: CameraRig | None, people: Mapping[int, Trajectory], fps: float | None
) -> tuple[Mapping[int, Observations], str]:
    """What the cameras saw, or why that cannot be read any more."""
    if file is None or rig is None:
        return {}, ""
    if not file.is_there:
        return {}, "They are not there any more, or others: nothing that needs them is judged; --keypoints PATH helps"
    try:
        return used_detections(Path(file.path), rig, people, fps), ""
    except (ValueError, OSError) as error:
        return {}, f"They cannot be read any more ({error}): nothing that needs them is judged"


def _upright(
    result: Path, world_up: UpChoice, rig: CameraRig | None
) -> tuple[dict[int, Trajectory], CameraRig | None, str]:
    """Everybody and the cameras in a world with z up, and what is to be said of that."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        people, up_R_world = load_upright(result, world_up, rig)
    for warning in caught:
        warnings.warn(warning.message, stacklevel=3)
    said = "; ".join(str(warning.message).removeprefix(f"{result}: ") for warning in caught)
    upright = None if rig is None else rig.turned(up_R_world)
    if np.array_equal(up_R_world, np.eye(3)):
        return people, upright, said
    rows = ", ".join(" ".join(f"{value:.3g}" for value in row) for row in (up_R_world + 0.0).tolist())
    turned = f"the world of this report is that of the result, turned by the rotation ({rows}) so that z is up"
    return people, upright, f"{said}; {turned}" if said else turned


def said_up(world_up: UpChoice) -> WorldUp | None:
    """The axis that somebody says to be up; None: nobody says it."""
    return None if world_up == "auto" else world_up


def _still_true(findings: tuple[Finding, ...], world_up: UpChoice) -> tuple[Finding, ...]:
    """What was found when the result was estimated; where the axis that is up is given now, nothing of the one then."""
    return tuple(each for each in findings if world_up == "auto" or each.code is not Code.WORLD_UP)


def _named(**files: Path | str | None) -> dict[str, str]:
    """Those that were given."""
    return {what: str(file) for what, file in files.items() if file}


def _rig_beside(result: Path) -> Path | None:
    names = (f"{_run_of(result.stem)}_calibration.toml", *_RIGS)
    return next((file for name in names if (file := result.with_name(name)).exists()), None)


def _videos(origin: Origin, rig: CameraRig | None) -> Path | None:
    """Those that the origin names, if they are still there."""
    file = origin.input_file("Videos")
    return Path(file.path) if file is not None and rig is not None and file.is_there else None


def _rig_of(path: Path, rig: CameraRig, trajectory: Trajectory) -> CameraRig:
    rig = in_pieces(rig) if is_changing(rig) else rig
    missing = [name for name in trajectory.camera_names if name not in rig.names]
    if missing:
        raise ValueError(f"{path}: camera {', '.join(missing)} of the result is not in this calibration")
    return rig.subset(trajectory.camera_names) if trajectory.camera_names else rig
