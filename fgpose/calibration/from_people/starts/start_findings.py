"""Why the start of a camera is not known, or not well, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.starts.clocks import Clocks
from fgpose.calibration.from_people.starts.joining import Joined
from fgpose.calibration.from_people.starts.motion_signals import MotionSignals
from fgpose.calibration.from_people.starts.same_view import shows_the_same
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.walk import SHORT_S, Track
from fgpose.sampling import usual_step_s

_LEAVE_OUT = "or leave this camera out (--cameras)"
_GIVE = "or cut the videos to begin at the same moment and say so (--synchronised)"
AMBIGUOUS_REMEDY = "clap once, or walk about where all cameras see you, with turns and stops"
"""Of a motion that repeats itself, as on a treadmill."""
_WALK = "walk about where all cameras see you, with turns and stops, for half a minute"
# Radii of the body per second, a quarter of a slow walk.
_STILL = 0.5
# Of an image period: beyond this a start is not known.
_MAX_SIGMA, _COARSE_SIGMA = 1.0, 0.3
# Pairs that agree within this are not asked whether they agree within their sigmas.
_FINE_S = 0.01
# Quartz clocks differ by 43 to 145 ppm; frame rates that are stated wrongly (30 for 29.97 Hz) by 1,000 or more.
_MAX_RATE = 5e-4


def nobody(camera: str) -> CalibrationFinding:
    return CalibrationFinding(
        camera, Grade.FAILED, "nobody is seen", f"walk where this camera sees you from head to foot, {_LEAVE_OUT}"
    )


def not_joined(
    camera: str, signals: MotionSignals, joined: Joined | None, moves: float, *, nobody_joined: bool
) -> CalibrationFinding:
    """Of a camera for which no moment is decisive, alone or because it is so for all.

    Args:
        moves: MotionSignals.moves as most cameras see it: who walks towards one of them hardly moves in its image.
    """
    if signals.lasts_s < SHORT_S:
        reason = f"the person is seen for {signals.lasts_s:.1f} s only: too short to find when the video begins"
        return CalibrationFinding(camera, Grade.FAILED, reason, f"film for half a minute, {_GIVE}")
    if joined is not None and joined.is_outstanding and joined.alike_s:
        return _ambiguous(camera, joined)
    if moves < _STILL:
        reason = "the person hardly moves from the spot: what is done there does not tell when the video begins"
        return CalibrationFinding(camera, Grade.FAILED, reason, f"{_WALK}, {_GIVE}")
    if joined is None or not joined.is_outstanding:
        others = "any other camera" if nobody_joined else "the other cameras"
        reason = f"no moment is found at which the person moves as before {others}"
        remedy = (
            f"{_WALK}; see that all cameras film at the same time and that frame rates are as the files say, {_GIVE}"
        )
        return CalibrationFinding(camera, Grade.FAILED, reason, remedy)
    return _ambiguous(camera, joined)


def _ambiguous(camera: str, joined: Joined) -> CalibrationFinding:
    second_s = () if joined.second_s is None else (joined.second_s,)
    moments_s = sorted({joined.best_s, *(joined.alike_s or second_s)})
    apart_s = min((b - a for a, b in pairwise(moments_s)), default=0.0)
    others = ", ".join(f"{each - joined.best_s:+.1f}" for each in moments_s if each != joined.best_s)
    repeats = ": the motion repeats itself" if apart_s < 5 else ""
    reason = (
        f"when the video begins is ambiguous by {apart_s:.1f} s{repeats}; starts that differ from the best by {others} "
        "s fit nearly as well"
    )
    return CalibrationFinding(camera, Grade.FAILED, reason, f"{AMBIGUOUS_REMEDY}, {_GIVE}")


def same_camera(
    names: Sequence[str], views: Sequence[View], offsets_s: Mapping[int, float]
) -> list[CalibrationFinding]:
    """Of every camera whose video shows the same as that of one before. Common time = own time + offset."""
    found: dict[str, CalibrationFinding] = {}
    for one, other in combinations(sorted(offsets_s), 2):
        if names[one] in found or names[other] in found:
            continue
        if shows_the_same(views[one], views[other], offsets_s[other] - offsets_s[one]):
            reason = f"it shows the same image as {names[one]}: both videos seem to be of one camera"
            remedy = f"give the video of the other camera, {_LEAVE_OUT}"
            found[names[other]] = CalibrationFinding(names[other], Grade.FAILED, reason, remedy)
    return list(found.values())


def about_clock(camera: str, number: int, clocks: Clocks, track: Track) -> list[CalibrationFinding]:
    """What is wrong with a start that was found; of grade failed if it is not to be trusted."""
    step_s = usual_step_s(track.time_s) if len(track.time_s) > 1 else 0.04
    sigma_s, apart_s = float(clocks.sigma_s[number]), float(clocks.disagreement_s[number])
    # Relative to most of the cameras, for it may be the reference whose clock is wrong.
    usual = np.sort(clocks.rates[np.isfinite(clocks.rates)])
    rate = float(clocks.rates[number] - usual[(len(usual) - 1) // 2]) if len(usual) else 0.0
    rate_sigma = max(float(clocks.rate_sigma[number]), float(np.nanmedian(clocks.rate_sigma)))
    remedy = f"{_WALK}; see that the frame rate is as the file says, {_GIVE}"
    if not np.isfinite(sigma_s):
        reason = "it has too little in common with the other cameras to find when the video begins"
        return [CalibrationFinding(camera, Grade.FAILED, reason, remedy)]
    found = []
    if sigma_s > _MAX_SIGMA * step_s or apart_s > _MAX_SIGMA * step_s:
        reason = f"when the video begins is known to {1e3 * max(sigma_s, apart_s):.0f} ms only"
        return [CalibrationFinding(camera, Grade.FAILED, reason, remedy)]
    if max(sigma_s, apart_s) > max(_COARSE_SIGMA * step_s, _FINE_S):
        reason = f"when the video begins is known to {1e3 * max(sigma_s, apart_s):.0f} ms only"
        found.append(CalibrationFinding(camera, Grade.COARSE, reason, _WALK))
    if abs(rate) > max(_MAX_RATE, 5 * rate_sigma):
        reason = f"its clock runs {1e2 * abs(rate):.2g} % {'slower' if rate > 0 else 'faster'} than that of the others"
        found.append(CalibrationFinding(camera, Grade.COARSE, reason, "check the frame rate that the file states"))
    return found


def in_words(findings: Sequence[CalibrationFinding]) -> str:
    """Reasons and remedies, those that several cameras have in common said once."""
    cameras: dict[tuple[str, str], list[str]] = {}
    for finding in findings:
        cameras.setdefault((finding.reason, finding.remedy), []).append(finding.camera)
    said = (f"{', '.join(names)}: {reason} ({remedy})" for (reason, remedy), names in cameras.items())
    return "; ".join(said)
