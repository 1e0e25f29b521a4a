"""Two videos of one camera are told from two cameras side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.calibration.from_people.starts.same_view import shows_the_same
from fgpose.calibration.from_people.starts.starts import GivenStart, find_starts
from fgpose.calibration.from_people.starts.views import View
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic import WalkScene, film, ring_rig, walkers

RING = ring_rig(2, 4.5, 1.9)


def moved(camera: Camera, name: str, right_m: float) -> Camera:
    pose = camera.world_T_camera.copy()
    pose[:3, 3] += right_m * pose[:3, 0]
    return replace(camera, name=name, world_T_camera=pose)


@pytest.fixture(scope="module")
def scene() -> WalkScene:
    """A camera, another detection of its video, a camera 0.1 m beside it, and one on the other side of the walker."""
    first, opposite = RING.cameras
    rig = CameraRig((first, moved(first, "again", 0.0), moved(first, "beside", 0.1), opposite))
    return film(walkers((4.0, 4.0), 8.0, 3), rig, 3)


@pytest.fixture(scope="module")
def views(scene: WalkScene) -> list[View]:
    tracks = main_tracks(find_tracks(scene.observations), scene.observations.skeleton)
    return [View.of(track, camera) for track, camera in zip(tracks, scene.intrinsics.cameras, strict=True)]


def test_another_detection_of_the_same_video(views: list[View]) -> None:
    first, again = views[:2]
    assert shows_the_same(first, again, 0.0)
    # Its clock began 3 s later, which is known to 0.05 s.
    later = replace(again, time_s=again.time_s - 3.0)
    assert shows_the_same(first, later, 3.05)


@pytest.mark.parametrize("noise_px", [0.0, 0.5, 3.0])
def test_a_copy_and_another_encoding(views: list[View], scene: WalkScene, noise_px: float) -> None:
    noise = np.random.default_rng(0).normal(0.0, noise_px / scene.intrinsics.focal_px[0], views[0].xy.shape)
    assert shows_the_same(views[0], replace(views[0], xy=views[0].xy + noise), 0.0)


def test_two_cameras_side_by_side_and_face_to_face(views: list[View]) -> None:
    for other in views[2:]:
        assert not shows_the_same(views[0], other, 0.0)


def test_who_is_at_another_time_in_the_same_place(views: list[View]) -> None:
    # The second half of a walk as if it were the first.
    first = views[0]
    half_s = 4.0
    late = replace(first, time_s=first.time_s - half_s)
    assert not shows_the_same(first, late, 0.0)


def test_synchronised_cameras_are_compared_too(scene: WalkScene) -> None:
    tracks = main_tracks(find_tracks(scene.observations), scene.observations.skeleton)
    given = {name: GivenStart(0.0) for name in scene.rig.names}
    starts = find_starts(tracks, scene.observations.skeleton, scene.intrinsics, given)
    assert starts.trusted.tolist() == [True, False, True, True]
    assert np.isnan(starts.offsets_s[1])
    (finding,) = starts.findings
    assert (finding.camera, finding.reason) == (
        "again",
        f"it shows the same image as {RING.names[0]}: both videos seem to be of one camera",
    )
