"""Which recordings a study has, found while it runs in folders as its file or Pose2Sim has them: no list is made."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path

from fgpose.io.names import natural_key, visible
from fgpose.study.job import CALIBRATION, CAMERAS
from fgpose.study.pattern import PLACEHOLDERS, Pattern
from fgpose.study.study import StudyDescription
from fgpose.study.trial import Kind, Trial

# Where a pattern has no such part.
_ALL = "all"
# Pose2Sim's names since 0.9 and before; what is synchronised is better than what is not.
_KEYPOINTS = ("pose-sync", "pose", "pose-associated", "pose-2d")
_VIDEOS = ("videos", "raw-2d")
_CALIBRATIONS = (".toml", ".qca.txt", ".yml", ".npz")


@dataclass(frozen=True)
class Plan:
    """The recordings of a study, each time looked for anew. Of each only 16 bytes are kept, to notice one that is there
    twice."""

    study: StudyDescription
    only: str = ""
    """Pattern of subject/session/trial; all by default."""

    def __iter__(self) -> Iterator[Trial]:
        """Recordings, and as one with a problem each pattern that matches nothing and each folder that cannot be
        read."""
        for stage in self.stages():
            yield from stage

    def stages(self) -> Iterator[Iterator[Trial]]:
        """The same, in parts each of which needs what comes of those before: first the trials on which the cameras of a
        session are calibrated, if there are such."""
        keys = _Keys()
        if not self.study.from_people.trial:
            yield self._wanted(self._found(), keys)
            return
        walks = self._walks()
        yield self._wanted(iter(walks.values()), keys)
        others = (each for each in self._found() if walks.get((each.subject, each.session)) != each)
        yield self._wanted((self._calibrated(each, walks) for each in others), keys)

    def _walks(self) -> dict[tuple[str, str], Trial]:
        """Of each session the trial on which its cameras are calibrated."""
        walks: dict[tuple[str, str], Trial] = {}
        for recording in self._found():
            if fnmatchcase(recording.trial, self.study.from_people.trial) and self._is_in_study(recording):
                walks.setdefault((recording.subject, recording.session), recording)
        return walks

    def _calibrated(self, recording: Trial, walks: Mapping[tuple[str, str], Trial]) -> Trial:
        """With the calibration of its session."""
        walk = walks.get((recording.subject, recording.session))
        if recording.problem:
            return recording
        if walk is None:
            trial = self.study.from_people.trial
            return replace(recording, problem=f"its session has no trial {trial!r} to calibrate the cameras on")
        file = walk.folder(self.study.output) / (CAMERAS if walk.kind == "videos" else CALIBRATION)
        return replace(recording, calibration=file, calibrated_on=walk.key)

    def _wanted(self, found: Iterable[Trial], keys: _Keys) -> Iterator[Trial]:
        for recording in found:
            if self._is_in_study(recording) and (not self.only or fnmatchcase(recording.key, self.only)):
                yield recording if not recording.trial or keys.is_new(recording) else _twice(recording)

    def counted(self) -> int:
        """How many there are.

        Raises:
            ValueError: there is none; the message names the pattern and what is there instead.
            OSError: the root cannot be read.
        """
        n_recordings = sum(1 for _ in self)
        if not any(recording.trial for recording in self):
            raise ValueError(self._nothing())
        return n_recordings

    def _found(self) -> Iterator[Trial]:
        if self.study.data.layout == "pose2sim":
            yield from in_pose2sim(self.study)
            return
        for pattern in self.study.data.keypoints or self.study.data.videos:
            n_found = 0
            for recording in in_folders(self.study, pattern):
                n_found += 1
                yield recording
            if not n_found:
                yield _of_nothing(self.study, pattern)

    def _is_in_study(self, recording: Trial) -> bool:
        if not recording.trial:
            return not self.only
        if recording.source.is_relative_to(self.study.output):
            return False  # results of the study, not recordings
        return not any(fnmatchcase(recording.key, pattern) for pattern in self.study.data.exclude)

    def _nothing(self) -> str:
        data, root = self.study.data, self.study.root
        if self.only:
            return f"no recording matches {self.only!r}; keys are subject/session/trial, as in S01/morning/walk_*"
        if not root.is_dir():
            return f"data.root: there is no folder {root}"
        there = ", ".join([path.name for path in visible(root)][:8]) or "nothing"
        if data.exclude and any(
            each.trial for each in replace(self, study=replace(self.study, data=replace(data, exclude=())))
        ):
            return f"data.exclude leaves out every recording: {', '.join(map(repr, data.exclude))}"
        if data.layout == "pose2sim":
            return f"no folder below {root} is a trial of Pose2Sim; it holds {there}"
        patterns = ", ".join(map(repr, data.keypoints or data.videos))
        return f"no recording matches {patterns} in {root}, which holds {there}"


@dataclass
class _Keys:
    """Those that there were so far, 16 bytes each."""

    digests: set[bytes] = field(default_factory=set)

    def is_new(self, recording: Trial) -> bool:
        digest = hashlib.blake2b(recording.key.encode(), digest_size=16).digest()
        is_new = digest not in self.digests
        self.digests.add(digest)
        return is_new


def _twice(recording: Trial) -> Trial:
    return replace(recording, problem=f"it is there twice: {recording.source} is another of its name")


def _of_nothing(study: StudyDescription, pattern: str) -> Trial:
    """Stands in the table for a pattern that matches nothing."""
    kind = "keypoints" if study.data.keypoints else "videos"
    problem = f"data.{kind}: the pattern {pattern!r} matches nothing in {study.root}"
    return Trial.unknown(study.root / pattern, kind, problem)


def in_folders(study: StudyDescription, pattern: str) -> Iterator[Trial]:
    """The recordings that one pattern of the study file describes, and each folder that cannot be read, with its
    problem."""
    kind: Kind = "keypoints" if study.data.keypoints else "videos"
    unread: list[OSError] = []
    for source, names in Pattern(pattern).matches(study.root, on_error=unread.append):
        calibration, problem = _calibration(study, names)
        if source == calibration:
            continue  # of {subject}/{session}/{trial}, where it lies beside the trials
        subject, session, trial = (names.get(name, _ALL) for name in PLACEHOLDERS)
        yield Trial(subject, session, trial, source, kind, calibration, problem)
    yield from (_unread(error, kind) for error in unread)


def _unread(error: OSError, kind: Kind) -> Trial:
    return Trial.unknown(Path(error.filename or ""), kind, f"{error.filename}: {error.strerror}")


def _calibration(study: StudyDescription, names: dict[str, str]) -> tuple[Path | None, str]:
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


def in_pose2sim(study: StudyDescription) -> Iterator[Trial]:
    """The trials below root, as Pose2Sim has them, and each folder that cannot be read, with its problem."""
    kind: Kind = "videos" if study.data.videos else "keypoints"
    wanted = study.data.videos or study.data.keypoints or _KEYPOINTS
    yield from _trials(study, (study.root,), None, kind, wanted)


def _trials(
    study: StudyDescription, above: tuple[Path, ...], session: Path | None, kind: Kind, wanted: tuple[str, ...]
) -> Iterator[Trial]:
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


def _trial(study: StudyDescription, folder: Path, session: Path | None, source: Path, kind: Kind) -> Trial:
    base = session or study.root
    *between, trial = folder.relative_to(base).parts or (folder.name,)
    calibration, problem = None, ""
    if study.steps.calibrate != "people":
        calibration, problem = _pose2sim_calibration(session, folder)
    # A session of trials without a folder for each participant is that of one.
    return Trial("_".join(between) or base.name, base.name, trial, source, kind, calibration, problem)


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
