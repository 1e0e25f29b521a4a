"""What a recording is made from: names, sizes and times of its files to see quickly that nothing has changed, and what
they hold where that does not tell, as on another machine."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from fgpose.io.folders import files_below
from fgpose.plain_files import open_plain
from fgpose.study.recording import Recording
from fgpose.study.study import Study, skeleton_of

_PART_BYTES = 1 << 20


def inputs_of(study: Study, recording: Recording) -> dict[str, Path]:
    """The files and folders from which a recording is made, by what they are."""
    inputs = {"source": recording.source}
    if recording.calibration is not None:
        inputs["calibration"] = recording.calibration
    skeleton = skeleton_of(study)
    if isinstance(skeleton, Path):
        inputs["skeleton"] = skeleton
    if study.from_people.intrinsics:
        inputs["intrinsics"] = study.file(study.from_people.intrinsics)
    for name, text in (("model", study.detect.model), ("detector", study.detect.detector)):
        if text and recording.kind == "videos" and study.file(text).is_file():
            inputs[name] = study.file(text)
    return inputs


def stamp_of(inputs: Mapping[str, Path]) -> str:
    """Digest of names, sizes and times of all files. Raises OSError if one cannot be seen."""
    digest = hashlib.blake2b(digest_size=16)
    for name, path in inputs.items():
        digest.update(f"{name}\0{path}\0".encode())
        for file, entry in _files(path):
            stat = entry.stat()
            digest.update(f"{file}\0{stat.st_size}\0{stat.st_mtime_ns}\0".encode())
    return digest.hexdigest()


def contents_of(inputs: Mapping[str, Path]) -> dict[str, str]:
    """Digest of what each input holds, whatever it is called. Raises OSError if a file cannot be read."""
    return {name: _content(path) for name, path in inputs.items()}


def _content(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for file, entry in _files(path):
        digest.update(f"{file}\0{entry.stat().st_size}\0".encode())
        with open_plain(entry) as stream:
            while part := stream.read(_PART_BYTES):
                digest.update(part)
    return digest.hexdigest()


def _files(path: Path) -> Iterator[tuple[str, Path]]:
    """All files of a folder that are not hidden, or the file."""
    if not path.is_dir():
        yield "", path
        return
    for file in files_below(path):
        yield file.relative_to(path).as_posix(), file
