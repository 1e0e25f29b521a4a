"""Whom cameras should detect: not people outside of their images, and less often those behind others.

Some show nobody, whoever is there: something stands before them, or their detector does not work. A camera with an
image that does not show somebody tells against that anybody is there, as long as it can be believed to see. Whether it
does is decided as whether somebody is there: each time that two cameras agree on a body in its image tells, by whether
it shows the body too.

A camera that hangs shows people where they were: images that come again tell nothing while other cameras show something
new.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from fgpose.association.pose_filter import PoseFilters
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections

# A camera that should see a person detects them so often; less often where somebody before them may hide them.
_DETECTED, _DETECTED_BEHIND = 0.9, 0.5
_HIDES_M = 0.4  # somebody whose middle is nearer than this to the line of sight
# A camera in fifty shows nobody, before anything is known; it then has as few false detections at a place.
_BLIND = 0.02
# Nobody is so certain that some seconds would not count.
_LOW, _HIGH = 2 * np.log(_BLIND), -np.log(_BLIND)
# Images within this time tell once: a detector misses somebody for about so long.
_MISSED_S = 0.3
# Of an image that may be that before it; numbers of networks have more digits than such a grid.
_FEWEST_JOINTS, _GRID_PX = 5, 0.25
# Bounds what one image tells where a camera is asked for the first time.
_FIRST_S = 0.1


def repeats(image: Detections, before: Detections) -> bool:
    """Whether an image shows exactly whom the one before of its camera shows, in any order, to the last digit: networks
    give the same numbers only for the same image. On a coarse grid who stands still is found at the same place."""
    known = image.confidence > 0
    people, people_before = ([row.tobytes() for row in each.points2d_px] for each in (image, before))
    if known.sum() < _FEWEST_JOINTS or sorted(people) != sorted(people_before):
        return False
    in_grid = image.points2d_px[known] / _GRID_PX
    return bool((in_grid != np.round(in_grid)).any(axis=-1).all())


class FrozenCameras:
    """Which of the cameras show the same again."""

    def __init__(self) -> None:
        self._newest: dict[str, Detections] = {}
        self._shows_new: dict[str, bool] = {}

    def without(self, images: Sequence[Detections]) -> list[Detections]:
        """The images of a moment that are not what their camera showed before."""
        repeated = set()
        for image in images:
            before = self._newest.get(image.camera)
            if before is not None and repeats(image, before):
                repeated.add(image.camera)
            self._newest[image.camera] = image
            self._shows_new[image.camera] = image.camera not in repeated and image.n_people > 0
        if not any(self._shows_new.values()):
            return list(images)
        return [image for image in images if image.camera not in repeated]


class Blind:
    """Which of the cameras are blind, from what they have shown so far."""

    def __init__(self, camera_names: Sequence[str]) -> None:
        self._log_odds = dict.fromkeys(camera_names, float(np.log(_BLIND / (1 - _BLIND))))
        self._told_s = dict.fromkeys(camera_names, -np.inf)
        self._shows = dict.fromkeys(camera_names, True)

    def sees(self, camera_names: Sequence[str]) -> Float[np.ndarray, " camera"]:
        """Probability that each of these is not blind."""
        return 1 / (1 + np.exp(np.array([self._log_odds[name] for name in camera_names])))

    def log_missed(
        self, camera_names: Sequence[str], probability: Float[np.ndarray, "body camera"], n_people: int
    ) -> Float[np.ndarray, "body camera"]:
        """Log probability that an image of each of these does not show a body that is there. Where no camera shows any
        of several people, all detectors have stopped, or what feeds them, rather than that all have left at once.

        Args:
            camera_names: of the images.
            probability: as for learn.
            n_people: how many are followed.
        """
        if n_people > 1 and not any(self._shows.values()):
            return np.zeros_like(probability)
        return np.asarray(np.log1p(-self.sees(camera_names) * probability))

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
        hit = np.asarray(shown.any(axis=0))
        self._shows |= dict(zip(camera_names, hit.tolist(), strict=True))
        if not hit.any():
            return
        # Of several bodies one tells, for a camera that misses one of them is not blind if it shows another.
        agreed = shown.sum(axis=1) >= 2
        missed = np.where((agreed[:, None] & ~shown), probability, 0.0).max(axis=0)
        for name, time_s, is_hit, share in zip(camera_names, times_s.tolist(), hit, missed.tolist(), strict=True):
            if not is_hit and not share:
                continue
            since_s = min(max(time_s - self._told_s[name], 0.0), _MISSED_S)
            since_s = _FIRST_S if np.isinf(self._told_s[name]) else since_s
            tells = np.log(_BLIND / 0.9) if is_hit else -np.log1p(-share)
            odds = self._log_odds[name] + tells * since_s / _MISSED_S
            self._log_odds[name], self._told_s[name] = float(np.clip(odds, _LOW, _HIGH)), time_s


def detection_probability(
    people: PoseFilters, others: PoseFilters | None, cameras: CameraRig
) -> Float[np.ndarray, "person camera"]:
    """How probable it is that each camera detects each person: not outside its image, less often behind others."""
    pixels = cameras.project(people.positions_m)
    size_px = np.array([camera.size_px for camera in cameras.cameras])[:, None]
    share_inside = ((pixels >= 0) & (pixels < size_px)).all(axis=-1).mean(axis=-1)
    hidden = _behind(people, others, cameras) if others is not None else np.zeros(share_inside.shape, dtype=bool)
    return share_inside * np.where(hidden, _DETECTED_BEHIND, _DETECTED)


def _behind(people: PoseFilters, others: PoseFilters, cameras: CameraRig) -> Bool[np.ndarray, "person camera"]:
    """Whether somebody nearer to the camera is in the way."""
    eye_m = cameras.positions_m
    to_person_m, to_other_m = (each.positions_m.mean(axis=1)[:, None] - eye_m for each in (people, others))
    distance_m = np.linalg.norm(to_person_m, axis=-1)
    along_m = np.einsum("kci,oci->koc", to_person_m / distance_m[..., None], to_other_m)
    aside2_m2 = np.sum(to_other_m**2, axis=-1) - along_m**2
    in_the_way = (aside2_m2 < _HIDES_M**2) & (along_m > 0) & (along_m < distance_m[:, None] - _HIDES_M)
    return np.asarray(in_the_way.any(axis=1))
