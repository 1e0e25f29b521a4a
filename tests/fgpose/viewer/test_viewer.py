"""The Rerun recordings: read back without a viewer, a window or a browser."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rrd_contents import (
    METRE_TOLERANCE,
    PIXEL_TOLERANCE,
    camera,
    entities,
    rows,
    static_value,
    static_values,
    values,
    view_contents,
    view_origins,
)

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.trajectory import Estimate, Status, Trajectory
from fgpose.viewer import Recording, open_recording
from tests.fgpose.live.output_frames import wait_until

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")

N_FRAMES = 6
SKELETON = load_skeleton("coco_17")
LEFT_WRIST = SKELETON.index("left_wrist")
LEFT_ELBOW = SKELETON.index("left_elbow")


@pytest.fixture(scope="module")
def trajectory(rig: CameraRig, observations: Observations) -> Trajectory:
    """Joints that move; the left wrist is missing in frames 2 and 3, the left elbow predicted in frame 3."""
    positions_m = true_positions_m()
    positions_m[2:4, LEFT_WRIST] = np.nan
    status = np.full((N_FRAMES, SKELETON.n_joints), Status.OBSERVED)
    status[2:4, LEFT_WRIST] = Status.UNOBSERVABLE
    status[3, LEFT_ELBOW] = Status.PREDICTED
    covariance_m2 = np.broadcast_to(np.diag([1e-4, 4e-4, 9e-4]), (*status.shape, 3, 3)).copy()
    covariance_m2[2:4, LEFT_WRIST] = np.nan
    residual_px = reprojection_residual_px(rig.undistort(observations.points2d_px), rig, positions_m)
    return Trajectory(SKELETON, time_s(), positions_m, status, covariance_m2, residual_px, rig.names)


@pytest.fixture(scope="module")
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
        newly_smoothed=() if smoothed is None else (smoothed,),
    )


@pytest.fixture(scope="module")
def batch_file(
    tmp_path_factory: pytest.TempPathFactory, rig: CameraRig, observations: Observations, trajectory: Trajectory
) -> Path:
    path = tmp_path_factory.mktemp("batch") / "batch.rrd"
    with open_recording(path, rig, SKELETON, ("fused", "smoothed")) as recording:
        assert not path.exists()
        recording.log_observations(observations, weights())
        recording.log_trajectory("fused", trajectory)
        recording.log_trajectory("smoothed", trajectory)
        recording.log_residuals(time_s(), residuals())
        recording.log_update_times(time_s(), np.arange(1.0, 1 + N_FRAMES))
        recording.log_image("cam_2", 1, 10.02, np.full((480, 640, 3), 128, dtype=np.uint8))
    return path


def weights(of_views: tuple[float, float] = (0.1, 0.3)) -> np.ndarray:
    """The same for all joints in all frames; the second camera has three times the weight of the first."""
    return np.broadcast_to(np.array(of_views)[:, None], (N_FRAMES, 2, SKELETON.n_joints)).copy()


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
        r"/world/camera/cam\ 1/image/detections",
        "/world/camera/cam_2/image/picture",
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


def test_bones_join_their_joints_and_are_left_out_without_one(batch_file: Path, trajectory: Trajectory) -> None:
    strips = values(batch_file, "/world/smoothed/bones", "LineStrips3D:strips")
    bones = [list(bone) for bone in (*SKELETON.bones, *SKELETON.lines)]
    for frame, found_m in enumerate(strips):
        shown = [bone for bone in bones if frame not in (2, 3) or LEFT_WRIST not in bone]
        np.testing.assert_allclose(found_m, trajectory.positions_m[frame, shown], atol=METRE_TOLERANCE)


def brightness(colours: np.ndarray) -> np.ndarray:
    """Of colours packed as 0xRRGGBBAA."""
    return np.sum([(colours >> shift) & 0xFF for shift in (24, 16, 8)], axis=0)


def test_predicted_joints_and_their_bones_are_thinner_and_paler(batch_file: Path) -> None:
    # Frame 3 lacks the left wrist, which comes after the left elbow, and the bone between the two.
    bones = [bone for bone in (*SKELETON.bones, *SKELETON.lines) if LEFT_WRIST not in bone]
    for entity, archetype, predicted in (
        ("joints", "Points3D", np.arange(SKELETON.n_joints - 1) == LEFT_ELBOW),
        ("bones", "LineStrips3D", np.array([LEFT_ELBOW in bone for bone in bones])),
    ):
        radii = values(batch_file, f"/world/smoothed/{entity}", f"{archetype}:radii")[3]
        colours = values(batch_file, f"/world/smoothed/{entity}", f"{archetype}:colors")[3]
        assert predicted.any()
        assert radii[predicted].max() < radii[~predicted].min()
        # On a dark background.
        assert brightness(colours[predicted]).max() < brightness(colours[~predicted]).min()


def test_joints_and_bones_of_something_small_are_thin(tmp_path: Path, rig: CameraRig, trajectory: Trajectory) -> None:
    path, small = tmp_path / "small.rrd", replace(trajectory, positions_m=0.05 * trajectory.positions_m)
    with open_recording(path, rig, SKELETON, ("smoothed",)) as recording:
        recording.log_trajectory("smoothed", small)
    bones = np.array((*SKELETON.bones, *SKELETON.lines))
    length_m = np.linalg.norm(np.diff(small.positions_m[0, bones], axis=1)[:, 0], axis=-1)
    joint_m = values(path, "/world/smoothed/joints", "Points3D:radii")[0]
    bone_m = values(path, "/world/smoothed/bones", "LineStrips3D:radii")[0]
    # The balls of two joints do not touch, however short the bone between them; they are seen still.
    assert (joint_m[bones].sum(axis=1) < 0.5 * length_m).all()
    assert (bone_m < 0.2 * length_m).all()
    assert min(joint_m.min(), bone_m.min()) > 0


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


def test_the_cameras_stand_where_they_see_what_they_see(batch_file: Path, rig: CameraRig) -> None:
    """Pose and pinhole as they are shown, against the rig without lens distortion."""
    points_m = true_positions_m()[0]
    for seen_by, path in zip(rig.cameras, (r"/world/camera/cam\ 1", "/world/camera/cam_2"), strict=True):
        # Matrices are stored column by column.
        rotation = np.reshape(static_value(batch_file, path, "Transform3D:mat3x3"), (3, 3)).T
        position_m = np.array(static_value(batch_file, path, "Transform3D:translation"))
        K = np.reshape(static_value(batch_file, f"{path}/image", "Pinhole:image_from_camera"), (3, 3)).T
        projected = (points_m - position_m) @ rotation @ K.T
        # Single precision: 1e-7 of 500 px and of metres times 200 px/m.
        np.testing.assert_allclose(projected[:, :2] / projected[:, 2:], seen_by.project(points_m), atol=PIXEL_TOLERANCE)
        assert static_value(batch_file, f"{path}/image", "Pinhole:resolution") == [640, 480]


@pytest.mark.parametrize(
    ("up", "axes"), [("+z", "RIGHT_HAND_Z_UP"), ("z", "RIGHT_HAND_Z_UP"), ("-y", "RIGHT_HAND_Y_DOWN")]
)
def test_up_is_where_it_is_said_to_be(tmp_path: Path, rig: CameraRig, up: Any, axes: str) -> None:
    import rerun as rr

    path = tmp_path / "up.rrd"
    open_recording(path, rig, SKELETON, up=up).close()
    expected = [direction.value for direction in getattr(rr.components.ViewCoordinates, axes).coordinates]
    assert static_value(path, "/world", "ViewCoordinates:xyz") == expected


def test_the_views_own_poses_are_those_logged(batch_file: Path, observations: Observations) -> None:
    assert observations.points3d_m is not None
    for index, name in enumerate((r"cam\ 1", "cam_2")):
        found_m = values(batch_file, f"/world/views/{name}", "Points3D:positions")
        np.testing.assert_allclose(found_m, observations.points3d_m[:, index], atol=METRE_TOLERANCE)


def test_ellipsoids_hold_ninety_percent(batch_file: Path, trajectory: Trajectory) -> None:
    half_sizes_m = values(batch_file, "/world/smoothed/covariance", "Ellipsoids3D:half_sizes")
    # chi2 with 3 degrees of freedom: P(x < 6.251) = 0.9; the table's four digits give 1e-4 of 7.5 cm.
    expected_m = np.sqrt(6.251) * np.array([0.01, 0.02, 0.03])
    np.testing.assert_allclose(half_sizes_m[0], np.tile(expected_m, (SKELETON.n_joints, 1)), atol=1e-5)
    assert len(half_sizes_m[2]) == SKELETON.n_joints - 1
    for frame, centers_m in enumerate(values(batch_file, "/world/smoothed/covariance", "Ellipsoids3D:centers")):
        known = np.isfinite(trajectory.positions_m[frame]).all(axis=-1)
        np.testing.assert_allclose(centers_m, trajectory.positions_m[frame, known], atol=METRE_TOLERANCE)


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
    # The share of a view in the joints that it sees: one to three, and all of what it sees alone.
    np.testing.assert_allclose(plot("/plots/weight/cam_2")[:, 0], 0.75)
    alone = 0.75 / SKELETON.n_joints
    expected = [0.25, 0.25, 0.25, 0.25, 0.25 + alone, 0.25]
    np.testing.assert_allclose(plot(r"/plots/weight/cam\ 1")[:, 0], expected)
    np.testing.assert_array_equal(plot("/plots/update_ms")[:, 0], np.arange(1.0, 1 + N_FRAMES))


def test_weights_are_relative_to_the_best_view(tmp_path: Path, rig: CameraRig, observations: Observations) -> None:
    """In any unit: the best view is yellow, and one of half the weight is not."""

    def colours(name: str, of_views: tuple[float, float]) -> list[np.ndarray]:
        path = tmp_path / f"{name}.rrd"
        with open_recording(path, rig, SKELETON) as recording:
            recording.log_observations(observations, weights(of_views))
        entities = (f"/world/camera/{camera}/image/detections" for camera in (r"cam\ 1", "cam_2"))
        found = [values(path, entity, "Points2D:colors")[0] for entity in entities]
        assert [len(set(of_view.tolist())) for of_view in found] == [1, 1]
        return [of_view[0] for of_view in found]

    best, half = colours("ones", (1.0, 0.5))
    assert best != half
    assert colours("small", (1e-3, 5e-4)) == [best, half]
    assert colours("second", (0.2, 0.4)) == [half, best]


def test_residuals_by_factor(batch_file: Path) -> None:
    of_wrist = np.stack(values(batch_file, "/plots/residual/left_wrist", "Scalars:scalars"))
    np.testing.assert_array_equal(of_wrist, np.tile([5.0, np.nan], (N_FRAMES, 1)))
    table = values(batch_file, "/residuals", "TextDocument:text")[0][0]
    assert "| left_wrist | **5.0** |  |" in table
    assert "| nose | **5.0** | 1.0 |" in table


def pictures(path: Path, camera: str) -> dict[int, np.ndarray]:
    """The camera's decoded pictures by frame, blue first."""
    import cv2

    found = {}
    for frame, (_, blob) in rows(path, f"/world/camera/{camera}/image/picture", "EncodedImage:blob").items():
        file = np.asarray(blob[0], dtype=np.uint8)
        assert file[:3].tolist() == [0xFF, 0xD8, 0xFF]  # how every JPEG file begins
        found[frame] = np.asarray(cv2.imdecode(file, cv2.IMREAD_COLOR))
    return found


