"""Results of a study, perhaps of somebody else: none is a link, through which it would be written elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

# What fgpose study and fgpose report write into the folder of the results.
_FOLDERS = ("recordings", "motion", "angles")
_FILES = ("quality.csv", "quality.parquet", "events.parquet", "report.html")


def check_unlinked(results: Path) -> None:
    """Make sure that what is read and written as a result of a study is in the folder of its results. The folder itself
    may be a link, and so may anything in it that fgpose does not write.

    Raises:
        OSError: there is a link, or a folder that cannot be listed; the message names it.
    """
    for path in (results / name for name in (*_FOLDERS, *_FILES)):
        link = path if path.is_symlink() else next(_links(path), None) if path.is_dir() else None
        if link is not None:
            raise OSError(
                f"{link} is a link, to {os.readlink(link)}: results of a study are neither read nor written through "
                "links, for a study of somebody else could name any file. Remove it; output in the study file may name "
                "another folder, and inputs may be links"
            )


def _links(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_symlink():
                yield Path(entry.path)
            elif entry.is_dir():
                yield from _links(Path(entry.path))
