"""One thing in a result that should be looked at."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Suspicion:
    """Something that is probably wrong, why it is thought so, and what to do.

    The reason names the number that gave it away and what it was compared with.
    """

    subject: str
    """The camera, joint, bone or person it is about; empty: the whole recording."""
    reason: str
    remedy: str
    weight: float = 1.0
    """Share of the result that it puts in doubt, in [0, 1]: the most important has the largest."""
