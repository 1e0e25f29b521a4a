"""Which views still follow the person, and in which the detector has gone over to somebody else.

Somebody else's body fits bones as well, and two views that follow it agree as well. But a view that goes over breaks
off: its whole body leaves the line on which it moved, by more than a person who turns. From then on it is suspect, and
the others tell where the person is, until it has been with the person for a while. A view whose whole body leaves the
person has gone over, until it comes back.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.evidence.gather import FRAMES_AT_ONCE
from fgpose.estimation.evidence.image_checks.moving_body import MovingBody
from fgpose.estimation.evidence.image_checks.recent_images import RECENT_S, RecentImages
from fgpose.estimation.evidence.plausibility import known_medians
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import parallax_rad, triangulate_robust
from fgpose.geometry.vectors import norm
from fgpose.observations import Observations
from fgpose.sampling import parts_of

# Two bodies in one place of an image are farther apart than a network errs, and than a body usually leaves its line,
# which is farther at low rates. Of 3 to 8 times as far, 4 to 6 find the same.
_BREAK_M, _TIMES_USUAL, _USUAL_S = 0.04, 5.0, 1.0
_OFF_M, _AWAY_M = 0.1, 0.2  # detections err by less; and two people are farther apart
# Of the joints: where most are off, a view is; where nearly all are, it is not hallucinated joints.
_OFF, _NEARLY_ALL = 0.5, 0.85
_FASTEST_MPS = 12.0  # nobody is so fast
_MEET_S = 0.5  # people who meet in an image have passed each other
_TELL, _KNOWN_S = 2, 1.0  # so many views tell where somebody is, and for so long it is known
_APART_RAD = np.deg2rad(8.11)  # between rays that tell how far away somebody is


@dataclass(frozen=True, eq=False)
class FollowedViews:
    """What the next images are compared with."""

    gone_over: Bool[np.ndarray, " camera"]
    """In which views the detector has gone over to somebody else."""
    is_off: Bool[np.ndarray, " camera"]
    """In which the last body was not where the person was."""
    since_s: Float[np.ndarray, " camera"]
    """Since when that is so or not; NaN: the view never was with the person, in whom most views agreed."""
    suspect_s: Float[np.ndarray, " camera"]
    """When the view broke off, or was off thereafter."""
    usual_m: Float[np.ndarray, " camera"]
    """How far the body usually leaves its line from image to image."""
    told_s: float
    """When enough views told where the person was."""
    recent: RecentImages
    body: MovingBody
    """The person."""

    @staticmethod
    def none(n_cameras: int, n_joints: int) -> FollowedViews:
        """Before the first image."""
        off, zero = np.ones(n_cameras, dtype=bool), np.zeros(n_cameras)
        recent, body = RecentImages.none(n_cameras, n_joints), MovingBody.nowhere(n_joints)
        return FollowedViews(~off, off, zero + np.nan, zero - np.inf, zero, -np.inf, recent, body)

    def after(
        self,
        points_px: Float[np.ndarray, "camera joint 2"],
        confidence: Float[np.ndarray, "camera joint"],
        time_s: float,
        known_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> FollowedViews:
        """With the next images.

        Args:
            points_px: undistorted; NaN where nothing is detected.
            confidence: of the detections.
            time_s: when the images were taken.
            known_m: where the person is by all views, or was expected; world frame, NaN where that is not known.
            rig: the cameras.
        """
        if np.isfinite(self.body.time_s) and time_s - self.body.time_s > _KNOWN_S:
            return self._anew().after(points_px, confidence, time_s, known_m, rig)
        shows = _any_joint(points_px)
        follows = ~self.gone_over & (np.where(shows, time_s, self.recent.newest_s) >= time_s - RECENT_S)
        line_px = self.recent.expected_px(time_s)
        breaks, usual_m = self._breaks(points_px, line_px, time_s, known_m, rig)
        # Where most views leave their lines, the person does, unless nobody could get there.
        if 2 * np.count_nonzero(breaks & follows) > np.count_nonzero(follows):
            if self._is_too_far(known_m, time_s):
                return self._anew().after(points_px, confidence, time_s, known_m, rig)
            breaks[:] = False
        unseen_s = time_s - self.recent.newest_s
        breaks |= shows & (unseen_s > RECENT_S) & np.isfinite(unseen_s)
        suspect_s = np.where(breaks, time_s, self.suspect_s)
        trusted = follows & (time_s - suspect_s > _MEET_S)
        is_tie = np.count_nonzero(trusted) < _TELL
        if is_tie:
            trusted = follows
        if (follows & ~trusted).any() or (self.gone_over & shows).any():
            known_m = triangulate_robust(points_px, confidence, rig).positions_m
            # Whom most views show together, with those among them that had gone over, is the person.
            if not _is_majority(points_px, known_m, shows, rig, _OFF if is_tie else 1 - _NEARLY_ALL):
                now_px = np.where(shows[:, None, None], points_px, line_px)
                known_m = self._located_m(np.where(trusted[:, None, None], now_px, np.nan), time_s, rig)
        body = self.body.seen(known_m, time_s)
        share_off, away_m = _away(points_px, body.at(time_s), rig)
        is_off = np.where(np.isnan(share_off), self.is_off, share_off > _OFF)
        are_together = 2 * np.count_nonzero(is_off & shows) < np.count_nonzero(shows)
        changes = np.where(np.isnan(self.since_s), ~is_off & are_together, is_off != self.is_off)
        since_s = np.where(changes, time_s, self.since_s)
        suspect_s = np.where(is_off & (time_s - suspect_s <= _MEET_S), time_s, suspect_s)

        elsewhere = (share_off >= _NEARLY_ALL) & (away_m > _AWAY_M)
        goes = follows & elsewhere & np.isfinite(since_s) & (body.time_s == time_s)
        n_stay = np.count_nonzero(trusted & ~goes & ~(is_off & shows))
        told_s = time_s if n_stay >= _TELL else self.told_s
        goes &= n_stay >= max(_TELL, np.count_nonzero(goes | (self.gone_over & shows)) + is_tie)
        is_with = share_off <= 1 - _NEARLY_ALL  # who passes is not where nearly all joints are
        comes_back = shows & ~is_off & (breaks | is_with | (time_s - since_s >= _MEET_S))
        gone_over = (self.gone_over | goes) & ~comes_back & (time_s - told_s <= _KNOWN_S)
        recent = self.recent.plus(points_px, shows, time_s)
        return FollowedViews(gone_over, is_off, since_s, suspect_s, usual_m, told_s, recent, body)

    def _anew(self) -> FollowedViews:
        return self.none(len(self.gone_over), len(self.body.positions_m))

    def _breaks(
        self,
        points_px: Float[np.ndarray, "camera joint 2"],
        line_px: Float[np.ndarray, "camera joint 2"],
        time_s: float,
        known_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> tuple[Bool[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
        """In which views the whole body leaves its line, and how far it usually leaves it."""
        known_m = np.where(np.isnan(known_m), self.body.at(time_s), known_m)
        left_m = known_medians((points_px - line_px) / rig.px_per_m(known_m)[..., None])
        break_m = norm(left_m)
        breaks = break_m > np.maximum(_BREAK_M, _TIMES_USUAL * self.usual_m)
        passed_s = np.clip(time_s - self.recent.newest_s, 0.0, RECENT_S)
        share = np.where(np.isfinite(break_m), -np.expm1(-passed_s / _USUAL_S), 0.0)
        usual_m = self.usual_m + share * (np.minimum(np.nan_to_num(break_m), _OFF_M) - self.usual_m)
        return breaks, usual_m

    def _located_m(
        self, points_px: Float[np.ndarray, "camera joint 2"], time_s: float, rig: CameraRig
    ) -> Float[np.ndarray, "joint 3"]:
        """Where these views have the person; NaN where they do not tell, contradict each other, or have nobody who
        could get there."""
        is_seen, nowhere_m = np.isfinite(points_px[..., 0]), np.full((points_px.shape[1], 3), np.nan)
        views, n_shared = _any_joint(points_px), np.count_nonzero(np.count_nonzero(is_seen, axis=0) >= _TELL)
        if np.count_nonzero(views) < _TELL:
            return nowhere_m
        located_m = triangulate_robust(points_px, is_seen.astype(float), rig).positions_m
        # Two views agree on some joints of any two bodies, and what they agree on may be far along their rays.
        n_located = np.count_nonzero(np.isfinite(located_m[:, 0]))
        if n_located < max(len(located_m) / 2, _NEARLY_ALL * n_shared):
            return nowhere_m
        apart_rad = parallax_rad(known_medians(located_m[None])[0], views, rig)
        return nowhere_m if apart_rad < _APART_RAD or self._is_too_far(located_m, time_s) else located_m

    def _is_too_far(self, positions_m: Float[np.ndarray, "joint 3"], time_s: float) -> bool:
        """Whether nobody could get there."""
        moved_m = np.linalg.norm(known_medians((positions_m - self.body.at(time_s))[None]))
        return bool(moved_m > _AWAY_M + _FASTEST_MPS * (time_s - self.body.time_s))


def views_gone_over(observations: Observations, rig: CameraRig) -> Bool[np.ndarray, "frame camera"]:
    """In which images of a recording the detector has gone over to somebody else, from where the view left the
    person."""
    time_s, found = observations.frame_time_s, np.zeros((observations.n_frames, observations.n_cameras), dtype=bool)
    before = FollowedViews.none(observations.n_cameras, len(observations.skeleton.body))
    for frame, (points_px, confidence, known_m) in enumerate(_located(observations, rig)):
        views = before.after(points_px, confidence, float(time_s[frame]), known_m, rig)
        found[frame] = views.gone_over
        for camera in np.flatnonzero(views.gone_over & ~before.gone_over):
            found[: frame + 1, camera] |= time_s[: frame + 1] >= views.since_s[camera]
        before = views
    return found


def _located(
    observations: Observations, rig: CameraRig
) -> Iterator[
    tuple[Float[np.ndarray, "camera joint 2"], Float[np.ndarray, "camera joint"], Float[np.ndarray, "joint 3"]]
]:
    """Of each frame the undistorted detections of the body, their confidence, and where all views together have it."""
    body = list(observations.skeleton.body)
    for part in parts_of(observations.n_frames, FRAMES_AT_ONCE):
        points_px = rig.undistort(observations.points2d_px[part][:, :, body])
        confidence = observations.confidence[part][:, :, body].astype(float)
        yield from zip(points_px, confidence, triangulate_robust(points_px, confidence, rig).positions_m, strict=True)


def _away(
    points_px: Float[np.ndarray, "camera joint 2"],
    person_m: Float[np.ndarray, "joint 3"],
    rig: CameraRig,
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """The share of joints that are off where the person has them, in each view, and how far away the whole body is, in
    metres; NaN where that is not known of half of the joints."""
    away_m = (points_px - rig.project(person_m)) / rig.px_per_m(person_m)[..., None]
    joints_m = norm(away_m)
    n_known, n_seen = np.isfinite(joints_m).sum(axis=-1), np.isfinite(points_px[..., 0]).sum(axis=-1)
    n_off = np.where((n_known > 1) & (2 * n_known >= n_seen), (joints_m > _OFF_M).sum(axis=-1), np.nan)
    return n_off / np.maximum(n_known, 1), norm(known_medians(away_m))


def _is_majority(
    points_px: Float[np.ndarray, "camera joint 2"],
    person_m: Float[np.ndarray, "joint 3"],
    shows: Bool[np.ndarray, " camera"],
    rig: CameraRig,
    off: float,
) -> bool:
    """Whether most of the views, and more than any two that meet by chance, show somebody there, with at most this
    share of the joints off."""
    n_there = np.count_nonzero(shows & (_away(points_px, person_m, rig)[0] <= off))
    return bool(n_there > max(_TELL, np.count_nonzero(shows) / 2))


def _any_joint(points_px: Float[np.ndarray, "camera joint 2"]) -> Bool[np.ndarray, " camera"]:
    return np.asarray(np.isfinite(points_px).any(axis=(1, 2)))
