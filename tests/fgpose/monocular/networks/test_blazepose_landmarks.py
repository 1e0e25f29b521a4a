from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tiny_blazepose as tiny
from tiny_blazepose import SIDE_PX, scene

from fgpose.monocular.networks.blazepose_landmarks import LandmarkNetwork
from fgpose.monocular.networks.crops import Region

# The middle of a turned square, seen through bilinear interpolation, is off by a few hundredths of a pixel.
TOLERANCE_PX = 0.1


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.landmarks(tmp_path_factory.mktemp("blazepose") / "landmarks.onnx")


@pytest.mark.parametrize("angle_rad", [0.0, 0.6, -2.5])
def test_landmarks_and_world_turn_back_with_the_region(path: Path, angle_rad: float) -> None:
    region = Region((170.0, 210.0), 150.0, angle_rad)
    found = LandmarkNetwork(path).locate(scene((13, 13)), region)
    expected_px = tiny.square_middle_px(13, 13) + tiny.turned(tiny.OFFSETS_CROP_PX, angle_rad) * 150 / 256
    np.testing.assert_allclose(found.points2d_px, expected_px, atol=TOLERANCE_PX)
    np.testing.assert_allclose(found.world_m, tiny.turned(tiny.WORLD_M, angle_rad), atol=1e-6)
    np.testing.assert_allclose(found.visibility, tiny.VISIBILITY, rtol=1e-5)
    np.testing.assert_allclose(found.presence, tiny.PRESENCE, rtol=1e-5)
    np.testing.assert_allclose(found.next_region.center_px, tiny.square_middle_px(13, 13), atol=TOLERANCE_PX)
    assert found.next_region.side_px == pytest.approx(SIDE_PX, rel=1e-5)
    assert found.next_region.angle_rad % (2 * np.pi) == pytest.approx(angle_rad % (2 * np.pi), abs=1e-5)


def refined_one_by_one(points_crop: np.ndarray, logits: np.ndarray) -> np.ndarray:
    """MediaPipe's RefineLandmarksFromHeatmapCalculator, loop by loop; window of 7 cells, confidence of at least 0.5."""
    refined = points_crop.copy()
    for j, (x, y) in enumerate(points_crop):
        column, row = int(x / 256 * 64), int(y / 256 * 64)
        if not (0 <= column < 64 and 0 <= row < 64):
            continue
        mass, moment, peak = 0.0, np.zeros(2), 0.0
        for r in range(max(row - 3, 0), min(row + 4, 64)):
            for c in range(max(column - 3, 0), min(column + 4, 64)):
                confidence = 1 / (1 + np.exp(-logits[r, c, j]))
                peak, mass, moment = max(peak, confidence), mass + confidence, moment + confidence * np.array([c, r])
        if peak >= 0.5:
            refined[j] = moment / mass * 256 / 64
    return refined


def test_landmarks_are_refined_by_their_heatmaps(tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    heatmaps = random.normal(-2.0, 2.0, (64, 64, 39))
    heatmaps[:, :, 2::3] = -8.0  # every third heatmap says nothing
    # Somewhere in the crop, near each of its edges, and beyond it.
    raw_crop = random.uniform(0, 256, (33, 2))
    raw_crop[:16] = np.repeat([(3, 100), (253, 130), (90, 2), (140, 254)], 4, axis=0) + random.uniform(-1, 1, (16, 2))
    raw_crop[16:20] = (-6, 100), (262, 100), (100, -6), (100, 262)
    # At this size pixels of the crop are those of the image.
    region, corner_px = Region((168.0, 224.0), 256.0), np.array([168.0 - 128, 224.0 - 128])
    offsets_px = raw_crop + corner_px - tiny.square_middle_px(13, 13)
    path = tiny.landmarks(tmp_path / "landmarks.onnx", offsets_px, heatmaps=heatmaps)
    found = LandmarkNetwork(path).locate(scene((13, 13)), region)
    expected = refined_one_by_one(raw_crop, heatmaps)
    changed = np.abs(expected - raw_crop).max(axis=1) > 0
    assert changed[:16].reshape(4, 4).any(axis=1).all()
    assert not changed[16:20].any()
    assert not changed[2::3].any()
    # Float32 on the way: 1e-5 of 256 px.
    np.testing.assert_allclose(found.points2d_px, expected + corner_px, atol=3e-3)


def test_a_region_without_a_person_says_so(path: Path) -> None:
    network = LandmarkNetwork(path)
    assert network.locate(scene((13, 13)), Region((168.0, 216.0), SIDE_PX)).is_person
    assert not network.locate(scene((13, 13)), Region((60.0, 60.0), SIDE_PX / 2)).is_person
