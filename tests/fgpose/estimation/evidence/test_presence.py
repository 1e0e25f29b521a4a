"""Nothing is written where nobody is: before somebody comes, after they have gone, and while they are away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Bool, Float

import fgpose
from fgpose.estimation.evidence.presence import present
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, Scene, simulate, walking

FPS = 15.0
FAST = fgpose.Config(solver={"covariance": False})


@pytest.mark.parametrize(
    ("seen", "located", "expected"),
    [
        ("0011100", "0011100", "0011100"),  # before they come and after they have gone
        ("1101011", "1101011", "1111111"),  # hidden for a moment
        ("1100011", "1100011", "1100011"),  # away for longer
        ("1100011", "0000011", "0000011"),  # one camera alone sees somebody in an empty room
        ("1111111", "0000001", "1111111"),  # one camera alone, until another one joins it
        ("0000000", "0000000", "0000000"),
    ],
)
def test_a_stay_lasts_from_its_first_to_its_last_sighting(seen: str, located: str, expected: str):
    flags = [np.array([each == "1" for each in text]) for text in (seen, located, expected)]
    # Frames are a second apart: three seconds pass between sightings that have two frames between them.
    np.testing.assert_array_equal(present(flags[0], flags[1], np.arange(7.0), coast_s=3.0), flags[2])


@pytest.fixture(scope="module")
def scene(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> Scene:
    """Seven seconds of a walk."""
    return simulate(walking(105, FPS, skeleton), skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=4)


def without(scene: Scene, gone: Bool[np.ndarray, "frame camera"]) -> fgpose.Observations:
    observations = scene.observations
    points3d_m = None if observations.points3d_m is None else observations.points3d_m.copy()
    points2d_px = observations.points2d_px.copy()
    for array in (points2d_px, points3d_m):
        if array is not None:
            array[gone] = np.nan
    return replace(observations, points2d_px=points2d_px, points3d_m=points3d_m)


def absences(scene: Scene) -> Float[np.ndarray, "frame camera"]:
    """Nobody before 1 s, between 3 and 4.5 s and after 6.2 s; hidden between 2 and 2.4 s."""
    time_s = scene.observations.frame_time_s
    gone = (time_s < 1) | ((time_s >= 3) & (time_s < 4.5)) | (time_s >= 6.2)
    return np.repeat(gone[:, None], scene.observations.n_cameras, axis=1)


def test_the_smoother_invents_nobody(scene: Scene, rig: fgpose.CameraRig):
    gone, time_s = absences(scene), scene.observations.frame_time_s
    hidden = (time_s >= 2) & (time_s < 2.4)
    smoothed = fgpose.smooth(without(scene, gone | hidden[:, None]), rig, FAST)
    np.testing.assert_array_equal(smoothed.absent, gone.all(axis=1))
    assert np.isnan(smoothed.positions_m[smoothed.absent]).all()
    assert (smoothed.status[hidden] == fgpose.Status.PREDICTED).all()
    error_m = np.linalg.norm(smoothed.positions_m - scene.truth_m, axis=-1)
    # As of a walk without absences: 15 to 25 mm in the other tests.
    assert np.nanmean(error_m[~hidden]) < 0.03


def test_who_is_seen_by_one_camera_in_an_empty_room_is_nobody(scene: Scene, rig: fgpose.CameraRig):
    """A detector that takes a coat for somebody, in one of the cameras."""
    gone = absences(scene)
    gone[(scene.observations.frame_time_s < 1.5), :] = True
    coat = gone.all(axis=1) & (scene.observations.frame_time_s < 0.2)
    gone[coat, 0] = False
    observations = replace(without(scene, gone), points3d_m=None)
    smoothed = fgpose.smooth(observations, rig, FAST)
    assert smoothed.absent[coat].all()


@pytest.mark.slow
def test_live_nobody_is_predicted_for_longer_than_tracking_coast_s(scene: Scene, rig: fgpose.CameraRig):
    gone = np.asarray(absences(scene).all(axis=1))
    estimator = fgpose.Estimator(rig, scene.observations.skeleton, FAST)
    estimates = [estimator.update(frame) for frame in without(scene, absences(scene))]
    absent = np.array([(each.status == fgpose.Status.UNOBSERVABLE).all() for each in estimates])
    time_s = scene.observations.frame_time_s
    last_s = np.array([time_s[: t + 1][~gone[: t + 1]].max(initial=-np.inf) for t in range(len(time_s))])
    np.testing.assert_array_equal(absent, gone & (time_s > last_s + 1.0 + 1e-9))
    back = (time_s >= 4.8) & (time_s < 6.2)
    positions_m = np.stack([each.positions_m for each in estimates])
    # Estimated anew, from two views and more: 20 to 35 mm in the other tests.
    assert np.linalg.norm(positions_m - scene.truth_m, axis=-1)[back].mean() < 0.04


def test_where_nobody_ever_is_everything_is_unobservable(scene: Scene, rig: fgpose.CameraRig):
    nobody = without(scene, np.ones_like(absences(scene)))
    assert fgpose.smooth(nobody, rig, FAST).absent.all()


@pytest.mark.slow
@pytest.mark.parametrize("gap_s", [0.4, 1.5])
def test_live_a_child_who_comes_after_an_adult_has_bones_of_its_own(
    gap_s: float, scene: Scene, rig: fgpose.CameraRig, skeleton: fgpose.Skeleton
):
    """Also where the adult has just gone: nobody runs four metres in 0.4 s."""
    aside_m = np.array([0.0, 2.0, 0.0])
    adult_m, child_m = scene.truth_m[:60] - aside_m, 0.6 * scene.truth_m[:45] + aside_m
    scenes = [simulate(each, skeleton, rig, FPS, DetectionNoise(), NO_OCCLUSION, seed=4) for each in (adult_m, child_m)]
    estimator = fgpose.Estimator(rig, skeleton, FAST)
    for frame in scenes[0].observations:
        estimator.update(frame)
    errors_m = []
    begin_s = 60 / FPS + gap_s
    for seen, truth_m in zip(scenes[1].observations, child_m, strict=True):
        estimate = estimator.update(replace(seen, time_s=seen.time_s + begin_s, points3d_m=None))
        errors_m.append(np.linalg.norm(estimate.positions_m - truth_m, axis=-1))
    # As of anybody; with the bones of the adult it is more than 100 mm.
    assert np.nanmean(errors_m[15:]) < 0.04
    assert np.nanmax(errors_m[15:]) < 0.15
