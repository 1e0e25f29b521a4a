"""Pictures of the status page: whoever is drawn is where they were when the picture was taken."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from live_frames import live_frame, live_person, standing_m

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import LiveFrame
from fgpose.live.page.status_page import drawn_jpeg
from fgpose.live.pictures_with_people import PicturesWithPeople
from fgpose.overlay.drawing import Drawing
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status
from fgpose.viewer.rerun.palette import person_colour
from fgpose_benchmarks.synthetic import ring_rig

SPEED_M_S = 1.5
BEGIN_S = 1.7e9


@pytest.fixture
def lenses() -> CameraRig:
    """The first camera stands on its side, and all lenses distort by tens of pixels."""
    cameras = list(ring_rig(3, 4.0, 1.5, focal_px=900.0, size_px=(1280, 720)).cameras)
    K = cameras[0].K.copy()
    K[:2, 2] = K[1, 2], K[0, 2]
    cameras[0] = replace(cameras[0], K=K, size_px=(720, 1280))
    return CameraRig(tuple(replace(camera, distortion=np.array([-0.25, 0.06, 0.0, 0.0])) for camera in cameras))


def walker_m(skeleton: Skeleton, time_s: float) -> np.ndarray:
    return standing_m(skeleton, (-0.6 + SPEED_M_S * (time_s - BEGIN_S), 0.4))


def frame_at(skeleton: Skeleton, rig: CameraRig, time_s: float) -> LiveFrame:
    return live_frame(skeleton, [live_person(walker_m(skeleton, time_s), 2)], time_s, cameras=rig.names)


def black(camera: Camera) -> np.ndarray:
    """Half as large as the camera took it, as small pictures are."""
    width, height = camera.size_px
    return np.zeros((height // 2, width // 2, 3), np.uint8)


def shown(pictures: PicturesWithPeople, camera: Camera) -> np.ndarray:
    """(height, width, 3) RGB."""
    picture = pictures.newest(camera.name)
    assert picture is not None
    jpeg = drawn_jpeg(picture, camera, Drawing(load_skeleton("h36m_17"), ellipses=False, numbers=True))
    bgr = np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR))
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def has_joints(image: np.ndarray, camera: Camera, joints_m: np.ndarray, person: int) -> float:
    """Share of the joints where the picture has the colour of the person."""
    scale = image.shape[1] / camera.size_px[0]
    joints_px = np.round(scale * camera.distort(camera.project(joints_m))).astype(int)
    colours = image[joints_px[:, 1], joints_px[:, 0]].astype(float)
    # JPEG mixes the colours of neighbours.
    return float(np.mean(np.linalg.norm(colours - person_colour(person), axis=1) < 90))


@pytest.mark.parametrize("number", [0, 1])
def test_people_are_drawn_where_they_were_when_it_was_taken(lenses: CameraRig, skeleton: Skeleton, number: int) -> None:
    pictures, camera = PicturesWithPeople(lenses), lenses.cameras[number]
    taken_s = BEGIN_S + 0.115
    pictures.add_picture(camera.name, black(camera), taken_s)
    for time_s in BEGIN_S + np.arange(0.0, 0.6, 0.04):
        pictures.add_frame(frame_at(skeleton, lenses, float(time_s)))
    image = shown(pictures, camera)
    width, height = camera.size_px
    # All of the picture, whichever side it stands on.
    assert image.shape == (round(480 * height / max(width, height)), round(480 * width / max(width, height)), 3)
    # Between two frames, although newer ones are known: 0.1 s of way are more than the width of a joint.
    assert has_joints(image, camera, walker_m(skeleton, taken_s), 2) > 0.9
    assert has_joints(image, camera, walker_m(skeleton, taken_s + 0.2), 2) < 0.3


def test_a_picture_waits_for_its_people(lenses: CameraRig, skeleton: Skeleton) -> None:
    pictures, camera = PicturesWithPeople(lenses), lenses.cameras[1]
    assert pictures.cameras == set()
    assert pictures.newest(camera.name) is None
    for time_s in (0.0, 0.04):
        pictures.add_frame(frame_at(skeleton, lenses, BEGIN_S + time_s))
    pictures.add_picture(camera.name, black(camera), BEGIN_S + 0.02)
    before = pictures.newest(camera.name)
    pictures.add_picture(camera.name, black(camera) + np.uint8(60), BEGIN_S + 0.3)
    assert pictures.newest(camera.name) is before
    for time_s in (0.28, 0.32):
        pictures.add_frame(frame_at(skeleton, lenses, BEGIN_S + time_s))
    after = shown(pictures, camera)
    assert np.median(after) == pytest.approx(60, abs=3)
    assert has_joints(after, camera, walker_m(skeleton, BEGIN_S + 0.3), 2) > 0.9
    # Tracking hangs: pictures go on, with nobody whose place is not known.
    pictures.add_picture(camera.name, black(camera) + np.uint8(120), BEGIN_S + 1.4)
    assert shown(pictures, camera).std() < 3
    assert pictures.cameras == {camera.name}


def test_nobody_is_drawn_where_nobody_knows(lenses: CameraRig, skeleton: Skeleton) -> None:
    pictures, camera = PicturesWithPeople(lenses), lenses.cameras[1]
    pictures.add_picture(camera.name, black(camera), np.nan)
    # JPEG may make black a little brighter.
    assert shown(pictures, camera).max() < 3
    # Half a second without a frame.
    for time_s in (0.0, 0.5):
        pictures.add_frame(frame_at(skeleton, lenses, BEGIN_S + time_s))
    pictures.add_picture(camera.name, black(camera), BEGIN_S + 0.25)
    assert shown(pictures, camera).max() < 3
    # A frame whose time is nearly that of the picture is enough.
    pictures.add_picture(camera.name, black(camera), BEGIN_S + 0.49)
    assert has_joints(shown(pictures, camera), camera, walker_m(skeleton, BEGIN_S + 0.5), 2) > 0.9


def test_a_camera_that_is_late_shows_the_people_of_later(lenses: CameraRig, skeleton: Skeleton) -> None:
    late = replace(lenses.cameras[1], time_offset_s=0.06)
    rig = CameraRig((lenses.cameras[0], late, lenses.cameras[2]))
    pictures = PicturesWithPeople(rig)
    for time_s in BEGIN_S + np.arange(0.0, 0.6, 0.04):
        frame = frame_at(skeleton, rig, float(time_s))
        status = tuple(replace(each, motion_offset_s=0.1, motion_sigma_s=0.002) for each in frame.cameras)
        pictures.add_frame(replace(frame, cameras=status))
    pictures.add_picture(late.name, black(late), BEGIN_S + 0.15)
    assert has_joints(shown(pictures, late), late, walker_m(skeleton, BEGIN_S + 0.31), 2) > 0.9


def test_who_is_predicted_is_hollow(lenses: CameraRig, skeleton: Skeleton) -> None:
    pictures, camera = PicturesWithPeople(lenses), lenses.cameras[1]
    frame = frame_at(skeleton, lenses, BEGIN_S)
    predicted = replace(frame.people[0], status=np.full(skeleton.n_joints, Status.PREDICTED))
    pictures.add_frame(replace(frame, people=(predicted,)))
    pictures.add_picture(camera.name, black(camera), BEGIN_S)
    image = shown(pictures, camera)
    assert image.max() > 150
    assert has_joints(image, camera, walker_m(skeleton, BEGIN_S), 2) < 0.3


def test_a_clock_that_is_set_back_begins_again(lenses: CameraRig, skeleton: Skeleton) -> None:
    pictures, camera = PicturesWithPeople(lenses), lenses.cameras[1]
    pictures.add_frame(frame_at(skeleton, lenses, BEGIN_S + 100.0))
    pictures.add_frame(frame_at(skeleton, lenses, BEGIN_S))
    pictures.add_picture(camera.name, black(camera), BEGIN_S)
    assert has_joints(shown(pictures, camera), camera, walker_m(skeleton, BEGIN_S), 2) > 0.9
