"""The newest images of some cameras, and which detection in them is whose: the best assignment of people to detections,
then joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.association.likelihood import Distances, Likelihood, padded
from fgpose.association.pose_filter import Expected, PoseFilters
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.field_of_view import clipped
from fgpose.people_observations import Detections

_FITS, _DOES_NOT_FIT = 0.9, 0.1  # probabilities that a joint is of a person
_TURNS = 2  # in which detections that may be of several people are given anew


@dataclass(frozen=True, eq=False)
class Moment:
    """At most one image of each camera, and at most P detections in it; NaN: none."""

    cameras: CameraRig
    """Those that have an image."""
    times_s: Float[np.ndarray, " camera"]
    """When they took it."""
    points_px: Float[np.ndarray, "camera detection joint 2"]
    """Undistorted."""
    confidence: Float[np.ndarray, "camera detection"]
    """Mean over the joints."""
    distances: Distances | None = None
    """From the cameras, where there is per-view 3D."""

    @staticmethod
    def of(images: Sequence[Detections], rig: CameraRig) -> Moment:
        """Of these images, one at least."""
        names = [image.camera for image in images]
        cameras = rig if tuple(names) == rig.names else rig.subset(names)
        points_px = [_measured_px(image, camera) for image, camera in zip(images, cameras.cameras, strict=True)]
        confidence = [image.confidence.mean(axis=-1) for image in images]
        times_s = np.array([image.time_s for image in images]) + cameras.time_offsets_s
        return Moment(
            cameras, times_s, padded(points_px, np.nan), padded(confidence, 0.0), Distances.of(images, cameras)
        )

    @staticmethod
    def together(moments: Sequence[Moment], rig: CameraRig) -> Moment:
        """From moments of one camera each, in which detections may be differently many."""
        n_joints = moments[0].points_px.shape[2]
        return Moment(
            rig.subset([name for moment in moments for name in moment.cameras.names]),
            np.concatenate([moment.times_s for moment in moments]),
            padded([moment.points_px[0] for moment in moments], np.nan),
            padded([moment.confidence[0] for moment in moments], 0.0),
            Distances.together([(moment.distances, moment.points_px.shape[1]) for moment in moments], n_joints),
        )

    def of_camera(self, camera: int) -> Moment:
        """The image of one camera alone, by its number."""
        own = slice(camera, camera + 1)
        return Moment(
            self.cameras.subset([self.cameras.names[camera]]),
            self.times_s[own],
            self.points_px[own].copy(),
            self.confidence[own],
            None if self.distances is None else self.distances[own],
        )

    @property
    def time_s(self) -> float:
        """Of the newest image."""
        return float(self.times_s.max())

    @property
    def tells_distance(self) -> Bool[np.ndarray, "camera detection joint"]:
        """Of which joints the camera tells how far they are."""
        if self.distances is None:
            return np.zeros(self.points_px.shape[:3], dtype=bool)
        return np.asarray(np.isfinite(self.points_px).all(axis=-1)) & np.isfinite(self.distances.distance_m)

    def likelihood(self, expected: Expected) -> Likelihood:
        """Of the detections against people of whom this is expected, with their distances."""
        likelihood = Likelihood.of(expected, self.points_px, self.cameras)
        if self.distances is None:
            return likelihood
        return replace(likelihood, distance_log_ratio=self.distances.log_ratio(expected))

    def likelihood_either_way(
        self, expected: Expected, mirror: Int[np.ndarray, " joint"]
    ) -> tuple[Likelihood, Int[np.ndarray, "camera person detection"]]:
        """The same, see Likelihood.mirrored_where_better."""
        return self.likelihood(expected).mirrored_where_better(expected, self.points_px, self.cameras, mirror)

    def without(self, taken: Bool[np.ndarray, "camera detection"]) -> Moment:
        """The same without some of the detections; the others keep their numbers."""
        return replace(self, points_px=np.where(taken[..., None, None], np.nan, self.points_px))


@dataclass(frozen=True, eq=False)
class Matches:
    """Which joint of which detection, in one image of each camera, is which joint of each person."""

    chosen: Int[np.ndarray, "camera person"]
    """The detection of each person, or NOBODY."""
    detection: Int[np.ndarray, "camera person joint"]
    """The same joint by joint: a joint may come from the detection of another person, or be left out (NOBODY)."""
    joint: Int[np.ndarray, "camera person joint"]
    """Which joint of that detection it is: another one where left and right are exchanged."""
    score: Float[np.ndarray, "camera person"]
    """Log of the ratio of probabilities of the chosen detection; -inf without."""
    gain: Float[np.ndarray, "camera person"]
    """By how much the score of everybody together would fall without this person: nearly nothing where somebody else
    would explain the detection as well; 0 without one."""
    is_double: Bool[np.ndarray, "camera detection"]
    """Whether a detection is of somebody who has another one in the same image."""
    sides: Int[np.ndarray, "camera person"]
    """1 where the chosen detection has left and right exchanged, -1 where it has not, 0 where it does not tell."""

    @property
    def is_free(self) -> Bool[np.ndarray, "camera detection"]:
        """Whether a detection belongs to nobody."""
        free = ~self.is_double
        camera, person = np.nonzero(self.chosen != NOBODY)
        free[camera, self.chosen[camera, person]] = False
        return free

    @staticmethod
    def nobody(n_cameras: int, n_detections: int, n_joints: int) -> Matches:
        """Where nobody is followed."""
        none = np.zeros((n_cameras, 0, n_joints), dtype=int)
        is_double = np.zeros((n_cameras, n_detections), dtype=bool)
        nothing = np.zeros((n_cameras, 0))
        return Matches(none[..., 0], none, none, nothing, nothing, is_double, none[..., 0])

    def probability(self, likelihood: Likelihood) -> Float[np.ndarray, "camera person joint"]:
        """That each matched joint is of the person; 0 where there is none."""
        camera, person, joint = np.nonzero(self.detection != NOBODY)
        probability = np.zeros(self.detection.shape)
        of_detection = self.detection[camera, person, joint]
        probability[camera, person, joint] = likelihood.probability[camera, person, of_detection, joint]
        return probability

    def update(
        self,
        people: PoseFilters,
        expected: Expected,
        moment: Moment,
        likelihood: Likelihood,
        without: int | None = None,
    ) -> PoseFilters:
        """The people after what is matched to them, without the image of one camera.

        Args:
            people, expected: before, and what the cameras should detect.
            moment, likelihood: whose detections these are.
            without: number of the camera.
        """
        residual_px = self.of(moment.points_px) - expected.pixels
        if without is not None:
            residual_px[without] = np.nan
        distance = None if moment.distances is None else moment.distances.taken(self.of).against(expected)
        return people.updated(residual_px, expected, self.probability(likelihood), distance)

    def of(self, array: np.ndarray) -> np.ndarray:
        """The values of the matched joints, (C, K, J, ...), from those of the detections, (C, P, J, ...); NaN: none."""
        if not array.shape[1]:
            return np.full((*self.detection.shape, *array.shape[3:]), np.nan)
        camera = np.arange(len(self.detection))[:, None, None]
        values = array[camera, np.maximum(self.detection, 0), self.joint]
        none = (self.detection == NOBODY).reshape(*self.detection.shape, *[1] * (array.ndim - 3))
        return np.where(none, np.nan, values)


def _measured_px(image: Detections, camera: Camera) -> Float[np.ndarray, "detection joint 2"]:
    """Undistorted, without joints that are clipped to the image."""
    seen_px, undistorted_px = image.points2d_px, camera.undistort(image.points2d_px)
    return np.where(clipped(seen_px, np.array(camera.size_px))[..., None], np.nan, undistorted_px)


def match(
    likelihood: Likelihood,
    sides: Int[np.ndarray, "camera person detection"],
    exists: Float[np.ndarray, " person"],
    mirror: Int[np.ndarray, " joint"],
) -> Matches:
    """Give each person at most one detection of each image, and each joint of it to the person whom it fits.

    Args:
        likelihood: of every detection against every person.
        sides: 1 where it is that of the detection with left and right exchanged; see Likelihood.mirrored_where_better.
        exists: probability that each person is there.
        mirror: the joint on the other side of each.
    """
    n_cameras, n_people, _, n_joints = likelihood.log_ratio.shape
    chosen = np.full((n_cameras, n_people), NOBODY)
    for camera in range(n_cameras):
        chosen[camera] = _assigned(likelihood.score[camera], exists)
    half_of = _half_of(likelihood, chosen)
    halves = np.argwhere(half_of != NOBODY).tolist()
    for c, half in halves:
        chosen[c, chosen[c] == half] = NOBODY
    camera, person = np.nonzero(chosen != NOBODY)
    own = chosen[camera, person]
    score = np.full(chosen.shape, -np.inf)
    score[camera, person] = likelihood.score[camera, person, own]
    detection = np.repeat(chosen[..., None], n_joints, axis=2)
    joint = np.tile(np.arange(n_joints), (n_cameras, n_people, 1))
    of_chosen = np.zeros(chosen.shape, dtype=int)
    of_chosen[camera, person] = sides[camera, person, own]
    joint[of_chosen > 0] = mirror
    hand_over(detection, joint, chosen, likelihood.probability, sides > 0, mirror)
    is_double = (likelihood.fits & (chosen != NOBODY)[..., None]).any(axis=1)
    is_double[camera, own] = False
    for c, half in halves:
        is_double[c, half], k = True, half_of[c, half]
        known = np.isfinite(likelihood.log_ratio[c, k, half]) & (chosen[c, k] != NOBODY)
        detection[c, k, known] = half
        joint[c, k, known] = (mirror if sides[c, k, half] > 0 else np.arange(n_joints))[known]
    gain = _gain(likelihood, chosen, score)
    return Matches(chosen, detection, joint, score, gain, is_double, of_chosen)


def _half_of(likelihood: Likelihood, chosen: Int[np.ndarray, "camera person"]) -> Int[np.ndarray, "camera detection"]:
    """Of bodies that a detector has split: whose other half a detection is, or NOBODY. It has no joint of the half that
    was given to them, and fits them better than whomever it was given to itself.

    Somebody of whom little is known may be anywhere: one detection a person, they would live on what those beside them
    leave over.
    """
    known, score = np.isfinite(likelihood.log_ratio), likelihood.score
    if not score.size:
        return np.full(score.shape[::2], NOBODY)
    is_own = np.asarray(chosen[..., None] == np.arange(score.shape[2]))
    of_own = np.asarray((known & is_own[..., None]).any(axis=2))
    is_half = of_own.any(axis=-1, keepdims=True) & ~(of_own[:, :, None] & known).any(axis=-1)
    fits = np.where(is_half, score, -np.inf)
    return np.where(fits.max(axis=1) > np.where(is_own, score, 0.0).max(axis=1), fits.argmax(axis=1), NOBODY)


def _assigned(
    score: Float[np.ndarray, "person detection"], exists: Float[np.ndarray, " person"]
) -> Int[np.ndarray, " person"]:
    """The detection of each person, so that all together are explained best; NOBODY where none is probable."""
    # Takes longer to import than the rest of fgpose.
    from scipy.optimize import linear_sum_assignment

    chosen, there = np.full(len(score), NOBODY), np.maximum(score, 0.0)
    # Whoever is there explains it better than nobody; who is not, as well.
    gain = there + np.log(exists[:, None] + (1 - exists[:, None]) * np.exp(-there))
    for person, candidate in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
        if score[person, candidate] > 0:
            chosen[person] = candidate
    return chosen


def _gain(
    likelihood: Likelihood, chosen: Int[np.ndarray, "camera person"], score: Float[np.ndarray, "camera person"]
) -> Float[np.ndarray, "camera person"]:
    """Without a person, their detection would go to whom it helps most, who gives up their own. One that fits somebody
    who has another would be of them once more: it tells nothing."""
    gain = np.zeros(chosen.shape)
    for c, k in np.argwhere(chosen != NOBODY).tolist():
        own = chosen[c, k]
        others = np.arange(len(chosen[c])) != k
        if (likelihood.fits[c, :, own] & (chosen[c] != NOBODY) & others).any():
            continue
        helps = likelihood.score[c, others, own] - np.maximum(score[c, others], 0.0)
        gain[c, k] = max(score[c, k] - max(float(helps.max(initial=0.0)), 0.0), 0.0)
    return gain


def hand_over(
    detection: np.ndarray,
    joint: np.ndarray,
    chosen: np.ndarray,
    probability: Float[np.ndarray, "camera person detection joint"],
    mirrored: Bool[np.ndarray, "camera person detection"],
    mirror: Int[np.ndarray, " joint"],
) -> None:
    """Wrong grouping: a joint that does not fit its person and fits exactly one other is theirs, unless they have one
    that fits."""
    camera, person = np.nonzero(chosen != NOBODY)
    if not len(camera):
        return
    own = chosen[camera, person]
    # By the number of the joint in the detection: who has it mirrored takes it for that of the other side.
    as_labelled = np.where(mirrored[..., None], probability[..., mirror], probability)
    of_own, of_all = as_labelled[camera, person, own], np.swapaxes(as_labelled[camera, :, own], 0, 1)
    only_one = (of_all > _FITS).sum(axis=0) == 1
    n, label = np.nonzero((of_own < _DOES_NOT_FIT) & only_one)
    camera, person, own, other = camera[n], person[n], own[n], np.argmax(of_all[:, n, label], axis=0)
    of_person, of_other = (np.where(mirrored[camera, k, own], mirror[label], label) for k in (person, other))
    others_own = chosen[camera, other]
    lacks = (others_own == NOBODY) | (probability[camera, other, others_own, of_other] < _DOES_NOT_FIT)
    detection[camera, person, of_person] = NOBODY
    detection[camera[lacks], other[lacks], of_other[lacks]] = own[lacks]
    joint[camera[lacks], other[lacks], of_other[lacks]] = label[lacks]


def follow(
    people: PoseFilters, exists: Float[np.ndarray, " person"], moment: Moment, mirror: Int[np.ndarray, " joint"]
) -> tuple[PoseFilters, Matches]:
    """Give the detections of a moment to the people whom they fit, and let these follow them.

    Where a detection may be of several people, it is given once more by where the other cameras say that they are: two
    who pass each other in one view are apart in others (iterated conditional modes, Besag 1986).

    Args:
        people: as they are known so far.
        exists: probability that each person is there.
        moment: later than that, or of old images.
        mirror: the joint on the other side of each.
    """
    people = people.predicted(moment.time_s)
    expected = people.seen_by(moment.cameras, moment.times_s)
    likelihood, sides = moment.likelihood_either_way(expected, mirror)
    matches = match(likelihood, sides, exists, mirror)
    for _ in range(_TURNS if moment.cameras.n_cameras > 1 else 0):
        contested = np.flatnonzero(np.any(np.sum(likelihood.score > 0, axis=1) > 1, axis=-1))
        by_others, sides = likelihood, sides.copy()
        for camera in contested.tolist():
            own = moment.of_camera(camera)
            others = matches.update(people, expected, moment, likelihood, without=camera)
            there = others.seen_by(own.cameras, own.times_s)
            of_camera, sides[camera : camera + 1] = own.likelihood_either_way(there, mirror)
            by_others = by_others.with_camera(camera, of_camera)
        before, likelihood = matches, by_others
        matches = match(likelihood, sides, exists, mirror)
        if np.array_equal(matches.chosen, before.chosen):
            break
    return matches.update(people, expected, moment, likelihood), matches
