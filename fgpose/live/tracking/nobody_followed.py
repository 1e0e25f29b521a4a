"""Cameras that show people, but none of those whom the others see before them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgpose.association.track import Tracked, TrackState
from fgpose.finding import Code
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.field_of_view import in_views
from fgpose.people_observations import Detections

# Who is hidden while a reflection is seen is back by then; and so many images.
_LASTS_S, _FEWEST_IMAGES = 8.0, 20
_NOW_S = 0.5  # a slow camera has an image of somebody now
_FEWEST_JOINTS = 6  # of somebody who is seen
_BEFORE_IT = 0.8  # of the joints of somebody lie in the image, this share of its sides from its edges
_MARGIN = 0.05
_REASON = (
    "it shows people, but nobody of those whom two others see before it: are its keypoints those of another camera, or "
    f"was it moved? [{Code.OTHER_PERSON}]"
)


class NobodyFollowed:
    """Follows which cameras the tracker finds people in. What was said stays until it finds somebody again.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._found_s = dict.fromkeys(rig.names, -np.inf)
        self._in_vain: dict[str, tuple[float, int]] = {}
        """By camera: since when, and in how many images."""

    @property
    def faults(self) -> dict[str, str]:
        """By camera, in words."""
        return {
            camera: _REASON
            for camera, (since_s, n_images) in self._in_vain.items()
            if n_images >= _FEWEST_IMAGES and self._found_s_of_others(camera) - since_s > _LASTS_S
        }

    def add(self, images: Sequence[Detections], people: Sequence[Tracked]) -> None:
        """The newest images, and who is in them."""
        found = {camera for person in people for camera in person.seen}
        for image in images:
            if image.camera in found:
                self._found_s[image.camera] = image.time_s
                self._in_vain.pop(image.camera, None)
        for image in images:
            if image.camera not in found and _shows_somebody(image) and self._should_see(image, people):
                since_s, n_images = self._in_vain.get(image.camera, (image.time_s, 0))
                self._in_vain[image.camera] = since_s, n_images + 1

    def _found_s_of_others(self, camera: str) -> float:
        """When two others saw somebody last."""
        return sorted((at_s for other, at_s in self._found_s.items() if other != camera), reverse=True)[1]

    def _should_see(self, image: Detections, people: Sequence[Tracked]) -> bool:
        if self._rig.n_cameras < 3 or image.time_s - self._found_s_of_others(image.camera) > _NOW_S:
            return False
        view = self._rig.subset([image.camera])
        return any(
            in_views(view, person.estimate.positions_m, _MARGIN).mean() > _BEFORE_IT
            for person in people
            if person.state is TrackState.CONFIRMED
        )


def _shows_somebody(image: Detections) -> bool:
    return bool(image.n_people and np.isfinite(image.points2d_px).all(axis=-1).sum(axis=-1).max() >= _FEWEST_JOINTS)
