"""Cameras that began at different moments, put together by the time offsets of the rig."""

from __future__ import annotations

import numpy as np
import pytest
from calibrated_walks import FPS, SKELETON, joints_m, true_rig

import fgpose
from fgpose.association.common_clock import on_common_clock
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.tracking.batch import smooth_people

LATE = np.array([0.0, 10.2, -7.013])
"""Frames: the starts of the cameras by the clock of the first. The last one is 13 thousandths of a frame beside it."""


def recorded(rig: CameraRig, frames: range) -> PeopleObservations:
    """The same walk, each camera by its own clock, which begins when it does."""
    truth_m = joints_m(40)
    images = []
    for c, camera in enumerate(rig.cameras):
        for n in frames:
            at = n + LATE[c]
            if not 0 <= at <= len(truth_m) - 2:
                continue
            before = int(at)
            joints = truth_m[before] + (at - before) * (truth_m[before + 1] - truth_m[before])
            points_px = camera.project(joints)[None]
            images.append(fgpose.people.Detections(camera.name, n / FPS, points_px, np.ones(points_px.shape[:2])))
    return PeopleObservations(SKELETON, rig.names, tuple(images))


def test_images_of_one_moment_come_together() -> None:
    rig = true_rig().with_time_offsets(LATE / FPS)
    people = recorded(true_rig(), range(-10, 60))
    together, on_clock = on_common_clock(people, rig)
    assert not on_clock.time_offsets_s.any()
    # Time by the clock of the first camera, whose frame 0 is the first of the truth.
    for name, late in zip(rig.names, LATE, strict=True):
        np.testing.assert_allclose(together.times_s(name), people.times_s(name) + late / FPS, atol=1e-12)
    seen = together.of_person(together.only())
    complete = np.asarray(seen.seen.all(axis=(1, 2)))
    assert complete.sum() >= 25
    # An image is at most half a frame from its frame: 1.2 m/s / 40 Hz are 30 mm, 7 px at 5 m. Sorted by their own
    # stamps, the images are 17 frames apart: 1 m.
    moments = seen.time_s[complete]
    assert np.ptp(moments, axis=1).max() <= 1 / FPS
    trajectory = fgpose.smooth(seen.frames(complete), on_clock)
    frames = np.round(trajectory.time_s * FPS).astype(int)
    # Images are up to 0.2 frames, 12 mm, beside the time of their frame.
    error_m = np.linalg.norm(trajectory.positions_m - joints_m(40)[frames], axis=-1)
    assert np.median(error_m) < 0.02


def test_frames_of_several_moments_are_put_right() -> None:
    """Given frame by frame, each image with its time: those of a frame were taken up to 17 frames apart."""
    rig = true_rig()
    images = [own[:28] for own in recorded(rig, range(60)).by_camera.values()]
    time_s = np.array([[each.time_s for each in own] for own in images]).T + LATE / FPS
    points2d_px, confidence = (
        np.stack([[getattr(each, name) for each in own] for own in images], axis=1)
        for name in ("points2d_px", "confidence")
    )
    people = PeopleObservations.of_frames(SKELETON, rig.names, time_s, points2d_px, confidence)
    one = people.of_person(people.only())
    together, _ = on_common_clock(one, rig)
    complete = np.isfinite(together.time_s).all(axis=1)
    assert complete.sum() > 10
    assert np.ptp(together.time_s[complete], axis=1).max() <= 1 / FPS
    trajectory = fgpose.smooth(one, rig)
    frames = np.round(trajectory.time_s * FPS).astype(int)
    error_m = np.linalg.norm(trajectory.positions_m - joints_m(40)[frames], axis=-1)
    assert np.nanmedian(error_m) < 0.02


def test_small_offsets_are_left_to_the_estimator() -> None:
    rig = true_rig().with_time_offsets(np.array([0.0, 0.4, -0.4]) / FPS)
    people = recorded(true_rig(), range(20))
    same, same_rig = on_common_clock(people, rig)
    assert same is people
    assert same_rig is rig


def test_the_cameras_must_be_the_same() -> None:
    with pytest.raises(ValueError, match="lacks camera ring_2"):
        on_common_clock(recorded(true_rig(), range(20)), true_rig().subset(["ring_0", "ring_1"]))


def test_people_are_told_apart_by_the_clock_of_the_rig() -> None:
    people = recorded(true_rig(), range(-10, 60))
    late = true_rig().with_time_offsets(LATE / FPS)
    association = smooth_people(people, late, Config(solver={"covariance": False})).association
    assert not association.rig.time_offsets_s.any()
    (person,) = association.people
    assert np.asarray(association.of(person).seen.all(axis=(1, 2))).sum() >= 25
