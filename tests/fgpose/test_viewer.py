"""The Rerun recordings: read back without a viewer, a window or a browser."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.trajectory import Estimate, Status, Trajectory, reprojection_residual_px
from fgpose.viewer import NullRecording, Recording, open_recording

pytest.importorskip("rerun")

N_FRAMES = 6
SKELETON = load_skeleton("coco_17")
LEFT_WRIST = SKELETON.index("left_wrist")
LEFT_ELBOW = SKELETON.index("left_elbow")
# What is logged in single precision differs by 2^-24 of its size: 1e-3 px of 2000, 1e-6 m of 10.
PIXEL_TOLERANCE = 1e-3
METRE_TOLERANCE = 1e-6


@pytest.fixture(autouse=True)
def strict_and_silent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rerun raises instead of logging, and finds no home to write analytics into."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr("rerun.error_utils._strict_mode", True)


def camera(name: str, x_m: float) -> Camera:
    """A camera at (x, -4, 1) that looks along the world's y axis, z up, with a visible lens distortion."""
    K = np.array([[900.0, 0, 320], [0, 880.0, 240], [0, 0, 1]])
    R = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return Camera.from_world_to_camera(name, (640, 480), K, R, -R @ np.array([x_m, -4.0, 1.0]), (-0.1, 0.02, 0.0, 0.0))


@pytest.fixture
def rig() -> CameraRig:
    return CameraRig((camera("cam 1", -0.5), camera("cam_2", 0.5)))


@pytest.fixture
def trajectory(rig: CameraRig, observations: Observations) -> Trajectory:
    """Joints that move; the left wrist is missing in frames 2 and 3, the left elbow predicted in frame 3."""
    positions_m = true_positions_m()
    positions_m[2:4, LEFT_WRIST] = np.nan
    status = np.full((N_FRAMES, SKELETON.n_joints), Status.OBSERVED)
    status[2:4, LEFT_WRIST] = Status.UNOBSERVABLE
    status[3, LEFT_ELBOW] = Status.PREDICTED
    covariance_m2 = np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (*status.shape, 3, 3)).copy()
    covariance_m2[2:4, LEFT_WRIST] = np.nan
    residual_px = reprojection_residual_px(observations, rig, positions_m)
    return Trajectory(SKELETON, time_s(), positions_m, status, covariance_m2, residual_px, rig.names)


@pytest.fixture
def observations(rig: CameraRig) -> Observations:
    """The true joints 3 px off in the distorted images; camera 2 does not see the left wrist in frame 4."""
    projected_px = rig.project(true_positions_m())
    points2d_px = np.stack([cam.distort(projected_px[:, c]) for c, cam in enumerate(rig.cameras)], axis=1) + 3.0
    points2d_px[4, 1, LEFT_WRIST] = np.nan
    points3d_m = np.repeat(true_positions_m()[:, None], 2, axis=1)
    return Observations(SKELETON, time_s(), points2d_px, points3d_m=points3d_m, camera_names=rig.names)


def true_positions_m() -> np.ndarray:
    rng = np.random.default_rng(0)
    start_m = rng.uniform(-0.4, 0.4, (SKELETON.n_joints, 3)) + np.array([0.0, 0.0, 1.0])
    return start_m + np.linspace(0, 0.3, N_FRAMES)[:, None, None]


def time_s() -> np.ndarray:
    return 10.0 + np.arange(N_FRAMES) / 50


def estimate_of(trajectory: Trajectory, frame: int, smoothed: Estimate | None = None) -> Estimate:
    assert trajectory.covariance_m2 is not None
    assert trajectory.residual_px is not None
    return Estimate(
        SKELETON,
        frame,
        float(trajectory.time_s[frame]),
        trajectory.positions_m[frame],
        trajectory.status[frame],
        trajectory.covariance_m2[frame],
        trajectory.residual_px[frame],
        smoothed,
    )


def entities(path: Path) -> set[str]:
    from rerun.chunk import RrdReader

    return {str(chunk.entity_path) for chunk in RrdReader(path).stream().to_chunks()}