def image_with_dots(size_px: tuple[int, int], dots_px: np.ndarray) -> np.ndarray:
    """White dots, 10 px wide, on black; the centre of a pixel is at whole numbers."""
    x, y = np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1]))
    distance_px = np.hypot(x - dots_px[:, 0, None, None], y - dots_px[:, 1, None, None]).min(axis=0)
    grey = 255 * np.clip(5.5 - distance_px, 0, 1)
    return np.repeat(grey[..., None], 3, axis=-1).astype(np.uint8)


def shown_at_px(picture: np.ndarray, shrink: float, offset_px: float, near_px: np.ndarray) -> np.ndarray:
    """Where the viewer shows the middle of the dot near a point: before it is placed, pixel i covers i to i + 1."""
    height, width = picture.shape[:2]
    x, y = np.meshgrid((np.arange(width) + 0.5) * shrink + offset_px, (np.arange(height) + 0.5) * shrink + offset_px)
    # JPEG leaves a little noise around a dot.
    bright = np.where(picture[..., 1] > 40, picture[..., 1].astype(float), 0.0)
    bright[np.hypot(x - near_px[0], y - near_px[1]) > 12] = 0.0
    return np.array([(x * bright).sum(), (y * bright).sum()]) / bright.sum()


@pytest.mark.parametrize("image_width_px", [None, 320, 200])
@pytest.mark.parametrize(("lens", "distortion"), [("pinhole", (-0.4, 0.15, 2e-3, -1e-3)), ("fisheye", (0.0,) * 4)])
def test_pictures_coincide_with_their_points(
    tmp_path: Path, lens: Any, distortion: tuple[float, ...], image_width_px: int | None
) -> None:
    K = np.array([[500.0, 0, 310], [0, 490.0, 250], [0, 0, 1]])
    seen = Camera.from_world_to_camera("cam", (640, 480), K, np.eye(3), np.zeros(3), distortion, lens)
    dots_px = np.array([[130.0, 110], [320, 60], [310, 250], [80, 300], [500.5, 420.5]])
    undistorted_px = seen.undistort(dots_px)
    assert np.linalg.norm(undistorted_px - dots_px, axis=-1).max() > 15  # else the test could not fail
    path = tmp_path / "dots.rrd"
    with open_recording(
        path, CameraRig((seen,)), SKELETON, image_width_px=image_width_px, jpeg_quality=95
    ) as recording:
        recording.log_image("cam", 0, 0.0, image_with_dots(seen.size_px, dots_px))
    picture = pictures(path, "cam")[0]
    assert picture.shape[1] <= (image_width_px or 640)
    entity = "/world/camera/cam/image/picture"
    shrink = static_value(path, entity, "Transform3D:scale")[0]
    offset_px = static_value(path, entity, "Transform3D:translation")[0]
    shown_px = np.stack([shown_at_px(picture, shrink, offset_px, near_px) for near_px in undistorted_px])
    # The lens bends the dot, of 10 px, so that its middle moves a little; blocks of 4 px and JPEG add some. Half a
    # pixel of offset, the usual mistake, would show in all dots.
    np.testing.assert_allclose(shown_px, undistorted_px, atol=0.5)
    np.testing.assert_allclose((shown_px - undistorted_px).mean(axis=0), 0.0, atol=0.15)


