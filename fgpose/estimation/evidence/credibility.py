"""Whether anybody says that a joint is seen: what the stated confidences limit.

Views that agree do not prove that a joint is seen, for networks have habits in common: all of them put the legs of
somebody who sits behind a table straight down. They say so by their confidence. So the probability that the joint is
seen at all, which all of its cameras have in common, follows from the highest confidence that any of them states. Its
scale differs from detector to detector: it is taken relative to what is usual in the recording. Where that is low for
all joints it tells nothing, and neither does a detector that always says 1. One image in which all views are unsure
says less than seconds of it: a joint that is seen has its better images. And of what it guesses a network is less sure
than of the same joint before, while it is of the other joints as sure as before.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from jaxtyping import Float

from fgpose.sampling import parts_of
from fgpose_factors.robust_statistics import medians

# What is usual: most detections of a recording are good. And where some reach a high confidence it is meant as a
# probability, though most of the person is hidden.
_USUAL_QUANTILE, _HIGHEST_QUANTILE, _SHARE_OF_HIGHEST = 0.75, 0.99, 0.5
# Relative to the usual: a guess, and a detection like others; of one image, and of the images of so long a time on
# either side. Of joints that OpenPose and BlazePose put within 10 cm in two views, 0 to 0.7 % are less credible than
# 0.5 without occluders, 0.1 to 3.7 % with them; of those that no view puts there, 3 to 100 %. By one image alone: 0 to
# 0.6, 0 to 2.8 and 3 to 88 % (two to four of the views of fgpose_benchmarks/data/detection_errors).
_GUESSED, _LIKE_OTHERS = 0.15, 0.35
_GUESSED_LONG, _LIKE_OTHERS_LONG, _LONG_S = 0.3, 0.6, 1.0
# Relative to what is usual for the joint, and to how all joints are beside what is usual for them: of the images
# around, and of one image, which is believed in their midst. Those of joints within 10 cm in two views are doubted by
# 0 % in the mean without occluders, 0.8 to 1.3 % with them; those of joints in no view by 6 to 14 %.
_GUESSED_OWN, _AS_USUAL_OWN = (0.55, 0.8), (0.8, 0.95)
# That alone says no more than that a joint is rather guessed than seen: where it could say that no view tells anything,
# bones were learned worse online, 29 mm in place of 26 after legs had been hidden (five seeds).
_LEAST_OWN = 0.4
# The usual confidence of a stream is that of so many images of all cameras.
_MEMORY_FRAMES = 500.0
# What is usual for a joint is learned from frames in which it is guessed this much more slowly.
_GUESSES_COUNT = 0.1


def usual_confidence(confidence: Float[np.ndarray, "*detections"]) -> float:
    """Of these detections, 0 where there is none; NaN if there is none at all."""
    known = confidence[confidence > 0]
    if not known.size:
        return np.nan
    known.sort()
    usual, highest = (_quantile(known, quantile) for quantile in (_USUAL_QUANTILE, _HIGHEST_QUANTILE))
    return float(max(usual, _SHARE_OF_HIGHEST * highest))


def _quantile(ordered: Float[np.ndarray, " value"], quantile: float) -> float:
    """numpy.quantile takes five times as long for one frame."""
    # The places of all values, and they in double precision, take four times as much memory as they.
    last = len(ordered) - 1
    first = max(int(quantile * last) - 1, 0)
    near = np.arange(first, min(first + 4, len(ordered)))
    at = np.where(near < last, near * (1.0 / max(last, 1)), 1.0)
    return float(np.interp(quantile, at, ordered[near]))


def credible(
    confidence: Float[np.ndarray, "frame camera joint"], time_s: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame joint"]:
    """Probability that some camera sees each joint, as far as the detector says; 1 where nothing is detected."""
    first, last = np.searchsorted(time_s, time_s - _LONG_S), np.searchsorted(time_s, time_s + _LONG_S, side="right")
    (n_frames, n_cameras, n_joints), usual = confidence.shape, usual_confidence(confidence)
    said, at, sums = np.empty((n_frames, 2, n_joints)), 0, np.zeros((1, 2, n_cameras, n_joints))
    for part in parts_of(n_frames):
        # Of all frames at once the sums take three times as much memory as the confidences.
        begin, end = first[part], last[part]
        before, own = sums[begin[0] - at], confidence[begin[0] : end[-1]]
        at, sums = begin[0], np.cumsum(np.concatenate([before[None], np.stack([own, own > 0], axis=1)]), axis=0)
        total, images = (sums[end - at] - sums[begin - at]).swapaxes(0, 1)
        said[part] = np.stack([_highest(_mean(total, images)), _highest(confidence[part])], axis=1)
    own = np.stack([np.quantile(said[:, :, joint], _USUAL_QUANTILE, axis=0) for joint in range(n_joints)], axis=-1)
    found = np.empty((n_frames, n_joints))
    for part in parts_of(n_frames):
        found[part] = _credible(said[part], usual, own)
    return found


class RunningCredibility:
    """The same of a stream, from what came before."""

    def __init__(self, n_cameras: int, n_joints: int) -> None:
        self._usual, self._frames, self._own = np.nan, 0, np.full((2, n_joints), np.nan)
        self._time_s = -np.inf
        self._total, self._images = np.zeros((2, n_cameras, n_joints))

    def plus(self, confidence: Float[np.ndarray, "1 camera joint"], time_s: float) -> RunningCredibility:
        """With those of one frame or image, 0 where there is none; this one stays as it is."""
        own, after = usual_confidence(confidence), copy(self)
        if np.isfinite(own):
            after._frames += 1
            before = own if np.isnan(self._usual) else self._usual
            after._usual = before + (own - before) / min(after._frames, _MEMORY_FRAMES)
        keep = np.exp(-max(time_s - self._time_s, 0.0) / _LONG_S)
        after._total = keep * self._total + confidence[0]
        after._images = keep * self._images + (confidence[0] > 0)
        after._time_s = max(time_s, self._time_s)
        after._own = self._own_after(after._said(confidence)[0], after._frames)
        return after

    def credible(self, confidence: Float[np.ndarray, "1 camera joint"]) -> Float[np.ndarray, "1 joint"]:
        """Of the joints of a frame; 1 where nothing is detected, or nothing known of what is usual."""
        return _credible(self._said(confidence), self._usual, self._own)

    def _said(self, confidence: Float[np.ndarray, "1 camera joint"]) -> Float[np.ndarray, "1 2 joint"]:
        return np.stack([_highest(_mean(self._total, self._images))[None], _highest(confidence)], axis=-2)

    def _own_after(self, said: Float[np.ndarray, "2 joint"], n_frames: int) -> Float[np.ndarray, "2 joint"]:
        own = np.where(np.isnan(self._own), said, self._own)
        learned = np.maximum(_as_usual(said, own), _GUESSES_COUNT) / min(max(n_frames, 1), _MEMORY_FRAMES)
        return np.where(said[1] > 0, own + learned * (said - own), self._own)


def _mean(total: Float[np.ndarray, "*shape"], images: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """0 where there is no image."""
    return np.divide(total, images, out=np.zeros_like(total), where=images > 0)


def _highest(confidence: Float[np.ndarray, "*frames camera joint"]) -> Float[np.ndarray, "*frames joint"]:
    return np.max(confidence, axis=-2, initial=0.0)


def _credible(
    said: Float[np.ndarray, "frame 2 joint"], usual: float, own: Float[np.ndarray, "2 joint"]
) -> Float[np.ndarray, "frame joint"]:
    """One confident image is enough, for it and for no other.

    Args:
        said: the highest of all cameras: the mean of the images around, and the confidence of the image.
        usual: of all detections.
        own: what is usual of both for each joint; NaN where it is not known.
    """
    lately, now = said.swapaxes(0, 1)
    of_image = _share(now / usual, _GUESSED, _LIKE_OTHERS)
    of_long = _share(np.maximum(lately, now) / usual, _GUESSED_LONG, _LIKE_OTHERS_LONG)
    of_own = np.maximum(_as_usual(said, own), _LEAST_OWN)
    least = np.minimum(np.minimum(of_image, of_long), of_own)
    return np.where((now > 0) & np.isfinite(least), least, 1.0)


def _as_usual(
    said: Float[np.ndarray, "*frames 2 joint"], own: Float[np.ndarray, "2 joint"]
) -> Float[np.ndarray, "*frames joint"]:
    """As far as a joint is as credible as usual; what all joints have less, as of somebody far away, tells nothing."""
    relative = np.divide(said, own, out=np.ones_like(said), where=(own > 0) & (said > 0))
    relative /= np.minimum(medians(relative)[..., None], 1.0)
    none, all_ = np.array(_GUESSED_OWN)[:, None], np.array(_AS_USUAL_OWN)[:, None]
    return np.max(_share(relative, none, all_), axis=-2)


def _share(
    value: Float[np.ndarray, "*shape"], none: float | np.ndarray, all_: float | np.ndarray
) -> Float[np.ndarray, "*shape"]:
    return np.clip((value - none) / (all_ - none), 0.0, 1.0)
