"""Detections near a link that are nobody's: somebody may be there whom one camera alone shows.

A detection is a body on rays. Where along them it is, its size tells: the bones of a body are of a known length, and
look shorter where they point at the camera. Who is far behind the link, or right in front of the camera, is not near.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.kinematics.proportions import shares_of_stature
from fgpose.live.frame import LiveFrame
from fgpose.people_observations import Detections
from fgpose.robot.cell import Limits
from fgpose.robot.clearance import Axes, Shapes, clearance
from fgpose.skeleton import Skeleton

_STATURE_M = 1.7
# Of its usual length a bone looks at least so long that does not point at the camera, also a child's; and at most so
# long the one in the middle of all, also a tall man's with errors of the detector. A wrong bone that looks too long,
# and many that point at the camera, make the part of the ray longer.
_LOOKS = 0.35, 1.5
_FEWEST_BONES = 5
_FAR_M = 30.0
# A detector misses somebody for a moment.
_MISSED_S = 0.3


@dataclass(frozen=True)
class _Shown:
    """Something that is nobody's near a link, by the times of its images."""

    since_s: float
    until_s: float
    cameras: tuple[str, ...]
    """That showed it last."""


class Nobodys:
    """Follows them, by link: one camera after the other may show somebody.

    Args:
        rig: whose images they are in.
        skeleton: of the joints.
        limits: how near and how long is a fault.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, limits: Limits) -> None:
        self._rig, self._limits = rig, limits
        self._bones = np.array(skeleton.bones)
        self._usual_m = _STATURE_M * shares_of_stature(skeleton)[np.array(skeleton.length_of_bone)]
        self._shown: dict[int, _Shown] = {}

    def near(
        self, frame: LiveFrame, ok: Collection[str], shapes: Shapes, links: Int[np.ndarray, " shape"]
    ) -> list[str]:
        """Of each link, what is nobody's and has been near it for too long, in words; empty: nothing.

        Args:
            frame: the newest.
            ok: names of the cameras that can be trusted.
            shapes: of the links.
            links: of each shape the number of its link.
        """
        images = [image for image in frame.nobodys if image.camera in ok and image.n_people]
        distances_m = [self._distances_m(image, shapes) for image in images]
        said, before, self._shown = [], self._shown, {}
        for link in range(int(links.max()) + 1):
            showing = [
                image
                for image, distance_m in zip(images, distances_m, strict=True)
                if distance_m[links == link].min() < self._limits.surroundings_m
            ]
            shown = before.get(link)
            if showing:
                until_s = max(image.time_s for image in showing)
                cameras = tuple(image.camera for image in showing)
                shown = _Shown(until_s if shown is None else shown.since_s, until_s, cameras)
            if shown is not None and frame.time_s <= shown.until_s + _MISSED_S:
                self._shown[link] = shown
            said.append(self._said(self._shown.get(link)))
        return said

    def _said(self, shown: _Shown | None) -> str:
        if shown is None or (lasts_s := shown.until_s - shown.since_s) < self._limits.nobodys_s:
            return ""
        return f"{', '.join(shown.cameras)}: somebody near it for {lasts_s:.1f} s who is none of the people"

    def _distances_m(self, image: Detections, shapes: Shapes) -> Float[np.ndarray, " shape"]:
        """Of each shape from the rays of all joints, as far along them as a body can be."""
        camera = self._rig[image.camera]
        points_px = camera.undistort(image.points2d_px)
        ends_m = np.concatenate([self._ends_m(camera, each) for each in points_px])
        n = len(ends_m)
        nothing = np.zeros((n, 2, 2, 3, 3)), np.zeros(n), np.zeros(n, dtype=bool)
        expected_m = clearance(Axes(ends_m, *nothing), shapes, self._limits.quantile).expected_m
        return expected_m.min(axis=0, initial=np.inf)

    def _ends_m(self, camera: Camera, points_px: Float[np.ndarray, "joint 2"]) -> Float[np.ndarray, "seen end=2 3"]:
        """Of each joint that is detected, the part of its ray where a body of this size can be, in the world frame."""
        at_1m = (points_px - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        start, end = self._bones.T
        looks = np.linalg.norm(at_1m[start] - at_1m[end], axis=-1) / self._usual_m
        looks = looks[np.isfinite(looks)]
        depths_m = np.array([0.0, _FAR_M])
        if len(looks) >= _FEWEST_BONES and np.median(looks) > 0:
            depths_m = np.minimum(_LOOKS / np.array([looks.max(), np.median(looks)]), _FAR_M)
        seen = at_1m[np.isfinite(at_1m).all(axis=-1)]
        in_camera_m = np.concatenate([seen, np.ones((len(seen), 1))], axis=1)[:, None] * depths_m[:, None]
        return camera.to_world_frame(in_camera_m)
