"""Whole recordings of several people in our own formats: npz, and parquet as a long table for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.io.arrays import array_names, checked, read_arrays, texts, write_arrays
from fgpose.io.keypoints.detection_columns import (
    DETECTION,
    detection_arrays,
    detection_columns,
    joint_indices,
    repeated_row,
    require_columns,
)
from fgpose.io.keypoints.recording_files import SKELETON, is_parquet, is_recording, with_skeleton
from fgpose.io.names import match_cameras
from fgpose.io.skeletons.tables import skeleton_to_json
from fgpose.io.tables import Column, column_names, names, nullable, numbers, read_table, write_table
from fgpose.observations import is_infinite, positive_definite
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

_SHAPES = {"points2d_px": (2,), "confidence": (), "points3d_m": (3,), "covariance3d_m2": (3, 3)}
_IN_3D = ("points3d_m", "covariance3d_m2")
COLUMNS = (
    Column("camera", "", "its name"),
    Column("image", "", "number of the image of this camera, from 0"),
    Column("time_s", "s", "time of the image"),
    Column("person", "", "number of the detection in the image; says nothing of who it is"),
    Column("joint", "", "name of the joint"),
    *DETECTION,
)
ARRAYS = (
    Column("camera_names", "", "their names", "(C,)"),
    Column("joints", "", "their names", "(J,)"),
    Column("skeleton", "", "the skeleton, as JSON", "(1,)"),
    Column("image_camera", "", "number of the camera of each image", "(I,)"),
    Column("image_time_s", "s", "when it was taken", "(I,)"),
    Column("n_people", "", "how many detections it has; the sum is N", "(I,)"),
    Column("points2d_px", "px", "detections in the original images", "(N, J, 2)"),
    Column("confidence", "0 to 1", "of the detector; 0: not detected", "(N, J)"),
    Column(
        "points3d_m",
        "m",
        "the joints as the view alone gives them, in the world; if there is per-view 3D",
        "(N, J, 3)",
    ),
    Column("covariance3d_m2", "m²", "their covariances", "(N, J, 3, 3)"),
)


@dataclass(frozen=True, eq=False)
class _Images:
    """The I images of a recording, and all N detections in them, image by image."""

    cameras: tuple[str, ...]
    camera: Int[np.ndarray, " image"]
    """Index into cameras."""
    time_s: Float[np.ndarray, " image"]
    n_people: Int[np.ndarray, " image"]
    arrays: dict[str, np.ndarray]
    """Of all detections, by the names of Detections; without per-view 3D where there is none."""


def is_people(path: Path) -> bool:
    """Whether a file was written by save_people_observations, by its content; errors as of is_recording."""
    if not is_recording(path):
        return False
    with naming(path):
        return {"image", "person"} <= column_names(path) if is_parquet(path) else "n_people" in array_names(path)


def read(path: Path, rig: CameraRig, skeleton: Skeleton, *, ignore_other_cameras: bool = False) -> PeopleObservations:
    """A recording written by save_people_observations, with its cameras in the order of the rig.

    Raises:
        ValueError: the file is damaged, of another skeleton or other cameras; the message names the file.
    """
    with naming(path):
        images = _read_parquet(path, skeleton) if is_parquet(path) else _read_npz(path, skeleton)
        matched = match_cameras(images.cameras, rig.names, ignore_others=ignore_other_cameras)
        _check_3d(images, skeleton)
        called = {matched[name]: name for name in rig.names}
        return PeopleObservations(skeleton, rig.names, tuple(_detections(images, called)))


def _detections(images: _Images, called: dict[str, str]) -> list[Detections]:
    """Image by image. Per-view 3D is None where no joint of an image has it."""
    found = []
    starts = np.cumsum(images.n_people) - images.n_people
    for camera, time_s, start, n_people in zip(images.camera, images.time_s, starts, images.n_people, strict=True):
        if images.cameras[camera] not in called:
            continue
        own = {name: array[start : start + n_people] for name, array in images.arrays.items()}
        given = {name: array for name, array in own.items() if name not in _IN_3D or not np.isnan(array).all()}
        found.append(Detections(called[images.cameras[camera]], float(time_s), **given))
    return found


def _check_3d(images: _Images, skeleton: Skeleton) -> None:
    """What Detections does not check. A point that is not known has no covariance, without points there is none."""
    points3d_m, covariance_m2 = (images.arrays.get(name) for name in _IN_3D)
    if points3d_m is None:
        images.arrays.pop("covariance3d_m2", None)
        return
    problems = {"a 3D coordinate that is infinite": is_infinite(points3d_m).any(axis=-1)}
    known = np.asarray(np.isfinite(points3d_m).all(axis=-1))
    points3d_m[~known] = np.nan
    if covariance_m2 is not None:
        covariance_m2[~known] = np.nan
        problems["a covariance that is not positive definite"] = known & ~positive_definite(covariance_m2)
    for what, bad in problems.items():
        if bad.any():
            detection, joint = np.argwhere(bad)[0].tolist()
            ends = np.cumsum(images.n_people)
            image = int(np.searchsorted(ends, detection, side="right"))
            person = detection - int(ends[image] - images.n_people[image])
            raise ValueError(
                f"camera {images.cameras[images.camera[image]]}, image at {images.time_s[image]:.13g} s, "
                f"person {person}, joint {skeleton.joints[joint]}: {what}"
            )


def save_people_observations(observations: PeopleObservations, path: str | Path) -> None:
    """Write a recording of several people as npz or as a parquet table, by the extension.

    Rounded to single precision as by save_observations. The file appears under its name only when it is complete.

    Parquet: one row per image, person and joint; columns camera, image (its number among those of its camera, from 0),
    time_s, person (the number of the detection in the image, from 0), joint, x_px, y_px, confidence and, with per-view
    3D, x_m, y_m, z_m in the world frame, with covariance cov_xx_m2 to cov_zz_m2; null = missing. An image that shows
    nobody is a row whose person is null, a camera without images a row whose image is null.

    npz: camera_names (C,), joints (J,); of each image image_camera (I,), the index of its camera, image_time_s (I,) and
    n_people (I,); of all detections, image by image, points2d_px (N, J, 2), confidence (N, J), points3d_m (N, J, 3) and
    covariance3d_m2 (N, J, 3, 3).

    Raises:
        ValueError: the extension is neither .npz nor .parquet.
        OSError: the file cannot be written.
    """
    path = Path(path)
    writers = {".npz": _write_npz, ".parquet": _write_parquet}
    if path.suffix not in writers:
        raise ValueError(f"{path}: observations are written as .npz or .parquet")
    writers[path.suffix](_images(observations), observations.skeleton, path)


def _images(observations: PeopleObservations) -> _Images:
    images, n_joints = observations.images, observations.skeleton.n_joints

    def of_all(name: str) -> np.ndarray:
        own = ((image.n_people, getattr(image, name)) for image in images)
        shape = n_joints, *_SHAPES[name]
        return np.concatenate([np.full((n, *shape), np.nan) if array is None else array for n, array in own])

    number = {name: c for c, name in enumerate(observations.camera_names)}
    return _Images(
        observations.camera_names,
        np.array([number[image.camera] for image in images]),
        np.array([image.time_s for image in images], dtype=float),
        np.array([image.n_people for image in images]),
        {name: of_all(name) for name in _SHAPES if any(getattr(image, name) is not None for image in images)},
    )


def _write_npz(images: _Images, skeleton: Skeleton, path: Path) -> None:
    write_arrays(
        path,
        {
            "camera_names": np.array(images.cameras),
            "joints": np.array(skeleton.joints),
            SKELETON: np.array([skeleton_to_json(skeleton)]),
            "image_camera": images.camera.astype(np.int32),
            "image_time_s": images.time_s,
            "n_people": images.n_people.astype(np.int32),
            **{name: array.astype(np.float32) for name, array in images.arrays.items()},
        },
    )


def _read_npz(path: Path, skeleton: Skeleton) -> _Images:
    arrays = read_arrays(path)
    joints, cameras = texts(arrays, "joints"), texts(arrays, "camera_names")
    if joints != skeleton.joints:
        raise ValueError(f"its joints are not those of skeleton {skeleton.name}: {', '.join(joints)}")
    n_people = checked(arrays, "n_people", "whole numbers", None).astype(int)
    camera = checked(arrays, "image_camera", "whole numbers", len(n_people)).astype(int)
    if not ((camera >= 0) & (camera < len(cameras))).all():
        raise ValueError(f"array image_camera has a number that is none of the {len(cameras)} cameras")
    n_detections = len(checked(arrays, "confidence", "numbers", None, len(joints)))
    if not ((n_people >= 0) & (n_people <= n_detections)).all() or n_people.sum() != n_detections:
        raise ValueError(f"array n_people does not count the {n_detections} detections")
    found = {
        name: checked(arrays, name, "numbers", n_detections, len(joints), *shape).astype(float)
        for name, shape in _SHAPES.items()
        if name in arrays or name not in _IN_3D
    }
    time_s = checked(arrays, "image_time_s", "numbers", len(n_people)).astype(float)
    return _Images(cameras, camera, time_s, n_people, found)


def _write_parquet(images: _Images, skeleton: Skeleton, path: Path) -> None:
    import pyarrow as pa

    n_images, n_detections, n_joints = len(images.camera), int(images.n_people.sum()), skeleton.n_joints
    place = np.zeros(n_images)
    for c in range(len(images.cameras)):
        place[images.camera == c] = np.arange((images.camera == c).sum())
    person = np.arange(n_detections) - np.repeat(np.cumsum(images.n_people) - images.n_people, images.n_people)
    # Of each row the image and the joint among those of all detections; -1: none.
    without_image = np.setdiff1d(np.arange(len(images.cameras)), images.camera)
    n_rows = np.where(images.n_people > 0, images.n_people * n_joints, 1)
    image = np.append(np.repeat(np.arange(n_images), n_rows), np.full(len(without_image), -1))
    joint = np.full(len(image), -1)
    joint[np.flatnonzero(np.repeat(images.n_people > 0, n_rows))] = np.arange(n_detections * n_joints)

    def column(values: np.ndarray, index: np.ndarray) -> pa.Array:
        return nullable(np.concatenate([values, np.full(1, np.nan, dtype=values.dtype)])[index])

    camera = np.append(np.repeat(images.camera, n_rows), without_image).astype(np.int32)
    skeleton_joint = column(np.tile(np.arange(n_joints, dtype=float), n_detections), joint).cast(pa.int32())
    columns = {
        "camera": pa.DictionaryArray.from_arrays(camera, list(images.cameras)),
        "image": column(place, image).cast(pa.int32()),
        "time_s": column(images.time_s, image),
        "person": column(np.repeat(person.astype(float), n_joints), joint).cast(pa.int32()),
        "joint": pa.DictionaryArray.from_arrays(skeleton_joint, list(skeleton.joints)),
    }
    columns |= {name: column(values, joint) for name, values in detection_columns(images.arrays).items()}
    write_table(path, with_skeleton(pa.table(columns), skeleton))


def _read_parquet(path: Path, skeleton: Skeleton) -> _Images:
    table = read_table(path)
    require_columns(table, ("camera", "image", "time_s", "person", "joint"))
    cameras, camera = names(table, "camera")
    image, person, time_s = (numbers(table, name) for name in ("image", "person", "time_s"))
    joint = joint_indices(table, skeleton, may_lack=True)
    with_image, with_person = ~np.isnan(image), ~np.isnan(person)

    def refuse(bad: np.ndarray, what: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            raise ValueError(f"camera {cameras[camera[row]]}, image {image[row]:g}, person {person[row]:g}: {what}")

    refuse((with_person != (joint >= 0)) | (with_person & ~with_image), "a joint needs a person, a person an image")
    first, image_of = _groups(camera, image, with_image)
    image_camera, image_time_s = camera[first], time_s[first]
    refuse(with_image & (time_s != np.append(image_time_s, np.nan)[image_of]), "an image needs one time")
    first, detection_of = _groups(image_of, person, with_person)
    repeated = repeated_row(detection_of[with_person] * skeleton.n_joints + joint[with_person])
    if repeated is not None:
        row = np.flatnonzero(with_person)[repeated]
        refuse(np.arange(len(person)) == row, f"two rows for joint {skeleton.joints[joint[row]]}")

    def spread(column: np.ndarray) -> np.ndarray:
        array = np.full((len(first), skeleton.n_joints), np.nan)
        array[detection_of[with_person], joint[with_person]] = column[with_person]
        return array

    n_people = np.bincount(image_of[first], minlength=len(image_camera))
    return _Images(cameras, image_camera, image_time_s, n_people, detection_arrays(table, spread))


def _groups(
    outer: Int[np.ndarray, " row"], inner: Float[np.ndarray, " row"], wanted: Bool[np.ndarray, " row"]
) -> tuple[Int[np.ndarray, " group"], Int[np.ndarray, " row"]]:
    """The wanted rows with the same two numbers: of each group, in their order, the first row; of each row its group
    (-1: not wanted)."""
    rows = np.flatnonzero(wanted)
    values, number = np.unique(inner[rows], return_inverse=True)
    _, first, group = np.unique(outer[rows] * len(values) + number, return_index=True, return_inverse=True)
    group_of = np.full(len(wanted), -1)
    group_of[rows] = group
    return rows[first], group_of