def rows(path: Path, entity: str, component: str) -> dict[int, tuple[float, Any]]:
    """By frame: time in seconds and the component's values."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream().filter(content=entity).to_chunks():
        batch = chunk.to_record_batch()
        if "frame" not in batch.schema.names or component not in batch.schema.names:
            continue
        times = batch["time"].cast("int64").to_pylist()
        for frame, nanoseconds, value in zip(
            batch["frame"].to_pylist(), times, batch[component].to_pylist(), strict=True
        ):
            if value is not None:
                found[frame] = (nanoseconds / 1e9, value)
    return found


def values(path: Path, entity: str, component: str) -> list[np.ndarray]:
    """The component's values in every frame, in order."""
    found = rows(path, entity, component)
    return [np.array(found[frame][1]) for frame in sorted(found)]


@pytest.fixture
def batch_file(tmp_path: Path, rig: CameraRig, observations: Observations, trajectory: Trajectory) -> Path:
    path = tmp_path / "batch.rrd"
    with open_recording(path, rig, SKELETON, ("fused", "smoothed")) as recording:
        assert not path.exists()
        recording.log_observations(observations, np.full((N_FRAMES, 2, SKELETON.n_joints), 0.5))
        recording.log_trajectory("fused", trajectory)
        recording.log_trajectory("smoothed", trajectory)
        recording.log_residuals(time_s(), residuals())
        recording.log_update_times(time_s(), np.arange(1.0, 1 + N_FRAMES))
        recording.log_image("cam_2", 1, 10.02, np.full((480, 640, 3), 128, dtype=np.uint8))
    return path


def residuals() -> dict[str, np.ndarray]:
    shape = (N_FRAMES, SKELETON.n_joints)
    nothing_of_wrist = np.ones(shape)
    nothing_of_wrist[:, LEFT_WRIST] = np.nan
    return {"projection/cam_2": np.full(shape, 5.0), "bones": nothing_of_wrist}


def test_file_has_every_entity_blueprint_and_both_timelines(batch_file: Path) -> None:
    from rerun.chunk import RrdReader

    reader = RrdReader(batch_file)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    assert {column.name for column in reader.store().schema().index_columns()} == {"frame", "time"}
    assert entities(batch_file) >= {
        "/world",
        r"/world/camera/cam\ 1",
        "/world/camera/cam_2/image",
        "/world/camera/cam_2/image/detections",
        "/world/camera/cam_2/image/reprojections/fused",
        r"/world/views/cam\ 1",
        "/world/fused/joints",
        "/world/smoothed/bones",
        "/world/smoothed/covariance",
        "/plots/reprojection_px/smoothed/cam_2",
        "/plots/bone_length/smoothed/upper_arm/left",
        "/plots/bone_length/smoothed/upper_arm/right",
        "/plots/weight/cam_2",
        "/plots/residual/left_wrist",
        "/plots/update_ms",
        "/status/smoothed/left_wrist",
        "/residuals",
    }


def test_positions_are_those_logged_and_missing_joints_are_left_out(batch_file: Path, trajectory: Trajectory) -> None:
    found = rows(batch_file, "/world/smoothed/joints", "Points3D:positions")
    assert sorted(found) == list(range(N_FRAMES))
    for frame, (seconds, positions_m) in found.items():
        assert seconds == pytest.approx(trajectory.time_s[frame], abs=1e-9)  # nanoseconds are whole numbers
        known = np.isfinite(trajectory.positions_m[frame]).all(axis=-1)
        np.testing.assert_allclose(positions_m, trajectory.positions_m[frame, known], atol=METRE_TOLERANCE)
    joints = values(batch_file, "/world/smoothed/joints", "Points3D:keypoint_ids")
    assert [LEFT_WRIST in of_frame for of_frame in joints] == [True, True, False, False, True, True]


def test_bones_of_a_missing_joint_are_left_out(batch_file: Path) -> None:
    strips = values(batch_file, "/world/smoothed/bones", "LineStrips3D:strips")
    n_bones = len(SKELETON.bones) + len(SKELETON.lines)
    assert [len(of_frame) for of_frame in strips] == [n_bones, n_bones, n_bones - 1, n_bones - 1, n_bones, n_bones]


def test_predicted_joints_are_thinner_and_paler(batch_file: Path) -> None:
    # Frame 3 lacks the left wrist, which comes after the left elbow.
    radii = values(batch_file, "/world/smoothed/joints", "Points3D:radii")[3]
    colours = values(batch_file, "/world/smoothed/joints", "Points3D:colors")[3]
    others = np.arange(len(radii)) != LEFT_ELBOW
    assert (radii[LEFT_ELBOW] < radii[others]).all()
    assert (colours[LEFT_ELBOW] != colours[others]).all()


