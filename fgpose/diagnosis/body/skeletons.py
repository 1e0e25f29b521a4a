"""Joints that are not what their names say: another skeleton with as many, or another order."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from fgpose.diagnosis.body.joint_names import in_words
from fgpose.diagnosis.body.proportions import LEAST_FRAMES, contradictions, lengths_m, looseness, strangeness
from fgpose.diagnosis.examined import Examined, NotJudgedError
from fgpose.finding import Code, Finding, Severity
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.skeleton import Skeleton

# 0.08 to 0.23 of two real recordings and of five motions with the errors of real detectors, a third of the joints
# hidden or not; 0.30 to 0.79 of built-in skeletons that are taken for each other.
_STRANGE, _VERY_STRANGE = 0.27, 0.35
# 0.008 to 0.020 of the same, and of joints in any other order; 0.04 to 0.4 of cameras whose poses or lenses are wrong.
_LOOSE = 0.035
_LESS = 0.65  # share of it that is left with the right one
_CHAINS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
_SIDES = (("left",), ("right",), ("left", "right"))
# Of the sum over all parts, in either half; a share of it where that is more than the 1 that it is of a body at most,
# for joints that are guessed fit in no order. What the best wrong order has less than the right one is up to 0.04, in
# 173 recordings by 2 to 8 cameras; 0.08 of 2.1 of somebody at a desk, whose hips and knees are guessed. The other way
# round it is 0.3 to 2, less of arms that are always bent.
_LESS_UNLIKE = 0.12


def wrong_skeleton(examined: Examined) -> list[Finding]:
    """Bones that no body has."""
    examined.refuse_side_by_side()
    positions_m, given = examined.body_m, examined.main.skeleton
    strange = strangeness(positions_m, given)
    if np.isnan(strange) and len(positions_m) < LEAST_FRAMES:
        raise NotJudgedError(examined.frames_in_words())
    if np.isnan(strange):
        raise NotJudgedError(f"skeleton {given.name} has too few joints of arms and legs that are seen")
    found = _cause(positions_m, given, strange)
    if found is None:
        return []
    code, reason, remedy = found
    return [Finding(code, Severity.WRONG, reason, remedy, 1.0, numbers={"strangeness": strange})]


def _cause(
    positions_m: Float[np.ndarray, "frame joint 3"], given: Skeleton, strange: float
) -> tuple[Code, str, str] | None:
    """What the joints probably are, and what to do; None: what their names say."""
    as_named = _strangest(positions_m, given)
    if strange >= _STRANGE and (better := better_skeleton(positions_m, given)) is not None:
        return (
            Code.WRONG_SKELETON,
            f"The joints are not those of skeleton {given.name}, but probably of {better.name}, which has as many: "
            f"{as_named}; as {better.name} all bones are those of a body",
            f"Give --skeleton {better.name}.",
        )
    order = better_order(positions_m, given)
    if order is not None and strangeness(positions_m[:, order.order], given) < _STRANGE:
        return (
            Code.WRONG_SKELETON,
            f"Joints are not in the order of skeleton {given.name}: {order.what}, in all views. As they are named, "
            f"{as_named}; in this order all bones are those of a body",
            "Put them in order in the keypoints, or write a skeleton file with the joints as they stand "
            "(--skeleton my.toml).",
        )
    if strange < _VERY_STRANGE:
        return None
    loose = looseness(positions_m)
    if loose > _LOOSE:
        return (
            Code.NO_AGREEMENT,
            f"What the cameras agree on is no body: {as_named}, and in no order of the joints is it one: half of them "
            f"change their distance to each other one by more than {100 * loose:.0f} %",
            "Is the calibration that of this recording? Calibrate anew.",
        )
    return (Code.WRONG_SKELETON, *_neither(positions_m, given, as_named))


def _neither(positions_m: Float[np.ndarray, "frame joint 3"], given: Skeleton, as_named: str) -> tuple[str, str]:
    """What is said of joints that are none of this skeleton, and fit no other one clearly; and what to do."""
    reason = f"The joints are not those of skeleton {given.name}: {as_named}"
    own_file = "a skeleton file with the joints in the order of the keypoints (--skeleton my.toml)"
    # Another one, or another order, must fit in either half.
    if len(positions_m) < 2 * LEAST_FRAMES:
        few = f"{len(positions_m)} frames are too few to tell whose they are"
        others = " or ".join(other.name for other in _as_many(given))
        choice = f"--skeleton {others}, where it fits, or " if others else ""
        return f"{reason}; {few}", f"Give more frames, {choice}{own_file}."
    return (
        f"{reason}. No built-in skeleton with {given.n_joints} joints fits either: their order is probably another one",
        f"Write {own_file}.",
    )


def better_skeleton(positions_m: Float[np.ndarray, "frame joint 3"], given: Skeleton) -> Skeleton | None:
    """The built-in one of as many joints that is clearly more like a body, and so in both halves of the recording."""
    halves = np.array_split(positions_m, 2)
    best, least = None, _LESS * strangeness(positions_m, given)
    for other in _as_many(given):
        strange = strangeness(positions_m, other)
        fits = [strangeness(half, other) < _STRANGE for half in halves]
        if strange < least and all(fits):
            best, least = other, strange
    return best


def _as_many(given: Skeleton) -> list[Skeleton]:
    """The built-in ones of as many joints, others than these."""
    known = [load_skeleton(name) for name in builtin_skeletons()]
    return [each for each in known if each.n_joints == given.n_joints and each.joints != given.joints]


def _strangest(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> str:
    """What is most unlike a body, in words."""
    pairs = skeleton.limb_pairs
    if not pairs:
        return "its parts have lengths that no body has"
    usual, change, share = lengths_m(positions_m, skeleton)
    statures = usual / share
    low, high = float(statures.min()), float(statures.max())
    worst = 100 * float(np.max(change / np.maximum(usual, 1e-9)))
    return (
        f"by some of its bones the person is {low:.1f} m tall, by others {high:.1f} m, and one changes its length by "
        f"{worst:.0f} %"
    )


class JointOrder(NamedTuple):
    """Joints that are probably others: of the same arm or leg, or all of them the next ones."""

    what: str
    """As "what it calls knees are probably ankles"."""
    order: Int[np.ndarray, " joint"]
    """For each joint of the skeleton, where it stands in the keypoints."""


def better_order(positions_m: Float[np.ndarray, "frame joint 3"], skeleton: Skeleton) -> JointOrder | None:
    """The order of the joints of an arm, of a leg, of both or of all that is clearly more like a body, and so in both
    halves of the recording; None if there is none."""
    halves = np.array_split(positions_m, 2)
    as_named = [contradictions(half, skeleton) for half in halves]
    best, most = None, _LESS_UNLIKE * max(1.0, *as_named)
    for each in _orders(skeleton):
        in_order = [contradictions(half[:, each.order], skeleton) for half in halves]
        less = [before - after for before, after in zip(as_named, in_order, strict=True)]
        if all(own > most for own in less):  # not where it is NaN
            best, most = each, min(less)
    return best


def _orders(skeleton: Skeleton) -> Iterator[JointOrder]:
    # Counted from one, or with one more in front.
    for shift, beside in ((1, "before"), (-1, "behind")):
        order = (np.arange(skeleton.n_joints) + shift) % skeleton.n_joints
        yield JointOrder(f"each is probably the one {beside} it in its list", order)
    for chain in _CHAINS:
        for sides in _SIDES:
            if not {f"{side}_{joint}" for side in sides for joint in chain} <= set(skeleton.joints):
                continue
            for found in list(permutations(chain))[1:]:
                order = np.arange(skeleton.n_joints)
                for side in sides:
                    for joint, place in zip(chain, found, strict=True):
                        order[skeleton.index(f"{side}_{joint}")] = skeleton.index(f"{side}_{place}")
                moved = [(place, chain[found.index(place)]) for place in chain if chain[found.index(place)] != place]
                named, probably = (in_words(f"{side}_{pair[k]}" for pair in moved for side in sides) for k in (0, 1))
                yield JointOrder(f"what it calls {named} are probably {probably}", order)
