"""What was detected in the last minute, and whether somebody moved."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fgpose.io.live.recordings import RecordedImage
from fgpose.live.cameras.frozen_keypoints import are_same
from fgpose.people_observations import Detections

KEPT_S = 60.0
# Eight cameras of 60 Hz; of more images it is the last seconds. Three people of 33 joints each take 90 MB then.
_MAX_IMAGES = 30_000
# Between two looks at whether somebody moves, and by how much of their size their joints do then (80 %). Of somebody
# who stands still it is 0.03 to 0.06, for detections err; of a walker 0.1 to 0.5; what is beyond is somebody else.
_STEP_S, _QUANTILE, _MOVES, _SOMEBODY_ELSE = 0.5, 0.8, 0.08, 1.0
_FEWEST_JOINTS = 4
_FEWEST_CAMERAS = 2


class RecentDetections:
    """Of the last minute: those that were used, and those that repeat what the camera showed before, which are not.
    Detections of pictures in which a fault was seen are not kept: the state of the camera says it.

    One thread adds, another may read.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: deque[Detections] = deque(maxlen=_MAX_IMAGES)
        self._last: dict[str, Detections] = {}
        self.newest_s = -np.inf
        """Unix time at which the newest image was taken."""

    def add(self, images: Sequence[RecordedImage]) -> None:
        """Keep the detections of some images, which nobody changes any more; forget those of more than a minute ago."""
        with self._lock:
            for image in images:
                seen = image.detections
                last = self._last.get(seen.camera)
                if image.is_used or (last is not None and are_same(last, seen)):
                    self._kept.append(seen)
                    self._last[seen.camera] = seen
                    self.newest_s = max(self.newest_s, seen.time_s)
            while self._kept and self._kept[0].time_s < self.newest_s - KEPT_S:
                self._kept.popleft()

    def images(self, since_s: float = -np.inf) -> tuple[Detections, ...]:
        """Those that were taken since a time, in the order in which they came."""
        with self._lock:
            kept = tuple(self._kept)
        return tuple(image for image in kept if image.time_s >= since_s)


class Movements:
    """Half seconds in which somebody moves in two cameras at least, or in the only one.

    In the images alone: where cameras do not agree, nobody is followed.

    Args:
        n_cameras: there are.
    """

    def __init__(self, n_cameras: int) -> None:
        self._fewest = min(_FEWEST_CAMERAS, n_cameras)
        self._first: dict[str, tuple[int, Detections]] = {}
        """Of each camera the newest step that shows somebody, and its first image that does."""
        self._cameras: dict[int, set[str]] = {}
        """Which cameras show somebody move in each step."""

    def add(self, images: Sequence[Detections]) -> None:
        """The next images, those of each camera in their order."""
        for image in images:
            step = int(image.time_s // _STEP_S)
            before_step, before = self._first.get(image.camera, (step - 2, image))
            if not image.n_people or step <= before_step:
                continue
            if step == before_step + 1 and _somebody_moves(before, image):
                self._cameras.setdefault(step, set()).add(image.camera)
            self._first[image.camera] = step, image

    def forget(self, until_s: float) -> None:
        """What was before a time."""
        self._cameras = {step: cameras for step, cameras in self._cameras.items() if step * _STEP_S >= until_s}

    def duration_s(self, since_s: float) -> float:
        """For how long somebody has moved since a time."""
        moving = [step for step, cameras in self._cameras.items() if len(cameras) >= self._fewest]
        return _STEP_S * sum(step * _STEP_S >= since_s for step in moving)


def _somebody_moves(before: Detections, after: Detections) -> bool:
    """Whoever is nearest is taken for the same."""
    return any(
        _MOVES < min(_moved_share(earlier, later) for earlier in before.points2d_px) < _SOMEBODY_ELSE
        for later in after.points2d_px
    )


def _moved_share(before_px: Float[np.ndarray, "joint 2"], after_px: Float[np.ndarray, "joint 2"]) -> float:
    """How far joints have moved, as a share of the size of the body; 0: nothing can be told."""
    known = np.isfinite(before_px).all(axis=1) & np.isfinite(after_px).all(axis=1)
    if known.sum() < _FEWEST_JOINTS:
        return 0.0
    size_px = float(np.linalg.norm(np.ptp(after_px[known], axis=0)))
    moved_px = np.quantile(np.linalg.norm(after_px[known] - before_px[known], axis=1), _QUANTILE)
    return float(moved_px) / size_px if size_px > 0 else 0.0
