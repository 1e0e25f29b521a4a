"""(joint, frame) <-> GTSAM key.

Symbols: ``x`` position, ``v`` velocity, ``l`` shared bone length. Position and velocity keys sort by frame, then joint,
so vectors that GTSAM returns in key order reshape to (frame, joint, 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam

from fgpose.skeleton import MAX_JOINTS

# The first key of each kind; the character is in the highest byte, so kinds cannot overlap.
_POSITION = gtsam.symbol("x", 0)
_VELOCITY = gtsam.symbol("v", 0)
_LENGTH = gtsam.symbol("l", 0)


def position_key(joint: int, frame: int) -> int:
    """Key of a joint's position (Point3, metres, world frame)."""
    return _POSITION + frame * MAX_JOINTS + joint


def velocity_key(joint: int, frame: int) -> int:
    """Key of a joint's velocity (Point3, m/s, world frame)."""
    return _VELOCITY + frame * MAX_JOINTS + joint


def length_key(length: int) -> int:
    """Key of a bone length that left and right share (double, metres)."""
    return _LENGTH + length


@dataclass(frozen=True)
class Keys:
    """The keys of a run of frames, in which joints are numbered by their slots."""

    joints: tuple[int, ...]
    """By slot."""
    first_frame: int

    def position(self, row: int, slot: int) -> int:
        """In a frame counted from the first; row -1 is the frame before it."""
        return position_key(self.joints[slot], self.first_frame + row)

    def velocity(self, row: int, slot: int) -> int:
        return velocity_key(self.joints[slot], self.first_frame + row)
