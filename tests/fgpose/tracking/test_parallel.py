from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from crowds import crowd

import fgpose
from fgpose.estimation.online.clock_offsets import OffsetEvidence
from fgpose.people_observations import Detections
from fgpose.tracking import parallel
from fgpose.tracking.estimator_process import EstimatorProcess
from fgpose.tracking.estimators import Estimators, NewDetections
from fgpose.tracking.parallel import ParallelEstimators
from fgpose_benchmarks.synthetic import CrowdScene

CONFIG = fgpose.Config(online={"lag_s": 0.2}, tracking={"max_processes": 2})


@pytest.fixture(scope="module")
def scene() -> CrowdScene:
    return crowd(2, 3, 2.0, 1)


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "n_cores", lambda: 2)


@pytest.fixture
def estimators(scene: CrowdScene) -> Iterator[ParallelEstimators]:
    shared = ParallelEstimators(scene.rig, scene.motion.skeleton, CONFIG)
    yield shared
    shared.close()


def newest(scene: CrowdScene, frame: int, people: tuple[int, ...]) -> dict[int, NewDetections]:
    """Anybody's detections will do: the first of each camera, for all."""
    images = [scene.observations.by_camera[name][frame] for name in scene.rig.names]
    arrays = {name: np.stack([image.arrays[name][0] for image in images]) for name in images[0].arrays}
    return {person: NewDetections(None, np.full(len(images), images[0].time_s), arrays) for person in people}


def process_ids(estimators: ParallelEstimators) -> list[int]:
    return [process.process_id for process in estimators._others]


@pytest.mark.slow
def test_processes_do_not_change_the_result(scene: CrowdScene):
    """Tidied between updates or not."""
    configs = [fgpose.Config(online={"lag_s": 0.2}, tracking={"max_processes": n}) for n in (1, 2)]
    by_time: dict[float, list[Detections]] = {}
    for image in scene.observations.images:
        by_time.setdefault(image.time_s, []).append(image)
    with (
        fgpose.Tracker(scene.rig, scene.motion.skeleton, configs[0]) as alone,
        fgpose.Tracker(scene.rig, scene.motion.skeleton, configs[1]) as parallel,
    ):
        n_most = 0
        for number, images in enumerate(by_time.values()):
            one, other = alone.update(images), parallel.update(images)
            assert [tracked.person for tracked in one] == [tracked.person for tracked in other]
            for a, b in zip(one, other, strict=True):
                np.testing.assert_array_equal(a.estimate.positions_m, b.estimate.positions_m)
                np.testing.assert_array_equal(a.estimate.covariance_m2, b.estimate.covariance_m2)
                assert a.estimate.skeleton == b.estimate.skeleton
            n_most = max(n_most, len(one))
            if number % 2:
                alone.tidy()
                parallel.tidy()
    assert n_most == 2  # one of them in the other process


@pytest.mark.slow
def test_people_are_divided_evenly_and_forgotten(scene: CrowdScene, estimators: ParallelEstimators):
    estimators.update(newest(scene, 0, (5, 7, 9)))
    assert estimators._process_of == {5: 0, 7: 1, 9: 0}
    assert list(estimators.update(newest(scene, 1, (9, 11)))) == [9, 11]
    assert estimators._process_of == {9: 0, 11: 1}
    assert estimators.update({}) == {}
    # Who comes again begins anew: their first frame is 0.
    again = estimators.update(newest(scene, 2, (11, 12)))
    assert [estimate.frame for estimate in again.values()] == [0, 0]


@pytest.mark.slow
def test_a_process_that_ends_is_started_again(scene: CrowdScene, estimators: ParallelEstimators):
    estimators.update(newest(scene, 0, (0, 1)))
    before = estimators.update(newest(scene, 1, (0, 1)))
    assert [estimate.frame for estimate in before.values()] == [1, 1]
    (process_id,) = process_ids(estimators)
    os.kill(process_id, signal.SIGKILL)
    with pytest.warns(UserWarning, match="ended with status -9 and is started again: the estimates of 1 people begin"):
        after = estimators.update(newest(scene, 2, (0, 1)))
    assert [estimate.frame for estimate in after.values()] == [2, 0]
    assert process_ids(estimators) != [process_id]
    assert [each.frame for each in estimators.update(newest(scene, 3, (0, 1))).values()] == [3, 1]


def test_a_process_that_is_stopped_is_replaced(scene: CrowdScene):
    # Not because the time is over, which would be longer than the test may take.
    with contextlib.closing(ParallelEstimators(scene.rig, scene.motion.skeleton, CONFIG)) as estimators:  # pyrefly: ignore[bad-specialization]
        estimators.update(newest(scene, 0, (0, 1)))
        (before,) = process_ids(estimators)
        os.kill(before, signal.SIGSTOP)
        with pytest.warns(UserWarning, match="does not answer and is started again: the estimates of 1 people begin"):
            after = estimators.update(newest(scene, 1, (0, 1)))
        assert [estimate.frame for estimate in after.values()] == [1, 0]
        assert (estimators.n_restarts, process_ids(estimators) == [before]) == (1, False)
        with pytest.raises(ProcessLookupError):
            os.kill(before, 0)


