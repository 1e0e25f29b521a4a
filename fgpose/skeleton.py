"""Skeletons: the joints of a body, its rigid bones and its left/right symmetry."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from fgpose.shown import Shown
from fgpose.shown.unknown_names import did_you_mean

MAX_JOINTS = 4096  # so many numbers are reserved for each frame in the keys of the graph (estimation/keys.py)
CONTROL = re.compile("[\x00-\x1f\x7f\x85\u2028\u2029]")
"""What would make several cells or lines of a name in a file."""
LIMBS = ("upper_arm", "lower_arm", "upper_leg", "lower_leg")
"""The four limb pairs of the paper's symmetry cost (eq. 4)."""
_SMALL_LINKAGE = 8  # joints: to halve such a set saves less than what each set costs


@dataclass(frozen=True)
class BodyPart:
    """A hand or a face: joints that are estimated by themselves, given where they hang on the rest of the body."""

    name: str
    joints: tuple[int, ...]
    hangs_on: tuple[int, int]
    """A joint of the rest, and the joint of the part that is at the same place; or that joint of the rest twice, which
    bones join to the part."""
    carried_by: tuple[int, ...] = ()
    """Of a part that is one rigid set of points, those that place it; none where its bones move."""
    relative_sigma: float = 1.0
    """Standard deviation of its detections and of its bones, in that of a body's: 0.33 of hands, 0.17 of faces, by the
    spread of annotations (COCO-WholeBody, Jin et al. 2020)."""

    @property
    def is_joined(self) -> bool:
        """Whether bones join it to the joint on which it hangs, in place of a joint of its own there."""
        return self.hangs_on[0] == self.hangs_on[1]

    @property
    def estimated(self) -> tuple[int, ...]:
        """The joints that are estimated together: those of the part, or those that carry it; and first that of the rest
        to which bones join it."""
        return (self.hangs_on[0], *self.joints) if self.is_joined else self.carried_by or self.joints


