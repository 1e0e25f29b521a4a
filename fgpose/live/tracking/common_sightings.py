"""Where all cameras see somebody at one instant, from images that each camera takes at its own times."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.track import Tracked, TrackState
from fgpose.calibration.disagreement import USUAL_MRAD
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import Detections

# Between two images of a camera joints move straight on; two slow ones apart they do not.
_LONGEST_GAP_S = 0.2
# A camera has images of somebody now, also if it is slow or its times are off by as much as motion may tell.
_NOW_S = 0.4
# Where one camera is behind, older images of the others are of the same instant as its newest.
_REMEMBERED_S = 1.0
# Images whose times differ by less are of one instant: a walker moves 1 mm.
_SAME_S = 1e-3
# A joint that is more probably hallucinated tells nothing of the camera.
_SEEN = 0.5
_ALL_OFF = 0.5


@dataclass(frozen=True, eq=False)
class _Glimpse:
    """Somebody in one image: for every joint the number of the detection (or NOBODY) and of its joint."""

    image: Detections
    detection: Int[np.ndarray, " joint"]
    joint: Int[np.ndarray, " joint"]
    visibility: Float[np.ndarray, " joint"] | None

    def seen(self) -> tuple[Float[np.ndarray, "joint 2"], Float[np.ndarray, " joint"]]:
        """Original pixels and confidence."""
        shown = self.image.of_person(self.detection, self.joint)
        confidence = shown["confidence"]
        if self.visibility is None:
            return shown["points2d_px"], confidence
        hidden = (self.visibility < _SEEN) & (confidence > 0)
        # What nothing hides and is all off is a camera that was moved.
        is_all_off = hidden.sum() > _ALL_OFF * (confidence > 0).sum()
        return shown["points2d_px"], confidence if is_all_off else np.where(hidden, 0.0, confidence)


@dataclass(frozen=True, eq=False)
class CommonSighting:
    """Somebody as all cameras see them at one instant."""

    undistorted_px: Float[np.ndarray, "camera joint 2"]
    confidence: Float[np.ndarray, "camera joint"]
    """0: missing, or the camera has no image near that instant."""
    late_mrad: Float[np.ndarray, " camera"]
    """By how much somebody as fast as this one may be elsewhere in the image because of what is not known of its clock:
    one standard deviation."""
    person: int
    """Their number."""
    instant_s: float
    """By the clock of the cameras, with what is known of their offsets."""

    @property
    def of_known_clocks(self) -> CommonSighting:
        """Without the cameras whose times are not known well enough for how fast somebody moves."""
        is_known = ~(self.late_mrad > USUAL_MRAD)
        return replace(self, confidence=np.where(is_known[:, None], self.confidence, 0.0))


class CommonSightings:
    """Remembers the newest images of everybody in each camera. What is between them is interpolated."""

    def __init__(self, rig: CameraRig) -> None:
        self._rig = rig
        self._glimpses: dict[int, dict[str, deque[_Glimpse]]] = {}
        """By person and camera, in the order of time."""
        self._at: dict[int, tuple[float, np.ndarray]] = {}
        """When and where everybody was when somebody was taken out last."""
        self._turn_s: dict[int, float] = {}
        """When each was taken out last."""
        self._people: tuple[Tracked, ...] = ()
        self._newest_s = -np.inf

    def add(self, images: Sequence[Detections], people: Sequence[Tracked]) -> None:
        """The newest images, and who is in them. Takes some microseconds."""
        self._people = tuple(people)
        self._newest_s = max([self._newest_s, *(image.time_s for image in images)])
        self._glimpses = {person.person: self._glimpses.get(person.person, {}) for person in people}
        for image in images:
            for person in people:
                if image.camera in person.seen:
                    self._see(person, image, *person.seen[image.camera])
        for image in images:
            self._see_unclaimed(image)

    def take(
        self, offsets_s: Float[np.ndarray, " camera"], sigma_s: Float[np.ndarray, " camera"]
    ) -> CommonSighting | None:
        """Of the person whose turn it is, if two cameras or more see them.

        Args:
            offsets_s: how much later than its times say each camera takes its images.
            sigma_s: of these.
        """
        offset_s = dict(zip(self._rig.names, offsets_s.tolist(), strict=True))
        speeds_mps = {person.person: self._speed_mps(person) for person in self._people}
        self._at = {person.person: (person.estimate.time_s, _middle_m(person)) for person in self._people}
        self._turn_s = {number: at_s for number, at_s in self._turn_s.items() if number in self._at}
        for person in sorted(self._people, key=lambda person: self._turn_s.get(person.person, -np.inf)):
            # Clocks that are known do no harm, however fast somebody is.
            late_m = np.where(sigma_s > 0, speeds_mps[person.person] * np.maximum(sigma_s, 1e-9), 0.0)
            sighting = self._at_one_instant(person, offset_s, late_m)
            if (sighting.confidence > 0).any(axis=1).sum() >= 2:
                self._turn_s[person.person] = self._newest_s
                return sighting
        return None

    def _at_one_instant(
        self, person: Tracked, offset_s: dict[str, float], late_m: Float[np.ndarray, " camera"]
    ) -> CommonSighting:
        """Where all cameras see somebody who may be so far from where a camera says because of its clock."""
        glimpses = self._now(person.person)
        instant_s = min((each[-1].image.time_s + offset_s[name] for name, each in glimpses.items()), default=np.nan)
        n_joints = len(person.estimate.positions_m)
        px, confidence = np.full((self._rig.n_cameras, n_joints, 2), np.nan), np.zeros((self._rig.n_cameras, n_joints))
        away_m = np.array([np.linalg.norm(camera.position_m - _middle_m(person)) for camera in self._rig.cameras])
        for c, camera in enumerate(self._rig.cameras):
            if camera.name in glimpses:
                original_px, confidence[c] = _at_time(glimpses[camera.name], instant_s - offset_s[camera.name])
                px[c] = camera.undistort(original_px)
        confidence = np.where(np.isfinite(px).all(axis=-1), confidence, 0.0)
        return CommonSighting(px, confidence, 1e3 * late_m / away_m, person.person, float(instant_s))

    def _see(
        self, person: Tracked, image: Detections, detection: Int[np.ndarray, " joint"], joint: Int[np.ndarray, " joint"]
    ) -> None:
        visibility = person.estimate.visibility
        of_camera = None if visibility is None else visibility[self._rig.names.index(image.camera)]
        kept = self._glimpses[person.person].setdefault(image.camera, deque())
        kept.append(_Glimpse(image, detection, joint, of_camera))
        while kept[0].image.time_s < image.time_s - _REMEMBERED_S:
            kept.popleft()

    def _see_unclaimed(self, image: Detections) -> None:
        """A camera that is far off sees people where the tracker does not take them for the same. Where the others
        follow one who should be there, and one detection is left, it is theirs."""
        followed = [person for person in self._people if self._is_followed(person, image)]
        missing = [person for person in followed if image.camera not in person.seen]
        if len(missing) != 1:
            return
        claimed = [person.seen[image.camera][0] for person in followed if image.camera in person.seen]
        free = set(range(image.n_people)) - set(np.concatenate([[NOBODY], *claimed]).astype(int).tolist())
        if len(free) == 1 and self._is_in_view(missing[0], image.camera):
            n_joints = image.points2d_px.shape[1]
            self._see(missing[0], image, np.full(n_joints, free.pop()), np.arange(n_joints))

    def _is_followed(self, person: Tracked, image: Detections) -> bool:
        """By two other cameras."""
        others = self._now(person.person).keys() - {image.camera}
        return person.state is TrackState.CONFIRMED and len(others) >= 2

    def _is_in_view(self, person: Tracked, name: str) -> bool:
        camera = self._rig.cameras[self._rig.names.index(name)]
        at_px = camera.project(_middle_m(person))
        return bool(np.all((at_px >= 0) & (at_px < camera.size_px)))

    def _now(self, number: int) -> dict[str, deque[_Glimpse]]:
        """Of the cameras that see somebody now."""
        begin_s = self._newest_s - _NOW_S
        return {name: each for name, each in self._glimpses[number].items() if each[-1].image.time_s > begin_s}

    def _speed_mps(self, person: Tracked) -> float:
        """Since somebody was taken out last; inf: it is not known."""
        before_s, before_m = self._at.get(person.person, (np.inf, None))
        if before_m is None or person.estimate.time_s <= before_s:
            return np.inf
        return float(np.linalg.norm(_middle_m(person) - before_m)) / (person.estimate.time_s - before_s)


def _middle_m(person: Tracked) -> Float[np.ndarray, " 3"]:
    """NaN if no joint is known, as of somebody whom one camera alone sees."""
    positions_m = person.estimate.positions_m
    known_m = positions_m[np.isfinite(positions_m).all(axis=-1)]
    return np.median(known_m, axis=0) if len(known_m) else np.full(3, np.nan)


def _at_time(
    glimpses: Sequence[_Glimpse], time_s: float
) -> tuple[Float[np.ndarray, "joint 2"], Float[np.ndarray, " joint"]]:
    """Original pixels and confidence at a time of the camera; nothing where it is not between its images."""
    times_s = np.array([glimpse.image.time_s for glimpse in glimpses])
    after = int(np.searchsorted(times_s, time_s - _SAME_S))
    px, confidence = glimpses[min(after, len(glimpses) - 1)].seen()
    if after < len(glimpses) and times_s[after] - time_s < _SAME_S:
        return px, confidence
    if not 0 < after < len(glimpses) or times_s[after] - times_s[after - 1] > _LONGEST_GAP_S:
        return px, np.zeros_like(confidence)
    older_px, older_confidence = glimpses[after - 1].seen()
    share = (times_s[after] - time_s) / (times_s[after] - times_s[after - 1])
    return share * older_px + (1 - share) * px, np.minimum(older_confidence, confidence)
