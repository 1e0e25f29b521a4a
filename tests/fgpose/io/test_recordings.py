from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from fgpose.geometry.triangulation import triangulate_robust
from fgpose.io.recordings import load_recording, recordings


@pytest.mark.parametrize(("name", "n_joints"), [("balance_openpose", 25), ("balance_blazepose", 33)])
def test_what_a_recording_holds(name: str, n_joints: int):
    rig, observations = load_recording(name)
    assert name in recordings()
    assert observations.points2d_px.shape == (100, 4, n_joints, 2)
    assert observations.camera_names == rig.names
    np.testing.assert_allclose(np.diff(observations.time_s), 1 / 60)
    assert observations.seen.mean() > 0.9


@pytest.mark.parametrize("name", ["balance_openpose", "balance_blazepose"])
def test_cameras_and_keypoints_belong_together(name: str):
    rig, observations = load_recording(name)
    undistorted_px = rig.undistort(observations.points2d_px[::10])
    triangulation = triangulate_robust(undistorted_px, observations.confidence[::10], rig)
    error_px = np.linalg.norm(rig.project(triangulation.positions_m) - undistorted_px, axis=-1)
    # The detections of this recording triangulate to a median of about 11 px; a mixed-up camera gives hundreds.
    assert np.nanmedian(error_px) < 15


def test_per_view_joints_project_onto_their_landmarks():
    rig, observations = load_recording("balance_blazepose")
    assert observations.points3d_m is not None
    for c, camera in enumerate(rig.cameras):
        error_px = camera.project(observations.points3d_m[:, c]) - camera.undistort(observations.points2d_px[:, c])
        # Single precision of the file: 1e-4 px in the image, and 3e-7 m at 4 m and 1700 px of focal length.
        assert np.nanmax(np.abs(error_px)) < 1e-3


def test_an_unknown_recording_lists_the_known():
    with pytest.raises(ValueError, match="balance_blazepose, balance_openpose"):
        load_recording("walking")


@pytest.mark.parametrize("name", ["balance_openpose", "balance_blazepose"])
def test_licences_come_with_the_data(name: str):
    files = {file.name for file in resources.files("fgpose").joinpath("data", name).iterdir()}
    assert "README.md" in files
    assert any(file.startswith("LICENSE") for file in files)
