"""What of somebody's motion all cameras see alike, wherever they stand: signals to find common moments by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.body_size import mean_joint, steady_radius
from fgpose.calibration.from_people.walk import Track
from fgpose.estimation.noise import TELLING_HZ
from fgpose.skeleton import Skeleton

# Speeds are smoothed over less than a step (0.5 s); what is slower than the gait depends on the view, as the feet of
# somebody who comes nearer go down in the image.
_SMOOTH_S, _SLOW_S = 0.06, 0.4
# Effort and turning change from walk to stop and from turn to turn.
_SLOW_ACTIVITY_S = 3.0
_TURN_SMOOTH_S = 0.25
# Chosen on simulated walkers (tuning clips) before rings of cameras and cameras in corners: with the effort, the right
# moment stands out from the next by a factor of 3, without by 2, and 1 pair of 10 misses it. Activity and turning are
# one signal each against one for every joint of a gait, which repeats itself.
_VERTICAL_WEIGHT, _EFFORT_WEIGHT, _ACTIVITY_WEIGHT, _TURN_WEIGHT = 1.0, 2.0, 2.0, 3.0
_MAX_STEP_S = 0.2
_CLIP = 3.0
_ABOVE, _BELOW, _RIGID = ("head", "nose", "ear", "neck", "shoulder"), ("hip", "knee", "ankle"), ("hip", "shoulder")


@dataclass(frozen=True, eq=False)
class MotionSignals:
    """Signals of one track, sampled at whole numbers of samples by the clock of its camera."""

    first: int
    """Number of the first sample; its time is first / TELLING_HZ."""
    values: Float[np.ndarray, "channel sample"]
    """Without slow parts, of unit variance times the weight of the channel; 0 where unknown."""
    known: Bool[np.ndarray, "channel sample"]
    moves: float
    """Median over time of the mean speed of the joints relative to the image, in radii of the body per second (about
    0.5 m/s)."""

    @property
    def lasts_s(self) -> float:
        return self.known.shape[1] / TELLING_HZ


def motion_signals(track: Track, skeleton: Skeleton) -> MotionSignals:
    """The signals of a track.

    In each view: the speed of every joint along the body's vertical, which for upright people is nearly the same in
    all views of level cameras; the mean of their absolute values (as Pose2Sim synchronises); and the root of every
    joint's speed, its effort, for a foot that stands still does so in all views, also from above. Of per-view 3D: the
    distances of left and right joints, and how fast the body turns about its vertical.
    """
    clock = _Clock.of(track)
    if clock is None:
        channels = 2 * skeleton.n_joints
        return MotionSignals(0, np.zeros((channels, 0)), np.zeros((channels, 0), dtype=bool), 0.0)
    speeds = _speeds(track, skeleton)
    vertical = clock.smooth(clock.middles_s, speeds[..., 1], _SMOOTH_S)
    signals = [(vertical - clock.smooth(clock.middles_s, speeds[..., 1], _SLOW_S), _VERTICAL_WEIGHT)]
    sideways = clock.smooth(clock.middles_s, speeds[..., 0], _SMOOTH_S)
    effort = np.sqrt(np.hypot(sideways, vertical))
    signals.append((effort - clock.smooth(clock.times_s, effort, _SLOW_S), _EFFORT_WEIGHT))
    activity = _mean_of_known(np.abs(vertical))
    signals.append((activity - clock.smooth(clock.times_s, activity, _SLOW_ACTIVITY_S), _ACTIVITY_WEIGHT))
    if track.points3d_m is not None:
        signals += _of_3d(track.points3d_m, track.time_s, clock, skeleton)
    values = np.concatenate([_unit(signal) * weight for signal, weight in signals], axis=1).T
    known = np.isfinite(values)
    return MotionSignals(clock.first, np.where(known, values, 0.0), known, _typical_speed(track))


def _typical_speed(track: Track) -> float:
    """In radii of the body per second: how far the joints get within half a second, noise therefore hardly counts."""
    radius_px = steady_radius(track.time_s, track.points2d_px)
    step_s = float(np.median(np.diff(track.time_s)))
    later = max(round(0.5 / step_s), 1)
    if len(track.time_s) <= later:
        return 0.0
    moved = np.linalg.norm(track.points2d_px[later:] - track.points2d_px[:-later], axis=-1) / radius_px[later:, None]
    known = np.isfinite(moved)
    return float(np.median(moved[known])) / (later * step_s) if known.any() else 0.0


@dataclass(frozen=True, eq=False)
class _Clock:
    """Samples from the first to the last image of a track."""

    first: int
    n_samples: int
    middles_s: Float[np.ndarray, " step"]
    """Half-way between two images of the track."""

    @staticmethod
    def of(track: Track) -> _Clock | None:
        if len(track.time_s) < 2:
            return None
        first, last = np.ceil(track.time_s[0] * TELLING_HZ), np.floor(track.time_s[-1] * TELLING_HZ)
        middles_s = (track.time_s[1:] + track.time_s[:-1]) / 2
        return _Clock(int(first), int(last - first) + 1, middles_s) if last > first else None

    @property
    def times_s(self) -> Float[np.ndarray, " sample"]:
        return (self.first + np.arange(self.n_samples)) / TELLING_HZ

    def smooth(
        self, time_s: Float[np.ndarray, " time"], values: Float[np.ndarray, "time channel"], sigma_s: float
    ) -> Float[np.ndarray, "sample channel"]:
        """Weighted means around each sample (normalised convolution); NaN where little is known nearby."""
        from scipy.ndimage import gaussian_filter1d

        sample = np.clip(np.round(time_s * TELLING_HZ).astype(int) - self.first, 0, self.n_samples - 1)
        known = np.isfinite(values)
        sums, counts = np.zeros((2, self.n_samples, values.shape[1]))
        np.add.at(sums, sample, np.where(known, values, 0.0))
        np.add.at(counts, sample, known)
        sums, counts = (
            gaussian_filter1d(each, sigma_s * TELLING_HZ, axis=0, mode="constant") for each in (sums, counts)
        )
        # Half of the weight, in images as often as they come.
        enough = 0.25 * min(len(time_s) / self.n_samples, 1.0)
        return np.where(counts > enough, sums / np.maximum(counts, 1e-9), np.nan)


def _speeds(track: Track, skeleton: Skeleton) -> Float[np.ndarray, "step joint 2"]:
    """Across and downwards along the body, between each two images, in radii of the body per second."""
    step_s = np.diff(track.time_s)
    radius_px = steady_radius(track.time_s, track.points2d_px)
    down = _down(track, skeleton)
    moved = np.diff(track.points2d_px, axis=0) @ np.array([[down[1], down[0]], [-down[0], down[1]]])
    speeds = moved / (step_s * (radius_px[1:] + radius_px[:-1]) / 2)[:, None, None]
    speeds[step_s > _MAX_STEP_S] = np.nan
    return speeds


def _down(track: Track, skeleton: Skeleton) -> Float[np.ndarray, " 2"]:
    """Direction in the image from head to feet, of the whole track: images may be turned by 90 degrees. The axis of the
    image that is nearest; where too little of the body is seen, downwards."""
    above, below = ([j for j, name in enumerate(skeleton.joints) if _is_of(name, part)] for part in (_ABOVE, _BELOW))
    if not above or not below:
        return np.array([0.0, 1.0])
    axis_px = mean_joint(track.points2d_px[:, below]) - mean_joint(track.points2d_px[:, above])
    axis_px = axis_px[np.isfinite(axis_px).all(axis=-1)]
    if not len(axis_px):
        return np.array([0.0, 1.0])
    typical_px = np.median(axis_px, axis=0)
    down = np.zeros(2)
    nearest = int(np.argmax(np.abs(typical_px)))
    down[nearest] = 1.0 if typical_px[nearest] >= 0 else -1.0
    return down


def _is_of(joint: str, part: tuple[str, ...]) -> bool:
    return any(name in joint for name in part)


def _mean_of_known(values: Float[np.ndarray, "sample joint"]) -> Float[np.ndarray, "sample 1"]:
    """Where half of the joints that are seen at all are known."""
    known = np.isfinite(values)
    count, usual = known.sum(axis=1, keepdims=True), known.any(axis=0).sum()
    mean = np.where(known, values, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
    return np.where((2 * count >= usual) & (count > 0), mean, np.nan)


def _of_3d(
    points3d_m: Float[np.ndarray, "image joint 3"],
    time_s: Float[np.ndarray, " image"],
    clock: _Clock,
    skeleton: Skeleton,
) -> Iterator[tuple[Float[np.ndarray, "sample channel"], float]]:
    left, right = np.array(skeleton.left_right, dtype=int).reshape(-1, 2).T
    across_m = points3d_m[:, left] - points3d_m[:, right]
    apart_m = np.linalg.norm(across_m, axis=-1)
    yield clock.smooth(time_s, apart_m, _SMOOTH_S) - clock.smooth(time_s, apart_m, _SLOW_S), 1.0
    rigid = [n for n, (joint, _) in enumerate(skeleton.left_right) if _is_of(skeleton.joints[joint], _RIGID)]
    if rigid and clock.n_samples > 2:
        yield _turning(np.nansum(across_m[:, rigid], axis=1), time_s, clock), _TURN_WEIGHT


def _turning(
    axis_m: Float[np.ndarray, "image 3"], time_s: Float[np.ndarray, " image"], clock: _Clock
) -> Float[np.ndarray, "sample 1"]:
    """Radians per second about the camera's vertical of an axis across the body; of none it is zero."""
    smooth_m = clock.smooth(time_s, np.where(axis_m == 0, np.nan, axis_m), _TURN_SMOOTH_S)
    heading = smooth_m[:, 0] + 1j * smooth_m[:, 2]
    turned = np.full(len(heading), np.nan)
    # A product has no jump where the angle has one.
    turned[1:-1] = np.angle(heading[2:] * heading[:-2].conj()) / 2 * TELLING_HZ
    return turned[:, None]


def _unit(signal: Float[np.ndarray, "sample channel"]) -> Float[np.ndarray, "sample channel"]:
    """With unit root mean square over all channels, and without what is far outside in each: noise is alike in all
    joints, so those that move more tell more."""
    known = np.isfinite(signal)
    square = np.where(known, signal, 0.0) ** 2
    rms = np.sqrt(square.sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    limited = np.clip(signal, -_CLIP * rms, _CLIP * rms)
    return limited / max(np.sqrt(square.sum() / max(known.sum(), 1)), 1e-9)
