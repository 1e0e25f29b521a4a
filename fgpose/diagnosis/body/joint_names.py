"""Joints in words, and which of them belong together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from fgpose.skeleton import Skeleton

_SIDE = re.compile(r"^(left|right)_")
# What a network takes for something else, it takes as a whole.
_LIMBS: Mapping[str, tuple[str, ...]] = {
    "arm": ("shoulder", "elbow", "wrist", "hand", "thumb", "pinky", "index"),
    "leg": ("hip", "knee", "ankle", "heel", "big_toe", "small_toe", "foot_index", "foot"),
    "head": ("nose", "eye", "eye_inner", "eye_outer", "ear", "mouth", "head", "head_top"),
}

_NAMED = 3  # more of a hand or a face are counted


def limb_of(joint: str) -> str:
    """The arm, leg or head that a joint belongs to, with its side; other joints are limbs of their own."""
    side, name = (_SIDE.match(joint) or [""])[0], _SIDE.sub("", joint)
    limb = next((limb for limb, names in _LIMBS.items() if name in names), name)
    return limb if limb == "head" else f"{side}{limb}"


def in_words(joints: Iterable[str]) -> str:
    """Joints with those of both sides as one: "knees, ankles and left wrist"."""
    names, words = list(dict.fromkeys(joints)), []
    for name in names:
        other = _SIDE.sub(lambda found: "right_" if found.group(1) == "left" else "left_", name)
        if other != name and other in names:
            plural = f"{_SIDE.sub('', name)}s".replace("exs", "ices").replace("_", " ")
            words += [plural] if plural not in words else []
        else:
            words.append(name.replace("_", " "))
    return in_a_row(words)


def in_a_row(words: Sequence[str]) -> str:
    """As "knees, ankles and left wrist"; one at least."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def in_words_by_part(skeleton: Skeleton, joints: Sequence[str], at_most: int | None = None) -> str:
    """The same. Many of a hand or a face are counted: "left wrist and 21 joints of the left hand"; so are those after
    so many."""
    parts = [skeleton.part_names[skeleton.index(joint)] for joint in joints]
    of_part = Counter(parts)
    words = (
        f"{of_part[part]} joints of the {part}" if part and of_part[part] > _NAMED else joint
        for joint, part in zip(joints, parts, strict=True)
    )
    different = list(dict.fromkeys(words))
    more = len(different[at_most:]) if at_most else 0
    return in_words(different[:at_most]) + (f" and {more} more" if more else "")
