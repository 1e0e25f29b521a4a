"""Whether anybody says that a joint is seen: what the stated confidences limit.

Views that agree do not prove that a joint is seen, for networks have habits in common: all of them put the legs of
somebody who sits behind a table straight down. They say so by their confidence. So the probability that the joint is
seen at all, which all of its cameras have in common, follows from the highest confidence that any of them states. Its
scale differs from detector to detector: it is taken relative to what is usual in the recording. Where that is low for
all joints it tells nothing, and neither does a detector that always says 1.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# What is usual: most detections of a recording are good. And where some reach a high confidence it is meant as a
# probability, though most of the person is hidden.
_USUAL_QUANTILE, _HIGHEST_QUANTILE, _SHARE_OF_HIGHEST = 0.75, 0.99, 0.5
# Relative to the usual: a guess, and a detection like others. Of the detections of OpenPose and BlazePose that are
# within 10 cm of the joint, 0 to 3 % have less than 0.3 of the usual confidence without occluders, 2 to 9 % with them,
# each view by itself; of those that are not, 3 to 94 %.
_GUESSED, _LIKE_OTHERS = 0.15, 0.35
# The usual confidence of a stream is that of so many images of all cameras.
_MEMORY_FRAMES = 500.0


def usual_confidence(confidence: Float[np.ndarray, "*detections"]) -> float:
    """Of these detections, 0 where there is none; NaN if there is none at all."""
    known = confidence[confidence > 0]
    if not known.size:
        return np.nan
    usual, highest = np.quantile(known, (_USUAL_QUANTILE, _HIGHEST_QUANTILE))
    return float(max(usual, _SHARE_OF_HIGHEST * highest))


def credible(confidence: Float[np.ndarray, "frame camera joint"], usual: float) -> Float[np.ndarray, "frame joint"]:
    """Probability that some camera sees each joint, as far as the detector says; 1 where nothing is detected, or
    nothing known of what is usual."""
    highest = confidence.max(axis=1, initial=0.0)
    share = np.clip((highest / usual - _GUESSED) / (_LIKE_OTHERS - _GUESSED), 0.0, 1.0)
    return np.where((highest > 0) & np.isfinite(share), share, 1.0)


class RunningUsual:
    """The usual confidence of a stream."""

    def __init__(self) -> None:
        self._usual, self._frames = np.nan, 0

    def after(self, confidence: Float[np.ndarray, "frame camera joint"]) -> float:
        """With a frame more."""
        own = usual_confidence(confidence)
        if np.isfinite(own):
            self._frames += 1
            before = own if np.isnan(self._usual) else self._usual
            self._usual = before + (own - before) / min(self._frames, _MEMORY_FRAMES)
        return self._usual
