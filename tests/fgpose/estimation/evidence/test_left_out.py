"""What was left out is shown: as detections that are of no joint, where they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.config import Config
from fgpose.pipeline.result import show
from fgpose.pipeline.run import run_smooth
from fgpose.pipeline.source import Source
from fgpose.viewer.recording import Recording
from fgpose_benchmarks.synthetic import Scene

AWAY = slice(20, 40)
CAMERAS = [0, 1]
FLIPPED = slice(5, 17)
FLIPPED_CAMERA = 3


@pytest.fixture(scope="module")
def seen(walking_scene: Scene) -> fgpose.Observations:
    """Two views follow somebody else for a while, a third comes again in one frame, and the fourth has its sides
    exchanged for a while."""
    given = walking_scene.observations
    elsewhere_px = walking_scene.rig.project(walking_scene.truth_m + np.array([1.0, 0.8, 0.0]))
    points_px = given.points2d_px.copy()
    points_px[AWAY, CAMERAS] += (elsewhere_px - walking_scene.rig.project(walking_scene.truth_m))[AWAY, CAMERAS]
    points_px[50, 2] = points_px[49, 2]
    points_px[FLIPPED, FLIPPED_CAMERA] = points_px[FLIPPED, FLIPPED_CAMERA][:, given.skeleton.mirror]
    return replace(given, points2d_px=points_px, points3d_m=None)


def smoothed(seen: fgpose.Observations, rig: fgpose.CameraRig) -> fgpose.Trajectory:
    return fgpose.smooth(seen, rig)


def frame_by_frame(seen: fgpose.Observations, rig: fgpose.CameraRig) -> fgpose.Trajectory:
    estimator = fgpose.Estimator(rig, seen.skeleton)
    return fgpose.Trajectory.from_estimates([estimator.update(frame) for frame in seen], camera_names=rig.names)


def image_by_image(seen: fgpose.Observations, rig: fgpose.CameraRig) -> fgpose.Trajectory:
    """Those of a frame one after the other, as they come from cameras that are triggered together."""
    estimator, newest = fgpose.Estimator(rig, seen.skeleton), []
    for number, time_s in enumerate(seen.frame_time_s):
        for c, camera in enumerate(rig.names):
            estimator.update_camera(camera, float(time_s), seen.points2d_px[number, c])
        assert estimator.newest is not None
        newest.append(estimator.newest)
    return fgpose.Trajectory.from_estimates(newest, camera_names=rig.names)


@pytest.mark.parametrize("estimated", [smoothed, frame_by_frame, image_by_image])
def test_they_are_of_no_joint_and_as_far_off_as_they_are(
    estimated, seen: fgpose.Observations, walking_scene: Scene
) -> None:
    found = estimated(seen, walking_scene.rig)
    assert found.visibility is not None
    assert found.residual_px is not None
    np.testing.assert_array_equal(np.isfinite(found.visibility), seen.seen)
    np.testing.assert_array_equal(np.isfinite(found.residual_px), seen.seen)
    assert (found.visibility[AWAY, CAMERAS] == 0).all()
    assert (found.visibility[50, 2] == 0).all()
    assert np.median(found.visibility[AWAY, 2:]) > 0.9
    # 1.3 m away, against 3 px of noise and a pose that is within 0.1 m.
    rig, elsewhere_m = walking_scene.rig, walking_scene.truth_m + np.array([1.0, 0.8, 0.0])
    off_px = np.linalg.norm(rig.project(elsewhere_m) - rig.project(walking_scene.truth_m), axis=-1)
    ratio = found.residual_px[AWAY, CAMERAS] / off_px[AWAY, CAMERAS]
    assert 0.9 < np.median(ratio) < 1.1


@pytest.mark.parametrize("estimated", [smoothed, frame_by_frame, image_by_image])
def test_those_of_the_other_side_are_used_as_such_and_shown_as_they_were_given(
    estimated, seen: fgpose.Observations, walking_scene: Scene
) -> None:
    found = estimated(seen, walking_scene.rig)
    assert found.visibility is not None
    assert found.residual_px is not None
    rig, mirror = walking_scene.rig, seen.skeleton.mirror
    of_a_side = mirror != np.arange(len(mirror))
    projected_px = rig.project(walking_scene.truth_m)[FLIPPED, FLIPPED_CAMERA]
    apart_px = np.linalg.norm(projected_px - projected_px[:, mirror], axis=-1)
    # Farther than noise and errors of the pose, which are a few pixels; where the sides coincide nothing is wrong.
    clear = of_a_side & (apart_px > 60)
    assert clear.sum() > 50
    # Online the first image of them may not be sure yet.
    assert np.mean(found.visibility[FLIPPED, FLIPPED_CAMERA][clear] == 0) > 0.85
    ratio = found.residual_px[FLIPPED, FLIPPED_CAMERA][clear] / apart_px[clear]
    assert 0.9 < np.median(ratio) < 1.1
    assert np.median(found.visibility[FLIPPED, FLIPPED_CAMERA][:, ~of_a_side]) > 0.9


def test_without_any_nothing_is_changed(walking_scene: Scene) -> None:
    given = walking_scene.observations
    found = smoothed(given, walking_scene.rig)
    assert found.visibility is not None
    assert (found.visibility[given.seen] > 0).all()


class Spy(Recording):
    """Remembers which detections are shown."""

    def log_observations(
        self, observations: object, weights: object = None, undistorted_px: object = None, every: int = 1
    ) -> None:
        self.weights, self.undistorted_px = np.asarray(weights), np.asarray(undistorted_px)


def test_the_viewer_shows_them_without_weight(seen: fgpose.Observations, walking_scene: Scene) -> None:
    shown = Spy()
    show(run_smooth(Source(walking_scene.rig, seen), Config()), shown)
    np.testing.assert_array_equal(np.nan_to_num(shown.weights[AWAY, CAMERAS]), 0.0)
    undistorted_px = walking_scene.rig.undistort(seen.points2d_px)
    np.testing.assert_allclose(shown.undistorted_px, undistorted_px, rtol=1e-6)  # single precision
