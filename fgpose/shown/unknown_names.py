"""Which name was meant by one that there is not: of cameras, joints, commands, options."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches

_NEAR = 0.65  # of difflib's measure, in which hpi is as near to hip as 0.67


def nearest(name: str, names: Iterable[str], n_most: int = 1) -> list[str]:
    """Those that are near, the nearest first; case and separators do not count."""
    by_plain: dict[str, str] = {}
    for known in names:
        by_plain.setdefault(plain(known), known)
    wanted = plain(name)
    if not any(letter.isalpha() for letter in wanted):
        return []
    if wanted in by_plain:
        return [by_plain[wanted]]
    return [by_plain[near] for near in get_close_matches(wanted, by_plain, n=n_most, cutoff=_NEAR)]


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """``" (did you mean left_wrist?)"``; nothing where no name is near: cam_5 is not cam_6, but it is cam05."""
    possible = [known for known in names if _numbers(known) == _numbers(name)]
    return "".join(f" (did you mean {near}?)" for near in nearest(name, possible))


def check_names(wanted: Iterable[str], known: Collection[str], lacks: str, has: str) -> None:
    """Raises ValueError unless all names are known: the unknown ones, what may be meant by each, and those there are.

    Args:
        wanted: names to look up.
        known: all there are.
        lacks: what is said before the unknown names; "the calibration has no camera".
        has: what is said before those that there are; "it has".
    """
    unknown = dict.fromkeys(name for name in wanted if name not in known)
    if unknown:
        said = ", ".join(f"{name}{did_you_mean(str(name), known)}" for name in unknown)
        raise ValueError(f"{lacks} {said}; {has} {', '.join(known)}")


def plain(name: str) -> str:
    """Its letters and digits, in lower case."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _numbers(name: str) -> list[int]:
    return [int(number) for number in re.findall(r"[0-9]+", name)]
