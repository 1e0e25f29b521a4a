"""The scale of a rig whose unit is unknown: from the stature of the walker, measured distances, or the network's 3D.

Each cue says by what the unit has to be multiplied to be metres, with its standard deviation. Cues are independent and
are fused by their information; what contradicts the others is found out and said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.geometry.camera import CameraRig
from fgpose_factors.robust_statistics import known_median, weighted_median

# Of adults the mean over both sexes, and their standard deviation (coefficient of variation 4.5 %, and 4 % between the
# sexes): where nothing else is known.
_ADULT_M, _ADULT_SIGMA = 1.70, 0.06
# A network does not see how tall somebody is (4.5 %), and has an error of its own: BlazePose was 7.4 % off on a
# recording with known cameras.
_NETWORK_SIGMA = float(np.hypot(0.045, 0.074))
_DISTANCE_SIGMA = 0.005
# Of a stature that is told: 10 mm in the course of the day and by the shoes.
_STATURE_SIGMA_M = 0.01
_STATURES_M = (0.7, 2.5)
_CONTRADICTION = 3.0  # standard deviations: by chance in one of 370
_COARSE_BODY = 0.03  # 1 % at most with cameras around the person, 4 % and more with four that are 0.6 m apart
_HEAD_CENTILE = 0.95


@dataclass(frozen=True)
class MeasuredDistance:
    """What somebody measured between two cameras, lens to lens. Raises ValueError if it is not a positive length."""

    first: str
    second: str
    distance_m: float
    sigma_m: float | None = None
    """Standard deviation; None: 0.5 %."""

    def __post_init__(self) -> None:
        sigma_m = self.distance_m * _DISTANCE_SIGMA if self.sigma_m is None else self.sigma_m
        if not (0 < self.distance_m < np.inf and 0 < sigma_m < np.inf):
            raise ValueError(
                f"the distance from {self.first} to {self.second} must be a positive number of metres, "
                f"got {self.distance_m} (standard deviation {self.sigma_m})"
            )
        if self.first == self.second:
            raise ValueError(f"a distance needs two cameras, got {self.first} twice")

    @property
    def share(self) -> float:
        """Standard deviation as a share of the distance."""
        return _DISTANCE_SIGMA if self.sigma_m is None else self.sigma_m / self.distance_m


@dataclass(frozen=True)
class ScaleCue:
    """What one source says of the scale."""

    name: str
    """As "stature 1.78 m"."""
    factor: float
    """Metres per unit."""
    sigma: float
    """Standard deviation of the factor, as a share of it."""
    remedy: str = ""
    """What to check if it contradicts the others."""

    def of_body(self, body_sigma: float) -> ScaleCue:
        """With what is not known of the size of the body in the gauge."""
        return replace(self, sigma=float(np.hypot(self.sigma, body_sigma)))


@dataclass(frozen=True)
class Scale:
    factor: float
    """Metres per unit."""
    sigma: float
    """Standard deviation of the factor, as a share of it; larger where the cues contradict each other."""
    source: str
    """The cues that count, as "stature 1.78 m"."""
    findings: tuple[CalibrationFinding, ...] = ()


def stature_cues(
    stature_m: float,
    joints_m: Float[np.ndarray, "frame joint 3"],
    heads: Float[np.ndarray, " walking"],
    anatomy: Anatomy,
) -> tuple[ScaleCue, ...]:
    """What the walker's stature says: by the height of the head, which is twice as certain as by the segments of the
    body (bodies differ in proportions, networks in where they have the hips). The segments are used where nobody walks
    upright, and named beside it where the two contradict each other, as of somebody who stoops.

    Args:
        stature_m: of the walker, without shoes.
        joints_m: in any gauge.
        heads: heights of the head above the floor in the frames in which he walks upright; none: it does not count.
        anatomy: of the skeleton.

    Raises:
        ValueError: the stature is none of a person.
    """
    check_stature(stature_m)
    name, remedy = f"stature {stature_m:.2f} m", "check the stature that was given, and walk upright"
    told, (share, sigma) = _STATURE_SIGMA_M / stature_m, anatomy.segments
    by_segments = ScaleCue(name, stature_m * share / anatomy.segments_m(joints_m), float(np.hypot(sigma, told)), remedy)
    if anatomy.head is None or not heads.size or np.quantile(heads, _HEAD_CENTILE) <= 0:
        return (by_segments,)
    high = float(np.quantile(heads, _HEAD_CENTILE))
    by_head = ScaleCue(name, stature_m * anatomy.head.height / high, float(np.hypot(anatomy.head.sigma, told)), remedy)
    contradict = bool(fuse([by_head, by_segments]).findings)
    return (by_head, by_segments) if contradict else (by_head,)


def body_sigma(lengths: Float[np.ndarray, "frame bone"], of_halves: Sequence[Float[np.ndarray, "_half bone"]]) -> float:
    """Standard deviation of the size of the body in the gauge of a rig, as a share of it: how much larger the halves of
    a recording have it, beside rigs of their own that were laid on it. Where all cameras look from nearly the same
    side, the body may be larger and farther away.

    Args:
        lengths: of the bones, in the gauge; NaN = not known.
        of_halves: the same of the frames of each half, in its rig.
    """
    typical = _median_lengths(lengths)
    changes = [known_median(np.log(_median_lengths(own) / typical)) for own in of_halves]
    # Two numbers tell a variance to within a factor of two; this is twice what is expected of it.
    return float(np.sqrt(np.nansum(np.square(changes))))


def _median_lengths(lengths: Float[np.ndarray, "frame bone"]) -> Float[np.ndarray, " bone"]:
    return np.array([known_median(own) for own in lengths.T])


def body_uncertain(sigma: float) -> tuple[CalibrationFinding, ...]:
    """That the scale follows from the size of a body that is known so well."""
    if sigma <= _COARSE_BODY:
        return ()
    reason = f"how far apart the cameras are, in sizes of the body, is known to {sigma:.0%} only"
    remedy = "measure the distance between two cameras (--distance), or put them farther apart"
    return (CalibrationFinding("", Grade.COARSE, reason, remedy),)


def assumed(scale: Scale) -> CalibrationFinding:
    """That nothing was measured: what is left takes everybody for an adult, networks too."""
    reason = (
        f"the scale is assumed ({scale.source}): it holds for adults, to {scale.sigma:.0%}; of a child all lengths are "
        "wrong. Angles, and lengths relative to each other, do not need it"
    )
    return CalibrationFinding("", Grade.COARSE, reason, "give --height of the walker, or --distance of two cameras")


def check_stature(stature_m: float) -> None:
    """Raise ValueError for what is the stature of nobody who walks by himself."""
    low, high = _STATURES_M
    if low <= stature_m / 100 <= high:
        raise ValueError(f"a stature is in metres: {stature_m / 100:g}, not {stature_m:g}")
    if not low <= stature_m <= high:
        raise ValueError(f"a stature is from {low:g} to {high:g} metres, got {stature_m:g}")


def distance_cue(
    measured: MeasuredDistance, rig: CameraRig, covariance: Float[np.ndarray, "camera 3 camera 3"] | None = None
) -> ScaleCue:
    """What a measured distance says.

    Args:
        measured: between two cameras of the rig.
        rig: in any gauge.
        covariance: of the positions of the cameras, in the rig's frame and unit; None: exact.

    Raises:
        ValueError: the rig lacks one of the cameras, or they are at the same place.
    """
    first, second = rig.subset((measured.first, measured.second)).cameras
    between = second.position_m - first.position_m
    distance = float(np.linalg.norm(between))
    if distance == 0:
        raise ValueError(f"cameras {measured.first} and {measured.second} are at the same place")
    of_rig = 0.0
    if covariance is not None:
        a, b = rig.names.index(measured.first), rig.names.index(measured.second)
        of_both = covariance[a, :, a] + covariance[b, :, b] - covariance[a, :, b] - covariance[b, :, a]
        of_rig = float(np.sqrt(max(between @ of_both @ between, 0.0))) / distance**2
    return ScaleCue(
        name=f"distance {measured.first} to {measured.second} {measured.distance_m:.2f} m",
        factor=measured.distance_m / distance,
        sigma=float(np.hypot(measured.share, of_rig)),
        remedy=f"measure the distance from {measured.first} to {measured.second} again, lens to lens",
    )


def network_cue(
    points3d_m: Float[np.ndarray, "frame camera joint 3"],
    joints_m: Float[np.ndarray, "frame joint 3"],
    anatomy: Anatomy,
) -> ScaleCue | None:
    """What a network's metric 3D says: its bones against the reconstructed ones. None where there are no bones."""
    own = anatomy.skeleton.bone_lengths(joints_m)
    ratios = []
    for camera in range(points3d_m.shape[1]):
        theirs = anatomy.skeleton.bone_lengths(points3d_m[:, camera])
        both = np.isfinite(theirs) & np.isfinite(own) & (own > 0)
        long = [
            (np.median(theirs[known, b]), np.median(own[known, b])) for b, known in enumerate(both.T) if known.any()
        ]
        if long:
            lengths = np.array(long)
            ratio = lengths[:, 0] / lengths[:, 1]
            # Short bones (of the face, of the hips) are those that a network gets wrong.
            ratios.append(weighted_median(ratio, lengths[:, 1]))
    if not ratios:
        return None
    remedy = "give the stature of the walker or a measured distance: a network cannot know it"
    return ScaleCue("metric 3D of the network", float(np.median(ratios)), _NETWORK_SIGMA, remedy)


