"""When videos begin that have no common clock: found from the motion of the walker whom they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.starts.clocks import ClockShift, solve_clocks
from fgpose.calibration.from_people.starts.epipolar_shift import RATE_SIGMA, EpipolarShift, fit_epipolar_shift
from fgpose.calibration.from_people.starts.joining import Joining, join_cameras
from fgpose.calibration.from_people.starts.motion_signals import MotionSignals, motion_signals
from fgpose.calibration.from_people.starts.other_causes import Join, other_cause
from fgpose.calibration.from_people.starts.placed_joining import join_placed
from fgpose.calibration.from_people.starts.start_findings import about_clock, nobody, not_joined, same_camera
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.walk import Track
from fgpose.geometry.camera import CameraRig
from fgpose.shown.unknown_names import check_names
from fgpose.skeleton import Skeleton

# A pair whose shift moves further away from that of the whole rig has fallen into another gait cycle.
_MAX_MOVED_S = 0.2
# 30 for 29.97 Hz is 0.001, and more than 0.02 off no moment is found.
_WRONG_RATE = 0.02
# Half a minute of a walker gives 2 to 6 ms.
_SURE_S = 0.01
# Clocks of which nothing is known but that they are given.
_GIVEN_RATE_SIGMA = 1e-4


@dataclass(frozen=True, eq=False)
class Starts:
    """The clocks of all cameras relative to that of one of them."""

    camera_names: tuple[str, ...]
    reference: str
    """Camera whose clock is the common one: the first that is trusted, or the first if none is."""
    offsets_s: Float[np.ndarray, " camera"]
    """Common time = own time * (1 + rate) + offset_s; NaN where not trusted."""
    rates: Float[np.ndarray, " camera"]
    """Drift of each clock relative to the common one; NaN where not trusted."""
    sigma_s: Float[np.ndarray, " camera"]
    """Standard deviation of the common time in the middle of the recording; NaN where not trusted."""
    trusted: Bool[np.ndarray, " camera"]
    findings: tuple[CalibrationFinding, ...] = ()
    """Of each camera that is not trusted the reason, and doubts about others."""

    def common_s(self, camera: str, own_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """Times by the clock of a camera, by the common clock."""
        c = self.camera_names.index(camera)
        return own_s * (1 + self.rates[c]) + self.offsets_s[c]

    def own_s(self, camera: str, common_s: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
        """Times by the common clock, by the clock of a camera."""
        c = self.camera_names.index(camera)
        return (common_s - self.offsets_s[c]) / (1 + self.rates[c])

    def offsets_at_s(self, cameras: Sequence[str], common_s: float) -> Float[np.ndarray, " camera"]:
        """What turns the clock of each camera into the common one at this time of it, should the clock drift."""
        at_s = np.array([common_s])
        return np.array([common_s - float(self.own_s(name, at_s)[0]) for name in cameras])


@dataclass(frozen=True)
class GivenStart:
    """What is known of when a camera begins: from a time code, a synchronised system, or another cue, such as sound."""

    offset_s: float
    """Common time = own time + offset_s, the same origin for all cameras."""
    sigma_s: float = 0.0
    """Standard deviation; 0: exactly. The sound of two cameras gives about 10 ms."""


def find_starts(
    tracks: Sequence[Track],
    skeleton: Skeleton,
    intrinsics: CameraRig,
    given: Mapping[str, GivenStart] | None = None,
    *,
    placed: bool = False,
) -> Starts:
    """When the cameras began, relative to each other, from one walker.

    Coarse: signals of the motion that all views share propose moments, the epipolar geometry of the joints decides
    between them, and one camera after the other joins those that are consistent (joining.py). Fine: of every pair the
    shift and the drift that make the joints meet their epipolar lines (epipolar_shift.py), solved for all cameras
    together (clocks.py). What is not decisive is not guessed: such a camera is not trusted, and a finding says why.

    Args:
        tracks: of the same person, one of each camera of the rig in its order; empty where nobody is seen.
        intrinsics: known or guessed; poses do not matter unless the cameras are placed.
        given: of some cameras, by name, what is known already; no moments are searched for these. If it is exact for
            all of them, nothing is estimated.
        placed: whether the poses of the cameras are known; the epipolar geometry is theirs then.

    Raises:
        ValueError: there are fewer than two cameras, fewer than two see anybody, or the cameras differ.
    """
    names, given = intrinsics.names, dict(given or {})
    _check(tracks, names, given)
    given_s = {names.index(name): start.offset_s for name, start in given.items()}

    # Most tracks are asked for again where one camera is tried otherwise.
    signals = cache(partial(motion_signals, skeleton=skeleton))
    view = cache(View.of)

    def views_of(tracks: Sequence[Track], rig: CameraRig, *, placed: bool = placed) -> list[View]:
        return [view(track, camera, placed=placed) for track, camera in zip(tracks, rig.cameras, strict=True)]

    def join(
        tracks: Sequence[Track], rig: CameraRig, known_s: Mapping[int, float], *, placed: bool = placed
    ) -> Joining:
        views = views_of(tracks, rig, placed=placed)
        return join_placed(views, known_s) if placed else join_cameras([*map(signals, tracks)], views, known_s)

    views = views_of(tracks, intrinsics)
    findings = [nobody(name) for name, track in zip(names, tracks, strict=True) if not len(track.time_s)]
    if all(name in given and given[name].sigma_s == 0 for name in names):
        return _as_given(names, given, views, findings)
    joining = join(tracks, intrinsics, given_s)
    join_again = partial(join, known_s=joining.offsets_s)
    join_anywhere = partial(join_again, placed=False) if placed else None
    findings += _not_joined(tracks, joining, intrinsics, skeleton, signals, join_again, join_anywhere)
    shifts = _pair_shifts(views, joining.offsets_s)
    doubles = same_camera(names, views, joining.offsets_s)
    trusted = [c for c in sorted(joining.offsets_s) if names[c] not in {finding.camera for finding in doubles}]
    return _solved(names, trusted, {**_as_shifts(names, given), **shifts}, tracks, [*findings, *doubles])


def _not_joined(
    tracks: Sequence[Track],
    joining: Joining,
    intrinsics: CameraRig,
    skeleton: Skeleton,
    signals: Callable[[Track], MotionSignals],
    join: Join,
    join_anywhere: Join | None,
) -> list[CalibrationFinding]:
    """Why cameras that see somebody have not joined."""
    missing = [c for c, track in enumerate(tracks) if c not in joining.offsets_s and len(track.time_s)]
    if not missing:
        return []
    moves = float(np.median([signals(track).moves for track in tracks if len(track.time_s)]))
    nobody_joined = not joining.offsets_s
    return [
        other_cause(c, tracks, joining.offsets_s, intrinsics, skeleton, join, join_anywhere)
        or not_joined(
            intrinsics.names[c], signals(tracks[c]), joining.joined.get(c), moves, nobody_joined=nobody_joined
        )
        for c in missing
    ]


def _check(tracks: Sequence[Track], names: tuple[str, ...], given: Mapping[str, GivenStart]) -> None:
    if tuple(track.camera for track in tracks) != names:
        own = ", ".join(track.camera for track in tracks)
        raise ValueError(f"the tracks are of the cameras {own}, the intrinsics of {', '.join(names)}")
    if len(names) < 2:
        raise ValueError(
            f"there is only {', '.join(names)}; at least two cameras must see the same person at the same time"
        )
    check_names(given, names, "a start is given for", "the cameras are")
    seeing = [track.camera for track in tracks if np.isfinite(track.points2d_px).any()]
    if len(seeing) < 2:
        who = f"only {seeing[0]} sees anybody" if seeing else "no camera sees anybody"
        raise ValueError(f"{who}; at least two cameras must see the same person at the same time")


def _as_given(
    names: tuple[str, ...],
    given: Mapping[str, GivenStart],
    views: Sequence[View],
    findings: Sequence[CalibrationFinding],
) -> Starts:
    """Of all cameras that see somebody, and each of which is another one."""
    known = {c: given[name].offset_s for c, name in enumerate(names) if len(views[c].time_s)}
    doubles = same_camera(names, views, known)
    is_trusted = np.array([c in known and name not in {f.camera for f in doubles} for c, name in enumerate(names)])
    reference = int(np.argmax(is_trusted))
    offsets_s = np.array([given[name].offset_s for name in names]) - given[names[reference]].offset_s
    zero = np.where(is_trusted, 0.0, np.nan)
    offsets_s = np.where(is_trusted, offsets_s, np.nan)
    return Starts(names, names[reference], offsets_s, zero, zero.copy(), is_trusted, (*findings, *doubles))


def _as_shifts(names: tuple[str, ...], given: Mapping[str, GivenStart]) -> dict[tuple[int, int], ClockShift]:
    """What is given, as shifts between the first such camera and each of the others. The order of the pair is the one
    that is not used for what is estimated."""
    ordered = sorted(given, key=names.index)
    shifts = {}
    for first, other in ((ordered[0], other) for other in ordered[1:]):
        variance = given[first].sigma_s ** 2 + given[other].sigma_s ** 2
        shift_s = given[first].offset_s - given[other].offset_s
        covariance = np.diag([variance, _GIVEN_RATE_SIGMA**2])
        shifts[names.index(other), names.index(first)] = ClockShift(shift_s, 0.0, 0.0, covariance)
    return shifts


def _pair_shifts(views: Sequence[View], offsets_s: Mapping[int, float]) -> dict[tuple[int, int], ClockShift]:
    """Of all pairs that have enough in common."""
    shifts = {}
    for one, other in combinations(sorted(offsets_s), 2):
        near_s = offsets_s[other] - offsets_s[one]
        fit = _fit(views[one], views[other], near_s)
        if fit is not None and abs(fit.clock.shift_s - near_s) <= _MAX_MOVED_S:
            shifts[one, other] = fit.clock
    return shifts


def _fit(first: View, second: View, shift_s: float) -> EpipolarShift | None:
    """With the drift of two quartz clocks; if that comes out large, or one part of the recording contradicts another,
    with any, in case a file states a wrong rate."""
    fit = fit_epipolar_shift(first, second, shift_s)
    if fit is None or (abs(fit.clock.rate) < 1.5 * RATE_SIGMA and fit.clock.sigma_s < _SURE_S):
        return fit
    free = fit_epipolar_shift(first, second, fit.clock.shift_s, fit.clock.rate, _WRONG_RATE)
    is_wrong = free is not None and free.misfit < fit.misfit and abs(free.clock.rate) > 5 * free.clock.rate_sigma
    return free if is_wrong else fit


def _solved(
    names: tuple[str, ...],
    trusted: Sequence[int],
    shifts: Mapping[tuple[int, int], ClockShift],
    tracks: Sequence[Track],
    findings: Sequence[CalibrationFinding],
) -> Starts:
    """The clocks of those cameras; again without those that turn out not to be known."""
    reference = trusted[0] if trusted else 0
    kept = _connected({pair: shift for pair, shift in shifts.items() if set(pair) <= set(trusted)}, reference)
    clocks = solve_clocks(kept, len(names), reference)
    doubts = [finding for c in trusted for finding in about_clock(names[c], c, clocks, tracks[c])]
    fatal = [finding for finding in doubts if finding.grade is Grade.FAILED]
    if fatal:
        lost = {finding.camera for finding in fatal}
        return _solved(names, [c for c in trusted if names[c] not in lost], shifts, tracks, [*findings, *fatal])
    is_trusted = np.isin(np.arange(len(names)), trusted)
    offsets_s, rates, sigma_s = (
        np.where(is_trusted, array, np.nan) for array in (clocks.offsets_s, clocks.rates, clocks.sigma_s)
    )
    return Starts(names, names[reference], offsets_s, rates, sigma_s, is_trusted, (*findings, *doubts))


def _connected(shifts: Mapping[tuple[int, int], ClockShift], reference: int) -> dict[tuple[int, int], ClockShift]:
    """Those of cameras that are connected with the reference."""
    reached, grows = {reference}, True
    while grows:
        more = {camera for pair in shifts if reached & set(pair) for camera in pair} - reached
        reached, grows = reached | more, bool(more)
    return {pair: shift for pair, shift in shifts.items() if set(pair) <= reached}
