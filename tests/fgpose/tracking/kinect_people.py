"""Two real people as two depth sensors see them (tests/data/kinect_people), as observations with per-view 3D."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from fgpose.association.recording import Association
from fgpose.correspondences import NO_IMAGE, NOBODY
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections, PeopleObservations

FOLDER = Path(__file__).parents[2] / "data" / "kinect_people"
SKELETON = load_skeleton(FOLDER / "kinect_v2.toml")
# The depth image of a Kinect v2, and how high it stood.
_SIZE_PX, _FOCAL_PX, _HEIGHT_M = (512, 424), 366.0, 1.0
# The sensors differ from each other by 1 to 2 cm in each direction (robust standard deviation), by 6 cm or more in a
# tenth of the joints, and have errors in common, for they see the same side of the body.
_SIDEWAYS_M, _ALONG_M = 0.02, 0.05
# Farther from each other, two skeletons are of different people: these were half a metre apart or more.
_SAME_PERSON_M = 0.3


@dataclass(frozen=True, eq=False)
class Image:
    """The skeletons that a sensor sees at one time."""

    time_s: float
    kinect: int
    person_id: np.ndarray
    """(P,) who it is by the sensors' own tracker: right in most images."""
    joints_m: np.ndarray
    """(P, J, 3) axes of a camera: x right, y down, z forward; NaN: lost."""


@cache
def images(number: int) -> tuple[Image, ...]:
    """Of a recording, in the order of time."""
    with gzip.open(FOLDER / f"recording_{number}.csv.gz", "rt", newline="") as file:
        head, *rows = csv.reader(file)
    columns = [[head.index(f"{joint}_{axis}_mm") for axis in "xyz"] for joint in SKELETON.joints]
    found = []
    for (time_ms, kinect), group in groupby(rows, key=lambda row: (row[0], row[1])):
        people = np.array(list(group), dtype=float)
        joints_m = people[:, columns] * [-1e-3, -1e-3, 1e-3]
        joints_m[~joints_m.any(axis=-1)] = np.nan
        found.append(Image(float(time_ms) / 1000, int(kinect), people[:, 2].astype(int), joints_m))
    return tuple(found)


