"""BlazePose GHUM as a network of stage 1: a person detector, landmarks in 2D and in metres, and tracking between them.

A person is found by the detector once; from then on the landmarks of each image tell where to look in the next one.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import absolute_pose
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.network import Image, People, checked_image
from fgpose.monocular.networks.blazepose_detector import BlazePoseDetector
from fgpose.monocular.networks.blazepose_landmarks import LandmarkNetwork, Landmarks
from fgpose.monocular.networks.crops import Region
from fgpose.monocular.networks.devices import Device

_SEARCH_EVERY = 5
"""While somebody is tracked, the detector runs only once in this many images to find more people: it takes as long as
the landmarks of one person."""
# As shares of the side of a region. Measured: regions around one person lie within 0.06 of each other and differ by a
# factor of up to 1.27 (400 views). The median distance of the joints of two results for one person is 0.1 at most, of
# two people who stand side by side 0.2 at least (149 pairs). The overlap of the regions tells them apart less well.
_SAME_REGION = 0.1
_SAME_REGION_FACTOR = 1.5
_SAME_POSE = 0.12
# Of a region from the image before: turned by more (radians), or further from the person (share of the side). Nine of
# ten regions of a man who balances are nearer after 1/60 s; after 1/8 s a second look takes the landmarks from 7-11 px
# to 4-7 px from where they are at 60 Hz.
_TURNED_RAD, _ELSEWHERE = 0.05, 0.02
_PRESENT = 0.5  # as likely in the picture as not


class BlazePose:
    """Finds 33 joints of each of several people, in 2D and 3D. Any number of trackers share its two sessions.

    Args:
        landmarks: ONNX file of the landmark network: lite, full or heavy.
        detector: ONNX file of the person detector.
        threads: how many threads one run of a network may use.
        device: where both networks run.
        max_people: how many people to follow at most. The more confident detections come first.
        detect_every_frame: detect people in every image, without tracking.

    Raises:
        OSError: there is no such file.
        ValueError: a file is not that network, a number is below 1, or the device is not available.
    """

    def __init__(
        self,
        landmarks: Path,
        detector: Path,
        *,
        threads: int = 1,
        device: Device = "auto",
        max_people: int = 1,
        detect_every_frame: bool = False,
    ) -> None:
        if max_people < 1:
            raise ValueError(f"max_people must be at least 1, got {max_people}")
        self.landmarks = LandmarkNetwork(landmarks, threads, device)
        self.detector = BlazePoseDetector(detector, threads, device)
        self.max_people = max_people
        self.detect_every_frame = detect_every_frame
        self.skeleton = load_skeleton("blazepose_33")
        how = "detected" if detect_every_frame else "tracked"
        self.name = f"blazepose {self.landmarks.name}, {max_people} {how} by {self.detector.name}"

    def tracker(self, camera: Camera) -> BlazePoseTracker:
        """For the images of one camera, whose size and intrinsics are those of the images."""
        return BlazePoseTracker(self, camera)


class BlazePoseTracker:
    """Follows people through the images of one camera.

    The detector runs when nobody is tracked, in the image in which a track is lost, and in every fifth image while
    fewer people than wanted are tracked. A track is lost when the landmark network sees no person, or one who is
    tracked already. Who has moved much since the image before, as where images are rare, is looked at again in the
    region that the first look gives.
    """

    def __init__(self, network: BlazePose, camera: Camera) -> None:
        self._network = network
        self._camera = camera
        self._tracked: list[Region] = []
        self._images_since_search = 0

    def detect(self, image: np.ndarray) -> People:
        """The people in the next image, the most confident first.

        The confidence of a joint is the product of three probabilities of the network: that the joint is not hidden,
        that it lies in the picture, and that there is a person. The confidence of a box is the last of them. The box
        spans the joints that lie in the picture.

        Args:
            image: RGB, (height, width, 3) uint8, of the camera's size.

        Raises:
            ValueError: the image is different; the message names the camera.
        """
        image = checked_image(image, self._camera)
        people: list[Landmarks] = []
        self._add(image, self._tracked, people)
        self._images_since_search += 1
        if self._must_search(people):
            self._images_since_search = 0
            self._add(image, self._network.detector.detect(image), people)
        self._tracked = [] if self._network.detect_every_frame else [person.next_region for person in people]
        return self._as_people(people)

    def _add(self, image: Image, regions: Iterable[Region], people: list[Landmarks]) -> None:
        """Append the people in these regions that are not among people yet, as long as there is room."""
        for region in regions:
            if len(people) == self._network.max_people:
                return
            if any(_is_same_region(region, other.next_region) for other in people):
                continue
            person = self._network.landmarks.locate(image, region)
            if person.is_person and _has_moved(region, person.next_region):
                person = self._network.landmarks.locate(image, person.next_region)
            if person.is_person and not any(_is_same_pose(person, other) for other in people):
                people.append(person)

    def _must_search(self, people: list[Landmarks]) -> bool:
        wanted = len(people) < self._network.max_people
        lost = len(people) < max(len(self._tracked), 1)
        return wanted and (lost or self._images_since_search >= _SEARCH_EVERY)

    def _as_people(self, people: list[Landmarks]) -> People:
        if not people:
            return People.nobody(self._network.skeleton.n_joints)
        people = sorted(people, key=lambda person: -person.score)
        confidence = [person.visibility * person.presence * person.score for person in people]
        poses = [
            absolute_pose(person.world_m, person.points2d_px, each, self._camera, self._network.skeleton)
            for person, each in zip(people, confidence, strict=True)
        ]
        boxes = np.stack([_box(person) for person in people])
        return People.stacked(boxes, [person.points2d_px for person in people], confidence, poses)


def _has_moved(region: Region, now: Region) -> bool:
    """Whether a region is not where its person is now."""
    turned_rad = abs((now.angle_rad - region.angle_rad + np.pi) % (2 * np.pi) - np.pi)
    apart = np.hypot(*np.subtract(region.center_px, now.center_px)) / now.side_px
    return bool(turned_rad > _TURNED_RAD or apart > _ELSEWHERE)


def _is_same_region(a: Region, b: Region) -> bool:
    """Whether two regions are around the same person."""
    small_px, large_px = sorted((a.side_px, b.side_px))
    distance_px = np.hypot(*np.subtract(a.center_px, b.center_px))
    near = distance_px < _SAME_REGION * (small_px + large_px) / 2
    return bool(near and large_px < _SAME_REGION_FACTOR * small_px)


def _is_same_pose(a: Landmarks, b: Landmarks) -> bool:
    """Whether two results are of the same person, left and right perhaps exchanged."""
    distance_px = np.median(np.linalg.norm(a.points2d_px - b.points2d_px, axis=1))
    return bool(distance_px < _SAME_POSE * (a.next_region.side_px + b.next_region.side_px) / 2)


def _box(person: Landmarks) -> Float[np.ndarray, " 5"]:
    """Left, top, width, height around the joints that lie in the picture (all, if none does), and confidence."""
    present = person.presence >= _PRESENT
    points_px = person.points2d_px[present] if present.any() else person.points2d_px
    return np.array([*points_px.min(axis=0), *np.ptp(points_px, axis=0), person.score])
