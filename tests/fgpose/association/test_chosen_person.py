"""The person who is seen most, among by-standers: the first of the people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from everybody import track_people

from fgpose.association.chosen_person import ranked
from fgpose.association.recording import associate
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import load_rig
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import walking

DATA = Path(__file__).parents[2] / "data"
FPS = 60.0
BODY = load_skeleton("h36m_17")


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return load_rig(DATA / "qualisys" / "Calib_qualisys.toml")


def real_people() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    with np.load(DATA / "balance_openpose" / "people.npz") as file:
        people, person_index = file["people"].astype(float), file["person_index"].astype(int)
    return people[..., :2], np.nan_to_num(people[..., 2]), person_index


def first_person(
    points2d_px: np.ndarray, confidence: np.ndarray, rig: CameraRig, skeleton: Skeleton = BODY
) -> np.ndarray:
    time_s = np.arange(len(points2d_px)) / FPS
    return track_people(points2d_px, confidence, time_s, rig, skeleton)[0]


def shuffled(
    points2d_px: np.ndarray, confidence: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every image's people in an order of its own, and the place of the first one, (frame, camera)."""
    order = rng.permuted(np.broadcast_to(np.arange(confidence.shape[2]), confidence.shape[:3]), axis=2)
    points2d_px = np.take_along_axis(points2d_px, order[..., None, None], axis=2)
    return points2d_px, np.take_along_axis(confidence, order[..., None], axis=2), np.argmin(order, axis=2)


def test_the_subject_among_by_standers(rig: CameraRig):
    points2d_px, confidence, person_index = real_people()
    chosen = first_person(points2d_px, confidence, rig, load_skeleton("body_25b"))
    # In one of the 400 images two entries both lie on the subject, so 99 % is as good as can be asked.
    assert np.mean(chosen == person_index) >= 0.99


def test_the_order_of_the_people_does_not_matter(rig: CameraRig):
    points2d_px, confidence, person_index = real_people()
    order = np.array([2, 0, 1])
    chosen = first_person(points2d_px[:, :, order], confidence[:, :, order], rig, load_skeleton("body_25b"))
    assert np.mean(order[chosen] == person_index) >= 0.99


def two_people_walking(rig: CameraRig, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pixels with 4 px of noise of two people on crossing paths, 1.2 m apart at least; the first is seen better."""
    body_m = walking(1, FPS, BODY)[0]
    body_m = body_m - body_m[0] * [1.0, 1.0, 0.0]
    along = np.linspace(-0.6, 0.6, 40)
    first_m = body_m + np.stack([along, np.full(40, -0.6), np.zeros(40)], axis=-1)[:, None]
    second_m = body_m + np.stack([-along, np.full(40, 0.6), np.zeros(40)], axis=-1)[:, None]
    points2d_px = np.stack([rig.project(first_m), rig.project(second_m)], axis=2)
    points2d_px += rng.normal(scale=4, size=points2d_px.shape)
    confidence = np.broadcast_to(np.array([0.9, 0.7])[:, None], points2d_px.shape[:-1]).copy()
    return points2d_px, confidence


def test_all_views_and_frames_have_the_same_of_two_people(rig: CameraRig):
    rng = np.random.default_rng(0)
    points2d_px, confidence, first = shuffled(*two_people_walking(rig, rng), rng)
    np.testing.assert_array_equal(first_person(points2d_px, confidence, rig), first)


def test_frames_in_which_the_other_fits_better_do_not_change_the_person(rig: CameraRig):
    rng = np.random.default_rng(0)
    points2d_px, confidence = two_people_walking(rig, rng)
    confidence[18:22] = confidence[18:22, :, ::-1]
    points2d_px, confidence, first = shuffled(points2d_px, confidence, rng)
    np.testing.assert_array_equal(first_person(points2d_px, confidence, rig), first)


def test_a_view_of_another_person_alone_is_left_out(rig: CameraRig):
    points2d_px, confidence = two_people_walking(rig, np.random.default_rng(0))
    points2d_px[10:30, 1, 0] = np.nan
    confidence[:, [0, 2, 3], 1] = 0
    chosen = first_person(points2d_px, confidence, rig)
    assert (chosen[10:30, 1] == NOBODY).all()
    assert (chosen[:, [0, 2, 3]] == 0).all()
    assert (chosen[:10, 1] == 0).all()


def test_hidden_joints_do_not_hide_how_large_somebody_is(rig: CameraRig):
    """Somebody nearer to the cameras is the main person; a joint that no detector finds says nothing of sizes."""
    points2d_px, confidence = two_people_walking(rig, np.random.default_rng(0))
    confidence[..., BODY.index("left_wrist")] = 0.0
    points2d_px[confidence == 0] = np.nan
    people = PeopleObservations.of_frames(BODY, rig.names, np.arange(40) / FPS, points2d_px, confidence)
    assert all(each.size_rad > 0.1 for each in ranked(associate(people, rig)))


def test_nobody_is_nobody(rig: CameraRig):
    points2d_px = np.full((3, 4, 2, BODY.n_joints, 2), np.nan)
    assert track_people(points2d_px, np.zeros((3, 4, 2, BODY.n_joints)), np.arange(3) / FPS, rig, BODY) == []


def test_one_camera_goes_by_confidence_and_continuity(rig: CameraRig):
    points2d_px, confidence = two_people_walking(rig, np.random.default_rng(0))
    chosen = first_person(points2d_px[:, :1], confidence[:, :1], rig.subset([rig.names[0]]))
    assert (chosen == 0).all()