def test_pictures_keep_their_colours_and_become_no_wider_than_wanted(batch_file: Path, tmp_path: Path) -> None:
    (picture,) = pictures(batch_file, "cam_2").values()
    assert picture.shape == (480, 640, 3)
    # JPEG at quality 80 changes a flat grey by less than 3 of 255.
    assert abs(int(picture[240, 320, 0]) - 128) < 3
    plain = Camera.from_world_to_camera("plain", (641, 479), np.diag([500.0, 500, 1]), np.eye(3), np.zeros(3))
    red = np.full((479, 641, 3), (200, 40, 20), dtype=np.uint8)
    with open_recording(tmp_path / "red.rrd", CameraRig((plain,)), SKELETON, image_width_px=320) as recording:
        recording.log_image("plain", 3, 0.1, red)
    picture = pictures(tmp_path / "red.rrd", "plain")[3]
    assert picture.shape == (159, 213, 3)  # a third: two whole pixels of 320 hold 640 of the 641
    np.testing.assert_allclose(picture.reshape(-1, 3), [[20, 40, 200]] * (159 * 213), atol=4)  # as the grey, and hue


def test_points_are_drawn_above_the_pictures(batch_file: Path) -> None:
    image = "/world/camera/cam_2/image"
    behind = static_value(batch_file, f"{image}/picture", "EncodedImage:draw_order")
    assert behind < static_value(batch_file, f"{image}/detections", "Points2D:draw_order")
    assert behind < static_value(batch_file, f"{image}/reprojections/fused", "Points2D:draw_order")


