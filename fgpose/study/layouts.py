"""How recordings lie in folders: by the patterns of the study file, or as Pose2Sim has them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from fgpose.io.camera_names import natural_key
from fgpose.io.folders import visible
from fgpose.study.pattern import PLACEHOLDERS, Pattern
from fgpose.study.recording import Kind, Recording
from fgpose.study.study import Study

# Where a pattern has no such part.
_ALL = "all"
# Pose2Sim's names since 0.9 and before; what is synchronised is better than what is not.
_KEYPOINTS = ("pose-sync", "pose", "pose-associated", "pose-2d")
_VIDEOS = ("videos", "raw-2d")
_CALIBRATIONS = (".toml", ".qca.txt", ".yml", ".npz")


def in_folders(study: Study, pattern: str) -> Iterator[Recording]:
    """The recordings that one pattern of the study file describes, and each folder that cannot be read, with its
    problem."""
    kind: Kind = "keypoints" if study.data.keypoints else "videos"
    unread: list[OSError] = []
    for source, names in Pattern(pattern).matches(study.root, on_error=unread.append):
        calibration, problem = _calibration(study, names)
        if source == calibration:
            continue  # of {subject}/{session}/{trial}, where it lies beside the trials
        subject, session, trial = (names.get(name, _ALL) for name in PLACEHOLDERS)
        yield Recording(subject, session, trial, source, kind, calibration, problem)
    yield from (_unread(error, kind) for error in unread)


def _unread(error: OSError, kind: Kind) -> Recording:
    return Recording.unknown(Path(error.filename or ""), kind, f"{error.filename}: {error.strerror}")


def _calibration(study: Study, names: dict[str, str]) -> tuple[Path | None, str]:
    """Of a recording with these names, or what is wrong with it."""
    text = study.data.calibration
    if not text or study.steps.calibrate == "people":
        return None, ""
    own = {name: value for name, value in names.items() if name in Pattern(text).placeholders}
    try:
        found = _found(text, study.root, tuple(own.items()))
    except OSError as error:
        return None, f"its calibration cannot be read: {error.filename}: {error.strerror}"
    if len(found) == 1:
        return found[0], ""
    wanted = text.format_map(names)
    if not found:
        return None, f"it has no calibration: there is no {wanted} in {study.root}"
    return None, f"it has several calibrations: {', '.join(path.name for path in found)} match {wanted}"


@lru_cache(maxsize=16)  # recordings of one session follow each other
def _found(text: str, root: Path, names: tuple[tuple[str, str], ...]) -> tuple[Path, ...]:
    return tuple(path for path, _ in Pattern(text).matches(root, dict(names)))


def in_pose2sim(study: Study) -> Iterator[Recording]:
    """The trials below root, as Pose2Sim has them, and each folder that cannot be read, with its problem."""
    kind: Kind = "videos" if study.data.videos else "keypoints"
    wanted = study.data.videos or study.data.keypoints or _KEYPOINTS
    yield from _trials(study, (study.root,), None, kind, wanted)


def _trials(
    study: Study, above: tuple[Path, ...], session: Path | None, kind: Kind, wanted: tuple[str, ...]
) -> Iterator[Recording]:
    """In the last of these folders, each of which is in the one before."""
    folder = above[-1]
    try:
        if any(os.path.samefile(folder, each) for each in above[:-1]):
            return  # a link in a circle
        inside = sorted((name for name in os.listdir(folder) if (folder / name).is_dir()), key=natural_key)
    except OSError as error:
        yield _unread(error, kind)
        return
    if any("calib" in name.lower() for name in inside):
        session = folder
    source = next((folder / name for name in wanted if name in inside), None)
    if source is not None:
        yield _trial(study, folder, session, source, kind)
        return
    for name in inside:
        if not name.startswith(".") and "calib" not in name.lower() and name not in (*_KEYPOINTS, *_VIDEOS):
            yield from _trials(study, (*above, folder / name), session, kind, wanted)


def _trial(study: Study, folder: Path, session: Path | None, source: Path, kind: Kind) -> Recording:
    base = session or study.root
    *between, trial = folder.relative_to(base).parts or (folder.name,)
    calibration, problem = None, ""
    if study.steps.calibrate != "people":
        calibration, problem = _pose2sim_calibration(session, folder)
    # A session of trials without a folder for each participant is that of one.
    return Recording("_".join(between) or base.name, base.name, trial, source, kind, calibration, problem)


@lru_cache(maxsize=16)
def _calibration_files(session: Path) -> tuple[Path, ...]:
    folders = [path for path in visible(session) if path.is_dir() and "calib" in path.name.lower()]
    return tuple(file for path in folders for file in visible(path) if file.name.lower().endswith(_CALIBRATIONS))


def _pose2sim_calibration(session: Path | None, trial: Path) -> tuple[Path | None, str]:
    if session is None:
        return None, f"it has no calibration: no folder above {trial} has a folder named calibration"
    try:
        files = _calibration_files(session)
    except OSError as error:
        return None, f"its calibration cannot be read: {error.filename}: {error.strerror}"
    if len(files) == 1:
        return files[0], ""
    if not files:
        return None, f"it has no calibration: the calibration folder in {session} holds no calibration file"
    return None, f"it has several calibrations: {', '.join(str(file.relative_to(session)) for file in files)}"
