"""Cameras that show nobody, whoever is there: something stands before them, or their detector does not work.

A camera with an image that does not show somebody tells against that anybody is there, as long as it can be believed to
see. Whether it does is decided as whether somebody is there: each time that two cameras agree on a body in its image
tells, by whether it shows the body too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

# A camera in fifty shows nobody, before anything is known; it then has as few false detections at a place.
_BLIND = 0.02
# Nobody is so certain that some seconds would not count.
_LOW, _HIGH = 2 * np.log(_BLIND), -np.log(_BLIND)
# Images within this time tell once: a detector misses somebody for about so long.
_MISSED_S = 0.3
# Bounds what one image tells where a camera is asked for the first time.
_FIRST_S = 0.1


class Blind:
    """Which of the cameras are blind, from what they have shown so far."""

    def __init__(self, camera_names: Sequence[str]) -> None:
        self._log_odds = dict.fromkeys(camera_names, float(np.log(_BLIND / (1 - _BLIND))))
        self._told_s = dict.fromkeys(camera_names, -np.inf)

    def sees(self, camera_names: Sequence[str]) -> Float[np.ndarray, " camera"]:
        """Probability that each of these is not blind."""
        return 1 / (1 + np.exp(np.array([self._log_odds[name] for name in camera_names])))

    def learn(
        self,
        camera_names: Sequence[str],
        times_s: Float[np.ndarray, " camera"],
        probability: Float[np.ndarray, "body camera"],
        shown: Bool[np.ndarray, "body camera"],
    ) -> None:
        """Take the images of a moment.

        Args:
            camera_names, times_s: of its images.
            probability: of a detection of each body in each image, if the camera is not blind.
            shown: whether the image shows the body; a body on which fewer than two cameras agree tells nothing.
        """
        if not shown.any():
            return
        # Of several bodies one tells, for a camera that misses one of them is not blind if it shows another.
        agreed = shown.sum(axis=1) >= 2
        hit = np.asarray(shown.any(axis=0))
        missed = np.where((agreed[:, None] & ~shown), probability, 0.0).max(axis=0)
        for name, time_s, is_hit, share in zip(camera_names, times_s.tolist(), hit, missed.tolist(), strict=True):
            if not is_hit and not share:
                continue
            since_s = min(max(time_s - self._told_s[name], 0.0), _MISSED_S)
            since_s = _FIRST_S if np.isinf(self._told_s[name]) else since_s
            tells = np.log(_BLIND / 0.9) if is_hit else -np.log1p(-share)
            odds = self._log_odds[name] + tells * since_s / _MISSED_S
            self._log_odds[name], self._told_s[name] = float(np.clip(odds, _LOW, _HIGH)), time_s
