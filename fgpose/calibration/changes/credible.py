"""Which fits are believed: clear ones, that hardly a block contradicts, and that matter."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.change import Kind
from fgpose.calibration.changes.clock_changes import ClockFit, score
from fgpose.calibration.changes.lenses import Lens, LensFit
from fgpose.calibration.changes.poses.pose_changes import PoseFit

# Of undamaged recordings none reaches half of it; a frame that is lost reaches four times as much in ten seconds.
_SCORE = 5.0
_GAIN = 25.0
_SIGMAS = 3.0
_LATE_STEPS = 4.0  # of the costs, a frame at 30 Hz: a part with a smaller lag need not show it
# Cost of a block that a change makes worse, and of all such blocks in that of the others. Of bumps of 0.7 degrees no
# block loses 3; of a distortion one of 14 loses 6, 0.03 in all; of a reflection that is seen now and then every fourth
# loses 6 to 30, 0.06 and more in all.
_CONTRADICTS, _MAY_CONTRADICT, _LITTLE = 5.0, 0.06, 0.04
NOTICEABLE_FRAMES = 0.2
"""At 50 Hz and walking speed 6 mm, half of the usual error."""
JUMP_FRAMES = 0.5
"""Lost images are whole ones."""
WHOLE_FRAMES = 0.25  # by which a number may differ from a whole one
_RATE_FRAMES = 0.6  # that a rate adds up to from the first to the last second
# What a network errs by differs with the side from which it sees somebody. Of somebody who stands, the rays of right
# cameras miss each other by up to this, root mean square (webcams a metre away); that it changes at a moment is rarer.
_SHIFT = 0.4
_SHIFT_M = {Kind.MOVED: 0.03, Kind.BUMP: 0.018}
_SHIFT_OF_WALKING_M = {Kind.MOVED: 0.01, Kind.BUMP: 0.018}
# Of cameras that were moved by 0.7 to 4 degrees 0.57 to 0.79, where wrists are guessed at the hip for a while -0.1 to
# 0.1.
_OF_MOST_JOINTS = 1 / 3
# Of somebody who stands, with errors that are others in every posture and camera, 0.02 to 0.058; a bump of 1.5 degrees
# has 0.075 to 0.097.
_SHIFT_OF_POSTURE_M = 0.06
_SELDOM = 0.01  # of recordings in which nobody touched a camera
_ZOOM = 0.04  # of the focal length: 8 cm two metres from the middle of the room
_BENT_RAD = 0.005  # 2 cm at 4 m


def is_clear(fit: ClockFit | PoseFit | LensFit) -> bool:
    """Whether it is better by more than chance."""
    return is_better(fit.gain) and not (isinstance(fit, ClockFit) and _is_of_few_seconds(fit))


def is_better(gain: Float[np.ndarray, " block"]) -> bool:
    """Whether what did not enter is better by more than chance."""
    return score(gain) > _SCORE and float(gain.sum()) > _GAIN


def is_of_several_seconds(gain: Float[np.ndarray, " block"]) -> bool:
    """The same, and whether one second is not all that it is made of, as where somebody who stood begins to move."""
    return is_better(gain) and score(_without_best(gain)) > _SIGMAS


def is_better_by_each(gain: Float[np.ndarray, "part block"]) -> bool:
    """Whether every part is, by its share."""
    return bool((gain.sum(axis=1) > _GAIN / len(gain)).all())


def _is_of_few_seconds(fit: ClockFit) -> bool:
    """Whether a second or two may be all that it is made of: where a detector misses the person for moments, all joints
    suit some lag, of each moment another one; and of a few of them some line. Of who stands still and then moves, the
    second between suits some jump."""
    of_others = _without_best(fit.gain)
    if fit.kind is Kind.JUMP:
        parts = zip((0, *fit.firsts), (*fit.firsts, len(fit.lag)), strict=True)
        late = [fit.gain[first:end] for first, end in parts if abs(fit.lag[first]) > _LATE_STEPS]
        if any(score(_without_best(gain)) < _SIGMAS for gain in late):
            return True
    of_one = fit.kind is not Kind.OFFSET and score(of_others) < _SCORE
    gain = of_others if fit.kind is Kind.JUMP else fit.gain
    return of_one or float(gain.sum()) < _SIGMAS * fit.by_chance


def _without_best(gain: Float[np.ndarray, " block"]) -> Float[np.ndarray, " other"]:
    """Of all blocks but the one that gains most."""
    return np.delete(gain, np.argmax(gain))


def holds(fit: PoseFit | LensFit) -> bool:
    """Whether hardly a block contradicts what is there all the time: where somebody else is seen, or a reflection, now
    and then, a move or a lens suits many blocks, and the others not at all. And whether a move suits most joints: a
    limb that a view shows elsewhere for a while is none."""
    if isinstance(fit, PoseFit) and fit.of_most_joints < _OF_MOST_JOINTS:
        return False
    gain = fit.gain[fit.held] if isinstance(fit, PoseFit) else fit.gain
    lost, won = -float(np.minimum(gain, 0.0).sum()), float(np.maximum(gain, 0.0).sum())
    return float(np.mean(gain < -_CONTRADICTS)) <= _MAY_CONTRADICT or lost < _LITTLE * won


def clock_matters(kind: Kind, lag: Float[np.ndarray, " block"]) -> bool:
    """Whether lags, in images, are more than clocks that are right have."""
    if kind is Kind.OFFSET:
        return bool(abs(lag[0]) > NOTICEABLE_FRAMES)
    if kind is Kind.JUMP:
        return bool(np.abs(np.diff(lag)).max() > JUMP_FRAMES)
    return bool(abs(lag[-1] - lag[0]) > _RATE_FRAMES)


def move_matters(fit: PoseFit, *, walks: bool, of_posture: bool) -> bool:
    """Whether rays miss each other by more than those of right cameras; of a camera that is elsewhere all the time
    whether its calibration may not err by that; and of one that was put back whether it is certain that it went
    anywhere, for what comes and goes may be the motion that is cut off by a filter.

    Args:
        walks: whether somebody does, at any time.
        of_posture: whether it is there while somebody is in one posture only, from when they take it or until they
            leave it: errors of networks are then others too.
    """
    least_m = (_SHIFT_OF_WALKING_M if walks else _SHIFT_M)[fit.kind]
    is_far = fit.shift > _SHIFT and fit.shift_m > max(least_m, _SHIFT_OF_POSTURE_M if of_posture else 0.0)
    if fit.kind is Kind.MOVED and fit.untouched > _SELDOM:
        return False
    return is_far and (fit.end_edges is None or _is_certain(fit))


def _is_certain(fit: PoseFit) -> bool:
    """Whether the camera has turned or moved by more than two standard deviations."""
    turned, moved_m = (float(np.linalg.norm(each)) for each in (fit.rotation, fit.translation_m))
    return turned > 2 * fit.sigma_rotation or moved_m > 2 * fit.sigma_translation_m


def lens_matters(fit: LensFit) -> bool:
    """Whether it is another lens."""
    return abs(fit.value) > _ZOOM if fit.lens is Lens.FOCAL_LENGTH else fit.shift_rad > _BENT_RAD
