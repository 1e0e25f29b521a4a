"""Files with the detections of several people, there and back."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from small_files import STICK, assert_same, rig

from fgpose.io.keypoints import (
    keypoint_cameras,
    load_observations,
    load_people,
    save_observations,
    save_people_observations,
)
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations

RIG = rig()
BOTH = pytest.mark.parametrize("extension", [".npz", ".parquet"])


def detections(camera: str, time_s: float, n_people: int, seed: int, in_3d: int = 0) -> Detections:
    """Made of single precision, so that files keep them exactly; in_3d: 1 with points, 2 with covariances."""
    rng = np.random.default_rng(seed)

    def single(array: np.ndarray) -> np.ndarray:
        return array.astype(np.float32).astype(float)

    shape = (n_people, STICK.n_joints)
    points2d_px, confidence = rng.uniform(0, 1000, (*shape, 2)), single(rng.uniform(0.1, 1, shape))
    confidence[rng.uniform(size=shape) < 0.2] = 0.0
    points3d_m = single(rng.normal(size=(*shape, 3)))
    points3d_m[rng.uniform(size=shape) < 0.2] = np.nan
    covariance_m2 = np.where(np.isnan(points3d_m)[..., None], np.nan, single(0.01 * np.eye(3)))
    return Detections(
        camera,
        time_s,
        single(points2d_px),
        confidence,
        points3d_m if in_3d else None,
        covariance_m2 if in_3d == 2 else None,
    )


def recording(in_3d: int = 0, cameras: tuple[str, ...] = RIG.names) -> PeopleObservations:
    """Cameras of 25 and 30 Hz; 0 to 3 people in an image."""
    images = [
        detections(camera, i / rate_hz, (i + 2 * c) % 4, seed=10 * i + c, in_3d=in_3d if (i + 2 * c) % 4 else 0)
        for c, (camera, rate_hz) in enumerate(zip(cameras, (25, 30), strict=True))
        for i in range(9)
    ]
    return PeopleObservations(STICK, cameras, tuple(images))


def assert_same_images(actual: PeopleObservations, expected: PeopleObservations) -> None:
    assert (actual.skeleton, actual.camera_names) == (expected.skeleton, expected.camera_names)
    assert len(actual.images) == len(expected.images)
    for one, other in zip(actual.images, expected.images, strict=True):
        assert_same(one, other)


@BOTH
@pytest.mark.parametrize("in_3d", [0, 1, 2])
def test_everybody_in_every_image_survives_a_round_trip_exactly(tmp_path, extension, in_3d):
    path, original = tmp_path / f"seen{extension}", recording(in_3d)
    save_people_observations(original, path)
    loaded = load_people(path, RIG, STICK)
    assert_same_images(loaded, original)
    assert sorted({image.n_people for image in loaded.images}) == [0, 1, 2, 3]
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@BOTH
def test_a_detection_without_a_joint_and_images_of_nobody_survive(tmp_path, extension):
    nothing = Detections(RIG.names[0], 0.5, np.full((2, STICK.n_joints, 2), np.nan), np.zeros((2, STICK.n_joints)))
    empty = [detections(RIG.names[0], time_s, 0, 0) for time_s in (0.1, 0.3)]
    for images in ((nothing, *empty), tuple(empty)):
        # The second camera has no image.
        original = PeopleObservations(STICK, RIG.names, images)
        save_people_observations(original, tmp_path / f"seen{extension}")
        assert_same_images(load_people(tmp_path / f"seen{extension}", RIG, STICK), original)
        assert keypoint_cameras(tmp_path / f"seen{extension}") == RIG.names
        assert not load_observations(tmp_path / f"seen{extension}", RIG, STICK).seen.any()


@BOTH
def test_cameras_follow_the_rig(tmp_path, extension):
    path, original = tmp_path / f"seen{extension}", recording(2)
    called = {name: name.upper().replace("_", "-") for name in RIG.names}
    renamed = tuple(dataclasses.replace(image, camera=called[image.camera]) for image in original.images)
    save_people_observations(PeopleObservations(STICK, tuple(called.values()), renamed), path)
    assert keypoint_cameras(path) == tuple(called.values())
    turned = RIG.subset(RIG.names[::-1])
    assert_same_images(load_people(path, turned, STICK), PeopleObservations(STICK, turned.names, original.images))
    with pytest.raises(ValueError, match=rf"{path.name}.*lacks camera {called[RIG.names[1]]}"):
        load_people(path, RIG.subset([RIG.names[0]]), STICK)
    with pytest.raises(ValueError, match=rf"{path.name}.*coco_17"):
        load_people(path, RIG, load_skeleton("coco_17"))


def test_the_table_of_detections_needs_no_fgpose(tmp_path):
    original = recording(1)
    save_people_observations(original, tmp_path / "seen.parquet")
    table = pq.read_table(tmp_path / "seen.parquet")
    assert table.column_names == [
        *("camera", "image", "time_s", "person", "joint", "x_px", "y_px", "confidence", "x_m", "y_m", "z_m")
    ]
    shown = [max(image.n_people * STICK.n_joints, 1) for image in original.images]
    assert table.num_rows == sum(shown)
    rows = table.filter(pc.field("camera") == RIG.names[1]).to_pylist()
    (row,) = (r for r in rows if (r["image"], r["person"], r["joint"]) == (5, 2, "neck"))
    image = original.by_camera[RIG.names[1]][5]
    assert row["time_s"] == 5 / 30
    assert row["confidence"] == image.confidence[2, 3]
    assert row["x_px"] == (None if image.confidence[2, 3] == 0 else image.points2d_px[2, 3, 0])
    (nobody,) = (r for r in rows if r["image"] == 6)
    assert (nobody["person"], nobody["joint"], nobody["x_px"], nobody["time_s"]) == (None, None, None, 6 / 30)


def test_the_order_of_rows_and_further_columns_do_not_matter(tmp_path):
    path, original = tmp_path / "seen.parquet", recording(2)
    save_people_observations(original, path)
    table = pq.read_table(path)
    order = np.random.default_rng(0).permutation(table.num_rows)
    note = pa.array(["something"] * table.num_rows)
    pq.write_table(table.take(order).append_column("note", note), path)
    assert_same_images(load_people(path, RIG, STICK), original)


def test_detections_may_be_left_out(tmp_path):
    """Others are numbered anew, and joints without a row are missing."""
    path, original = tmp_path / "seen.parquet", recording()
    save_people_observations(original, path)
    table = pq.read_table(path)
    field = pc.field
    left_out = (field("person") == 1) | ((field("person") == 0) & (field("joint") == "neck"))
    pq.write_table(table.filter(~left_out | field("person").is_null()), path)
    for one, other in zip(load_people(path, RIG, STICK).images, original.images, strict=True):
        kept = [person for person in range(other.n_people) if person != 1]
        points2d_px = other.points2d_px[kept]
        points2d_px[: 1 if kept else 0, 3] = np.nan
        np.testing.assert_array_equal(one.points2d_px, points2d_px)
        np.testing.assert_array_equal(one.confidence > 0, ~np.isnan(points2d_px[..., 0]))


def changed(table: pa.Table, row: int, **values: Any) -> pa.Table:
    for name, value in values.items():
        column = table[name].to_pylist()
        column[row] = value
        place = table.column_names.index(name)
        kind = table.schema.field(name).type
        table = table.set_column(place, name, pa.array(column, pa.string() if pa.types.is_dictionary(kind) else kind))
    return table


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: pa.concat_tables([t, t.slice(2, 1)]),
            "camera {a}, image 1, person 0: two rows for joint left_knee",
        ),
        (lambda t: changed(t, 2, person=None), "camera {a}, image 1, person nan: a joint needs a person"),
        (lambda t: changed(t, 2, joint=None), "camera {a}, image 1, person 0: a joint needs a person"),
        (lambda t: changed(t, 2, image=None), "camera {a}, image nan, person 0: a joint needs a person, a person an"),
        (lambda t: changed(t, 2, time_s=9.0), "camera {a}, image 1, person 0: an image needs one time"),
        (lambda t: changed(t, 0, time_s=None), "camera {a}, image 0, person nan: an image needs one time"),
        (lambda t: changed(t, 0, time_s=1 / 25), "camera {a}, image at 0.04 s: the camera has two images"),
        (lambda t: changed(t, 2, joint="tail"), "skeleton stick has no joint tail"),
        (lambda t: changed(t, 2, camera=None), "a row without a camera"),
        (lambda t: changed(t, 2, confidence=1.5), "camera {a}, image at 0.04 s, person 0, joint number 1: a conf"),
        (lambda t: changed(t, 2, x_m=np.inf), "image at 0.04 s, person 0, joint left_knee: a 3D coordinate"),
        (lambda t: changed(t, 2, cov_xy_m2=9.0), "image at 0.04 s, person 0, joint left_knee: a covariance that is"),
        (lambda t: t.drop_columns(["person"]), "the column frame is missing"),
        (lambda t: t.drop_columns(["time_s"]), "the column time_s is missing"),
        (lambda t: t.slice(0, 0), "at least one image|has no keypoints"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(tmp_path, change, message):
    path = tmp_path / "seen.parquet"
    image = detections(RIG.names[0], 1 / 25, 2, seed=1, in_3d=2)
    # Everything is known.
    ones = np.ones((2, STICK.n_joints))
    covariance_m2 = np.broadcast_to(np.eye(3), (*ones.shape, 3, 3))
    image = dataclasses.replace(image, points2d_px=np.ones((*ones.shape, 2)), confidence=0.5 * ones)
    image = dataclasses.replace(image, points3d_m=np.ones((*ones.shape, 3)), covariance3d_m2=covariance_m2)
    images = (detections(RIG.names[0], 0.0, 0, seed=0), image, detections(RIG.names[1], 0.0, 0, seed=0))
    save_people_observations(PeopleObservations(STICK, RIG.names, images), path)
    table = pq.read_table(path)
    table = table.take([0, *range(2, table.num_rows), 1])  # the image of the other camera last
    load_people(path, RIG, STICK)
    pq.write_table(change(table), path)
    with pytest.raises(ValueError, match=message.format(a=RIG.names[0])) as refused:
        load_people(path, RIG, STICK)
    assert str(refused.value).startswith(str(path))
    assert str(refused.value).count(path.name) == 1


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("n_people", np.full(18, 1), "array n_people does not count the 26 detections"),
        ("n_people", np.append(np.full(16, 1), [-11, 22]), "array n_people does not count"),
        ("image_camera", np.full(18, 2), "array image_camera has a number that is none of the 2 cameras"),
        ("image_time_s", np.zeros(17), r"array image_time_s must be \(18\), got \(17,\)"),
        ("image_time_s", np.zeros(18), "the camera has two images at this time"),
        ("confidence", np.zeros((26, 5)), r"array confidence must be \(any, 6\)"),
        ("points2d_px", np.full((26, 6, 2), np.inf), "person 0, joint number 0: a pixel that is infinite"),
        ("points3d_m", np.zeros((25, 6, 3)), r"array points3d_m must be \(26, 6, 3\)"),
    ],
)
def test_an_archive_that_contradicts_itself_is_refused(tmp_path, name, array, message):
    path = tmp_path / "seen.npz"
    save_people_observations(recording(), path)
    with np.load(path) as archive:
        arrays: dict[str, Any] = dict(archive)
    np.savez(path, **(arrays | {name: array}))
    with pytest.raises(ValueError, match=rf"seen\.npz.*{message}"):
        load_people(path, RIG, STICK)


@BOTH
@pytest.mark.parametrize("keep", [0, 30, 400, -60])
def test_a_file_that_ends_early_is_named(tmp_path, extension, keep):
    path = tmp_path / f"seen{extension}"
    save_people_observations(recording(), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=path.name):
        load_people(path, RIG, STICK)


def test_other_extensions_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"seen\.csv: observations are written as"):
        save_people_observations(recording(), tmp_path / "seen.csv")


@BOTH
def test_a_recording_of_one_person_is_read_as_ever(tmp_path, extension):
    rng, path = np.random.default_rng(0), tmp_path / f"one{extension}"
    points2d_px = rng.uniform(0, 500, (4, 2, STICK.n_joints, 2)).astype(np.float32)
    one = Observations(STICK, np.arange(4.0), points2d_px, camera_names=RIG.names)
    save_observations(one, path)
    assert_same_images(load_people(path, RIG, STICK), PeopleObservations.of_one(one))
    np.testing.assert_array_equal(load_observations(path, RIG, STICK).points2d_px, points2d_px)


@BOTH
def test_of_several_the_person_who_is_seen_most_is_observed(tmp_path, extension):
    """Of two people who stand 1 m apart, in random order in each image, the one who is detected more surely."""
    body_m = np.array([[0, 0, 0.9], [0.1, 0, 0.5], [0.1, 0, 0.1], [0, 0, 1.4], [0.3, 0, 1.2], [0.4, 0.2, 1.0]])
    points2d_px = np.stack([RIG.project(body_m + np.array([x_m, 0, 0])) for x_m in (0.0, 1.0)])
    rng, images = np.random.default_rng(0), []
    for frame in range(15):
        for c, camera in enumerate(RIG.names):
            order = rng.permutation(2)
            confidence = np.repeat(np.array([[0.9], [0.5]])[order], STICK.n_joints, axis=1)
            images.append(Detections(camera, frame / 50, points2d_px[order, c], confidence))
    path = tmp_path / f"seen{extension}"
    save_people_observations(PeopleObservations(STICK, RIG.names, tuple(images)), path)
    observations = load_observations(path, RIG, STICK)
    np.testing.assert_array_equal(observations.frame_time_s, np.arange(15) / 50)
    # Single precision at 1000 px.
    np.testing.assert_allclose(observations.points2d_px, np.stack(15 * [points2d_px[0]]), atol=1e-4)


@BOTH
def test_a_number_takes_that_detection_of_every_image(tmp_path, extension):
    path, people = tmp_path / f"seen{extension}", recording()
    save_people_observations(people, path)
    chosen = load_observations(path, RIG, STICK, person=2)
    expected = sum((image.confidence[2] > 0).sum() for image in people.images if image.n_people > 2)
    assert chosen.seen.sum() == expected > 0
    with pytest.raises(ValueError, match=rf"{path.name}: there is no person 3: at most 3 in an image"):
        load_observations(path, RIG, STICK, person=3)
