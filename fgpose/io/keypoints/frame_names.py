"""Which number in the names of images is that of the frame."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

# Frame numbers are counters; longer ones overflow the arithmetic on them, and are identifiers.
MAX_FRAME = 10**15


def frame_numbers(names: Sequence[str], camera: str) -> dict[str, int | None]:
    """Of each name, without its extension, the number that counts the images of a camera; None where there is none.

    Names that differ only in numbers count by the number that is another in each: frame000012_cam01 and
    cam01_000012_halpe26 are frame 12. Where several are, by the one that is densest (a time stamp is not), and of these
    by the last. A single name counts by its last number. The name of the camera does not count.
    """
    parts = {name: _parts(name, camera) for name in names}
    alike: dict[tuple[str, ...], list[str]] = {}
    for name, (texts, _) in parts.items():
        alike.setdefault(texts, []).append(name)
    found: dict[str, int | None] = {}
    for same in alike.values():
        columns = list(zip(*(parts[name][1] for name in same), strict=True))
        usable = [column for column in columns if all(number < MAX_FRAME for number in column)]
        counting = [column for column in usable if len(set(column)) == len(column)]
        column = _densest(counting if len(same) > 1 and counting else usable[-1:])
        found |= dict(zip(same, column, strict=True)) if column else dict.fromkeys(same)
    return found


def _parts(name: str, camera: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """The texts between the numbers, and the numbers."""
    # A camera whose name is a number may be called like a frame.
    if re.search(r"[^\W\d_]", camera):
        without = re.sub(rf"(?<!\d){re.escape(camera)}(?!\d)", "", name, flags=re.IGNORECASE)
        name = without if re.search(r"[0-9]", without) else name
    texts = re.split(r"[0-9]+", name)
    return tuple(texts), tuple(_number(digits) for digits in re.findall(r"[0-9]+", name))


def _number(digits: str) -> int:
    """MAX_FRAME for more than that: Python refuses to convert some thousand digits."""
    digits = digits.lstrip("0") or "0"
    return int(digits) if len(digits) < len(str(MAX_FRAME)) else MAX_FRAME


def _densest(columns: Iterable[tuple[int, ...]]) -> tuple[int, ...]:
    return min(reversed(list(columns)), key=lambda column: max(column) - min(column), default=())