def test_layout_has_a_view_of_every_camera_and_every_view_shows_something(batch_file: Path) -> None:
    origins = view_origins(batch_file)
    legends = {"/legend/cameras", "/legend/limbs"}
    assert origins["2D"] == {r"/world/camera/cam\ 1/image", "/world/camera/cam_2/image"} | legends
    assert origins["3D"] == {"/world"}
    assert {"/plots/weight", "/plots/reprojection_px/smoothed", "/plots/update_ms"} <= origins["TimeSeries"]
    shown = entities(batch_file) | legends
    for where in set().union(*origins.values()):
        assert any(entity == where or entity.startswith(f"{where}/") for entity in shown), where


def test_it_opens_on_the_last_result_and_each_other_is_behind_a_tab(batch_file: Path) -> None:
    scenes = [contents for origin, contents in view_contents(batch_file) if origin == "world"]
    shown = [
        {name for name in ("fused", "smoothed", "views") if f"- /world/{name}/**" not in contents}
        for contents in scenes
    ]
    assert sorted(shown, key=sorted) == [{"smoothed", "fused"}, {"smoothed"}, {"smoothed", "views"}]
    pictures = [contents for origin, contents in view_contents(batch_file) if origin == "world/camera/cam_2/image"]
    without = [contents for contents in pictures if "- /world/camera/cam_2/image/reprojections/fused/**" in contents]
    assert (len(pictures), len(without)) == (3, 2)
    # In all of them the last one is there, and the detections are.
    assert not any("smoothed" in line or "detections" in line for contents in pictures for line in contents)


