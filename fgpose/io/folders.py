"""What is in a folder, without what systems hide there; and what files of people are called in it."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from fgpose.io.camera_names import natural_key


def visible(folder: Path) -> list[Path]:
    """The entries of a folder in natural order, without those whose names begin with a dot: macOS puts ``._name``
    beside each file on a disk that is not its own. Raises OSError if it cannot be listed."""
    return shown(folder.iterdir())


def shown(paths: Iterable[Path]) -> list[Path]:
    """Those that are not hidden, in natural order."""
    return sorted((path for path in paths if not path.name.startswith(".")), key=lambda path: natural_key(path.name))


def files_below(folder: Path) -> Iterator[Path]:
    """All files in a folder and its folders, none hidden or in what is hidden, in an order that does not depend on the
    machine."""
    for inside, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(inside, name) for name in sorted(files) if not name.startswith("."))


def own_paths(path: Path, people: Collection[int]) -> tuple[Path, ...]:
    """A file for each person, named after the number; whoever is alone has the file itself."""
    return (path,) if len(people) == 1 else tuple(path.with_stem(f"{path.stem}_person{person}") for person in people)
