"""Files that are given in the place of others are said to be that."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fgpose.io.calibration import load_rig, save_rig, write_lenses
from fgpose.io.keypoints import keypoint_cameras, load_observations
from fgpose.io.keypoints.people_files import save_people_observations
from fgpose.io.keypoints.recording_files import save_observations
from fgpose.io.recordings import load_recording
from fgpose.io.trajectories import load_origin, load_trajectory, load_upright, save_trajectory
from fgpose.monocular.sources import open_sources
from fgpose.people_observations import PeopleObservations
from fgpose.trajectory import Status, Trajectory

RIG, WHOLE = load_recording("balance_openpose")
SEEN = WHOLE[:5]


@pytest.fixture(params=[".npz", ".parquet", ".trc"])
def result(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    positions_m = np.random.default_rng(0).uniform(0, 2, (SEEN.n_frames, SEEN.skeleton.n_joints, 3))
    status = np.full(positions_m.shape[:2], Status.OBSERVED)
    path = tmp_path / f"result{request.param}"
    save_trajectory(Trajectory(SEEN.skeleton, SEEN.time_s, positions_m, status), path)
    return path


@pytest.mark.parametrize("extension", [".npz", ".parquet"])
@pytest.mark.parametrize("everybody", [False, True])
@pytest.mark.parametrize("read", [load_trajectory, load_origin, load_upright])
def test_keypoints_are_no_result(
    tmp_path: Path, extension: str, everybody: bool, read: Callable[[Path], object]
) -> None:
    path = tmp_path / f"seen{extension}"
    if everybody:
        save_people_observations(PeopleObservations.of_one(SEEN), path)
    else:
        save_observations(SEEN, path)
    with pytest.raises(ValueError, match="these are keypoints, not a result: fgpose smooth makes one") as error:
        read(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize("skeleton", [None, "body_25b"])
def test_a_result_is_no_keypoints(result: Path, skeleton: str | None) -> None:
    with pytest.raises(ValueError, match="this is a result, not keypoints") as error:
        load_observations(result, RIG, skeleton, fps=60.0)
    assert str(error.value).startswith(str(result))
    with pytest.raises(ValueError, match="this is a result, not keypoints"):
        keypoint_cameras(result)


def test_exchanged_keypoints_and_calibration_are_said_to_be_that(tmp_path: Path) -> None:
    rig, keypoints = tmp_path / "Calib.toml", tmp_path / "pose"
    save_rig(RIG, rig)
    (keypoints / "cam_01_json").mkdir(parents=True)
    (keypoints / "cam_01_json" / "cam_01_000.json").write_text('{"people": []}')
    with pytest.raises(ValueError, match="pose: a folder with keypoints, not a calibration: were the two exchanged"):
        load_rig(keypoints)
    with pytest.raises(
        ValueError, match=r"Calib.toml: a .toml file holds no keypoints; the calibration is given as rig"
    ):
        load_observations(rig, RIG, fps=60.0)


def test_a_recording_is_no_calibration(result: Path, tmp_path: Path) -> None:
    if result.suffix != ".trc":
        keypoints = tmp_path / f"seen{result.suffix}"
        save_observations(SEEN, keypoints)
        with pytest.raises(ValueError, match=f"seen{result.suffix}: these are keypoints, not a calibration"):
            load_rig(keypoints)
    with pytest.raises(ValueError, match=f"result{result.suffix}: this is a result, not a calibration"):
        load_rig(result)


def test_lenses_are_no_calibration(tmp_path: Path) -> None:
    write_lenses(RIG, tmp_path / "lenses.toml")
    with pytest.raises(
        ValueError, match=r"camera cam_01 has no rotation and translation. If these are lenses only"
    ) as e:
        load_rig(tmp_path / "lenses.toml")
    assert "fgpose calibrate with --intrinsics" in str(e.value)


def test_a_camera_with_two_files_says_what_to_do(tmp_path: Path) -> None:
    for name in ("cam_01.json", "cam_01.npz", "cam_01.mp4", "cam_01.MOV"):
        (tmp_path / name).write_bytes(b"")
    for find in (keypoint_cameras, has_two_videos):
        with pytest.raises(ValueError, match=r"cam_01.* beside it.* rename or move one of the two"):
            find(tmp_path)


def has_two_videos(folder: Path) -> None:
    open_sources(folder, RIG)
