"""Human3.6M from the folders of h36m-fetch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgpose.io.calibration import save_rig
from fgpose_benchmarks.human36m.h36m_fetch import load_annotations, load_subject_rigs
from tests.benchmarks.human36m.human36m_files import (
    h36m_rig,
    labels,
    motion_of_32,
    truth_of,
    write_annotation,
    write_camera_parameters,
)

RIGS = {"S9": h36m_rig(), "S11": h36m_rig(0.3)}
FRAMES = np.arange(0, 640, 64)


@pytest.fixture(scope="module")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("processed")
    write_annotation(folder, "S9", "Walking-1", FRAMES, RIGS["S9"])
    write_annotation(folder, "S9", "Greeting-2", FRAMES, RIGS["S9"])
    write_annotation(folder, "S11", "Directions-2", FRAMES, RIGS["S11"], without="54138969")
    return folder


def test_sequences_are_in_the_world_of_the_cameras(processed: Path):
    sequences = load_annotations(processed, RIGS)
    assert [each.name for each in sequences] == ["S9/Greeting-2", "S9/Walking-1", "S11/Directions-2"]
    for each in sequences:
        np.testing.assert_array_equal(each.frames, FRAMES)
        np.testing.assert_allclose(each.truth_m, truth_of(motion_of_32(len(FRAMES))), atol=1e-9)


def test_boxes_are_those_of_the_joints_in_the_images(processed: Path):
    walking = load_annotations(processed, RIGS, ["S9"])[1]
    # distorting and projecting back and forth
    np.testing.assert_allclose(walking.boxes_px, walking.joint_boxes_px(), atol=1e-6)


def test_a_view_that_was_dropped_is_missing(processed: Path):
    (directions,) = load_annotations(processed, RIGS, ["S11"])
    assert directions.rig.n_cameras == 4
    assert directions.has_view.all(axis=0).tolist() == [False, True, True, True]
    assert not directions.has_view[:, 0].any()


def test_the_cameras_of_another_subject_are_noticed(processed: Path):
    swapped = {"S9": RIGS["S11"], "S11": RIGS["S9"]}
    # all cameras turned in the same way put all views at one (wrong) place, which no view contradicts; so turn one of
    # them
    cameras = (RIGS["S11"].cameras[0], *RIGS["S9"].cameras[1:])
    wrong = type(RIGS["S9"])(cameras)
    with pytest.raises(ValueError, match=r"Greeting-2/annot\.h5.*calibration of S9.*m apart"):
        load_annotations(processed, swapped | {"S9": wrong})


def test_cameras_come_from_any_of_the_usual_files(tmp_path: Path):
    write_camera_parameters(tmp_path / "camera-parameters.json", RIGS)
    np.save(tmp_path / "labels.npy", np.array(labels({("S9", "Walking-1"): FRAMES}, RIGS), dtype=object))
    (tmp_path / "calibrations").mkdir()
    for subject, rig in RIGS.items():
        save_rig(rig, tmp_path / "calibrations" / f"{subject}.toml")
    for name in ("camera-parameters.json", "labels.npy", "calibrations"):
        rigs = load_subject_rigs(tmp_path / name)
        assert set(rigs) == {"S9", "S11"}
        for subject, rig in rigs.items():
            assert rig.names == RIGS[subject].names
            assert [camera.size_px for camera in rig.cameras] == [camera.size_px for camera in RIGS[subject].cameras]
            matrices = RIGS[subject].projection_matrices
            # single precision in the labels
            np.testing.assert_allclose(rig.projection_matrices, matrices, rtol=1e-5, atol=1e-3)


def test_what_is_wrong_is_said(processed: Path, tmp_path: Path):
    import h5py

    with pytest.raises(ValueError, match=r"there is no S8/ACTION/annot\.h5"):
        load_annotations(processed, RIGS, ["S8"])
    with pytest.raises(ValueError, match="the cameras of S11 are missing; there are those of S9"):
        load_annotations(processed, {"S9": RIGS["S9"]})
    with pytest.raises(ValueError, match="the calibration of S9 has no camera 54138969"):
        load_annotations(processed, RIGS | {"S9": RIGS["S9"].subset(RIGS["S9"].names[1:])})
    path = tmp_path / "S9" / "Eating-1" / "annot.h5"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"no HDF5")
    with pytest.raises(ValueError, match=r"Eating-1/annot\.h5"):
        load_annotations(tmp_path, RIGS, ["S9"])
    with h5py.File(path, "w") as file:
        file["frame"] = np.arange(3)
    with pytest.raises(ValueError, match="not an annotation of h36m-fetch: camera, pose/2d, pose/3d is missing"):
        load_annotations(tmp_path, RIGS, ["S9"])
    (tmp_path / "cameras.json").write_text('{"extrinsics": {"S9": {"54138969": {}}}}')
    with pytest.raises(
        ValueError, match=r"cameras\.json: not the camera parameters of Human3.6M: intrinsics is missing"
    ):
        load_subject_rigs(tmp_path / "cameras.json")
