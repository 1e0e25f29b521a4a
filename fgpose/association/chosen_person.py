"""One person, where several may be: the one who is seen most, or the one whom a region shows."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.association.recording import Association, associate
from fgpose.frame_matching import NO_IMAGE, MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people import NOBODY, PeopleObservations, Seen

# The person of a region has at least this share of its joints in it.
_MIN_INSIDE = 0.5
_REGION = re.compile(r"(?P<camera>.+):(?P<numbers>[^:]+)")


@dataclass(frozen=True)
class PersonRegion:
    """Where the wanted person is in the first image of one camera."""

    camera: str
    x_px: float
    y_px: float
    width_px: float
    height_px: float

    @staticmethod
    def parse(text: str) -> PersonRegion:
        """CAMERA:X,Y,W,H as a region. Raises ValueError if it is something else."""
        match = _REGION.fullmatch(text)
        try:
            assert match is not None
            x_px, y_px, width_px, height_px = (float(number) for number in match["numbers"].split(","))
            if not (np.isfinite([x_px, y_px]).all() and width_px > 0 and height_px > 0):
                raise ValueError
        except (AssertionError, ValueError):
            raise ValueError(f"a region is CAMERA:X,Y,W,H, in pixels, as cam01:400,200,300,900; got {text!r}") from None
        return PersonRegion(match["camera"], x_px, y_px, width_px, height_px)

    def __str__(self) -> str:
        numbers = ",".join(f"{value:g}" for value in (self.x_px, self.y_px, self.width_px, self.height_px))
        return f"{self.camera}:{numbers}"

    def share_inside(self, points2d_px: Float[np.ndarray, "person joint 2"]) -> Float[np.ndarray, " person"]:
        """Share of each person's known joints that lie in the region."""
        corner_px, size_px = np.array([self.x_px, self.y_px]), np.array([self.width_px, self.height_px])
        inside = ((points2d_px >= corner_px) & (points2d_px <= corner_px + size_px)).all(axis=-1)
        known = np.isfinite(points2d_px).all(axis=-1)
        return inside.sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)


def chosen_person(people: PeopleObservations, rig: CameraRig, person: int | PersonRegion = 0) -> Seen:
    """One person in all frames.

    People are followed through views and frames together, see associate; not needed where no image shows more than
    one.

    Args:
        people: everybody.
        rig: the cameras.
        person: 0 for the one who is seen most, 1 for the next, ...; or the one in a region.

    Raises:
        ValueError: there is no such person.
    """
    if person == 0 and people.n_most <= 1:
        return people.only()
    association = associate_somehow(people, rig)
    n_frames = len(people.frames.image)
    everybody = list(association.people.values())
    if isinstance(person, PersonRegion):
        frame, camera, candidate = _in_region(people, rig, person)
        whole = (seen.in_frames(n_frames) for seen in everybody)
        wanted = next((seen for seen in whole if (seen.detection[frame, camera] == candidate).any()), None)
        if wanted is None:
            raise ValueError(f"region {person}: no other camera agrees on the person who is there")
        return wanted
    if not 0 <= person < len(everybody):
        raise ValueError(f"there is no person {person}: {len(everybody)} were found, counted from 0")
    return everybody[person].in_frames(n_frames)


def main_person(people: PeopleObservations, rig: CameraRig) -> Observations:
    """What the cameras saw of the person who is seen most, in all frames; of nobody if nobody is seen."""
    if people.n_most <= 1:
        return people.of_person(people.only())
    association = associate_somehow(people, rig)
    if association.people:
        return association.in_all_frames(next(iter(association.people)))
    n_frames, n_cameras = people.frames.image.shape
    return people.of_person(Seen.nothing(n_frames, n_cameras, people.skeleton.n_joints))


def associate_somehow(people: PeopleObservations, rig: CameraRig) -> Association:
    """Who is who (see associate), also where no two cameras agree on anybody: because there is one only, or because the
    calibration is wrong.

    Then it is what each_camera_alone says. So what is wrong can be looked at.
    """
    association = associate(people, rig)
    return association if association.people else each_camera_alone(people, association.rig)


def each_camera_alone(people: PeopleObservations, rig: CameraRig) -> Association:
    """Those whom each camera follows for itself: the first person is the one whom each of them sees most, and so on."""
    frames = people.frames
    together: list[Seen] = []
    for c, name in enumerate(rig.names):
        if not (frames.image[:, c] != NO_IMAGE).any():
            continue
        own = replace(people.subset([name]), given_frames=MatchedFrames(frames.frame_time_s, frames.image[:, [c]]))
        for number, seen in enumerate(associate(own, rig).people.values()):
            if number == len(together):
                together.append(Seen.nothing(len(frames.image), rig.n_cameras, people.skeleton.n_joints))
            alone = seen.in_frames(len(frames.image))
            together[number].detection[:, c], together[number].joint[:, c] = alone.detection[:, 0], alone.joint[:, 0]
    return Association(people, rig, dict(enumerate(together)), ())


def _in_region(people: PeopleObservations, rig: CameraRig, region: PersonRegion) -> tuple[int, int, int]:
    """Frame, camera and detection that a region means. Raises ValueError if nobody is there."""
    rig.subset([region.camera])
    camera = rig.names.index(region.camera)
    with_image = np.flatnonzero(people.frames.image[:, camera] != NO_IMAGE)
    if not with_image.size:
        raise ValueError(f"region {region}: camera {region.camera} has no image")
    frame = int(with_image[0])
    points2d_px = people.by_camera[region.camera][people.frames.image[frame, camera]].points2d_px
    share = region.share_inside(points2d_px)
    best = int(np.argmax(share)) if len(share) else NOBODY
    if best == NOBODY or share[best] < _MIN_INSIDE:
        shown = [points_px for points_px in points2d_px if np.isfinite(points_px).any()]
        places = "; ".join(",".join(f"{value:.0f}" for value in _box(points_px)) for points_px in shown)
        raise ValueError(
            f"region {region}: nobody is there in the first image of {region.camera}; "
            + (f"people are at X,Y,W,H = {places}" if shown else "nobody is in the whole image")
        )
    return frame, camera, best


def _box(points_px: Float[np.ndarray, "joint 2"]) -> tuple[float, float, float, float]:
    corner, size = np.nanmin(points_px, axis=0), np.nanmax(points_px, axis=0) - np.nanmin(points_px, axis=0)
    return float(corner[0]), float(corner[1]), float(size[0]), float(size[1])
