"""Whose stature it was that gave the scale, where somebody else is there as well: what if it was theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool

from fgpose.calibration.from_people.body_size import mean_joint
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.from_people.world.scale import Scale

_OFTEN = 1 / 3  # of the time for which the walker is seen: who is there for less passes by
_REMEDY = (
    "film again with nobody else there, or give the distance between two cameras (--distance), which is nobody's; if "
    "the stature is of the other one, the scale is wrong"
)


@dataclass(frozen=True, eq=False)
class Beside:
    """Somebody beside the walker."""

    seen: Walk
    """In the frames of the walk."""
    ratio: float
    """How many times as tall as the walker; NaN: not known."""


def whose_stature(scale: Scale, sigma: float, walk: Walk, others: Sequence[Beside]) -> Scale:
    """The scale from a stature alone, with whom it was taken to be of, and what would be if it were somebody else's.

    Args:
        scale: from the stature of the walker.
        sigma: of the stature as a cue, as a share of it: of people whose sizes differ by less it does not matter.
        walk: of the walker.
        others: everybody else.
    """
    least_frames = _OFTEN * _frames(walk).sum()
    if not others or np.any([_frames(other.seen) for other in others], axis=0).sum() < least_frames:
        return scale
    who, _ = _in_one_image(walk, others[0].seen)
    source = f"{scale.source} (taken to be of whom {who})"
    measured = [other for other in others if np.isfinite(other.ratio) and _frames(other.seen).sum() >= least_frames]
    if not measured:
        return replace(scale, source=source)
    worst = max(measured, key=lambda other: abs(np.log(other.ratio)))
    apart = abs(float(np.log(worst.ratio)))
    findings = (_finding(scale, walk, worst),) if apart > sigma else ()
    return replace(
        scale, source=source, sigma=float(np.hypot(scale.sigma, apart)), findings=(*findings, *scale.findings)
    )


def _frames(walk: Walk) -> Bool[np.ndarray, " frame"]:
    """In which a camera shows the person."""
    return np.asarray(walk.shows_walker.any(axis=1))


def _finding(scale: Scale, walk: Walk, other: Beside) -> CalibrationFinding:
    who, whom_px = _in_one_image(walk, other.seen)
    seen_s = float(_frames(other.seen).sum()) * walk.step_s
    reason = (
        f"{scale.source} is taken to be of whom {who}; somebody else{whom_px}, who is seen for {seen_s:.0f} s, is "
        f"{other.ratio:.2f} times as tall: if it is theirs, all lengths are {other.ratio:.2f} times what they should be"
    )
    return CalibrationFinding("", Grade.COARSE, reason, _REMEDY)


def _in_one_image(walk: Walk, other: Walk) -> tuple[str, str]:
    """Where both are in an image that shows much of both: the walker, and the other; nothing of who is in none."""
    both = np.minimum(walk.seen.sum(axis=-1), other.seen.sum(axis=-1))
    both = np.where(walk.shows_walker & other.shows_walker, both, 0)
    if not both.any():
        seen = walk.seen.sum(axis=-1)
        frame, camera = np.unravel_index(np.argmax(seen), seen.shape)
        return _place(walk, int(frame), int(camera)), ""
    frame, camera = (int(number) for number in np.unravel_index(np.argmax(both), both.shape))
    return _place(walk, frame, camera), f" (at {_pixel(other, frame, camera)} then)"


def _place(walk: Walk, frame: int, camera: int) -> str:
    clock = "" if camera == 0 else f" by the clock of {walk.camera_names[0]}"
    at_s = float(walk.time_s[frame])
    return f"{walk.camera_names[camera]} shows at {_pixel(walk, frame, camera)} at {at_s:.2f} s{clock}"


def _pixel(walk: Walk, frame: int, camera: int) -> str:
    x, y = mean_joint(walk.points2d_px[frame, camera][None])[0]
    return f"pixel ({x:.0f}, {y:.0f})"
