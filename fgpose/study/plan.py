"""Which recordings a study has, found while it runs: no list of them is ever made."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

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
        """Recordings, and as one with a problem each pattern that matches nothing.

        Raises:
            OSError: a folder cannot be read.
        """
        seen: set[bytes] = set()
        for recording in self._found():
            if not self._is_wanted(recording):
                continue
            digest = hashlib.blake2b(recording.key.encode(), digest_size=16).digest()
            if digest in seen:
                recording = replace(recording, problem=f"it is there twice: {recording.source} is another of its name")
            seen.add(digest)
            yield recording

    def counted(self) -> int:
        """How many there are.

        Raises:
            ValueError: there is none; the message names the pattern and what is there instead.
            OSError: a folder cannot be read.
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

    def _is_wanted(self, recording: Recording) -> bool:
        if not recording.trial:
            return not self.only
        if recording.source.is_relative_to(self.study.output):
            return False  # results of the study, not recordings
        key = recording.key
        excluded = any(fnmatchcase(key, pattern) for pattern in self.study.data.exclude)
        return not excluded and (not self.only or fnmatchcase(key, self.only))

    def _nothing(self) -> str:
        data, root = self.study.data, self.study.root
        if self.only:
            return f"no recording matches {self.only!r}; keys are subject/session/trial, as in S01/morning/walk_*"
        if not root.is_dir():
            return f"data.root: there is no folder {root}"
        there = ", ".join(sorted(path.name for path in root.iterdir())[:8]) or "nothing"
        if data.exclude and any(
            each.trial for each in replace(self, study=replace(self.study, data=replace(data, exclude=())))
        ):
            return f"data.exclude leaves out every recording: {', '.join(map(repr, data.exclude))}"
        if data.layout == "pose2sim":
            return f"no folder below {root} is a trial of Pose2Sim; it holds {there}"
        patterns = ", ".join(map(repr, data.keypoints or data.videos))
        return f"no recording matches {patterns} in {root}, which holds {there}"


def _of_nothing(study: Study, pattern: str) -> Recording:
    """Stands in the table for a pattern that matches nothing."""
    kind = "keypoints" if study.data.keypoints else "videos"
    problem = f"data.{kind}: the pattern {pattern!r} matches nothing in {study.root}"
    return Recording("", "", "", study.root / pattern, kind, problem=problem)