def test_results_have_their_names_above_them(batch_file: Path, trajectory: Trajectory) -> None:
    heights_m = {}
    for name in ("fused", "smoothed"):
        labels = values(batch_file, f"/world/{name}/label", "Points3D:labels")
        assert labels[0] == [name]
        ((_, _, heights_m[name]),) = values(batch_file, f"/world/{name}/label", "Points3D:positions")[0]
    highest_m = float(trajectory.positions_m[0, :, 2].max())
    assert highest_m < heights_m["smoothed"] < heights_m["fused"]


def test_names_of_lines_stand_beside_plots_below_their_colours(batch_file: Path) -> None:
    for legend, plot in (("cameras", "reprojection_px/smoothed"), ("limbs", "bone_length/smoothed")):
        names = static_values(batch_file, f"/legend/{legend}", "Points2D:labels")
        colours = static_values(batch_file, f"/legend/{legend}/lines", "LineStrips2D:colors")
        lines = {
            static_value(batch_file, entity, "SeriesLines:names"): static_value(
                batch_file, entity, "SeriesLines:colors"
            )
            for entity in entities(batch_file)
            if entity.startswith(f"/plots/{plot}/")
        }
        assert dict(zip(names, colours, strict=True)) == lines
        # To be read on the boxes of the light theme too.
        assert static_value(batch_file, f"/legend/{legend}", "Points2D:colors") == 0xFFFFFFFF
    assert static_values(batch_file, "/world/camera_names", "Points3D:labels") == ["cam 1", "cam_2"]


def noise() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def noise_bytes(tmp_path_factory: pytest.TempPathFactory) -> int:
    """Size of the noise's picture."""
    path = tmp_path_factory.mktemp("noise") / "one.rrd"
    with open_recording(path, CameraRig((camera("cam", 0.0),)), SKELETON) as recording:
        recording.log_image("cam", 0, 0.0, noise())
    ((_, blob),) = rows(path, "/world/camera/cam/image/picture", "EncodedImage:blob").values()
    return len(blob[0])


