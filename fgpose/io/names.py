"""What names of files and folders say: their natural order, what is hidden, whose they are, which camera is meant."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key that puts cam_2 before cam_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def camera_name(stem: str) -> str:
    """The name of a camera in that of its file or folder, without what detectors put around it: cam01_json,
    results_cam01 (MMPose), AlphaPose_cam01 and cam01DLC_resnet50_walkNov25shuffle1_100000 are cam01."""
    name = re.sub(r"DLC_.*$", "", stem) if "DLC_" in stem else stem
    for around in _AROUND:
        name = around.sub("", name)
    return name or stem


_AROUND = tuple(
    re.compile(pattern, flags=re.IGNORECASE)
    for pattern in (
        r"^(?:results|predictions|alphapose(?:-results)?)[_\-.\s]+",
        r"[_\-.\s]+(?:json|keypoints|predictions|results|alphapose(?:-results)?)$",
    )
)


def match_cameras(found: Iterable[str], rig_names: Iterable[str], *, ignore_others: bool = False) -> dict[str, str]:
    """For each camera of the rig, the name by which the keypoints call it.

    Case, underscores, hyphens, dots, blanks, zeros before a number and what detectors put around a name (camera_name)
    do not count: cam1_json is cam_01. Neither does what Pose2Sim puts around the name in its intrinsics: int_cam01_img
    is cam_01 too. If the two have no name in common, words that all names of the keypoints begin or end with do not
    count either: S01_walk_cam01 is cam_01 where the others are S01_walk_cam02, ...

    Args:
        ignore_others: whether keypoints may be of cameras that the rig lacks.

    Raises:
        ValueError: a camera is in one of the two only, or two names of one side are the same; the message names them.
    """
    rig = _by_plain_name(rig_names, "calibration")
    keypoints = _as_in(rig, _by_plain_name(found, "keypoints"))
    lacking = [name for plain, name in keypoints.items() if plain not in rig]
    unused = [name for plain, name in rig.items() if plain not in keypoints]
    if lacking and not (ignore_others and len(unused) < len(rig)):
        raise ValueError(_lacking(lacking, unused, keypoints.values(), rig.values()))
    if unused:
        raise ValueError(_unused(unused, keypoints.values(), rig.values()))
    return {name: keypoints[plain] for plain, name in rig.items()}


def _lacking(lacking: list[str], unused: list[str], found: Collection[str], rig: Collection[str]) -> str:
    """What to say of cameras that the calibration lacks."""
    if pairs := counted_otherwise(found, rig):
        return f"{pairs}. Leaving cameras out would take each for its neighbour"
    said = f"the calibration lacks camera {', '.join(lacking)} of the keypoints; it has {', '.join(rig)}"
    if len(unused) == len(rig):
        return f"{said}. They have no camera in common: is it the calibration of this recording?"
    if not unused:
        return f"{said}. Use only those with --cameras {' '.join(rig)}, in Python with ignore_other_cameras=True"
    return (
        f"{said}; camera {', '.join(unused)} of the calibration has no keypoints. Is one of them the other? Then give "
        "them the same name"
    )


def _unused(unused: list[str], found: Collection[str], rig: Collection[str]) -> str:
    """What to say of cameras without keypoints."""
    kept = [name for name in rig if name not in unused]
    said = f"camera {', '.join(unused)} of the calibration has no keypoints"
    theirs, ours = _by_number(found), _by_number(rig)
    if theirs and ours and min(ours) == 0 < min(theirs):
        said += f". If {theirs[min(theirs)]} is {ours[0]}, and so on, rename the folders or files; otherwise"
    else:
        said += ";"
    return f"{said} leave it out with --cameras {' '.join(kept)}, in Python with rig.subset({kept})"


def counted_otherwise(found: Iterable[str], rig_names: Iterable[str]) -> str:
    """What to say where equally many cameras have the same numbers but for a constant, as where one side counts from 0
    and the other from 1; else empty. Names that both sides have are then likely to be different cameras."""
    theirs, ours = _by_number(found), _by_number(rig_names)
    if theirs is None or ours is None or len(theirs) != len(ours) or len(ours) < 2:
        return ""
    steps = {a - b for a, b in zip(sorted(theirs), sorted(ours), strict=True)}
    if len(steps) != 1 or steps == {0}:
        return ""
    pairs = [(theirs[a], ours[b]) for a, b in zip(sorted(theirs), sorted(ours), strict=True)]
    return (
        f"the keypoints have cameras {', '.join(a for a, _ in pairs)}, the calibration has "
        f"{', '.join(b for _, b in pairs)}: one seems to count from {min(theirs)}, the other from {min(ours)}. If so, "
        f"give them the same names: {', '.join(f'{a} is {b}' for a, b in pairs)}; fgpose info then says whether they "
        "agree"
    )


def _by_number(names: Iterable[str]) -> dict[int, str] | None:
    """Names that differ only in the number at their end, by it."""
    numbered: dict[int, str] = {}
    heads = set()
    for name in names:
        found = re.fullmatch(r"(.*?)(\d{1,9})", _plain(name))
        if found is None or int(found[2]) in numbered:
            return None
        heads.add(found[1])
        numbered[int(found[2])] = name
    return numbered if len(heads) == 1 else None


def _as_in(rig: Collection[str], found: dict[str, str]) -> dict[str, str]:
    """Names of keypoints by what they are compared by. If the rig has none of them, they are compared without the words
    that all begin or end with, provided that it has some of those; else by their last word, as Qualisys names videos
    Walk1_Miqus_1_21299 by a number and the serial number, provided that the rig has each of those."""
    names = {name: re.split(r"[_\-.\s]+", camera_name(name)) for name in found.values()}
    if found.keys() & set(rig) or len(names) < 2:
        return found
    words = list(names.values())
    head = _n_shared(words)
    tail = _n_shared([each[head:][::-1] for each in words])
    own = {_plain("_".join(each[head : len(each) - tail])): name for name, each in names.items()}
    if own.keys() & set(rig):
        return own
    last = {_plain(each[-1]): name for name, each in names.items()}
    return last if len(last) == len(names) and last.keys() <= set(rig) else found


def _n_shared(lists: Sequence[Sequence[str]]) -> int:
    """How many words all begin with."""
    same = itertools.takewhile(lambda words: len(set(words)) == 1, zip(*lists, strict=False))
    return sum(1 for _ in same)


def seen_cameras(found: Iterable[str], rig_names: Iterable[str]) -> tuple[str, ...]:
    """Those cameras of the rig that the keypoints have, in its order; compared as match_cameras does."""
    rig = {_plain(name): name for name in rig_names}
    known = _as_in(rig, {_plain(name): name for name in found})
    return tuple(name for plain, name in rig.items() if plain in known)


def named_cameras(wanted: Iterable[str], known: Iterable[str]) -> dict[str, str]:
    """For each camera that is wanted, what it is called among those that are known; compared as match_cameras does.

    Raises:
        ValueError: one is not among them, or two names of one side are the same; the message names them.
    """
    by_plain_name = _by_plain_name(known, "file")
    names = {name: by_plain_name.get(plain) for plain, name in _by_plain_name(wanted, "recording").items()}
    lacking = [name for name, found in names.items() if found is None]
    if lacking:
        raise ValueError(f"it has no camera {', '.join(lacking)}, only {', '.join(by_plain_name.values())}")
    return {name: found for name, found in names.items() if found is not None}


def _plain(name: str) -> str:
    name = re.sub(r"^(?:int|ext)_(.+)_img$", r"\1", name, flags=re.IGNORECASE)
    # cam01 is cam1. Before the separators go: in cam_1_0 the zero is a number.
    name = re.sub(r"(?<!\d)0+(?=\d)", "", camera_name(name).casefold())
    return re.sub(r"[_\-.\s]", "", name)


def _by_plain_name(names: Iterable[str], where: str) -> dict[str, str]:
    plain_names: dict[str, str] = {}
    for name in names:
        plain = _plain(name)
        if plain in plain_names:
            raise ValueError(f"cameras {plain_names[plain]} and {name} of the {where} cannot be told apart")
        plain_names[plain] = name
    return plain_names


def visible(folder: Path) -> list[Path]:
    """The entries of a folder in natural order, without those whose names begin with a dot: macOS puts ``._name``
    beside each file on a disk that is not its own. Raises OSError if it cannot be listed."""
    return not_hidden(folder.iterdir())


def not_hidden(paths: Iterable[Path]) -> list[Path]:
    """Those that are not hidden, in natural order."""
    return sorted((path for path in paths if not path.name.startswith(".")), key=lambda path: natural_key(path.name))


def files_below(folder: Path) -> Iterator[Path]:
    """All files in a folder and its folders, none hidden or in what is hidden, in an order that does not depend on the
    machine."""
    for inside, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        yield from (Path(inside, name) for name in sorted(files) if not name.startswith("."))


def recording_name(source: Path) -> str:
    """What a recording is called: the name of its folder, or of its file without the extension; links do not count."""
    path = Path(os.path.realpath(source))
    return path.name if path.is_dir() else path.stem


def own_paths(path: Path, people: Collection[int]) -> tuple[Path, ...]:
    """A file for each person, named after the number; whoever is alone has the file itself."""
    return (path,) if len(people) == 1 else tuple(path.with_stem(f"{path.stem}_person{person}") for person in people)


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