@pytest.mark.slow
def test_a_process_that_ends_while_no_image_comes_is_started_again(scene: CrowdScene, estimators: ParallelEstimators):
    estimators.update(newest(scene, 0, (0, 1)))
    estimators.look()
    (before,) = process_ids(estimators)
    os.kill(before, signal.SIGKILL)
    os.waitid(os.P_PID, before, os.WEXITED | os.WNOWAIT)
    with pytest.warns(UserWarning, match="ended with status -9 and is started again: the estimates of 1 people begin"):
        estimators.look()
    assert (estimators.n_restarts, process_ids(estimators) == [before]) == (1, False)
    assert [each.frame for each in estimators.update(newest(scene, 1, (0, 1))).values()] == [1, 0]


@pytest.mark.slow
def test_nobody_waits_for_a_process_that_starts_again(scene: CrowdScene, estimators: ParallelEstimators):
    estimators.update(newest(scene, 0, (0, 1)))
    (process_id,) = process_ids(estimators)
    os.kill(process_id, signal.SIGKILL)
    with pytest.warns(UserWarning, match="is started again"):
        estimators.update(newest(scene, 1, (0, 1)))
    (process_id,) = process_ids(estimators)
    # It cannot be ready: while it is stopped everybody is estimated here, also who is new.
    os.kill(process_id, signal.SIGSTOP)
    assert [each.frame for each in estimators.update(newest(scene, 2, (0, 1, 2))).values()] == [2, 1, 0]
    assert set(estimators._process_of.values()) == {0}
    os.kill(process_id, signal.SIGCONT)
    end_s = time.monotonic() + 120.0
    while not estimators._others[0].takes_people and time.monotonic() < end_s:
        time.sleep(0.01)
    assert [each.frame for each in estimators.update(newest(scene, 3, (0, 1, 3))).values()] == [3, 2, 0]
    assert estimators._process_of == {0: 0, 1: 0, 3: 1}


@pytest.mark.slow
def test_processes_end_with_the_tracker(scene: CrowdScene):
    estimators = ParallelEstimators(scene.rig, scene.motion.skeleton, CONFIG)
    (process_id,) = process_ids(estimators)
    os.kill(process_id, 0)
    del estimators
    with pytest.raises(ProcessLookupError):
        os.kill(process_id, 0)


@pytest.mark.slow
def test_errors_of_the_other_process_are_raised_here(scene: CrowdScene):
    process = EstimatorProcess(scene.rig, scene.motion.skeleton, CONFIG)
    wrong = NewDetections("door", 0.0, {"points2d_px": np.zeros((17, 2))})
    assert process.send({0: wrong}, (np.zeros(3), np.zeros(3), OffsetEvidence.nothing(3)))
    with pytest.raises(ValueError, match="door"):
        process.receive()
    process.close()
    process.close()


def test_what_one_estimator_raises_delays_nobody(scene: CrowdScene, estimators: ParallelEstimators):
    """An answer that is not read would be taken for that of the next update, for ever."""
    estimators.update(newest(scene, 0, (0, 1)))
    wrong = NewDetections("door", 0.0, {"points2d_px": np.zeros((17, 2))})
    with pytest.raises(ValueError, match="door"):
        estimators.update(newest(scene, 1, (0, 1)) | {0: wrong})
    after = newest(scene, 2, (0, 1))
    times_s = {person: estimate.time_s for person, estimate in estimators.update(after).items()}
    assert times_s == {person: float(np.mean(new.time_s)) for person, new in after.items()}


def test_one_core_starts_no_process(scene: CrowdScene, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parallel, "n_cores", lambda: 1)
    estimators = ParallelEstimators(scene.rig, scene.motion.skeleton, CONFIG)
    assert process_ids(estimators) == []
    images = newest(scene, 0, (0, 1))
    here = Estimators(scene.rig, scene.motion.skeleton, CONFIG).update(images)
    for person, estimate in estimators.update(images).items():
        np.testing.assert_array_equal(estimate.positions_m, here[person].positions_m)


@pytest.mark.slow
def test_the_motion_of_all_people_tells_of_the_clocks(scene: CrowdScene):
    """Each process has the evidence of the others one update later, and that of those who have left is forgotten."""
    learning = CONFIG.replace(online={"estimate_time_offsets": True})
    estimators = ParallelEstimators(scene.rig, scene.motion.skeleton, learning)
    alone = Estimators(scene.rig, scene.motion.skeleton, learning)
    for frame in range(30):
        estimators.update(newest(scene, frame, (0, 1)))
        alone.update(newest(scene, frame, (0,)))
        estimators.tidy()
        alone.tidy()
    offsets, (process,) = estimators.offsets, estimators._others
    assert np.diag(alone.offsets.evidence.information)[1:].all()
    # Both people are given the same detections. Twice the evidence makes other offsets, and those other poses.
    assert np.trace(offsets.evidence.information) == pytest.approx(np.trace(alone.offsets.evidence.information), 0.1)
    np.testing.assert_array_equal(offsets.elsewhere.information, process.told.information)
    assert np.trace(process.told.information) == pytest.approx(np.trace(offsets.evidence.information), 0.1)
    for frame in (30, 31):
        estimators.update(newest(scene, frame, (0,)))
    assert not offsets.elsewhere.information.any()
    estimators.close()


@pytest.mark.slow
def test_a_process_that_ends_while_nobody_is_there_is_started_again(scene: CrowdScene, estimators: ParallelEstimators):
    (before,) = process_ids(estimators)
    os.kill(before, signal.SIGKILL)
    os.waitid(os.P_PID, before, os.WEXITED | os.WNOWAIT)
    with pytest.warns(UserWarning, match="ended with status -9"):
        assert estimators.update({}) == {}
    (after,) = process_ids(estimators)
    assert after != before
    assert estimators.update(newest(scene, 0, (0, 1))).keys() == {0, 1}
