"""What a result was made from is found again in its keypoints, whoever else is in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from finished_walk import finished_walk

from fgpose.diagnosis.clock_checks import late_cameras
from fgpose.estimation.evidence.delays import image_motion_px
from fgpose.geometry.camera import CameraRig
from fgpose.io.keypoints import save_observations, save_people_observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.report import FinishedRecording
from fgpose.report.used_detections import used_detections
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory

N_FRAMES = 30
SINGLE_PX = 1e-3  # pixels of a few thousand in single precision, which files have


@pytest.fixture(scope="module")
def walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    """The first second."""
    whole = finished_walk(rig, skeleton)
    names = ("time_s", "positions_m", "status", "covariance_m2", "residual_px", "visibility")
    trajectory = replace(whole.main, **{name: getattr(whole.main, name)[:N_FRAMES] for name in names})
    return FinishedRecording("walk", {0: trajectory}, rig, {0: whole.observations[0].frames(slice(0, N_FRAMES))})


@pytest.fixture(scope="module")
def pair(walk: FinishedRecording) -> tuple[dict[int, Trajectory], dict[int, np.ndarray]]:
    """The walker and somebody 0.3 m beside, whom the last two cameras do not see; what all cameras detected of each."""
    assert walk.rig is not None
    one = walk.main
    positions_m = one.positions_m + np.array([0.0, 0.3, 0.0])
    assert one.residual_px is not None
    error_px = np.random.default_rng(1).normal(scale=4.0, size=(*one.residual_px.shape, 2))
    error_px[:, -2:] = np.nan
    other = replace(one, positions_m=positions_m, residual_px=np.linalg.norm(error_px, axis=-1))
    return {0: one, 3: other}, {0: walk.observations[0].points2d_px, 3: walk.rig.project(positions_m) + error_px}


def recorded(walk: FinishedRecording, seen_px: dict[int, np.ndarray], begin_s: tuple[float, ...]) -> PeopleObservations:
    """Everybody in any order, some with left and right exchanged; the clock of each camera is zero when it begins."""
    rng, mirror = np.random.default_rng(2), walk.main.skeleton.mirror
    images = []
    for t, time_s in enumerate(walk.main.time_s.tolist()):
        for c, name in enumerate(walk.camera_names):
            shown = [px[t, c] for px in seen_px.values() if np.isfinite(px[t, c]).any()]
            rng.shuffle(shown)
            points_px = np.stack([px[mirror] if rng.uniform() < 0.2 else px for px in shown])
            confidence = np.full(points_px.shape[:2], 0.8)
            images.append(Detections(name, time_s - begin_s[c], points_px, confidence))
    return PeopleObservations(walk.main.skeleton, walk.camera_names, tuple(images))


# Equal clocks; cameras that began so far apart that images of one time stamp do not belong together; offsets of less
# than half a frame, by which no images are put together.
@pytest.mark.parametrize("begin_s", [(0.0, 0.0, 0.0, 0.0), (0.0, 61.0, 0.0, -0.5), (0.0, 0.012, 0.0, -0.01)])
def test_everybody_is_found_again(
    walk: FinishedRecording,
    pair: tuple[dict[int, Trajectory], dict[int, np.ndarray]],
    begin_s: tuple[float, ...],
    tmp_path: Path,
) -> None:
    people, seen_px = pair
    assert walk.rig is not None
    save_people_observations(recorded(walk, seen_px, begin_s), tmp_path / "seen.parquet")
    found = used_detections(tmp_path / "seen.parquet", walk.rig.with_time_offsets(np.array(begin_s)), people)
    assert found.keys() == people.keys()
    for number, expected_px in seen_px.items():
        np.testing.assert_allclose(found[number].points2d_px, expected_px, atol=SINGLE_PX)
        np.testing.assert_allclose(found[number].time_s, walk.main.time_s[:, None] + np.zeros(4), atol=1e-6)


def test_only_the_cameras_of_the_result(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    save_observations(walk.observations[0], tmp_path / "seen.npz")
    assert walk.main.residual_px is not None
    residual_px = walk.main.residual_px[:, [2, 0]]
    kept = replace(walk.main, camera_names=("ring_2", "ring_0"), residual_px=residual_px, visibility=None)
    expected_px = walk.observations[0].points2d_px[:, [2, 0]]
    for rig in (walk.rig, walk.rig.subset(("ring_0", "ring_2"))):
        (found,) = used_detections(tmp_path / "seen.npz", rig, {0: kept}).values()
        assert found.camera_names == ("ring_2", "ring_0")
        np.testing.assert_allclose(found.points2d_px, expected_px, atol=SINGLE_PX)


def test_without_errors_in_the_result_the_nearest_count(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    save_observations(walk.observations[0], tmp_path / "seen.npz")
    points = replace(walk.main, residual_px=None, visibility=None, camera_names=())
    (found,) = used_detections(tmp_path / "seen.npz", walk.rig, {0: points}).values()
    np.testing.assert_allclose(found.points2d_px, walk.observations[0].points2d_px, atol=SINGLE_PX)


def test_keypoints_of_another_time_are_refused(walk: FinishedRecording, tmp_path: Path) -> None:
    assert walk.rig is not None
    save_observations(walk.observations[0].frames(slice(0, 20)), tmp_path / "seen.npz")
    with pytest.raises(ValueError, match=r"seen\.npz: no frame at 0\.967 s, where the result has one"):
        used_detections(tmp_path / "seen.npz", walk.rig, {0: walk.main})


def test_a_camera_that_is_known_to_be_late_is_not_suspicious(rig: CameraRig, skeleton: Skeleton) -> None:
    whole = finished_walk(rig, skeleton)
    seen, late_s = whole.observations[0], 0.012
    moved_px = image_motion_px(
        whole.main.positions_m, whole.main.time_s, np.full((whole.main.n_frames, 1), late_s), rig.subset(("ring_1",))
    )
    points2d_px = seen.points2d_px.copy()
    points2d_px[:, 1] += moved_px[:, 0]
    unknown = replace(whole, observations={0: replace(seen, points2d_px=points2d_px)})
    assert [each.subject for each in late_cameras(unknown)] == ["ring_1"]
    time_s = np.repeat(seen.time_s[:, None], rig.n_cameras, axis=1)
    time_s[:, 1] += late_s
    known = replace(whole, observations={0: replace(seen, points2d_px=points2d_px, time_s=time_s)})
    assert not late_cameras(known)


def test_offsets_that_times_hold_already_are_not_counted_twice(walk: FinishedRecording) -> None:
    """The rig says 20 ms, and so do the times of the images, which are by its clock."""
    assert walk.rig is not None
    rig, late_s = walk.rig.with_time_offsets(np.array([0.0, 0.02, 0.0, 0.0])), np.array([0.0, 0.02, 0.0, 0.0])
    trajectory, seen = walk.main, walk.observations[0]
    taken_s = trajectory.time_s[:, None] + late_s
    moved_px = image_motion_px(trajectory.positions_m, trajectory.time_s, taken_s - trajectory.time_s[:, None], rig)
    exact_px = rig.project(trajectory.positions_m) + moved_px
    given = replace(seen, time_s=taken_s, points2d_px=exact_px, confidence=np.ones_like(seen.confidence))
    on_time_px = FinishedRecording("walk", {0: trajectory}, rig, {0: given}).on_time_px(0)
    np.testing.assert_allclose(on_time_px, rig.project(trajectory.positions_m), atol=1e-6)
