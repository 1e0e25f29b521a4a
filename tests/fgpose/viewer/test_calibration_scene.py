"""The recording of a calibration from people: read back without a viewer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibrated_walks import FPS, N_FRAMES, SKELETON, calibrated, joints_m, seen_px, true_rig
from rrd_contents import (
    METRE_TOLERANCE,
    PIXEL_TOLERANCE,
    entities,
    rows,
    static_value,
    static_values,
    values,
    view_origins,
)

from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade
from fgpose.geometry.epipolar_distance import epipolar_distances_px, pairs_px
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.pipeline.calibration import show_calibrated, write_calibration
from fgpose.pipeline.seen_walk import hips_m
from fgpose.viewer import CalibrationScene, open_calibration_recording
from fgpose.viewer.rerun.calibration import walked_outline_m

pytest.importorskip("rerun")
pytestmark = pytest.mark.usefixtures("strict_and_silent")

RIG = true_rig()


@pytest.fixture(scope="module")
def result() -> CalibratedFromPeople:
    image = Detections(RIG.names[0], 0.0, np.zeros((0, SKELETON.n_joints, 2)), np.zeros((0, SKELETON.n_joints)))
    people = PeopleObservations(SKELETON, RIG.names, (image,))
    return calibrated(people, RIG, [CalibrationFinding("ring_1", Grade.COARSE, "it is far away", "put it nearer")])


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, result: CalibratedFromPeople) -> Path:
    folder = tmp_path_factory.mktemp("scene")
    written = write_calibration(result, folder / "rig.toml", rrd=folder / "rig.rrd")
    assert [path.name for path in written] == ["rig.toml", "rig.rrd"]
    return folder / "rig.rrd"


def test_everything_is_there(file: Path) -> None:
    expected = {"/world/walk/joints", "/world/walk/bones"}
    for name in RIG.names:
        expected |= {f"/world/camera/{name}/image/detections", f"/world/camera/{name}/image/reprojections/walk"}
        expected |= {f"/plots/reprojection_px/walk/{name}"}
        expected |= {f"/plots/epipolar_px/{name}/{other}" for other in RIG.names if other != name}
    assert expected <= entities(file)


def test_the_walk_by_the_common_clock(file: Path) -> None:
    found = rows(file, "/world/walk/joints", "Points3D:positions")
    assert sorted(found) == list(range(N_FRAMES))
    for frame, (time_s, positions_m) in found.items():
        assert time_s == pytest.approx(frame / FPS)
        np.testing.assert_allclose(positions_m, joints_m()[frame], atol=METRE_TOLERANCE)


def test_detections_lie_beside_the_reprojections(file: Path) -> None:
    for c, name in enumerate(RIG.names):
        detected = values(file, f"/world/camera/{name}/image/detections", "Points2D:positions")[7]
        reprojected = values(file, f"/world/camera/{name}/image/reprojections/walk", "Points2D:positions")[7]
        np.testing.assert_allclose(reprojected, seen_px(RIG)[7, c], atol=PIXEL_TOLERANCE)
        np.testing.assert_allclose(np.array(detected) - reprojected, 2.0, atol=2 * PIXEL_TOLERANCE)
        (error_px,) = values(file, f"/plots/reprojection_px/walk/{name}", "Scalars:scalars")[7]
        assert error_px == pytest.approx(2 * np.sqrt(2))


def test_every_pair_of_cameras_is_compared(file: Path, result: CalibratedFromPeople) -> None:
    expected_px = pairs_px(result.walk.points2d_px, RIG)
    (found_px,) = values(file, "/plots/epipolar_px/ring_2/ring_0", "Scalars:scalars")[3]
    assert found_px == pytest.approx(expected_px[3, 2, 0])
    # Both detections are 2.8 px off, and a line is off by no more than about its point.
    assert 0 < found_px < 6


def test_how_sure_the_cameras_are(file: Path) -> None:
    centres = static_values(file, "/world/camera_sigmas", "Ellipsoids3D:centers")
    np.testing.assert_allclose(centres, [camera.position_m for camera in RIG.cameras], atol=METRE_TOLERANCE)
    # 30 mm are the root of the sum over three axes; 2.5 standard deviations of one axis hold 90 %.
    half_sizes = static_values(file, "/world/camera_sigmas", "Ellipsoids3D:half_sizes")
    np.testing.assert_allclose(half_sizes, 2.5003 * 0.03 / np.sqrt(3), rtol=1e-6)
    assert static_values(file, "/world/camera_names", "Points3D:labels")[1] == "ring_1 ± 30 mm"


def test_the_way_the_floor_and_the_verdict(file: Path, result: CalibratedFromPeople) -> None:
    way = static_values(file, "/world/walked", "LineStrips3D:strips")
    np.testing.assert_allclose(way[0], hips_m(result.joints_m, SKELETON), atol=METRE_TOLERANCE)
    outline = np.array(static_values(file, "/world/floor", "LineStrips3D:strips")[0])
    assert not outline[:, 2].any()
    np.testing.assert_array_equal(outline[0], outline[-1])
    np.testing.assert_allclose(static_value(file, "/world/vertical", "Arrows3D:vectors"), [0, 0, 1])
    report = static_value(file, "/report", "TextDocument:text")
    assert report.startswith("**Verdict: coarse")
    assert "camera ring_1: it is far away. Remedy: put it nearer." in report
    assert "| residual, median [px] | 2.8 | 2.8 | 2.8 |" in report


def test_the_layout_shows_them(file: Path) -> None:
    origins = view_origins(file)
    assert {f"/plots/epipolar_px/{name}" for name in RIG.names} <= origins["TimeSeries"]
    assert "/plots/reprojection_px/walk" in origins["TimeSeries"]
    assert origins["TextDocument"] == {"/report"}
    assert {f"/world/camera/{name}/image" for name in RIG.names} | {"/legend/cameras"} == origins["2D"]


def test_a_failed_calibration_has_a_scene_but_no_rig(tmp_path: Path, result: CalibratedFromPeople) -> None:
    failed = replace(result, findings=(CalibrationFinding("", Grade.FAILED, "nothing fits", "walk"),))
    assert write_calibration(failed, tmp_path / "rig.toml", rrd=tmp_path / "rig.rrd") == (tmp_path / "rig.rrd",)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.rrd"]


def test_what_is_not_known_is_left_out(tmp_path: Path, result: CalibratedFromPeople) -> None:
    """No joint, no sigma, in half of the frames nothing seen."""
    points_px = result.walk.points2d_px.copy()
    points_px[: N_FRAMES // 2] = np.nan
    confidence = np.where(np.isnan(points_px[..., 0]), 0.0, 1.0)
    unknown = replace(
        result,
        walk=replace(result.walk, points2d_px=points_px, confidence=confidence),
        joints_m=np.full_like(result.joints_m, np.nan),
        residual_px=np.full_like(result.residual_px, np.nan),
        sigmas=replace(result.sigmas, position_m=np.full(3, np.nan)),
    )
    with open_calibration_recording(tmp_path / "rig.rrd", RIG, SKELETON) as recording:
        show_calibrated(unknown, recording)
    assert "/world/walk/bones" in entities(tmp_path / "rig.rrd")
    with pytest.raises(AssertionError, match="has no"):
        static_values(tmp_path / "rig.rrd", "/world/camera_sigmas", "Ellipsoids3D:centers")


def test_nothing_is_shown_without_a_file(
    result: CalibratedFromPeople, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with open_calibration_recording(None, RIG, SKELETON) as recording:
        show_calibrated(result, recording)
        assert not recording.wants_image(RIG.names[0], 0)
        assert recording.viewer_url is None
    assert list(tmp_path.iterdir()) == []


def test_a_scene_of_another_size_is_refused(tmp_path: Path) -> None:
    of_two = CalibrationScene(np.arange(2.0), np.zeros(2), np.zeros((2, 3)), np.zeros((2, 2, 2)), "")
    with open_calibration_recording(tmp_path / "rig.rrd", RIG, SKELETON) as recording:
        with pytest.raises(ValueError, match=r"position_sigma_m must be \(3,\), got \(2,\)"):
            recording.log_calibration(of_two)
        with pytest.raises(ValueError, match=r"epipolar_px must be \(2, 3, 3\)"):
            recording.log_calibration(replace(of_two, position_sigma_m=np.zeros(3), epipolar_px=np.zeros((2, 3, 2))))


def test_the_outline_of_a_walk() -> None:
    square = np.array([[0.0, 0, 1], [2, 0, 1], [2, 2, 1.1], [0, 2, 1], [1, 1, 0.9], [np.nan, 0, 0]])
    outline = walked_outline_m(square, "+z")
    assert {tuple(corner) for corner in outline.tolist()} == {(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)}
    # There and back on one line covers no floor.
    assert walked_outline_m(np.stack([np.linspace(0, 3, 50), np.zeros(50), np.ones(50)], axis=1), "+z").shape == (0, 3)


def test_epipolar_distances() -> None:
    """Zero for what both cameras see, the shift for a point that is moved away from its line."""
    own, other = RIG.cameras[0], RIG.cameras[1]
    truth_m = joints_m()[:3].reshape(-1, 3)
    own_px, other_px = own.project(truth_m), other.project(truth_m)
    # Lines are found to 1e-9 px of pixels in double precision.
    np.testing.assert_allclose(epipolar_distances_px(own_px, other_px, own, other), 0, atol=1e-8)
    epipole_px = own.project(other.position_m[None])
    along = own_px - epipole_px
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    moved = epipolar_distances_px(own_px + 3 * normal, other_px, own, other)
    np.testing.assert_allclose(moved, 3, atol=1e-8)
    missing = np.full_like(other_px, np.nan)
    assert np.isnan(epipolar_distances_px(own_px, missing, own, other)).all()