def test_too_many_pictures_are_thinned_out_evenly(tmp_path: Path, rig: CameraRig, noise_bytes: int) -> None:
    path, n_frames = tmp_path / "thin.rrd", 20
    limit_mb = 2 * 5.5 * noise_bytes / 1e6
    wanted = []
    with open_recording(path, rig, SKELETON, n_frames=n_frames, image_limit_mb=limit_mb) as recording:
        for frame in range(n_frames):
            for name in rig.names:
                wanted.append((name, frame, recording.wants_image(name, frame)))
                recording.log_image(name, frame, frame / 50, noise())
    for name in rig.names:
        shown = sorted(pictures(path, name.replace(" ", r"\ ")))
        assert shown == [frame for of, frame, wants in wanted if of == name and wants]
        assert len(shown) == 5
        assert shown[0] == 0
        assert set(np.diff(shown[1:])) <= {3, 4}


def test_pictures_that_fit_are_all_shown(tmp_path: Path, rig: CameraRig, noise_bytes: int) -> None:
    limit_mb = 2 * 6.01 * noise_bytes / 1e6
    with open_recording(tmp_path / "all.rrd", rig, SKELETON, n_frames=6, image_limit_mb=limit_mb) as recording:
        for frame in range(6):
            recording.log_image("cam_2", frame, frame / 50, noise())
    assert sorted(pictures(tmp_path / "all.rrd", "cam_2")) == list(range(6))


def test_without_a_number_of_frames_pictures_end_at_the_limit(tmp_path: Path, rig: CameraRig, noise_bytes: int) -> None:
    path = tmp_path / "end.rrd"
    limit_mb = 2 * 3.5 * noise_bytes / 1e6
    with open_recording(path, rig, SKELETON, image_limit_mb=limit_mb) as recording:
        for frame in range(6):
            recording.log_image("cam_2", frame, frame / 50, noise())
        assert not recording.wants_image("cam_2", 6)
        assert recording.wants_image("cam 1", 6)
    shown = rows(path, "/world/camera/cam_2/image/picture", "EncodedImage:blob")
    # The last picture does not stay under the points of later frames.
    assert {frame: bool(blob) for frame, (_, blob) in shown.items()} == {0: True, 1: True, 2: True, 3: False}


