"""Images whose detections are not of the person at their moment: they repeat the image before, or the detector has gone
over to somebody else.

Detections that are those of the image before, to the last digit, come from an image that came again, or from a tracker
that holds what it has lost. They tell where a joint was, and look like the best of all.

Somebody else's body fits bones as well, and two cameras that follow it agree as well. But nobody gets there between two
images. So a view in which the whole body jumps is left out while it is far from where the others have the person.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.gather import FRAMES_AT_ONCE
from fgpose.estimation.evidence.plausibility import known_medians
from fgpose.estimation.evidence.presence import MIN_JOINTS
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.observations import Observations
from fgpose.sampling import parts_of

# On such a grid joints that stand still come again by chance. Networks give more digits.
_GRID_PX = 0.25
_MOST = 0.5  # of the detections of an image that is new
# Of the size of the body in the image: less is no jump. A view goes over to somebody else if nobody is so fast, until
# it jumps back, or the two have been in one place of it for long; detections err.
_JUMP, _FASTEST_MPS, _ERRS_M, _BACK_M = 0.2, 12.0, 0.2, 0.3
_LONGEST_S = 0.5  # between images, and in one place
_TELL, _KNOWN_S = 2, 1.0  # so many cameras tell where somebody is, and for so long it is known


def checked(observations: Observations, rig: CameraRig) -> Observations:
    """A recording without detections that are not of the person at their moment."""
    points_px = observations.points2d_px
    repeated = np.zeros(observations.confidence.shape, dtype=bool)
    repeated[1:] = _repeated(points_px[1:], points_px[:-1], np.zeros(observations.n_cameras, dtype=bool))[0]
    new = observations.without(repeated)
    return _without_views(new, views_gone_over(new, rig))


@dataclass(frozen=True, eq=False)
class ImageChecks:
    """The same, image by image: what the next images are compared with."""

    before_px: Float[np.ndarray, "camera joint 2"]
    """The last image of each camera that showed anything, and when it was taken."""
    before_s: Float[np.ndarray, " camera"]
    is_new: Bool[np.ndarray, " camera"]
    """Whether that was another one than before it."""
    gone_over: Bool[np.ndarray, " camera"]
    """In which views the detector has gone over to somebody else."""
    meets_s: Float[np.ndarray, " camera"]
    """Since when somebody else and the person are in one place of such a view; inf: they are not."""
    tell_s: float
    """When enough cameras told where the person is."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> ImageChecks:
        """Before the first image."""
        never_s, (is_new, gone_over) = np.full(n_cameras, -np.inf), np.zeros((2, n_cameras), dtype=bool)
        return ImageChecks(np.full((n_cameras, n_joints, 2), np.nan), never_s, is_new, gone_over, -never_s, -np.inf)

    def checked(
        self, images: Observations, known_m: Callable[[], Float[np.ndarray, "joint 3"] | None], rig: CameraRig
    ) -> tuple[Observations, ImageChecks]:
        """The images, some of all cameras, without detections that are not of the person at their moment; and what
        those after them are compared with.

        Args:
            images: of one frame.
            known_m: where the person is; NaN where that is not known, None: nowhere.
            rig: the cameras.
        """
        repeated, is_new = _repeated(images.points2d_px, self.before_px[None], self.is_new)
        new = images.without(repeated)
        judged = self._judged(new, known_m, rig)
        return _without_views(new, judged.gone_over[None]), replace(judged._after(images), is_new=is_new[0])

    def _judged(
        self, images: Observations, known_m: Callable[[], Float[np.ndarray, "joint 3"] | None], rig: CameraRig
    ) -> ImageChecks:
        """With the views that have gone over by these images."""
        points_px, time_s, shows = images.points2d_px[0], float(images.frame_time_s[0]), images.seen[0].any(axis=-1)
        apart_s = np.maximum(time_s - self.before_s, 0.0)  # images may come late
        jumped = shows & _jumped(points_px, self.before_px) & (apart_s <= _LONGEST_S)
        of_person_m = known_m() if (jumped | (shows & self.gone_over)).any() else None
        if of_person_m is None:
            return self
        off_px = rig.project(of_person_m) - rig.undistort(points_px)
        off_m = known_medians((np.linalg.norm(off_px, axis=-1) / rig.px_per_m(of_person_m))[..., None])[:, 0]
        # Cameras that have no image now stay too.
        stay = ~self.gone_over & ~jumped & (apart_s <= _LONGEST_S) & ~(off_m >= _BACK_M)
        tell_s = time_s if stay.sum() >= _TELL else self.tell_s
        farthest_m = np.where(self.gone_over, _BACK_M, _ERRS_M + _FASTEST_MPS * apart_s)
        meets = shows & self.gone_over & ~jumped & (off_m < _BACK_M)
        meets_s = np.where(meets, np.minimum(self.meets_s, time_s), np.inf)
        comes_back = (jumped & (off_m <= farthest_m)) | (time_s - meets_s > _LONGEST_S)
        goes = jumped & (off_m > farthest_m) & (stay.sum() >= _TELL)
        gone_over = (self.gone_over | goes) & ~comes_back & (time_s - tell_s <= _KNOWN_S)
        return replace(self, gone_over=gone_over, meets_s=meets_s, tell_s=tell_s)

    def _after(self, images: Observations) -> ImageChecks:
        """With these images as the last ones."""
        shows = images.seen[0].any(axis=-1)
        return replace(
            self,
            before_px=np.where(shows[:, None, None], images.points2d_px[0], self.before_px),
            before_s=np.where(shows, images.frame_time_s[0], self.before_s),
        )


