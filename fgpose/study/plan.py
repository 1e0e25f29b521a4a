"""Which recordings a study has, found while it runs: no list of them is ever made."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from fgpose.io.folders import visible
from fgpose.study.job import CALIBRATION, CAMERAS
from fgpose.study.layouts import in_folders, in_pose2sim
from fgpose.study.recording import Recording
from fgpose.study.study import Study


@dataclass(frozen=True)
class Plan:
    """The recordings of a study, each time looked for anew. Of each only 16 bytes are kept, to notice one that is there
    twice."""

    study: Study
    only: str = ""
    """Pattern of subject/session/trial; all by default."""

    def __iter__(self) -> Iterator[Recording]:
        """Recordings, and as one with a problem each pattern that matches nothing and each folder that cannot be
        read."""
        for stage in self.stages():
            yield from stage

    def stages(self) -> Iterator[Iterator[Recording]]:
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

    def _walks(self) -> dict[tuple[str, str], Recording]:
        """Of each session the trial on which its cameras are calibrated."""
        walks: dict[tuple[str, str], Recording] = {}
        for recording in self._found():
            if fnmatchcase(recording.trial, self.study.from_people.trial) and self._is_in_study(recording):
                walks.setdefault((recording.subject, recording.session), recording)
        return walks

    def _calibrated(self, recording: Recording, walks: Mapping[tuple[str, str], Recording]) -> Recording:
        """With the calibration of its session."""
        walk = walks.get((recording.subject, recording.session))
        if recording.problem:
            return recording
        if walk is None:
            trial = self.study.from_people.trial
            return replace(recording, problem=f"its session has no trial {trial!r} to calibrate the cameras on")
        file = walk.folder(self.study.output) / (CAMERAS if walk.kind == "videos" else CALIBRATION)
        return replace(recording, calibration=file, calibrated_on=walk.key)

    def _wanted(self, found: Iterable[Recording], keys: _Keys) -> Iterator[Recording]:
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

    def _found(self) -> Iterator[Recording]:
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

    def _is_in_study(self, recording: Recording) -> bool:
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

    def is_new(self, recording: Recording) -> bool:
        digest = hashlib.blake2b(recording.key.encode(), digest_size=16).digest()
        is_new = digest not in self.digests
        self.digests.add(digest)
        return is_new


def _twice(recording: Recording) -> Recording:
    return replace(recording, problem=f"it is there twice: {recording.source} is another of its name")


def _of_nothing(study: Study, pattern: str) -> Recording:
    """Stands in the table for a pattern that matches nothing."""
    kind = "keypoints" if study.data.keypoints else "videos"
    problem = f"data.{kind}: the pattern {pattern!r} matches nothing in {study.root}"
    return Recording.unknown(study.root / pattern, kind, problem)