def adult_cue(joints_m: Float[np.ndarray, "frame joint 3"], anatomy: Anatomy) -> ScaleCue:
    """What is left where nothing is known: the walker is an adult of mean stature."""
    remedy = "give the stature of the walker or a measured distance"
    return ScaleCue("an adult's mean stature", _ADULT_M / anatomy.stature_m(joints_m), _ADULT_SIGMA, remedy)


def fuse(cues: Sequence[ScaleCue], check: ScaleCue | None = None) -> Scale:
    """The scale that all cues together give; one that contradicts the others by more than 3 sigma is a finding.

    Args:
        cues: independent of each other.
        check: one that does not count, but is compared with the others: a network's 3D makes everybody an adult.

    Raises:
        ValueError: there is no cue.
    """
    if not cues:
        raise ValueError("there is no cue for the scale")
    scale = _fused(cues)
    if check is None or scale.findings:
        return scale
    checked = _fused([*cues, check])
    sigma = checked.sigma if checked.findings else scale.sigma
    return replace(scale, sigma=max(sigma, scale.sigma), findings=checked.findings)


def _fused(cues: Sequence[ScaleCue]) -> Scale:
    log, information = np.log([cue.factor for cue in cues]), np.array([cue.sigma for cue in cues]) ** -2
    mean = float(information @ log / information.sum())
    sigma, worst = float(information.sum() ** -0.5), None
    if len(cues) > 1:
        chi2 = float(information @ (log - mean) ** 2) / (len(cues) - 1)
        worst = _worst(cues, log, information)
        sigma *= 1.0 if worst is None else max(1.0, float(np.sqrt(chi2)))
    findings = () if worst is None else (worst,)
    return Scale(float(np.exp(mean)), sigma, _named(cues, information), findings)


