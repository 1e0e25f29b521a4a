"""What became of one damaged recording: its errors, what was said of it, and what the advice was worth."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.diagnose import diagnose
from fgpose.estimation.smoother import smooth
from fgpose.finding import Code, Finding, Severity
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.faults.advice import followed
from fgpose_benchmarks.faults.damage import Damage, Damaged
from fgpose_benchmarks.faults.take import FPS, Take

UNDAMAGED = "undamaged"
# 99 % quantile of the chi-square distribution with three degrees of freedom.
_CHI2_99 = 11.345
_MORE_THAN = 2.0
"""Times the error of the undamaged recording; more is wrong."""
_LEAST_INSIDE = 0.9
"""Share of the errors within the 99 % ellipsoids; less is wrong."""
_LESS_INSIDE = 0.05
_DAMAGES_SEED = 7
_PART_S = 4.0
"""From the middle: what is estimated where a damage does the same to every frame. It is diagnosed as a whole."""


@dataclass(frozen=True)
class DamageOutcome:
    """Of one recording. Errors are 95 % quantiles over joints and frames that are given, millimetres."""

    damage: str
    clip: str
    rig: str
    undamaged_mm: float
    error_mm: float
    """NaN: nothing was determined, or the recording was refused."""
    undamaged_inside: float
    inside: float
    """Share of the errors within the claimed 99 % ellipsoids."""
    found: tuple[str, ...]
    """severity:code:camera of all findings, the severest first."""
    said: bool
    """Whether something is called wrong or doubtful, or the cause is named."""
    right: bool
    """Whether the first of what is said names the cause, and the camera."""
    followed_mm: float
    """After the advice was followed; NaN: there is none that can be followed here."""
    attainable_mm: float
    """Without damage, with the cameras that the advice leaves."""

    @property
    def harmful(self) -> bool:
        """Whether the numbers that are given are wrong: what is true of a real recording, its estimate says."""
        least = min(_LEAST_INSIDE, self.undamaged_inside - _LESS_INSIDE)
        return self.error_mm > _MORE_THAN * self.undamaged_mm or self.inside < least

    @property
    def silent(self) -> bool:
        """Wrong, and nothing is said."""
        return self.harmful and not self.said


def outcome_of(take: Take, damage: Damage | None) -> DamageOutcome:
    """Damage a recording, estimate and diagnose it, follow the advice.

    Args:
        take: a recording without a fault.
        damage: what is done to it; None: nothing.
    """
    part = _middle(take) if damage is not None and damage.is_constant else slice(None)
    name = UNDAMAGED if damage is None else damage.name
    rng = np.random.default_rng([_DAMAGES_SEED, take.seed, len(name)])
    given = Damaged(take.rig, take.observations, take.truth_m) if damage is None else damage.inflict(take, rng)
    result = _undamaged_result(take, part) if damage is None else _estimated(given, part)
    error_mm, inside = _errors(result, given, take.truth_covariance_m2)
    findings = diagnose(given.observations, given.rig, result).findings
    usual = _found_undamaged(take, part) if take.is_real and damage is not None else set()
    serious = [each for each in findings if each.severity is not Severity.NOTE and _place(each) not in usual]
    named = [] if damage is None else [each for each in findings if _names(each, damage, given)]
    if damage is None and take.is_real:  # joints that a network misplaces are what they are
        serious = [each for each in serious if each.severity is Severity.WRONG]
    first = serious[0] if serious else named[0] if named else None
    changed = None if first is None else followed(given, first)
    undamaged_mm, undamaged_inside = _undamaged(take, part)
    return DamageOutcome(
        damage=name,
        clip=take.clip,
        rig=take.rig_name,
        undamaged_mm=undamaged_mm,
        error_mm=error_mm,
        undamaged_inside=undamaged_inside,
        inside=inside,
        found=tuple(f"{each.severity}:{each.code}:{each.camera}" for each in findings),
        said=bool(serious or named),
        right=damage is not None and first is not None and _names(first, damage, given),
        followed_mm=_error_after(changed, first, part),
        attainable_mm=_undamaged(take, part, changed.rig.names if changed else take.rig.names)[0],
    )


def _names(finding: Finding, damage: Damage, given: Damaged) -> bool:
    of_camera = not given.cameras or not finding.camera or finding.camera in given.cameras
    return finding.code in damage.codes and of_camera


def _middle(take: Take) -> slice:
    n_frames = len(take.truth_m)
    half = min(round(_PART_S * FPS), n_frames) // 2
    return slice(n_frames // 2 - half, n_frames // 2 + half)


_Key = tuple[str, int, tuple[str, ...]]
_UNDAMAGED: dict[_Key, Trajectory | None] = {}
_FOUND_UNDAMAGED: dict[_Key, set[tuple[Code, str]]] = {}


def _undamaged_result(take: Take, part: slice, names: tuple[str, ...] | None = None) -> Trajectory | None:
    """Of some of the cameras; found once in each process."""
    kept = [name for name in take.rig.names if names is None or name in names]
    key = take.name, len(take.truth_m[part]), tuple(kept)
    if key not in _UNDAMAGED:
        given = Damaged(take.rig.subset(kept), take.observations.subset(kept), take.truth_m)
        _UNDAMAGED[key] = _estimated(given, part)
    return _UNDAMAGED[key]


def _undamaged(take: Take, part: slice, names: tuple[str, ...] | None = None) -> tuple[float, float]:
    """Error and share inside of some of the cameras."""
    result, given = _undamaged_result(take, part, names), Damaged(take.rig, take.observations, take.truth_m)
    error_mm, inside = _errors(result, given, take.truth_covariance_m2)
    if take.is_real and result is not None:  # the truth is known as well as it claims itself
        error_mm = max(error_mm, _claimed_mm(result))
    return error_mm, inside


def _claimed_mm(result: Trajectory) -> float:
    """The 95 % error by the covariances."""
    assert result.covariance_m2 is not None
    variance_m2 = np.trace(result.covariance_m2, axis1=-2, axis2=-1)
    return float(1000 * np.quantile(np.sqrt(variance_m2[np.isfinite(variance_m2)]), 0.95))


def _found_undamaged(take: Take, part: slice) -> set[tuple[Code, str]]:
    """What is wrong or doubtful of a recording as it is; found once in each process."""
    key = take.name, len(take.truth_m[part]), take.rig.names
    if key not in _FOUND_UNDAMAGED:
        findings = diagnose(take.observations, take.rig, _undamaged_result(take, part)).findings
        _FOUND_UNDAMAGED[key] = {_place(each) for each in findings if each.severity is not Severity.NOTE}
    return _FOUND_UNDAMAGED[key]


def _place(finding: Finding) -> tuple[Code, str]:
    return finding.code, finding.camera


_OF_CLOCKS = (Code.LATE_CAMERA, Code.LOST_FRAMES, Code.CLOCK_RATE)


def _error_after(changed: Damaged | None, finding: Finding | None, part: slice) -> float:
    if changed is None or finding is None:
        return np.nan
    result = _estimated(changed, part)
    if result is None or finding.code not in _OF_CLOCKS:
        return _errors(result, changed, None)[0]
    # Cameras are put on one clock; which of theirs that is makes no difference.
    shifts_s = (np.arange(-90, 91) / 60).tolist()
    return _errors(result, changed, None, min(shifts_s, key=lambda shift_s: _typical_m(result, changed, shift_s)))[0]


def _typical_m(result: Trajectory, given: Damaged, shift_s: float) -> float:
    known, difference_m = _differences_m(result, given, shift_s)
    return float(np.median(_lengths_m(difference_m[known]))) if known.any() else np.inf


def _estimated(given: Damaged, part: slice) -> Trajectory | None:
    """Of a part; None: it was refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what does not converge is a finding
        try:
            return smooth(given.observations.frames(part), given.rig)
        except ValueError:
            return None