def test_pictures_do_not_pile_up_in_memory(
    tmp_path: Path, rig: CameraRig, noise_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fgpose.viewer.rerun.session._UNFLUSHED_BYTES", 2.5 * noise_bytes)
    with open_recording(tmp_path / "out.rrd", rig, SKELETON) as recording:
        for frame in range(12):
            recording.log_image("cam_2", frame, frame / 50, noise())
            if frame % 3 == 2:  # 3 pictures are more than 2.5: all of them are in the file
                (file,) = tmp_path.glob(".fgpose-*.rrd")
                wait_until(lambda file=file, frame=frame: file.stat().st_size > (frame + 1) * noise_bytes)
                assert file.stat().st_size > (frame + 1) * noise_bytes


def test_late_viewers_are_served_results_and_pictures(rig: CameraRig, monkeypatch: pytest.MonkeyPatch) -> None:
    import rerun as rr

    limits_mb = []

    class Server:
        def __new__(cls, *where: Any, server_memory_limit: str) -> Any:
            limits_mb.append(float(server_memory_limit.removesuffix("MB")))
            return server(*where, server_memory_limit=server_memory_limit)

    server = rr.GrpcServerSink
    monkeypatch.setattr(rr, "GrpcServerSink", Server)
    for image_limit_mb in (500.0, None):
        open_recording(None, rig, SKELETON, live=True, port=0, image_limit_mb=image_limit_mb).close()
    # The oldest data is dropped first, results too: the server must have room for all pictures beside them.
    with_pictures_mb, without_mb = limits_mb
    assert with_pictures_mb - without_mb == 500.0
    assert without_mb > 100.0


OF_OBSERVATIONS_AND_RESIDUALS = (
    (r"/world/camera/cam\ 1/image/detections", "Points2D:positions"),
    ("/world/camera/cam_2/image/detections", "Points2D:colors"),
    ("/world/views/cam_2", "Points3D:positions"),
    ("/plots/weight/cam_2", "Scalars:scalars"),
    ("/plots/residual/left_elbow", "Scalars:scalars"),
    ("/residuals", "TextDocument:text"),
)


def rows_of_frames(path: Path, entity: str, component: str) -> dict[int, tuple[float, Any]]:
    """Rows of which there is one in every frame."""
    found = rows(path, entity, component)
    assert sorted(found) == list(range(N_FRAMES)), entity
    return found


def test_live_file_is_complete_although_nobody_watches(
    tmp_path: Path, rig: CameraRig, observations: Observations, trajectory: Trajectory, batch_file: Path
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
                weights()[frame],
                update_ms=4.0 + frame,
                residuals={factor: of_frames[frame] for factor, of_frames in residuals().items()},
            )
    assert recording.viewer_url is None
    newest = rows(path, "/world/online/joints", "Points3D:positions")
    assert sorted(newest) == list(range(N_FRAMES))
    assert newest[5][0] == pytest.approx(time_s()[5], abs=1e-9)  # nanoseconds are whole numbers
    np.testing.assert_allclose(newest[5][1], trajectory.positions_m[5], atol=METRE_TOLERANCE)
    lagged = rows(path, "/world/smoothed/joints", "Points3D:positions")
    assert sorted(lagged) == [0, 1, 2, 3]
    for frame, (seconds, positions_m) in lagged.items():
        assert seconds == pytest.approx(time_s()[frame], abs=1e-9)
        known = np.isfinite(trajectory.positions_m[frame]).all(axis=-1)
        np.testing.assert_allclose(positions_m, trajectory.positions_m[frame, known], atol=METRE_TOLERANCE)
    states = rows(path, "/status/online/left_wrist", "StateChange:state")
    assert {frame: state for frame, (_, state) in states.items()} == {2: ["unobservable"], 4: [""]}
    update_ms = np.array(values(path, "/plots/update_ms", "Scalars:scalars"))[:, 0]
    np.testing.assert_array_equal(update_ms, 4.0 + np.arange(N_FRAMES))
    for entity, component in OF_OBSERVATIONS_AND_RESIDUALS:
        assert rows_of_frames(path, entity, component) == rows_of_frames(batch_file, entity, component)


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # endless: that is the price
def test_live_and_batch_recordings_have_the_same_values(
    tmp_path: Path, rig: CameraRig, batch_file: Path, trajectory: Trajectory
) -> None:
    path = tmp_path / "live.rrd"
    with open_recording(path, rig, SKELETON, ("online",), endless=True) as recording:
        for frame in range(N_FRAMES):
            recording.log_estimate(estimate_of(trajectory, frame))
    for entity, component in (
        ("/world/{}/joints", "Points3D:positions"),
        ("/world/{}/joints", "Points3D:radii"),
        ("/world/{}/bones", "LineStrips3D:strips"),
        ("/world/{}/covariance", "Ellipsoids3D:half_sizes"),
        ("/world/camera/cam_2/image/reprojections/{}", "Points2D:positions"),
        ("/plots/reprojection_px/{}/cam_2", "Scalars:scalars"),
        ("/plots/bone_length/{}/upper_arm/left", "Scalars:scalars"),
    ):
        live = rows_of_frames(path, entity.format("online"), component)
        assert live == rows_of_frames(batch_file, entity.format("smoothed"), component), entity


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
    for entity, component in (
        ("/world/smoothed/joints", "Points3D:positions"),
        ("/world/smoothed/bones", "LineStrips3D:strips"),
        ("/world/smoothed/covariance", "Ellipsoids3D:half_sizes"),
        ("/world/camera/cam_2/image/reprojections/smoothed", "Points2D:positions"),
    ):
        assert rows(tmp_path / "empty.rrd", entity, component)[0][1] == []
    assert np.isnan(values(tmp_path / "empty.rrd", "/plots/reprojection_px/smoothed/cam_2", "Scalars:scalars")).all()


def test_nothing_is_left_after_an_error_and_the_old_file_stays(tmp_path: Path, rig: CameraRig) -> None:
    path = tmp_path / "out.rrd"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), open_recording(path, rig, SKELETON):
        raise ZeroDivisionError
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir() if file.is_file()] == ["out.rrd"]


