"""Several threads with one estimator, as callbacks of cameras are; and copies of it, which have a lock of their own."""

from __future__ import annotations

import copy
import pickle
import threading

import numpy as np
import pytest

import fgpose
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, simulate, walking
from tests.states import state_of

FPS, N_FRAMES = 25.0, 20


@pytest.fixture(scope="module")
def seen(rig: fgpose.CameraRig, skeleton: fgpose.Skeleton) -> fgpose.Observations:
    return simulate(walking(N_FRAMES, FPS), skeleton, rig, FPS, NO_NOISE, NO_OCCLUSION, seed=0).observations


@pytest.mark.parametrize("solver", ["isam2", "window"])
def test_threads_of_two_cameras_each_wait_for_each_other(
    seen: fgpose.Observations, rig: fgpose.CameraRig, solver: str
) -> None:
    config = fgpose.Config(online={"covariance": False, "lag_s": 0.2, "solver": solver})
    estimator, together = fgpose.Estimator(rig, seen.skeleton, config), threading.Barrier(2)
    failed: list[BaseException] = []

    def give(first: int) -> None:
        for frame in range(N_FRAMES):
            together.wait(timeout=60)
            for camera in range(first, rig.n_cameras, 2):
                try:
                    estimator.update_camera(rig.names[camera], frame / FPS, seen.points2d_px[frame, camera])
                except Exception as error:
                    failed.append(error)

    threads = [threading.Thread(target=give, args=(first,)) for first in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert estimator.newest is not None
    # Without noise; who is somewhere else by a frame is 5 cm away.
    errors_m = np.linalg.norm(estimator.newest.positions_m - walking(N_FRAMES, FPS)[-1], axis=-1)
    assert errors_m.max() < 0.01


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda estimator: pickle.loads(pickle.dumps(estimator))])
def test_a_copy_goes_on_by_itself(seen: fgpose.Observations, rig: fgpose.CameraRig, again) -> None:
    config = fgpose.Config(online={"covariance": False, "lag_s": 0.2, "solver": "window"})
    estimator = fgpose.Estimator(rig, seen.skeleton, config)
    for frame in range(5):
        estimator.update(seen.frames(slice(frame, frame + 1)))
    before, other = state_of(estimator), again(estimator)
    pose = other.update(seen.frames(slice(5, 6)))
    assert state_of(estimator) == before
    np.testing.assert_array_equal(pose.positions_m, estimator.update(seen.frames(slice(5, 6))).positions_m)