def _errors(
    result: Trajectory | None,
    given: Damaged,
    truth_covariance_m2: Float[np.ndarray, "frame joint 3 3"] | None,
    shift_s: float = 0.0,
) -> tuple[float, float]:
    """The error in millimetres and the share within the 99 % ellipsoids; NaN where nothing is given."""
    if result is None:
        return np.nan, np.nan
    known, difference_m = _differences_m(result, given, shift_s)
    difference_m = difference_m[known]
    if not len(difference_m):
        return np.nan, np.nan
    error_mm = float(1000 * np.quantile(_lengths_m(difference_m), 0.95))
    if result.covariance_m2 is None:
        return error_mm, np.nan
    nobody, difference_m = np.isnan(difference_m).any(axis=-1), np.nan_to_num(difference_m)
    covariance_m2 = result.covariance_m2
    if truth_covariance_m2 is not None:
        frame = np.clip(np.round(result.time_s * FPS).astype(int), 0, len(truth_covariance_m2) - 1)
        covariance_m2 = covariance_m2 + truth_covariance_m2[frame]
    whitened = np.linalg.solve(covariance_m2[known], difference_m[..., None])[..., 0]
    squared = np.einsum("ni,ni->n", difference_m, whitened)
    return error_mm, float(np.mean((squared < _CHI2_99) & ~nobody))


def _differences_m(
    result: Trajectory, given: Damaged, shift_s: float
) -> tuple[Bool[np.ndarray, "frame joint"], Float[np.ndarray, "frame joint 3"]]:
    """Which joints are given, and how far they are from the truth; NaN where nobody is."""
    known = result.status != Status.UNOBSERVABLE
    at_s = result.time_s / given.slower + shift_s
    last_s = (len(given.truth_m) - 1) / FPS  # images may be taken before or after those of the truth
    known &= ((at_s >= 0) & (at_s <= last_s))[:, None]
    return known, result.positions_m - _at(given.truth_m, at_s)


def _lengths_m(difference_m: Float[np.ndarray, "known 3"]) -> Float[np.ndarray, " known"]:
    """A position where nobody is has no error that could be measured: it counts as 10 m."""
    nobody = np.isnan(difference_m).any(axis=-1)
    return np.where(nobody, 10.0, np.linalg.norm(np.nan_to_num(difference_m), axis=-1))


def _at(
    truth_m: Float[np.ndarray, "frame joint 3"], time_s: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "time joint 3"]:
    """Between frames, where clocks were corrected."""
    frame = np.clip(time_s * FPS, 0, len(truth_m) - 1)
    before = np.minimum(np.floor(frame + 1e-6).astype(int), len(truth_m) - 2)
    share = (frame - before)[:, None, None]
    between_m = (1 - share) * truth_m[before] + share * truth_m[before + 1]
    return np.where(np.abs(share) < 1e-6, truth_m[before], between_m)
