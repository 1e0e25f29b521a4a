"""What is said of every change in time: what to do, and when it happened."""

from __future__ import annotations

from fgpose.calibration.changes.change import Change

CLOCKS, POSES = "--estimate-time-offsets", "--refine-calibration"
# The time of a change is told to a second where somebody moves; what is known less well is said.
_KNOWN_S = 2.5


def use(option: str, other: str, *, together: bool) -> str:
    # While the person walks in one direction, both faults cause the same errors. Either option alone would absorb the
    # error of the other.
    return f"Use {option} and {other} together." if together else f"Use {option}."


def moment(change: Change, at_s: float) -> str:
    begin_s, end_s = change.between_s or (at_s, at_s)
    if end_s - begin_s < _KNOWN_S:
        return f"at {at_s:.1f} s"
    return f"at some time from {max(begin_s, 0):.0f} to {end_s:.0f} s, most probably at {at_s:.1f} s"


def earliest_and_latest(change: Change) -> dict[str, float]:
    return dict(zip(("earliest_s", "latest_s"), change.between_s or (), strict=False))