def seen_by_both(number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The skeletons (P, J, 3) of the first and of the second sensor at the times that both have."""
    by_time: dict[float, dict[int, np.ndarray]] = {}
    for image in images(number):
        by_time.setdefault(image.time_s, {})[image.kinect] = image.joints_m
    return [(both[0], both[1]) for both in by_time.values() if len(both) == 2]


def matched(first_m: np.ndarray, second_m: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The skeletons of two sensors that fit each other best, and their median distance."""
    apart_m = np.linalg.norm(first_m[:, None] - second_m[None], axis=-1)
    distance_m = np.median(np.nan_to_num(apart_m, nan=1e3), axis=-1)
    for a, b in zip(*linear_sum_assignment(distance_m), strict=True):
        yield first_m[a], second_m[b], float(distance_m[a, b])


def moved(first_T_second: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    return points_m @ first_T_second[:3, :3].T + first_T_second[:3, 3]


def _aligned(first_m: np.ndarray, second_m: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """first_T_second for which points (N, 3) of both are nearest (Kabsch)."""
    known = np.isfinite(first_m).all(axis=-1) & np.isfinite(second_m).all(axis=-1)
    first_m, second_m, weights = first_m[known], second_m[known], None if weights is None else weights[known]
    a_m, b_m = (np.average(points_m, axis=0, weights=weights) for points_m in (first_m, second_m))
    first_T_second = np.eye(4)
    first_T_second[:3, :3] = Rotation.align_vectors(first_m - a_m, second_m - b_m, weights=weights)[0].as_matrix()
    first_T_second[:3, 3] = a_m - first_T_second[:3, :3] @ b_m
    return first_T_second


@cache
def alignment(number: int) -> np.ndarray:
    """first_T_second from the skeletons that both sensors see.

    Who is who between the sensors is not known at first: either way round in some instants is a hypothesis, and that
    with which the skeletons of all instants fit best is refined on those that fit, with Cauchy weights.
    """
    instants = seen_by_both(number)
    of_two = [each for each in instants if len(each[0]) == len(each[1]) == 2]

    def misfit_m(first_T_second: np.ndarray) -> float:
        pairs = (matched(a, moved(first_T_second, b)) for a, b in instants[::30])
        return float(np.median([distance_m for pair in pairs for *_, distance_m in pair]))

    hypotheses = [
        _aligned(a.reshape(-1, 3), b[list(order)].reshape(-1, 3))
        for a, b in of_two[:: len(of_two) // 10]
        for order in ((0, 1), (1, 0))
    ]
    best = min(hypotheses, key=misfit_m)
    for _ in range(5):
        inverse = np.linalg.inv(best)
        fitting = [
            (first_m, moved(inverse, second_m))
            for a, b in instants
            for first_m, second_m, distance_m in matched(a, moved(best, b))
            if distance_m < _SAME_PERSON_M
        ]
        first_m, second_m = (np.concatenate(points_m) for points_m in zip(*fitting, strict=True))
        error_m = np.linalg.norm(first_m - moved(best, second_m), axis=-1)
        best = _aligned(first_m, second_m, 1 / (1 + (error_m / np.nanmedian(error_m)) ** 2))
    return best


def rig_of(number: int) -> CameraRig:
    """Nominal cameras in place of the sensors; the floor is z = 0 of the world, the first looks along y."""
    K = np.array([[_FOCAL_PX, 0, _SIZE_PX[0] / 2], [0, _FOCAL_PX, _SIZE_PX[1] / 2], [0, 0, 1]])
    world_T_first = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, _HEIGHT_M], [0, 0, 0, 1]])
    poses = world_T_first, world_T_first @ alignment(number)
    return CameraRig(tuple(Camera(f"kinect_{c}", _SIZE_PX, K, pose, np.zeros(0)) for c, pose in enumerate(poses)))


@dataclass(frozen=True, eq=False)
class KinectPeople:
    """A recording as fgpose takes it."""

    rig: CameraRig
    observations: PeopleObservations
    person_id: dict[str, list[np.ndarray]]
    """By camera, of each of its images: see Image."""

    def right_share(self, association: Association) -> float:
        """Share of all detections that are given to the person who has their person_id elsewhere: each person that
        fgpose finds is at most one of theirs, and each of theirs at most one."""
        n_found, n_ids = max(association.people, default=0) + 1, 2
        same, n_all = np.zeros((n_found, n_ids)), sum(len(ids) for each in self.person_id.values() for ids in each)
        for person, seen in association.people.items():
            whole = seen.in_frames(len(association.frames.image)).main_detection
            for frame, c in np.argwhere(whole != NOBODY).tolist():
                ids = self.person_id[self.rig.names[c]][association.frames.image[frame, c]]
                same[person, ids[whole[frame, c]]] += 1
        return float(same[linear_sum_assignment(same, maximize=True)].sum() / n_all)

    def both_share(self, association: Association) -> float:
        """Share of the frames that show two people in which two are followed."""
        image_of = association.frames.image
        whole = [seen.in_frames(len(image_of)).main_detection for seen in association.people.values()]
        n_found = np.sum([(each != NOBODY).any(axis=1) for each in whole], axis=0) if whole else np.zeros(len(image_of))
        n_shown = np.array(
            [
                len(
                    {
                        i
                        for c, name in enumerate(self.rig.names)
                        if of[c] != NO_IMAGE
                        for i in self.person_id[name][of[c]]
                    }
                )
                for of in image_of
            ]
        )
        return float((n_found[n_shown == 2] >= 2).mean())


def kinect_people(
    number: int,
    kinects: Sequence[int] = (0, 1),
    per_view_3d: bool = True,
    begin_s: float = 0.0,
    end_s: float = np.inf,
) -> KinectPeople:
    """A part of a recording, of both sensors or one: joints in its image, with or without their 3D."""
    rig = rig_of(number)
    found, person_id = [], {rig.names[c]: [] for c in kinects}
    for image in images(number):
        if image.kinect not in kinects or not begin_s <= image.time_s < end_s:
            continue
        camera = rig.cameras[image.kinect]
        points3d_m = camera.to_world_frame(image.joints_m)
        points_px = camera.project(points3d_m)
        inside = (
            np.isfinite(points_px).all(axis=-1) & (points_px >= 0).all(axis=-1) & (points_px < _SIZE_PX).all(axis=-1)
        )
        rays = points3d_m - camera.position_m
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        along = rays[..., :, None] * rays[..., None, :]
        covariance_m2 = _SIDEWAYS_M**2 * np.eye(3) + (_ALONG_M**2 - _SIDEWAYS_M**2) * along
        in_3d = (points3d_m, covariance_m2) if per_view_3d else ()
        found.append(Detections(camera.name, image.time_s, points_px, np.where(inside, 0.9, 0.0), *in_3d))
        person_id[camera.name].append(image.person_id)
    rig = rig.subset([rig.names[c] for c in kinects])
    return KinectPeople(rig, PeopleObservations(SKELETON, rig.names, tuple(found)), person_id)