@dataclass(frozen=True, init=False, repr=False)
class Skeleton(Shown):
    """The joints of a body and what is known of it before any measurement.

    Joints are named; everything else refers to them by index, or by name when it is given: root="pelvis",
    bones=[("pelvis", "neck")]. No length is part of a skeleton: lengths are estimated.

    Raises:
        ValueError: a name or an index is repeated, unknown or inconsistent; the message names it.
    """

    name: str
    joints: tuple[str, ...]
    """Names in the order of every array's joint axis."""
    bones: tuple[tuple[int, int], ...]
    """Pairs of joints whose distance is taken to be constant in time, the one nearer to the root first."""
    root: tuple[int, ...]
    """Joints whose mean is the root (pelvis): one joint, or the two hips where a skeleton has no pelvis."""
    left_right: tuple[tuple[int, int], ...] = ()
    """Pairs (left, right) of mirrored joints."""
    limbs: tuple[tuple[int, int], ...] = ()
    """The left bone of each limb pair of eq. 4, in the order of LIMBS."""
    lines: tuple[tuple[int, int], ...] = ()
    """Pairs of joints joined when drawn although their distance varies (shoulder to hip)."""
    parts: tuple[BodyPart, ...] = ()
    """Hands and face. No bone joins them to other joints."""
    _mirror: dict[int, int] = field(init=False, repr=False, compare=False, default_factory=dict)

    def __init__(
        self,
        name: str,
        joints: Sequence[str],
        bones: Sequence[tuple[int | str, int | str]],
        root: int | str | Sequence[int | str],
        left_right: Sequence[tuple[int | str, int | str]] = (),
        limbs: Sequence[tuple[int | str, int | str]] = (),
        lines: Sequence[tuple[int | str, int | str]] = (),
        parts: Sequence[BodyPart] = (),
    ) -> None:
        given = {"bones": bones, "left_right": left_right, "limbs": limbs, "lines": lines}
        plain = {"name": name, "joints": tuple(joints), "parts": tuple(parts), "_mirror": {}}
        for field_name, value in plain.items():
            object.__setattr__(self, field_name, value)
        self._check_names()
        object.__setattr__(self, "root", self._indices((root,) if isinstance(root, int | str) else root))
        for what, pairs in given.items():
            object.__setattr__(self, what, tuple(self._indices(pair) for pair in pairs))
        self._check()

    def _check_names(self) -> None:
        if len(self.joints) > MAX_JOINTS:
            raise ValueError(f"skeleton {self.name}: {len(self.joints)} joints, at most {MAX_JOINTS} are possible")
        for joint in self.joints:
            if not joint or joint != joint.strip() or CONTROL.search(joint):
                raise ValueError(
                    f"skeleton {self.name}: {joint!r} is no name of a joint: it is empty, begins or ends with a blank, "
                    "or has a tab or a line break"
                )
        if len(set(self.joints)) != len(self.joints):
            repeated = sorted({joint for joint in self.joints if self.joints.count(joint) > 1})
            raise ValueError(f"skeleton {self.name}: joint names must differ, repeated: {', '.join(repeated)}")

    def _check(self) -> None:
        if not self.joints or not self.root:
            raise ValueError(f"skeleton {self.name}: at least one joint and a root are needed")
        for what in ("bones", "left_right", "limbs", "lines"):
            self._check_pairs(what)
        self._check_indices("root", self.root)
        for left, right in self.left_right:
            for joint in (left, right):
                if joint in self._mirror:
                    raise ValueError(f"skeleton {self.name}: left_right names {self.joints[joint]} twice")
            self._mirror.update({left: right, right: left})
        self._check_parts()
        edges = {frozenset(bone) for bone in self.bones}
        for limb in self.limbs:
            if frozenset(limb) not in edges or frozenset(self.mirrored(limb)) not in edges:
                raise ValueError(f"skeleton {self.name}: limb {self.bone_name(limb)} or its mirror image is not a bone")
            if frozenset(limb) == frozenset(self.mirrored(limb)):
                raise ValueError(f"skeleton {self.name}: limb {self.bone_name(limb)} is its own mirror image")

    def _check_parts(self) -> None:
        part_of = dict[int, str]()
        for part in self.parts:
            what = f"part {part.name}"
            self._check_indices(what, (*part.joints, *part.hangs_on, *part.carried_by))
            if twice := set(part.joints) & set(part_of):
                raise ValueError(f"skeleton {self.name}: {self.joints[min(twice)]} is in two parts")
            if not 0 < part.relative_sigma <= 1:
                raise ValueError(f"skeleton {self.name}: relative_sigma of {what} must be in (0, 1]")
            part_of.update(dict.fromkeys(part.joints, part.name))
            own = {*part.carried_by, *(() if part.is_joined else part.hangs_on[1:])}
            if not own <= set(part.joints):
                raise ValueError(f"skeleton {self.name}: {what} hangs on or is carried by a joint that is not in it")
            if part.carried_by and (len(part.carried_by) < 3 or part.hangs_on[1] not in part.carried_by):
                raise ValueError(
                    f"skeleton {self.name}: {what} is carried by at least three joints, one of them "
                    f"{self.joints[part.hangs_on[1]]}, on which it hangs"
                )
        for joint in (*self.root, *(part.hangs_on[0] for part in self.parts)):
            if joint in part_of:
                raise ValueError(f"skeleton {self.name}: {self.joints[joint]} is in {part_of[joint]}, not of the body")
        joined = {(part.hangs_on[0], part.name) for part in self.parts if part.is_joined}
        for bone in self.bones:
            between = {(bone[0], part_of.get(bone[1])), (bone[1], part_of.get(bone[0]))}
            if part_of.get(bone[0]) != part_of.get(bone[1]) and not between & joined:
                raise ValueError(f"skeleton {self.name}: bone {self.bone_name(bone)} joins a part to something else")

    def _indices(self, joints: Iterable[int | str]) -> tuple[int, ...]:
        return tuple(self.index(joint) if isinstance(joint, str) else joint for joint in joints)

    def _check_pairs(self, what: str) -> None:
        pairs = getattr(self, what)
        for pair in pairs:
            self._check_indices(what, pair)
            if pair[0] == pair[1]:
                raise ValueError(f"skeleton {self.name}: {what} joins {self.joints[pair[0]]} to itself")
        if len({frozenset(pair) for pair in pairs}) != len(pairs):
            raise ValueError(f"skeleton {self.name}: {what} names one pair twice")

    def _check_indices(self, what: str, indices: tuple[int, ...]) -> None:
        for index in indices:
            if not 0 <= index < len(self.joints):
                raise ValueError(f"skeleton {self.name}: {what} uses joint {index}, there are {len(self.joints)}")

    @property
    def n_joints(self) -> int:
        return len(self.joints)

    def index(self, joint: str) -> int:
        """Index of a joint by name. Raises ValueError for an unknown name; it says which known one is near."""
        if joint in self.joints:
            return self.joints.index(joint)
        meant = did_you_mean(joint, self.joints)
        raise ValueError(f"skeleton {self.name} has no joint {joint!r}{meant}; it has {', '.join(self.joints)}")

    def mirrored(self, bone: tuple[int, int]) -> tuple[int, int]:
        """The same bone on the other side of the body; a bone of the midline is its own mirror image."""
        a, b = bone
        return self._mirror.get(a, a), self._mirror.get(b, b)

    @cached_property
    def mirror(self) -> Int[np.ndarray, " joint"]:
        """For each joint, the index of that on the other side of the body; of the midline, its own."""
        return np.array([self._mirror.get(joint, joint) for joint in range(self.n_joints)])

    def bone_name(self, bone: tuple[int, int]) -> str:
        return f"{self.joints[bone[0]]}-{self.joints[bone[1]]}"

    @cached_property
    def body(self) -> tuple[int, ...]:
        """The joints that are in no part."""
        in_parts = {joint for part in self.parts for joint in part.joints}
        return tuple(joint for joint in range(self.n_joints) if joint not in in_parts)

    @cached_property
    def part_names(self) -> tuple[str, ...]:
        """For each joint, the name of the part that it is in; empty: it is of the body."""
        names = dict.fromkeys(range(self.n_joints), "")
        names.update((joint, part.name) for part in self.parts for joint in part.joints)
        return tuple(names.values())

    def of_joints(self, joints: Sequence[int], name: str = "", root: int | None = None) -> Skeleton:
        """Of some of the joints alone, in this order, with all that is between them.

        Args:
            joints: indices.
            name: of the new skeleton; by default that of this one.
            root: index of its root in this skeleton; by default its own root, or the first of the joints.

        Raises:
            ValueError: the root is not among the joints.
        """
        new = {joint: number for number, joint in enumerate(joints)}

        def between(pairs: tuple[tuple[int, int], ...]) -> list[tuple[int, int]]:
            return [(new[a], new[b]) for a, b in pairs if a in new and b in new]

        own_root = self.root if set(self.root) <= set(new) else tuple(joints[:1])
        if root is not None and root not in new:
            raise ValueError(f"{self.joints[root]} is not among the joints of {name or self.name}")
        with_mirror = tuple(limb for limb in self.limbs if set(self.mirrored(limb)) <= set(new))
        return Skeleton(
            name=name or self.name,
            joints=[self.joints[joint] for joint in joints],
            bones=between(self.bones),
            root=[new[joint] for joint in (own_root if root is None else (root,))],
            left_right=between(self.left_right),
            limbs=between(with_mirror),
            lines=between(self.lines),
        )

    @cached_property
    def limb_pairs(self) -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
        """Left and right bone of each limb of eq. 4."""
        return tuple((limb, self.mirrored(limb)) for limb in self.limbs)

    @cached_property
    def bone_ends(self) -> Int[np.ndarray, "end bone"]:
        """The joints at the start of every bone, and at its end."""
        return np.array(self.bones, dtype=int).reshape(-1, 2).T

    @cached_property
    def length_of_bone(self) -> tuple[int, ...]:
        """For each bone, the index of its length: mirrored bones share one, so there are fewer lengths than bones."""
        numbers: dict[frozenset[frozenset[int]], int] = {}
        return tuple(
            numbers.setdefault(frozenset((frozenset(bone), frozenset(self.mirrored(bone)))), len(numbers))
            for bone in self.bones
        )

    @property
    def n_lengths(self) -> int:
        return len(set(self.length_of_bone))

    @cached_property
    def length_names(self) -> tuple[str, ...]:
        """One name per shared length: that of the first bone that has it."""
        first: dict[int, str] = {}
        for bone, length in zip(self.bones, self.length_of_bone, strict=True):
            first.setdefault(length, self.bone_name(bone))
        return tuple(first[length] for length in sorted(first))

    @cached_property
    def linkages(self) -> tuple[tuple[int, ...], ...]:
        """All joints in sets, as arms, legs and face of BlazePose: neither a bone nor a limb pair has joints of two.
        Small ones are put together, unless the set became larger than the largest."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        of_limbs = (pair for left, right in self.limb_pairs for pair in pairwise(left + right))
        pairs = np.array([*self.bones, *of_limbs], dtype=int).reshape(-1, 2)
        joined = coo_array((np.ones(len(pairs)), pairs.T), shape=(self.n_joints, self.n_joints))
        n_linked, number = connected_components(joined, directed=False)
        linked = [np.flatnonzero(number == each).tolist() for each in range(n_linked)]
        most = max(_SMALL_LINKAGE, *(len(joints) for joints in linked))
        together: list[list[int]] = []
        for joints in sorted(linked, key=lambda joints: (-len(joints), joints[0])):
            with_room = (others for others in together if len(others) + len(joints) <= most)
            others = next(with_room, None)
            if others is None:
                together.append(joints)
            else:
                others += joints
        return tuple(tuple(sorted(joints)) for joints in together)

    @cached_property
    def neighbours(self) -> tuple[tuple[int, ...], ...]:
        """For each joint, the joints that a bone joins to it; the nearer to the root first."""
        towards_root = [tuple(a for a, b in self.bones if b == joint) for joint in range(self.n_joints)]
        away = [tuple(b for a, b in self.bones if a == joint) for joint in range(self.n_joints)]
        return tuple(a + b for a, b in zip(towards_root, away, strict=True))

    def bone_lengths(self, positions_m: Float[np.ndarray, "*frames joint 3"]) -> Float[np.ndarray, "*frames bone"]:
        """Length in metres of every bone, NaN where one of its joints is NaN."""
        start, end = self.bone_ends
        bones_m = positions_m[..., end, :] - positions_m[..., start, :]
        return np.asarray(np.sqrt(np.vecdot(bones_m, bones_m)))  # np.linalg.norm takes twice as long


@dataclass(frozen=True, eq=False, repr=False)
class BoneLengths(Shown):
    """What is known of somebody's bones, one number for each of skeleton.length_names. The arrays are read-only.

    Raises:
        ValueError: the shapes disagree, a length that is known is not positive, or its deviation is not.
    """

    lengths_m: Float[np.ndarray, " length"]
    """NaN: not known."""
    sigma_m: Float[np.ndarray, " length"]
    """Their standard deviations."""

    def __post_init__(self) -> None:
        if self.lengths_m.shape != self.sigma_m.shape or self.lengths_m.ndim != 1:
            raise ValueError(f"lengths_m and sigma_m must be (L,), got {self.lengths_m.shape} and {self.sigma_m.shape}")
        if not ((self.lengths_m > 0) & (self.sigma_m > 0) | np.isnan(self.lengths_m)).all():
            raise ValueError("lengths_m must be positive or NaN, and sigma_m positive where they are known")
        for array in (self.lengths_m, self.sigma_m):
            array.setflags(write=False)

    @staticmethod
    def unknown(n_lengths: int) -> BoneLengths:
        """None is known."""
        return BoneLengths(np.full(n_lengths, np.nan), np.full(n_lengths, np.inf))

    def check(self, skeleton: Skeleton) -> None:
        """Raise ValueError unless they can be of this skeleton."""
        if self.lengths_m.shape != (skeleton.n_lengths,):
            raise ValueError(f"{skeleton.n_lengths} bone lengths are needed, got {self.lengths_m.shape}")

    def or_else(self, others: BoneLengths) -> BoneLengths:
        """Others where one is not known."""
        known = np.isfinite(self.lengths_m)
        lengths_m = np.where(known, self.lengths_m, others.lengths_m)
        return BoneLengths(lengths_m, np.where(known, self.sigma_m, others.sigma_m))