def test_status_shows_when_a_joint_is_missing(batch_file: Path) -> None:
    found = rows(batch_file, "/status/smoothed/left_wrist", "StateChange:state")
    assert {frame: state for frame, (_, state) in found.items()} == {2: ["unobservable"], 4: [""]}
    found = rows(batch_file, "/status/smoothed/left_elbow", "StateChange:state")
    assert {frame: state for frame, (_, state) in found.items()} == {3: ["predicted"], 4: [""]}


def test_reprojections_and_detections_are_undistorted_pixels(
    batch_file: Path, rig: CameraRig, trajectory: Trajectory, observations: Observations
) -> None:
    reprojected_px = values(batch_file, "/world/camera/cam_2/image/reprojections/fused", "Points2D:positions")
    detected_px = values(batch_file, "/world/camera/cam_2/image/detections", "Points2D:positions")
    expected_px = rig.project(trajectory.positions_m)[:, 1]
    undistorted_px = rig.undistort(observations.points2d_px)[:, 1]
    for frame in range(N_FRAMES):
        known = np.isfinite(expected_px[frame]).all(axis=-1)
        np.testing.assert_allclose(reprojected_px[frame], expected_px[frame, known], atol=PIXEL_TOLERANCE)
        seen = observations.seen[frame, 1]
        np.testing.assert_allclose(detected_px[frame], undistorted_px[frame, seen], atol=PIXEL_TOLERANCE)


def test_ellipsoids_hold_ninety_percent(batch_file: Path) -> None:
    half_sizes_m = values(batch_file, "/world/smoothed/covariance", "Ellipsoids3D:half_sizes")
    # chi2 with 3 degrees of freedom: P(x < 6.251) = 0.9; the table's four digits give 1e-4 of 7.5 cm.
    expected_m = np.sqrt(6.251) * np.array([0.01, 0.02, 0.03])
    np.testing.assert_allclose(half_sizes_m[0], np.tile(expected_m, (SKELETON.n_joints, 1)), atol=1e-5)
    assert len(half_sizes_m[2]) == SKELETON.n_joints - 1


def test_turned_covariance_keeps_its_axes(tmp_path: Path, rig: CameraRig) -> None:
    from scipy.spatial.transform import Rotation

    turn = Rotation.random(SKELETON.n_joints, np.random.default_rng(0)).as_matrix()
    covariance_m2 = (turn @ np.diag([1e-4, 4e-4, 9e-4]) @ turn.transpose(0, 2, 1))[None]
    status = np.full((1, SKELETON.n_joints), Status.OBSERVED)
    result = Trajectory(SKELETON, time_s()[:1], true_positions_m()[:1], status, covariance_m2)
    with open_recording(tmp_path / "turned.rrd", rig, SKELETON, ("smoothed",)) as recording:
        recording.log_trajectory("smoothed", result)
    entity = "/world/smoothed/covariance"
    (quaternions,) = values(tmp_path / "turned.rrd", entity, "Ellipsoids3D:quaternions")
    (half_sizes_m,) = values(tmp_path / "turned.rrd", entity, "Ellipsoids3D:half_sizes")
    axes = Rotation.from_quat(quaternions).as_matrix() * half_sizes_m[:, None]
    # Single precision, variances of 1e-3 m^2.
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1) / 6.251, covariance_m2[0], atol=1e-6)


def test_plots_show_errors_lengths_weights_and_times(batch_file: Path, trajectory: Trajectory) -> None:
    def plot(entity: str) -> np.ndarray:
        return np.stack(values(batch_file, entity, "Scalars:scalars"))

    assert trajectory.residual_px is not None
    expected_px = np.nanmedian(trajectory.residual_px[:, 1], axis=-1)
    np.testing.assert_allclose(plot("/plots/reprojection_px/smoothed/cam_2")[:, 0], expected_px)
    lengths_m = SKELETON.bone_lengths(trajectory.positions_m)[:, SKELETON.bones.index((LEFT_ELBOW, LEFT_WRIST))]
    np.testing.assert_allclose(plot("/plots/bone_length/smoothed/lower_arm/left")[:, 0], lengths_m)
    weight = plot("/plots/weight/cam_2")[:, 0]
    # Two equal views share a joint evenly; what only the other view sees is not this one's.
    np.testing.assert_allclose(weight, 0.5)
    np.testing.assert_array_equal(plot("/plots/update_ms")[:, 0], np.arange(1.0, 1 + N_FRAMES))