def test_interrupted_live_session_keeps_its_file(tmp_path: Path, rig: CameraRig, trajectory: Trajectory) -> None:
    path = tmp_path / "out.rrd"
    recording = open_recording(path, rig, SKELETON)
    recording.log_trajectory("smoothed", trajectory)
    with pytest.raises(KeyboardInterrupt), recording:
        raise KeyboardInterrupt
    assert len(values(path, "/world/smoothed/joints", "Points3D:positions")) == N_FRAMES


@pytest.mark.skipif(os.name != "posix", reason="a file as a folder fails the same way on every POSIX system")
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


@pytest.mark.parametrize("port", [-1, 65536, 10**8])
def test_a_port_that_none_can_be_is_refused(tmp_path: Path, rig: CameraRig, port: int) -> None:
    with pytest.raises(ValueError, match=f"a port is a number from 0 to 65535, got {port}"):
        open_recording(tmp_path / "out.rrd", rig, SKELETON, live=True, port=port)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_is_refused(
    tmp_path: Path, rig: CameraRig, observations: Observations, trajectory: Trajectory
) -> None:
    other = load_skeleton("h36m_17")
    with pytest.raises(ValueError, match="none of them camera or views"):
        open_recording(tmp_path / "a.rrd", rig, SKELETON, ("views",))
    options: dict[str, Any] = {"image_width_px": 0, "jpeg_quality": 101, "image_limit_mb": -1.0, "n_frames": 0}
    for name, value in options.items():
        with pytest.raises(ValueError, match=f"{name} must be .* got {value}"):
            open_recording(None, rig, SKELETON, **{name: value})
    with open_recording(tmp_path / "b.rrd", rig, SKELETON) as recording:
        with pytest.raises(ValueError, match="the calibration has no camera cam_9"):
            recording.wants_image("cam_9", 0)
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
    assert type(recording) is Recording
    with recording:
        recording.log_observations(observations)
        recording.log_trajectory("anything", trajectory)
        recording.log_residuals(time_s(), residuals())
        recording.log_update_times(time_s(), np.ones(N_FRAMES))
        assert not recording.wants_image("cam_2", 0)
        recording.log_image("cam_2", 0, 0.0, np.zeros((480, 640, 3), dtype=np.uint8))
        recording.log_estimate(estimate_of(trajectory, 0))


def test_every_recording_takes_the_same_calls() -> None:
    from fgpose.viewer.rerun.recording import RerunRecording

    calls = {name for name in dir(Recording) if name.startswith("log_")} | {"close", "discard", "flush", "wants_image"}
    assert all(getattr(RerunRecording, name) is not getattr(Recording, name) for name in calls)
    own = {name for name in dir(RerunRecording) if not name.startswith("_")}
    assert own <= calls | {"viewer_url", "time_kind"}


def test_a_recording_refuses_what_it_was_not_opened_for(rig: CameraRig, trajectory: Trajectory, tmp_path: Path) -> None:
    with (
        open_recording(tmp_path / "one.rrd", rig, SKELETON) as compared,
        open_recording(tmp_path / "people.rrd", rig, SKELETON, None) as people,
    ):
        for call in (lambda: compared.log_person(0, trajectory), lambda: compared.log_tracked(0, [], [])):
            with pytest.raises(ValueError, match="opened for fused, refined, smoothed of one person, not for people"):
                call()
        with pytest.raises(ValueError, match="opened for people, not for 'smoothed'"):
            people.log_trajectory("smoothed", trajectory)


def test_viewer_is_loaded_only_when_a_recording_is_opened() -> None:
    import subprocess
    import sys

    code = "import sys, fgpose.viewer; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
