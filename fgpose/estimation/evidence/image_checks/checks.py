"""Images whose detections are not of the person at their moment: they repeat the image before, or the detector has gone
over to somebody else.

Detections that are those of the image before, to the last digit, come from an image that came again, or from a tracker
that holds what it has lost. They tell where a joint was, and look like the best of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.image_checks.flips import correct_flips
from fgpose.estimation.evidence.image_checks.followed import FollowedViews, views_gone_over
from fgpose.estimation.evidence.image_checks.on_other_side import RunningOtherSide, on_other_side
from fgpose.estimation.evidence.image_checks.running_flips import RunningFlips
from fgpose.estimation.evidence.image_checks.sides import limb_joints, limbs_of, with_sides_exchanged
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations, blanked
from fgpose.skeleton import Skeleton

# On such a grid joints that stand still come again by chance. Networks give more digits.
_GRID_PX = 0.25
_MOST = 0.5  # of the detections of an image that is new


def checked(observations: Observations, rig: CameraRig) -> tuple[Observations, Bool[np.ndarray, "frame camera joint"]]:
    """A recording without detections that are not of the person at their moment, with left and right of all views as
    they should be; and which detections were exchanged."""
    points_px = observations.points2d_px
    repeated = np.zeros(observations.confidence.shape, dtype=bool)
    repeated[1:] = _repeated(points_px[1:], points_px[:-1], np.zeros(observations.n_cameras, dtype=bool))[0]
    new = observations.without(repeated)
    corrected, flipped = correct_flips(new, rig)
    corrected = corrected.without(on_other_side(corrected, rig))
    return without_views(corrected, views_gone_over(corrected, rig)), flipped


@dataclass(frozen=True, eq=False)
class ImageChecks:
    """The same, image by image: what the next images are compared with."""

    before_px: Float[np.ndarray, "camera joint 2"]
    """The last image of each camera that showed anything."""
    is_new: Bool[np.ndarray, " camera"]
    """Whether that was another one than before it."""
    flips: RunningFlips
    other_side: RunningOtherSide
    followed: FollowedViews
    """By the joints of the body, without hands and face."""

    @staticmethod
    def none(n_cameras: int, skeleton: Skeleton) -> ImageChecks:
        """Before the first image."""
        before_px = np.full((n_cameras, skeleton.n_joints, 2), np.nan)
        sides = RunningFlips.none(n_cameras, skeleton), RunningOtherSide.none(n_cameras, skeleton)
        followed = FollowedViews.none(n_cameras, len(skeleton.body))
        return ImageChecks(before_px, np.zeros(n_cameras, dtype=bool), *sides, followed)

    def checked(
        self, images: Observations, expected_m: Callable[[float], Float[np.ndarray, "joint 3"]], rig: CameraRig
    ) -> tuple[Observations, ImageChecks]:
        """The images, some of all cameras, as checked gives them; and what those after them are compared with.

        Args:
            images: of one frame.
            expected_m: where the joints of the body are expected at a time in seconds; NaN where that is not known.
            rig: the cameras.
        """
        repeated, is_new = _repeated(images.points2d_px, self.before_px[None], self.is_new)
        new, time_s, body = images.without(repeated), float(images.frame_time_s[0]), list(images.skeleton.body)
        of_body_m, of_all_m = expected_m(time_s), np.full((images.skeleton.n_joints, 3), np.nan)
        of_all_m[body] = of_body_m
        undistorted_px = _undistorted_px(new, rig)
        of_limbs = limbs_of(undistorted_px, new)
        flipped, flips = self.flips.after(new, of_limbs, of_all_m, rig)
        if flipped.any():
            new = with_sides_exchanged(new, flipped[None])
            undistorted_px = _undistorted_px(new, rig)
            of_limbs = limbs_of(undistorted_px, new)
        on_other, other_side = self.other_side.after(new, of_limbs, of_all_m, rig)
        new = new.without(on_other[None])
        of_body_px = blanked(undistorted_px[0], on_other)[:, body]
        confidence = new.confidence[0][:, body].astype(float)
        followed = self.followed.after(of_body_px, confidence, time_s, of_body_m, rig)
        shows = images.seen[0].any(axis=-1)
        before_px = np.where(shows[:, None, None], images.points2d_px[0], self.before_px)
        after = ImageChecks(before_px, is_new[0], flips, other_side, followed)
        return without_views(new, followed.gone_over[None]), after


def _undistorted_px(images: Observations, rig: CameraRig) -> Float[np.ndarray, "frame camera joint 2"]:
    """Of the joints that are looked at; NaN for hands and face."""
    joints = sorted({*images.skeleton.body, *limb_joints(images.skeleton).ravel().tolist()})
    undistorted_px = np.full(images.points2d_px.shape, np.nan)
    undistorted_px[:, :, joints] = rig.undistort(images.points2d_px[:, :, joints])
    return undistorted_px


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


def without_views(observations: Observations, views: Bool[np.ndarray, "frame camera"]) -> Observations:
    """Without all that these views detect."""
    return observations.without(np.broadcast_to(views[..., None], observations.confidence.shape))