def test_weights_are_relative_to_the_best_view(tmp_path: Path, rig: CameraRig, observations: Observations) -> None:
    weights = np.ones((N_FRAMES, 2, SKELETON.n_joints))
    weights[:, 1] = 1e-3
    with open_recording(tmp_path / "weights.rrd", rig, SKELETON) as recording:
        recording.log_observations(observations, weights)
    trusted, distrusted = (
        values(tmp_path / "weights.rrd", f"/world/camera/{name}/image/detections", "Points2D:colors")[0]
        for name in (r"cam\ 1", "cam_2")
    )
    assert len(set(trusted)) == len(set(distrusted)) == 1
    assert trusted[0] != distrusted[0]


def test_residuals_by_factor(batch_file: Path) -> None:
    of_wrist = np.stack(values(batch_file, "/plots/residual/left_wrist", "Scalars:scalars"))
    np.testing.assert_array_equal(of_wrist, np.tile([5.0, np.nan], (N_FRAMES, 1)))
    table = values(batch_file, "/residuals", "TextDocument:text")[0][0]
    assert "| left_wrist | **5.0** |  |" in table
    assert "| nose | **5.0** | 1.0 |" in table


def test_image_is_compressed_and_undistorted(batch_file: Path) -> None:
    import cv2

    (blob,) = values(batch_file, "/world/camera/cam_2/image", "EncodedImage:blob")
    picture = cv2.imdecode(np.asarray(blob[0], dtype=np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    # JPEG at quality 80 changes a flat grey by less than 3 of 255.
    assert abs(int(picture[240, 320, 0]) - 128) < 3


def test_live_file_is_complete_although_nobody_watches(
    tmp_path: Path, rig: CameraRig, observations: Observations, trajectory: Trajectory
) -> None:
    path = tmp_path / "live.rrd"
    with open_recording(path, rig, SKELETON, ("smoothed", "online"), live=True, port=0) as recording:
        assert recording.viewer_url is not None
        assert "127.0.0.1" in recording.viewer_url
        for frame in range(N_FRAMES):
            lagged = estimate_of(trajectory, frame - 2) if frame >= 2 else None
            recording.log_estimate(
                estimate_of(trajectory, frame, lagged),
                observations.frames(slice(frame, frame + 1)),
                np.ones((2, SKELETON.n_joints)),
                update_ms=4.0,
                residuals={"bones": np.ones(SKELETON.n_joints)},
            )
    assert recording.viewer_url is None
    newest = rows(path, "/world/online/joints", "Points3D:positions")
    assert sorted(newest) == list(range(N_FRAMES))
    assert newest[5][0] == pytest.approx(time_s()[5], abs=1e-9)  # nanoseconds are whole numbers
    np.testing.assert_allclose(newest[5][1], trajectory.positions_m[5], atol=METRE_TOLERANCE)
    assert sorted(rows(path, "/world/smoothed/joints", "Points3D:positions")) == [0, 1, 2, 3]
    states = rows(path, "/status/online/left_wrist", "StateChange:state")
    assert {frame: state for frame, (_, state) in states.items()} == {2: ["unobservable"], 4: [""]}
    assert len(rows(path, "/plots/update_ms", "Scalars:scalars")) == N_FRAMES
    assert len(rows(path, "/world/camera/cam_2/image/detections", "Points2D:positions")) == N_FRAMES


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # endless: that is the price
def test_live_and_batch_recordings_have_the_same_values(
    tmp_path: Path, rig: CameraRig, batch_file: Path, trajectory: Trajectory
) -> None:
    path = tmp_path / "live.rrd"
    with open_recording(path, rig, SKELETON, ("online",), endless=True) as recording:
        for frame in range(N_FRAMES):
            recording.log_estimate(estimate_of(trajectory, frame))
    for entity, component in (("joints", "Points3D:positions"), ("bones", "LineStrips3D:strips")):
        live = rows(path, f"/world/online/{entity}", component)
        assert live == rows(batch_file, f"/world/smoothed/{entity}", component)


def test_frame_without_any_joint_shows_nothing(tmp_path: Path, rig: CameraRig) -> None:
    nothing = Trajectory(
        SKELETON,
        time_s()[:1],
        np.full((1, SKELETON.n_joints, 3), np.nan),
        np.full((1, SKELETON.n_joints), Status.UNOBSERVABLE),
        np.full((1, SKELETON.n_joints, 3, 3), np.nan),
        np.full((1, 2, SKELETON.n_joints), np.nan),
        rig.names,
    )
    with open_recording(tmp_path / "empty.rrd", rig, SKELETON) as recording:
        recording.log_trajectory("smoothed", nothing)
    found = rows(tmp_path / "empty.rrd", "/world/smoothed/joints", "Points3D:positions")
    assert found[0][1] == []


def test_nothing_is_left_after_an_error_and_the_old_file_stays(tmp_path: Path, rig: CameraRig) -> None:
    path = tmp_path / "out.rrd"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), open_recording(path, rig, SKELETON):
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]


