"""Images of several cameras that come one by one, and the frames that they belong to."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.estimation.online.arrivals import Arrivals
from fgpose.estimation.online.window_graph import WindowGraph

STEP_S = 0.02
NAMES = ("a", "b", "c", "d")


class Window:
    """The times of all frames, and of the images in them, as the estimator keeps them."""

    def __init__(self) -> None:
        self.arrivals = Arrivals(NAMES)
        self.frame_time_s: list[float] = []
        self.images_s: list[np.ndarray] = []

    def take(self, camera: int, time_s: float) -> int:
        """The frame of the image."""
        images_s = np.array(self.images_s).reshape(-1, len(NAMES))
        at = self.arrivals.frame_of(camera, time_s, np.array(self.frame_time_s), images_s)
        self.arrivals.took(np.where(np.arange(len(NAMES)) == camera, time_s, np.nan))
        if at is None:
            self.frame_time_s.append(time_s)
            self.images_s.append(np.full(len(NAMES), np.nan))
            at = len(self.frame_time_s) - 1
        self.images_s[at][camera] = time_s
        return at


@pytest.mark.parametrize(
    "offsets_s", [np.zeros(4), np.array([0, 0.005, 0.01, 0.015]), np.array([0, -0.003, 0.004, 0.007])]
)
def test_every_frame_gets_an_image_of_every_camera(offsets_s: np.ndarray) -> None:
    window = Window()
    images = [(frame * STEP_S + offsets_s[camera], camera) for frame in range(10) for camera in range(4)]
    for time_s, camera in sorted(images):
        window.take(camera, time_s)
    assert len(window.frame_time_s) == 10
    assert np.isfinite(window.images_s).all()


def test_cameras_of_different_rates() -> None:
    """A camera at half the rate joins every other frame of the faster one."""
    window = Window()
    for frame in range(12):
        window.take(0, frame * STEP_S)
        if frame % 2 == 0:
            window.take(1, frame * STEP_S + 0.001)
    assert len(window.frame_time_s) == 12
    np.testing.assert_array_equal(np.isfinite(window.images_s)[:, 1], np.arange(12) % 2 == 0)


def test_a_late_image_joins_the_frame_of_its_time() -> None:
    window = Window()
    for frame in range(10):
        window.take(0, frame * STEP_S)
    assert window.take(1, 4 * STEP_S + 0.003) == 4
    assert window.take(2, 7 * STEP_S - 0.004) == 7
    # frame 4 has an image of this camera: the next one it is
    assert window.take(1, 4 * STEP_S + 0.004) == 5


def test_a_lost_image_of_the_fastest_camera_begins_a_frame() -> None:
    window = Window()
    for frame in (0, 1, 2, 4):
        window.take(0, frame * STEP_S)
        window.take(1, frame * STEP_S)
    assert window.take(2, 5 * STEP_S) == 4, "no image of camera a or b at this time"
    assert window.frame_time_s[-1] == 5 * STEP_S


def test_an_image_that_belongs_nowhere_is_refused() -> None:
    window = Window()
    for frame in range(5, 10):
        window.take(0, frame * STEP_S)
    with pytest.raises(
        ValueError,
        match=r"camera b: no frame near 0.02 s .* begins at 0.1 s, and the newest image is of a, 0.16 s ahead; ",
    ):
        window.take(1, STEP_S)
    window.take(1, 7 * STEP_S)
    with pytest.raises(ValueError, match=r"camera b gave an image at 0.14 s before; this one was not used"):
        window.take(1, 7 * STEP_S)


def test_without_any_frame_the_first_image_begins_one() -> None:
    window = Window()
    assert window.take(3, -1.0) == 0
    # nobody knows yet how fast the cameras are
    assert window.take(0, -0.5) == 0
    assert window.take(1, -1.2) == 0
    assert window.take(3, -0.98) == 1


def test_images_seconds_apart_are_of_no_frame_whatever_the_rate() -> None:
    window = Window()
    assert window.take(0, 0.0) == 0
    assert window.take(1, 5.0) == 1


def test_a_time_of_day_is_told_to_the_millisecond(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    now_s, nothing = 1753000000.125, np.full((2, rig.n_cameras, skeleton.n_joints, 2), np.nan)
    with pytest.raises(ValueError, match=r"frame 1 is at 1753000000\.025 s, the one before at 1753000000\.125 s"):
        fgpose.Observations(skeleton, np.array([now_s, now_s - 0.1]), nothing)
    estimator = fgpose.Estimator(rig, skeleton)
    estimator.update_arrays(now_s, nothing[0])
    with pytest.raises(ValueError, match=r"got a frame at 1753000000\.025 s after one at 1753000000\.125 s"):
        estimator.update_arrays(now_s - 0.1, nothing[0])
    no_pixel = np.zeros((0, skeleton.n_joints))
    assert str(fgpose.people.Detections("cam", now_s, np.zeros((0, skeleton.n_joints, 2)), no_pixel)).count(
        "1753000000.125 s"
    )


def test_failures_of_gtsam_are_told_with_each_estimate(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> None:
    estimator, nothing = fgpose.Estimator(rig, skeleton), np.full((rig.n_cameras, skeleton.n_joints, 2), np.nan)
    assert estimator.update_arrays(0.0, nothing).n_repairs == 0
    assert isinstance(estimator._body._window._solver, WindowGraph)
    estimator._body._window._solver._smoother.repairs += 3
    assert estimator.update_arrays(0.1, nothing).n_repairs == estimator.repairs == 3
