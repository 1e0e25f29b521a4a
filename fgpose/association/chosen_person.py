"""One person, where several may be: the main one, or the one whom a region shows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
from jaxtyping import Float

from fgpose.association.recording import Association, associate, total_confidence
from fgpose.association.successive import successive
from fgpose.correspondences import NO_IMAGE, NOBODY, MatchedFrames, Seen
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.sampling import spread_evenly, usual_step_s

# The person of a region has at least this share of its joints in it.
_MIN_INSIDE = 0.5
# Who is seen so much as the one who is seen most, may be the main person too. Of so many images their size is taken.
_ABOUT_AS_MUCH, _SOME_IMAGES = 0.8, 200
# In so many of its images a camera shows somebody, and in so few of these somebody who is followed. In a mirrored
# image people may fit for a quarter of the time: while they are in its middle.
_SHOWS, _SELDOM = 0.5, 0.5
_CANDIDATES, _COMBINATIONS = 2, 8  # of those whom a camera sees most, and of such of several cameras
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


@dataclass(frozen=True, eq=False)
class Chosen:
    """One of the people in a recording."""

    seen: Seen
    """In all frames."""
    n_people: int = 1
    """How many were found."""
    reason: str = ""
    """Why this one; nothing where there is nobody else."""
    with_unfollowed: Seen | None = None
    """The same with whom cameras show in which nobody is followed, see with_unfollowed; None: no such camera."""

    def __str__(self) -> str:
        return f"one of {self.n_people} people: {self.reason}" if self.n_people > 1 else ""


def chosen_person(people: PeopleObservations, rig: CameraRig, person: int | PersonRegion = 0) -> Chosen:
    """One person in all frames.

    People are followed through views and frames together, see associate; where no image shows more than one, only if
    there seems to be somebody after somebody else.

    Args:
        people: everybody.
        rig: the cameras.
        person: 0 for the main person, 1 for the next, ... (see ranked); or the one in a region.

    Raises:
        ValueError: there is no such person.
    """
    association = _everybody(people, rig, person)
    if association is None:
        return Chosen(people.only())
    return _in_region(association, person) if isinstance(person, PersonRegion) else _by_rank(association, person)


def main_person(people: PeopleObservations, rig: CameraRig) -> Chosen:
    """The main person in all frames, see ranked; nobody if nobody is seen."""
    association = _everybody(people, rig, 0)
    if association is None:
        return Chosen(people.only())
    if not association.people:
        n_frames, n_cameras = people.frames.image.shape
        return Chosen(Seen.nothing(n_frames, n_cameras, people.skeleton.n_joints), 0)
    return _by_rank(association, 0)


def _everybody(people: PeopleObservations, rig: CameraRig, person: int | PersonRegion) -> Association | None:
    """None where there is one person only."""
    if person == 0 and people.n_most <= 1:
        succession = successive(people, rig)
        return succession.association if succession and succession.n_people > 1 else None
    return associate_or_each_camera(people, rig)


@dataclass(frozen=True)
class Candidate:
    """How much is seen of somebody."""

    person: int
    confidence: float
    """Of all joints that were seen, summed."""
    seen_s: float
    """For how long some camera sees them."""
    n_cameras: float
    """How many do, on average."""
    size_rad: float
    """How large they are in the images, as an angle; the median."""


def ranked(association: Association) -> list[Candidate]:
    """The people of a recording, the main one first: of those seen about as much as the one seen most, that of whom
    most is seen, weighted by the area that they take in the images; then the others by how much is seen of them. So
    somebody comes before their reflection, which every camera sees farther away, and before by-standers."""
    candidates = [_candidate(association, person) for person in association.people]
    most = max((each.confidence for each in candidates), default=0.0)

    def order(each: Candidate) -> tuple[bool, float]:
        is_main = each.confidence >= _ABOUT_AS_MUCH * most
        return not is_main, -each.confidence * (each.size_rad**2 if is_main else 1.0)

    return sorted(candidates, key=order)


def _candidate(association: Association, person: int) -> Candidate:
    people, seen = association.observations, association.people[person]
    shown = (seen.detection != NOBODY).any(axis=-1)
    time_s = association.frames.frame_time_s
    step_s = usual_step_s(time_s) if len(time_s) > 1 else 0.0
    sizes_rad, images = [], np.argwhere(shown)
    for t, c in images[spread_evenly(len(images), _SOME_IMAGES)].tolist():
        detection, known = seen.detection[t, c], seen.detection[t, c] != NOBODY
        points_px = people.image(seen.first_frame + t, c).points2d_px[detection[known], seen.joint[t, c, known]]
        found_px = points_px[np.isfinite(points_px).all(axis=-1)]  # joints of a detection may be missing
        if len(found_px):
            sizes_rad.append(np.linalg.norm(np.ptp(found_px, axis=0)) / association.rig.cameras[c].K[0, 0])
    n_frames = np.count_nonzero(shown.any(axis=1))
    return Candidate(
        person,
        total_confidence(people, seen),
        float(n_frames * step_s),
        float(shown.sum() / max(n_frames, 1)),
        float(np.median(sizes_rad)) if sizes_rad else 0.0,
    )


def _by_rank(association: Association, rank: int) -> Chosen:
    """Raises ValueError if there are fewer."""
    n_people = len(association.people)
    if not 0 <= rank < n_people:
        raise ValueError(f"there is no person {rank}: {n_people} were found, counted from 0")
    order = ranked(association)
    seen = association.people[order[rank].person].in_frames(len(association.frames.image))
    reason = f"number {rank} of them" if rank else _reason(order, association.rig.n_cameras)
    return Chosen(seen, n_people, reason, next(with_unfollowed(association, seen), None))


def _reason(order: Sequence[Candidate], n_cameras: int) -> str:
    """Why the first of several is the main person."""
    first, second = order[0], order[1] if len(order) > 1 else None
    own = f"by {first.n_cameras:.1f} of {n_cameras} cameras for {first.seen_s:.1f} s"
    if second is None:
        return f"seen {own}"
    others = f"by {second.n_cameras:.1f} for {second.seen_s:.1f} s"
    if second.confidence < _ABOUT_AS_MUCH * first.confidence:
        return f"seen most, {own}; the next {others}"
    larger = 100 * (first.size_rad / max(second.size_rad, 1e-9) - 1)
    size = f"{larger:.0f} % larger" if larger >= 0 else f"{-larger:.0f} % smaller"
    return f"seen {own}, {size} in the images than the next, who is seen {others}"


def associate_or_each_camera(people: PeopleObservations, rig: CameraRig) -> Association:
    """Who is who (see associate), also where no two cameras agree on anybody: because there is one only, or because the
    calibration is wrong.

    Then it is what each_camera_alone says. So what is wrong can be looked at.
    """
    association = associate(people, rig)
    return association if association.people else each_camera_alone(people, association.rig)


def each_camera_alone(people: PeopleObservations, rig: CameraRig) -> Association:
    """Those whom each camera follows for itself: the first person is the one whom each of them sees most, and so on."""
    together: list[Seen] = []
    for c in range(rig.n_cameras):
        for number, alone in enumerate(of_camera_alone(people, rig, c)):
            if number == len(together):
                together.append(Seen.nothing(len(people.frames.image), rig.n_cameras, people.skeleton.n_joints))
            together[number].detection[:, c], together[number].joint[:, c] = alone.detection[:, 0], alone.joint[:, 0]
    return Association(people, rig, dict(enumerate(together)), ())


def of_camera_alone(people: PeopleObservations, rig: CameraRig, camera: int) -> list[Seen]:
    """Those whom one camera follows for itself, in all frames, in its images alone: the one whom it sees most first."""
    frames = people.frames
    if not (frames.image[:, camera] != NO_IMAGE).any():
        return []
    own_frames = MatchedFrames(frames.frame_time_s, frames.image[:, [camera]])
    own = replace(people.subset([rig.names[camera]]), given_frames=own_frames)
    return [seen.in_frames(len(frames.image)) for seen in associate(own, rig).people.values()]


def with_unfollowed(association: Association, person: Seen) -> Iterator[Seen]:
    """Somebody, in all frames; in cameras in most of whose images nobody is followed although they show people, one of
    those whom they see most: with a wrong calibration people do not fit. First the one whom each sees most, then the
    others: who is seen most by one camera need not be by another. Nothing where there is no such camera.

    Args:
        association: who is who.
        person: one of them, in all frames.
    """
    cameras = unfollowed(association)
    if not cameras:
        return
    alone = [of_camera_alone(association.observations, association.rig, c)[:_CANDIDATES] for c in cameras]
    for chosen in islice(product(*((own or [None]) for own in alone)), _COMBINATIONS):
        seen = Seen(person.first_frame, person.detection.copy(), person.joint.copy())
        for c, own in zip(cameras, chosen, strict=True):
            if own is not None:
                seen.detection[:, c], seen.joint[:, c] = own.detection[:, 0], own.joint[:, 0]
        yield seen


def unfollowed(association: Association) -> list[int]:
    """Numbers of the cameras in most of whose images nobody is followed, although they show people."""
    observations, image = association.observations, association.frames.image
    n_frames, found = len(image), np.zeros(image.shape, dtype=bool)
    for seen in association.people.values():
        found |= (seen.in_frames(n_frames).detection != NOBODY).any(axis=-1)
    shows = image != NO_IMAGE
    for t, c in np.argwhere(shows).tolist():
        shows[t, c] = observations.image(t, c).n_people > 0
    n_shown, n_found = shows.sum(axis=0), found.sum(axis=0)
    return np.flatnonzero((n_shown > _SHOWS * n_frames) & (n_found < _SELDOM * n_shown)).tolist()


def _in_region(association: Association, region: PersonRegion) -> Chosen:
    """Raises ValueError if nobody is there, or nobody is followed there."""
    frame, camera, detection = _detection_in(association.observations, association.rig, region)
    everybody = (seen.in_frames(len(association.frames.image)) for seen in association.people.values())
    wanted = next((seen for seen in everybody if (seen.detection[frame, camera] == detection).any()), None)
    if wanted is None:
        raise ValueError(f"region {region}: no other camera agrees on the person who is there")
    reason = f"the one in {region}"
    return Chosen(wanted, len(association.people), reason, next(with_unfollowed(association, wanted), None))


def _detection_in(people: PeopleObservations, rig: CameraRig, region: PersonRegion) -> tuple[int, int, int]:
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