def test_interrupted_live_session_keeps_its_file(tmp_path: Path, rig: CameraRig) -> None:
    path = tmp_path / "out.rrd"
    with pytest.raises(KeyboardInterrupt), open_recording(path, rig, SKELETON):
        raise KeyboardInterrupt
    assert "/world" in entities(path)


@pytest.mark.skipif(os.name != "posix", reason="a file as a folder fails alike on every POSIX system")
def test_unwritable_path_is_named(tmp_path: Path, rig: CameraRig) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"cannot write results into .*file"):
        open_recording(tmp_path / "file" / "out.rrd", rig, SKELETON)


def test_taken_port_is_named_and_leaves_no_file(tmp_path: Path, rig: CameraRig) -> None:
    import socket

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=f"127.0.0.1:{port}.*another port"):
            open_recording(tmp_path / "out.rrd", rig, SKELETON, live=True, port=port)
    assert [file for file in tmp_path.iterdir() if file.is_file()] == []


def test_bad_input_is_refused(
    tmp_path: Path, rig: CameraRig, observations: Observations, trajectory: Trajectory
) -> None:
    other = load_skeleton("h36m_17")
    with pytest.raises(ValueError, match="none of them camera or views"):
        open_recording(tmp_path / "a.rrd", rig, SKELETON, ("views",))
    with open_recording(tmp_path / "b.rrd", rig, SKELETON) as recording:
        with pytest.raises(ValueError, match="fused, refined, smoothed, not for 'online'"):
            recording.log_trajectory("online", trajectory)
        with pytest.raises(ValueError, match="the calibration has no camera cam_9"):
            recording.log_image("cam_9", 0, 0.0, np.zeros((480, 640, 3), dtype=np.uint8))
        with pytest.raises(ValueError, match="camera cam_2, frame 7: the picture is 64 x 48"):
            recording.log_image("cam_2", 7, 0.0, np.zeros((48, 64, 3), dtype=np.uint8))
        with pytest.raises(ValueError, match="weights must be"):
            recording.log_observations(observations, np.ones((1, 2, SKELETON.n_joints)))
        with pytest.raises(ValueError, match="residuals of bones must be"):
            recording.log_residuals(time_s(), {"bones": np.ones((N_FRAMES, 3))})
    with pytest.raises(ValueError, match="closed"):
        recording.log_trajectory("smoothed", trajectory)
    with (
        open_recording(tmp_path / "c.rrd", rig, other) as recording,
        pytest.raises(ValueError, match="joints of skeleton coco_17"),
    ):
        recording.log_trajectory("smoothed", trajectory)


def test_recording_to_nowhere_takes_everything(
    rig: CameraRig, observations: Observations, trajectory: Trajectory
) -> None:
    recording = open_recording(None, rig, SKELETON)
    assert isinstance(recording, NullRecording)
    with recording:
        recording.log_observations(observations)
        recording.log_trajectory("anything", trajectory)
        recording.log_residuals(time_s(), residuals())
        recording.log_update_times(time_s(), np.ones(N_FRAMES))
        recording.log_image("cam_2", 0, 0.0, np.zeros((480, 640, 3), dtype=np.uint8))
        recording.log_estimate(estimate_of(trajectory, 0))


def test_every_recording_takes_the_same_calls() -> None:
    from fgpose.viewer.rerun_recording import RerunRecording

    calls = {name for name in vars(Recording) if name.startswith("log_")} | {"close", "discard"}
    assert calls <= set(vars(RerunRecording))
    assert {name for name in vars(RerunRecording) if not name.startswith("_")} <= calls | {"viewer_url"}


def test_viewer_is_loaded_only_when_a_recording_is_opened() -> None:
    import subprocess
    import sys

    code = "import sys, fgpose.viewer; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
