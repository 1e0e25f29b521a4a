"""Detections that come again to the last digit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.estimation.evidence.repeats import RunningRepeats, without_repeats
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, Scene, simulate


def held(seen: fgpose.Observations, camera: int, joints: list[int], frames: slice) -> fgpose.Observations:
    """As from a tracker that holds what it has lost."""
    points_px = seen.points2d_px.copy()
    points_px[frames, camera, joints] = points_px[frames.start - 1, camera, joints]
    return replace(seen, points2d_px=points_px)


def taken(seen: fgpose.Observations) -> fgpose.Observations:
    """As they are left, frame by frame."""
    running, left = RunningRepeats(seen.n_cameras, seen.skeleton.n_joints), []
    for frame in seen:
        left.append(running.without(frame).points2d_px)
        running.add(frame)
    return seen.without(np.asarray(np.isnan(np.concatenate(left)).any(axis=-1)))


@pytest.fixture(scope="module")
def seen(walking_scene: Scene) -> fgpose.Observations:
    return walking_scene.observations


@pytest.mark.parametrize("left", [without_repeats, taken], ids=["batch", "online"])
@pytest.mark.parametrize("joints", [[3], list(range(17))], ids=["a joint", "an image"])
def test_what_is_held_is_left_out(left, joints: list[int], seen: fgpose.Observations) -> None:
    repeated = np.zeros(seen.confidence.shape, dtype=bool)
    repeated[10:20, 1, joints] = True
    found = left(held(seen, 1, joints, slice(10, 20)))
    np.testing.assert_array_equal(found.seen, seen.seen & ~repeated)
    np.testing.assert_array_equal(found.points2d_px[found.seen], seen.points2d_px[found.seen])


def test_of_images_of_one_camera_at_a_time(seen: fgpose.Observations) -> None:
    """As Estimator.update_camera takes them: what the others showed last tells that somebody moves."""
    stalled = held(seen, 1, list(range(17)), slice(10, 20))
    running = RunningRepeats(seen.n_cameras, seen.skeleton.n_joints)
    for number, frame in enumerate(stalled):
        for camera in range(seen.n_cameras):
            others = np.ones(frame.confidence.shape, dtype=bool)
            others[:, camera] = False
            alone = frame.without(others)
            is_left = running.without(alone).seen[0, camera].any()
            assert is_left == (not (camera == 1 and 10 <= number < 20))
            running.add(alone)


@pytest.mark.parametrize("grid_px", [1.0, 0.25])
def test_on_a_grid_whoever_stands_still_comes_again(grid_px: float, seen: fgpose.Observations) -> None:
    coarse = replace(seen, points2d_px=np.round(held(seen, 1, [3], slice(10, 20)).points2d_px / grid_px) * grid_px)
    np.testing.assert_array_equal(without_repeats(coarse).seen, coarse.seen)


def test_where_nothing_moves_all_is_kept(
    rig: fgpose.CameraRig, skeleton: fgpose.Skeleton, walking_scene: Scene
) -> None:
    """Somebody who stands still, seen without noise; and a recording of 15 Hz that was written at 30."""
    still_m = walking_scene.truth_m[:1].repeat(10, axis=0)
    still = simulate(still_m, skeleton, rig, 30.0, NO_NOISE, NO_OCCLUSION, seed=0).observations
    np.testing.assert_array_equal(without_repeats(still).seen, still.seen)
    seen = walking_scene.observations
    twice = replace(seen, points2d_px=seen.points2d_px[np.arange(seen.n_frames) // 2 * 2])
    np.testing.assert_array_equal(without_repeats(twice).seen, twice.seen)


@pytest.mark.parametrize("online", [False, True])
def test_a_walker_is_not_held_back(online: bool, walking_scene: Scene) -> None:
    """Of two cameras that tell where a walker is, one stalls for 0.7 s, in which she goes a metre."""
    rig = walking_scene.rig.subset(walking_scene.rig.names[:3])
    stalled = held(walking_scene.observations, 1, list(range(17)), slice(30, 50))
    stalled = held(stalled, 2, list(range(17)), slice(30, 50)).subset(rig.names)
    stalled = replace(stalled, points3d_m=None)
    if online:
        estimator = fgpose.Estimator(rig, stalled.skeleton)
        positions_m = np.stack([estimator.update(frame).positions_m for frame in stalled])
    else:
        positions_m = fgpose.smooth(stalled, rig).positions_m
    error_m = np.linalg.norm(positions_m - walking_scene.truth_m, axis=-1)[30:50]
    assert np.mean(error_m) < 0.2
