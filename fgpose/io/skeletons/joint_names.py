"""Which joints files have: by their number, or by names that they say themselves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache

from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.skeleton import Skeleton

_FEET = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("big_toe", "small_toe", "heel"))
# MMPose's names of data sets, without separators.
_SKELETON_OF_DATA_SET = {
    "coco": "coco_17",
    "cocowholebody": "coco_wholebody_133",
    "halpe26": "halpe_26",
    "body26": "halpe_26",
    "halpe": "halpe_136",
    "h36m": "h36m_17",
}
# What our skeletons call otherwise.
_SYNONYMS = {"root": "pelvis", "hip": "pelvis", "midhip": "pelvis"}


@cache
def _larger_sets() -> dict[int, tuple[str, tuple[str, ...]]]:
    """Sets of joints with face and hands, by their number: the name, and the joints known here, which come first."""
    return {
        70: ("MHR70", load_skeleton("mhr_70").joints),
        133: ("COCO-WholeBody", (*load_skeleton("coco_17").joints, *_FEET)),
        135: ("BODY_135", load_skeleton("body_25b").joints),
        136: ("Halpe with face and hands", load_skeleton("halpe_26").joints),
    }


def chosen_joints(skeleton: Skeleton, n_given: int) -> tuple[int, ...] | None:
    """Where the joints of the skeleton are among so many; None where these are not a larger set that has them all."""
    if n_given == skeleton.n_joints or n_given not in _larger_sets():
        return None
    _, names = _larger_sets()[n_given]
    if not set(skeleton.joints) <= set(names):
        return None
    return tuple(names.index(joint) for joint in skeleton.joints)


def skeletons_with(n_given: int) -> tuple[str, ...]:
    """The built-in skeletons of so many joints; of a larger set that is known, the one that takes most of them."""
    known = {name: load_skeleton(name) for name in builtin_skeletons()}
    exact = tuple(name for name, skeleton in known.items() if skeleton.n_joints == n_given)
    among = [name for name, skeleton in known.items() if chosen_joints(skeleton, n_given) is not None]
    return exact or tuple(sorted(among, key=lambda name: -known[name].n_joints)[:1])


def skeletons_named(names: Sequence[str], data_set: str = "") -> tuple[str, ...]:
    """The built-in skeletons that have these joints at these places, or that a data set of MMPose has."""
    if names:
        return tuple(each for each in builtin_skeletons() if _is_of(each, names))
    known = _SKELETON_OF_DATA_SET.get(plain_joint(data_set))
    return () if known is None else (known,)


def no_such_joints(skeleton: Skeleton, n_given: int = -1) -> str:
    """What to say where so many joints are not those of the skeleton."""
    return f"skeleton {skeleton.name} has {skeleton.n_joints} joints{whose_joints(skeleton, n_given)}"


def whose_joints(skeleton: Skeleton, n_given: int) -> str:
    """``". So many has halpe_26"``: what has so many joints, which are not the skeleton's; empty: none is known."""
    if n_given == skeleton.n_joints:
        return ""
    others = skeletons_with(n_given)
    if n_given not in _larger_sets():
        return f". So many has {' or '.join(others)}" if others else ""
    name, joints = _larger_sets()[n_given]
    if skeleton.parts and others:
        return f". The {n_given} are {name}: use --skeleton {others[0]}"
    lacking = [joint for joint in skeleton.joints if joint not in joints]
    fitting = [each for each in builtin_skeletons() if chosen_joints(load_skeleton(each), n_given) is not None]
    return f". The {n_given} are {name}, without {_listed(lacking)}: use --skeleton {fitting[0]}"


def check_joints(skeleton: Skeleton, names: Sequence[str], data_set: str = "") -> None:
    """Compare the joints that a file says it has with those of the skeleton. Names are compared without case and
    separators; where the two have no name in common nothing can be said.

    Args:
        skeleton: what the joints are read as.
        names: of all joints of the file, in its order; none where only the data set is known.
        data_set: that the network was trained on, as MMPose calls it.

    Raises:
        ValueError: a joint is at another place, or there is another number of them; the message names the skeleton that
            fits.
    """
    known = _SKELETON_OF_DATA_SET.get(plain_joint(data_set))
    names = list(names) or list(load_skeleton(known).joints if known else ())
    chosen = chosen_joints(skeleton, len(names))
    if not names or _fits(skeleton, names if chosen is None else [names[i] for i in chosen]):
        return
    fitting = [each for each in skeletons_named(names) if each != skeleton.name]
    said = f", of {data_set}" if data_set else ""
    remedy = f"give --skeleton {fitting[0]}" if fitting else "give a skeleton file with these joints in this order"
    raise ValueError(
        f"it says that its joints are {_listed(names)}{said}, not those of skeleton {skeleton.name} "
        f"({_listed(skeleton.joints)}); {remedy}"
    )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:8])
    return f"{shown}, ... ({len(names)})" if len(names) > 8 else shown


def _is_of(builtin: str, names: Sequence[str]) -> bool:
    skeleton = load_skeleton(builtin)
    chosen = chosen_joints(skeleton, len(names))
    used = list(names) if chosen is None else [names[i] for i in chosen]
    return bool(_common(skeleton, used)) and _fits(skeleton, used)


def _fits(skeleton: Skeleton, names: Sequence[str]) -> bool:
    """Whether there are as many, and those that both have are at the same places."""
    common = _common(skeleton, names)
    ours, theirs = [plain_joint(joint) for joint in skeleton.joints], [plain_joint(name) for name in names]
    if not common:
        return True
    return len(ours) == len(theirs) and all(ours.index(name) == theirs.index(name) for name in common)


def _common(skeleton: Skeleton, names: Sequence[str]) -> set[str]:
    return {plain_joint(joint) for joint in skeleton.joints} & {plain_joint(name) for name in names}


def plain_joint(name: str) -> str:
    """What names of joints are compared by."""
    plain = re.sub(r"[_\-.\s]", "", name.casefold())
    return _SYNONYMS.get(plain, plain)
