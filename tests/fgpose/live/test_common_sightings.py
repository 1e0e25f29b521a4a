"""Where cameras see somebody at one instant."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.association.track import Tracked, TrackState
from fgpose.live.tracking.common_sightings import CommonSighting, CommonSightings
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Estimate, Status
from fgpose_benchmarks.synthetic import ring_rig

RIG = ring_rig(3, 4.5, 2.5, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
PX_PER_S = 100.0
PERIOD_S = 0.1


def taken(skeleton: Skeleton, first_s: tuple[float, ...], offsets_s: np.ndarray, sigma_s: np.ndarray) -> CommonSighting:
    """Of somebody whose joints move straight on in all images, from cameras that take them at their own times."""
    sightings, n_joints = CommonSightings(RIG), skeleton.n_joints
    joint, status = np.arange(n_joints), np.full(n_joints, Status.OBSERVED, dtype=np.int8)
    result = None
    for n in range(6):
        for name, begin_s in zip(RIG.names, first_s, strict=True):
            time_s = begin_s + n * PERIOD_S
            image = Detections(name, time_s, np.full((1, n_joints, 2), PX_PER_S * time_s), np.ones((1, n_joints)))
            positions_m = np.tile([time_s, 0.0, 1.0], (n_joints, 1))
            estimate = Estimate(skeleton, n, time_s, positions_m, status)
            seen = {name: (np.zeros(n_joints, dtype=int), joint)}
            sightings.add([image], [Tracked(0, TrackState.CONFIRMED, estimate, seen)])
        result = sightings.take(offsets_s, sigma_s)
    assert result is not None
    return result


def test_all_at_the_newest_time_that_all_have_seen(skeleton: Skeleton) -> None:
    sighting = taken(skeleton, (0.0, 0.03, 0.07), np.zeros(3), np.zeros(3))
    assert (sighting.confidence == 1).all()
    np.testing.assert_allclose(sighting.undistorted_px, PX_PER_S * 0.5)


@pytest.mark.filterwarnings("error")
def test_of_somebody_without_any_joint_nothing_is_known_and_nothing_is_said(skeleton: Skeleton) -> None:
    sightings, n_joints = CommonSightings(RIG), skeleton.n_joints
    unknown = np.full((n_joints, 3), np.nan), np.full(n_joints, Status.UNOBSERVABLE, dtype=np.int8)
    image = Detections(RIG.names[0], 0.0, np.zeros((1, n_joints, 2)), np.ones((1, n_joints)))
    sightings.add([image], [Tracked(0, TrackState.CONFIRMED, Estimate(skeleton, 0, 0.0, *unknown), {})])
    assert sightings.take(np.zeros(3), np.zeros(3)) is None


def test_each_at_its_own_time_where_it_is_known_to_be_late(skeleton: Skeleton) -> None:
    sighting = taken(skeleton, (0.0, 0.0, 0.0), np.array([0.0, 0.0, 0.15]), np.zeros(3))
    np.testing.assert_allclose(sighting.undistorted_px[:, 0, 0], PX_PER_S * np.array([0.5, 0.5, 0.35]))


@pytest.mark.parametrize(("sigma_s", "counts"), [(0.002, True), (0.05, False)])
def test_a_camera_does_not_count_whose_clock_is_not_known_for_this_speed(
    skeleton: Skeleton, sigma_s: float, counts: bool
) -> None:
    """1 m/s at 5 m: 0.4 mrad, and 10 mrad."""
    sighting = taken(skeleton, (0.0, 0.0, 0.0), np.zeros(3), np.array([0.0, 0.0, sigma_s]))
    assert sighting.late_mrad == pytest.approx([0.0, 0.0, 200 * sigma_s], rel=0.3)  # 5 m from the middle of the body
    assert (sighting.of_known_clocks.confidence > 0).all(axis=1).tolist() == [True, True, counts]
