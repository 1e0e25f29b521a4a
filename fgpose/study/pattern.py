"""Patterns of paths: which part of a path is the subject, the session, the trial."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from fgpose.io.names import natural_key
from fgpose.io.studies.results import are_results

OnError = Callable[[OSError], None]
"""Called with what is wrong with a folder, which is then passed over."""
PLACEHOLDERS = ("subject", "session", "trial")
_TOKEN = re.compile(r"\{([^{}]*)\}|(\*)")


@dataclass(frozen=True)
class Pattern:
    """A path in which {subject}, {session} and {trial} stand for names, and * for anything within a name."""

    text: str

    @staticmethod
    def parse(text: str, key: str) -> Pattern:
        """Raises ValueError, which names the key of the study file, for an unknown placeholder or a stray brace."""
        for name, star in _TOKEN.findall(text):
            if not star and name not in PLACEHOLDERS:
                nearest = difflib.get_close_matches(name, PLACEHOLDERS, n=1, cutoff=0.0)[0]
                raise ValueError(f"{key}: unknown placeholder {{{name}}} in {text!r}; did you mean {{{nearest}}}?")
        if not text or set("{}") & set(_TOKEN.sub("", text)):
            raise ValueError(f"{key}: {text!r} is no pattern")
        return Pattern(text)

    @property
    def placeholders(self) -> set[str]:
        return {name for name, _ in _TOKEN.findall(self.text) if name}

    def matches(
        self, root: Path, names: Mapping[str, str] | None = None, on_error: OnError | None = None
    ) -> Iterator[tuple[Path, dict[str, str]]]:
        """The paths that match, with their names, folder by folder in natural order. At no time more is held than the
        names in one folder of each level. Folders of results of studies are entered only where the pattern has their
        own name.

        Args:
            root: to which the pattern is relative, unless it is absolute.
            names: those that are known already.
            on_error: told of each folder that cannot be read; without it, such a folder is an error.

        Raises:
            OSError: a folder cannot be read.
        """
        path = Path(self.text)
        start = Path(path.anchor) if path.is_absolute() else root
        parts = path.parts[1:] if path.is_absolute() else path.parts
        yield from _walk(start, parts, dict(names or {}), on_error or _raise)


def _raise(error: OSError) -> None:
    raise error


def _walk(
    folder: Path, parts: tuple[str, ...], names: dict[str, str], on_error: OnError
) -> Iterator[tuple[Path, dict[str, str]]]:
    if not parts:
        yield folder, names
        return
    part, rest = parts[0], parts[1:]
    try:
        inside = _inside(folder, part, names, only_folders=bool(rest))
    except OSError as error:
        on_error(error)
        return
    for name, found in inside:
        yield from _walk(folder / name, rest, names | found, on_error)


def _inside(
    folder: Path, part: str, names: Mapping[str, str], *, only_folders: bool
) -> list[tuple[str, dict[str, str]]]:
    """What in a folder is as this part of a pattern, with the names that it says. Raises OSError."""
    if not _TOKEN.search(part):
        return [(part, {})] if (folder / part).exists() else []
    if not folder.is_dir():
        return []
    wanted = _regex(part, names)
    matches = {entry: wanted.fullmatch(entry) for entry in sorted(os.listdir(folder), key=natural_key)}
    return [
        (entry, found.groupdict())
        for entry, found in matches.items()
        if found
        and not entry.startswith(".")
        and (not only_folders or (folder / entry).is_dir())
        and not are_results(folder / entry)
    ]


def _regex(part: str, names: Mapping[str, str]) -> re.Pattern[str]:
    """Of one name in a path; a placeholder whose name is known stands for it."""
    seen: set[str] = set()
    pieces, end = [], 0
    for token in _TOKEN.finditer(part):
        pieces.append(re.escape(part[end : token.start()]))
        pieces.append(_piece(token, names, seen))
        end = token.end()
    return re.compile("".join(pieces) + re.escape(part[end:]))


def _piece(token: re.Match[str], names: Mapping[str, str], seen: set[str]) -> str:
    name = token[1]
    if token[2]:
        return ".*"
    if name in names:
        return re.escape(names[name])
    if name in seen:
        return f"(?P={name})"
    seen.add(name)
    return f"(?P<{name}>.+?)"
