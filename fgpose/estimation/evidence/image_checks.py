"""Images whose detections are not of the person at their moment: they repeat the image before, or the detector has gone
over to somebody else.

Detections that are those of the image before, to the last digit, come from an image that came again, or from a tracker
that holds what it has lost. They tell where a joint was, and look like the best of all.

Somebody else's body fits bones as well, and two cameras that follow it agree as well. But nobody gets there between two
images. So a view in which the whole body jumps is left out while it is far from where the others have the person.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

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
_FRAMES_AT_ONCE = 1000


def checked(observations: Observations, rig: CameraRig) -> Observations:
    """A recording without detections that are not of the person at their moment."""
    points_px = observations.points2d_px
    repeated = np.zeros(observations.confidence.shape, dtype=bool)
    repeated[1:] = _repeated(points_px[1:], points_px[:-1], np.zeros(observations.n_cameras, dtype=bool))[0]
    new = observations.without(repeated)
    return new.without(np.broadcast_to(views_gone_over(new, rig)[..., None], repeated.shape))


class RunningImageChecks:
    """The same, image by image.

    Args:
        rig: the cameras.
        n_joints: of the person.
    """

    def __init__(self, rig: CameraRig, n_joints: int) -> None:
        shape = rig.n_cameras, n_joints, 2
        self._before_px, self._is_new = np.full((1, *shape), np.nan), np.zeros(rig.n_cameras, dtype=bool)
        self._views = _Views(rig, n_joints)

    def checked(self, images: Observations, known_m: Callable[[], Float[np.ndarray, "joint 3"] | None]) -> Observations:
        """The images, some of all cameras, without detections that are not of the person at their moment.

        Args:
            images: of one frame.
            known_m: where the person is; NaN where that is not known, None: nowhere.
        """
        new = images.without(_repeated(images.points2d_px, self._before_px, self._is_new)[0])
        gone_over = self._views.gone_over(new, known_m)
        return new.without(np.broadcast_to(gone_over[None, :, None], new.confidence.shape))

    def add(self, images: Observations) -> None:
        """Take the images that the next ones come after."""
        came = images.seen[0].any(axis=-1)
        is_new = _repeated(images.points2d_px, self._before_px, self._is_new)[1][0]
        self._is_new = np.where(came, is_new, self._is_new)
        self._before_px = np.where(came[:, None, None], images.points2d_px, self._before_px)
        self._views.add(images)


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


class _Views:
    """In which views the detector has gone over to somebody else."""

    def __init__(self, rig: CameraRig, n_joints: int) -> None:
        self._rig, n_cameras = rig, rig.n_cameras
        self._before_px, self._before_s = np.full((n_cameras, n_joints, 2), np.nan), np.full(n_cameras, -np.inf)
        self._gone_over, self._tell_s = np.zeros(n_cameras, dtype=bool), -np.inf
        self._meets_s = np.full(n_cameras, np.inf)

    def gone_over(
        self, images: Observations, known_m: Callable[[], Float[np.ndarray, "joint 3"] | None]
    ) -> Bool[np.ndarray, " camera"]:
        """In which of these images; arguments as RunningImageChecks.checked."""
        points_px, time_s, shows = images.points2d_px[0], float(images.frame_time_s[0]), images.seen[0].any(axis=-1)
        apart_s = np.maximum(time_s - self._before_s, 0.0)  # images may come late
        jumped = shows & _jumped(points_px, self._before_px) & (apart_s <= _LONGEST_S)
        of_person_m = known_m() if (jumped | (shows & self._gone_over)).any() else None
        if of_person_m is not None:
            off_px = self._rig.project(of_person_m) - self._rig.undistort(points_px)
            off_m = known_medians((np.linalg.norm(off_px, axis=-1) / self._rig.px_per_m(of_person_m))[..., None])[:, 0]
            # So do cameras that have no image now.
            stay = ~self._gone_over & ~jumped & (apart_s <= _LONGEST_S) & ~(off_m >= _BACK_M)
            self._tell_s = time_s if stay.sum() >= _TELL else self._tell_s
            farthest_m = np.where(self._gone_over, _BACK_M, _ERRS_M + _FASTEST_MPS * apart_s)
            meets = shows & self._gone_over & ~jumped & (off_m < _BACK_M)
            self._meets_s = np.where(meets, np.minimum(self._meets_s, time_s), np.inf)
            comes_back = (jumped & (off_m <= farthest_m)) | (time_s - self._meets_s > _LONGEST_S)
            goes = jumped & (off_m > farthest_m) & (stay.sum() >= _TELL)
            self._gone_over = (self._gone_over | goes) & ~comes_back & (time_s - self._tell_s <= _KNOWN_S)
        return self._gone_over

    def add(self, images: Observations) -> None:
        """Take the images that the next ones come after."""
        shows = images.seen[0].any(axis=-1)
        self._before_px = np.where(shows[:, None, None], images.points2d_px[0], self._before_px)
        self._before_s = np.where(shows, images.frame_time_s[0], self._before_s)


def views_gone_over(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera"]:
    """In which images of a recording the detector has gone over to somebody else."""
    found = np.zeros(observations.confidence.shape[:2], dtype=bool)
    if not _any_jump(observations):
        return found
    views, latest = _Views(rig, observations.skeleton.n_joints), observations.frames(slice(0, 1))
    for frame, images in enumerate(observations):
        found[frame] = views.gone_over(images, lambda latest=latest: _triangulated_m(latest, rig))
        views.add(images)
        of_person = images.without(np.broadcast_to(found[frame][None, :, None], images.confidence.shape))
        if of_person.seen.any(axis=-1).sum() >= 2:
            latest = of_person
    return found


def _triangulated_m(frame: Observations, rig: CameraRig) -> Float[np.ndarray, "joint 3"]:
    return triangulate_robust(rig.undistort(frame.points2d_px), frame.confidence.astype(float), rig).positions_m[0]


def _any_jump(observations: Observations) -> bool:
    """Whether the whole body jumps in any view."""
    points_px, shows = observations.points2d_px, np.asarray(observations.seen.any(axis=-1))
    latest = np.maximum.accumulate(np.where(shows, np.arange(len(shows))[:, None], 0), axis=0)
    for part in parts_of(observations.n_frames - 1, _FRAMES_AT_ONCE):
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