def _repeated(
    points_px: Float[np.ndarray, "frame camera joint 2"],
    before_px: Float[np.ndarray, "frame camera joint 2"],
    was_new: Bool[np.ndarray, " camera"],
) -> tuple[Bool[np.ndarray, "frame camera joint"], Bool[np.ndarray, "frame camera"]]:
    """Which detections come again, and which images are new. None comes again where nothing else in the frame moves, as
    where detections have no noise and somebody stands still.

    Args:
        points_px: detections.
        before_px: those of the image before.
        was_new: for each camera that has no image in a frame, whether its last one was new.
    """
    same = np.asarray((points_px == before_px).all(axis=-1))
    n_seen = np.isfinite(points_px).all(axis=-1).sum(axis=-1)
    is_new = np.where(n_seen > 0, same.sum(axis=-1) < _MOST * n_seen, was_new)
    same &= np.asarray(is_new.any(axis=-1))[:, None, None]
    in_grid = points_px[same] / _GRID_PX
    same[same] = (in_grid != np.round(in_grid)).any(axis=-1)
    return same, is_new


def _without_views(observations: Observations, views: Bool[np.ndarray, "frame camera"]) -> Observations:
    return observations.without(np.broadcast_to(views[..., None], observations.confidence.shape))


def views_gone_over(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera"]:
    """In which images of a recording the detector has gone over to somebody else."""
    found = np.zeros(observations.confidence.shape[:2], dtype=bool)
    if not _any_jump(observations):
        return found
    checks = ImageChecks.none(observations.n_cameras, observations.skeleton.n_joints)
    latest = observations.frames(slice(0, 1))
    for frame, images in enumerate(observations):
        checks = checks._judged(images, lambda latest=latest: _triangulated_m(latest, rig), rig)._after(images)
        found[frame] = checks.gone_over
        of_person = _without_views(images, found[frame][None])
        if of_person.seen.any(axis=-1).sum() >= 2:
            latest = of_person
    return found


def _triangulated_m(frame: Observations, rig: CameraRig) -> Float[np.ndarray, "joint 3"]:
    return triangulate_robust(rig.undistort(frame.points2d_px), frame.confidence.astype(float), rig).positions_m[0]


def _any_jump(observations: Observations) -> bool:
    """Whether the whole body jumps in any view."""
    points_px, shows = observations.points2d_px, np.asarray(observations.seen.any(axis=-1))
    latest = np.maximum.accumulate(np.where(shows, np.arange(len(shows))[:, None], 0), axis=0)
    for part in parts_of(observations.n_frames - 1, FRAMES_AT_ONCE):
        before_px = points_px[latest[part], np.arange(observations.n_cameras)]
        if _jumped(points_px[part.start + 1 : part.stop + 1], before_px).any():
            return True
    return False


def _jumped(
    points_px: Float[np.ndarray, "*shape joint 2"], before_px: Float[np.ndarray, "*shape joint 2"]
) -> Bool[np.ndarray, "*shape"]:
    """In which views the whole body is elsewhere than in the image before."""
    known, moved_px = np.isfinite(points_px), np.linalg.norm(points_px - before_px, axis=-1)
    of_views_px = moved_px.reshape(-1, moved_px.shape[-1], 1)
    median_px = known_medians(of_views_px).reshape(moved_px.shape[:-1])
    ends_px = (np.max(points_px, -2, where=known, initial=-np.inf), np.min(points_px, -2, where=known, initial=np.inf))
    size_px = (ends_px[0] - ends_px[1]).max(axis=-1)
    return np.asarray((np.isfinite(moved_px).sum(axis=-1) >= MIN_JOINTS) & (median_px > _JUMP * size_px))
