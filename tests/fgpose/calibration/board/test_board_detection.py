"""Boards in rendered images against where their corners are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from filmed_boards import small

from fgpose.calibration.board.board import parse_board
from fgpose.calibration.board.detection import blur_px, detector_of, opencv_charuco, saddle_points
from fgpose_benchmarks.synthetic.board_images import render
from fgpose_benchmarks.synthetic.boards import seen_px, simulate_boards


@pytest.mark.parametrize(
    "text",
    [
        "charuco:6x5:160mm:120mm:DICT_4X4_50",
        "charuco:6x6:140mm:105mm:DICT_4X4_50",
        "chessboard:7x4:110mm",
        "circles:4x7:70mm",
        "charuco:6x6:140mm:105mm:DICT_4X4_50:inverted",
        "chessboard:7x4:110mm:inverted",
        "circles:4x7:70mm:inverted",
    ],
)
def test_corners_are_where_they_are(text: str) -> None:
    board = parse_board(text)
    scene = simulate_boards(1, 2, noise_px=0, n_common=4, n_near=3, board=board, radius_m=2.2)
    camera, detector = small(scene.rig.cameras[0]), detector_of(board)
    errors_px = list[np.ndarray]()
    for pose in scene.world_T_board:
        true_px = seen_px(type(scene.rig)((camera,)), pose, board)[0]
        found_px = detector.find(render(camera, pose, board, 0.5))
        if found_px is not None and np.isfinite(true_px).all():
            errors_px.append(np.linalg.norm(found_px - true_px, axis=1))
    assert len(errors_px) >= 3
    # Corners to some hundredths of a pixel; centres of tilted circles are not those of their images.
    assert np.nanmedian(np.concatenate(errors_px)) < (0.15 if text.startswith("circles") else 0.03)


@pytest.mark.parametrize(("text", "share"), [("charuco:7x5:90mm:66mm:DICT_5X5_100", 0.4), ("chessboard:7x4:90mm", 0.6)])
def test_saddles_are_nearer_to_the_corners_than_what_opencv_finds(text: str, share: float) -> None:
    """Its windows hold markers too, and the edges beside a corner count as much as those next to it."""
    board, rng = parse_board(text), np.random.default_rng(0)
    scene = simulate_boards(1, 4, noise_px=0, n_common=4, n_near=6, board=board, radius_m=2.2)
    camera, detector = small(scene.rig.cameras[0]), detector_of(board)
    ours, theirs = list[np.ndarray](), list[np.ndarray]()
    for pose in scene.world_T_board:
        true_px = seen_px(type(scene.rig)((camera,)), pose, board)[0]
        noisy = render(camera, pose, board, 0.6) + rng.normal(0, 2, camera.size_px[::-1])
        image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        found_px = detector.find(image)
        if found_px is None:
            continue
        known = np.isfinite(found_px).all(axis=1)
        ours.append((found_px - true_px)[known])
        if board.kind == "charuco":
            corners, ids, *_ = cv2.aruco.CharucoDetector(opencv_charuco(board)).detectBoard(image)
            if ids is not None:
                theirs.append(np.reshape(corners, (-1, 2)) - true_px[np.ravel(ids)])
        else:
            start_px = found_px[known].astype(np.float32)
            theirs.append(cv2.cornerSubPix(image, start_px, (5, 5), (-1, -1), (3, 30, 1e-3)) - true_px[known])
    rms_px, theirs_px = (np.sqrt(np.mean(np.concatenate(each) ** 2)) for each in (ours, theirs))
    assert rms_px < share * theirs_px


def test_a_saddle_is_where_a_corner_is_or_nowhere() -> None:
    y, x = np.mgrid[:41, :41]
    # (20.3, 19.6) is where the colours change, softly, as behind a lens.
    image = np.rint(128 + 100 * np.tanh((x - 20.3) / 1.5) * np.tanh((y - 19.6) / 1.5)).astype(np.uint8)
    points_px = np.array([[20.0, 20.0], [np.nan, np.nan], [5.0, 19.6], [24.0, 23.0]])
    # Half the window has 2 px. The others are not found, an edge, and too far away.
    found_px = saddle_points(image, points_px, 0.3)
    np.testing.assert_allclose(found_px[0], [20.3, 19.6], atol=0.02)  # grey values are rounded
    assert np.isnan(found_px[1:]).all()


def test_the_first_corner_is_the_same_upside_down() -> None:
    board = parse_board("chessboard:7x4:110mm")
    scene = simulate_boards(1, 2, noise_px=0, n_common=1, n_near=0, board=board, radius_m=2.2)
    camera, detector = small(scene.rig.cameras[0]), detector_of(board)
    image = render(camera, scene.world_T_board[-1], board, 0.5)
    upright_px, turned_px = detector.find(image), detector.find(np.ascontiguousarray(image[::-1, ::-1]))
    assert upright_px is not None
    assert turned_px is not None
    np.testing.assert_allclose(np.array(camera.size_px) - 1 - turned_px, upright_px, atol=0.2)


def test_boards_as_opencv_drew_them_before_4_6() -> None:
    board = parse_board("charuco:6x6:30mm:22mm:DICT_4X4_50")
    for legacy in (False, True):
        image = np.asarray(opencv_charuco(board, legacy=legacy).generateImage((420, 420), marginSize=30))
        found_px = detector_of(board).find(image)
        assert found_px is not None
        np.testing.assert_allclose(found_px, board.points_m[:, :2] / board.square_m * 60 + 29.5, atol=0.6)


def test_no_board_is_no_board() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    for text in ("charuco:6x5:160mm:120mm", "chessboard:7x4:110mm", "circles:4x7:70mm"):
        assert detector_of(parse_board(text)).find(noise) is None


def test_blur_is_the_width_of_the_edges() -> None:
    board = parse_board("charuco:6x5:160mm:120mm:DICT_4X4_50")
    image = np.asarray(opencv_charuco(board).generateImage((360, 300)))
    points_px = board.points_m[:, :2] / board.square_m * 60 - 0.5
    widths = [blur_px(np.asarray(cv2.GaussianBlur(image, (0, 0), sigma)), points_px) for sigma in (0.5, 1.0, 2.0, 4.0)]
    assert np.all(np.diff(widths) > 0)
    # An edge that is blurred by a Gaussian is sqrt(2 pi) standard deviations wide.
    assert widths[2] == pytest.approx(np.sqrt(2 * np.pi) * 2.0, rel=0.2)
    # Light and contrast do not count.
    assert blur_px((image // 3 + 20).astype(np.uint8), points_px) == pytest.approx(blur_px(image, points_px), rel=0.05)


def test_a_board_is_found_from_the_other_side_of_a_room() -> None:
    """0.63 m at 4 m in Full HD: bits of its markers have two pixels."""
    scene = simulate_boards(4, 0, noise_px=0)
    board, camera, pose = scene.sightings.board, scene.rig.cameras[2], scene.world_T_board[3]
    image = render(camera, pose, board).astype(float) + np.random.default_rng(0).normal(0, 2, (1080, 1920))
    found_px = detector_of(board).find(np.clip(image, 0, 255).astype(np.uint8))
    assert found_px is not None
    known = np.isfinite(found_px).all(axis=1)
    assert known.sum() > board.n_points / 2
    errors_px = np.linalg.norm(found_px - seen_px(scene.rig, pose, board)[2], axis=1)[known]
    # As near by: some hundredths to a tenth of a pixel.
    assert np.median(errors_px) < 0.15


def test_motion_along_one_edge_is_blur() -> None:
    """The edges along it stay sharp, so the steepest slope says nothing of it."""
    board = parse_board("charuco:6x5:160mm:120mm:DICT_4X4_50")
    scene = simulate_boards(1, 2, noise_px=0, n_common=4, n_near=3, board=board, radius_m=2.2)
    camera = small(scene.rig.cameras[0])
    image = render(camera, scene.world_T_board[-1], board, 0.5)
    points_px = detector_of(board).find(image)
    assert points_px is not None
    sharp_px = blur_px(image, points_px)
    for shape in ((1, 6), (6, 1)):
        assert blur_px(np.asarray(cv2.blur(image, shape)), points_px) > 1.8 * sharp_px