def _worst(
    cues: Sequence[ScaleCue], log: Float[np.ndarray, " cue"], information: Float[np.ndarray, " cue"]
) -> CalibrationFinding | None:
    """The cue that contradicts the others most, by more than chance."""
    others = information.sum() - information
    apart = log - (information @ log - information * log) / others
    sigmas = np.abs(apart) / np.sqrt(1 / information + 1 / others)
    # Of two cues both contradict each other equally: the less certain one is named.
    worst = max(range(len(cues)), key=lambda c: (round(float(sigmas[c]), 6), cues[c].sigma))
    if sigmas[worst] <= _CONTRADICTION:
        return None
    names = [cue.name for c, cue in enumerate(cues) if c != worst and cue.name != cues[worst].name]
    against = " and ".join(dict.fromkeys(names)) or "the proportions of the body"
    size = "larger" if apart[worst] > 0 else "smaller"
    reason = (
        f"{cues[worst].name} makes everything {abs(np.expm1(apart[worst])):.0%} {size} than {against} "
        f"({sigmas[worst]:.1f} standard deviations)"
    )
    return CalibrationFinding("", Grade.COARSE, reason, cues[worst].remedy)


def _named(cues: Sequence[ScaleCue], information: Float[np.ndarray, " cue"]) -> str:
    """Those that have more than a tenth of the information, the best first."""
    order = np.argsort(-information, kind="stable")
    names = [cues[c].name for c in order if information[c] >= 0.1 * information.sum()]
    return ", ".join(dict.fromkeys(names))
