from __future__ import annotations

import numpy as np
import pytest
import tiny_blazepose as tiny
from tiny_blazepose import LEAN_RAD, SIDE_PX, detected_region, scene

from fgpose.monocular.networks.blazepose_detector import BlazePoseDetector


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> BlazePoseDetector:
    return BlazePoseDetector(tiny.detector(tmp_path_factory.mktemp("blazepose") / "detector.onnx"))


@pytest.mark.parametrize("cell", [(12, 13), (4, 2), (23, 27)])
def test_a_person_is_found_where_the_anchor_is(network: BlazePoseDetector, cell: tuple[int, int]) -> None:
    (found,) = network.detect(scene(cell))
    expected = detected_region(*cell)
    np.testing.assert_allclose(found.center_px, expected.center_px, atol=1e-4)
    # The numbers of the network are float32.
    assert found.side_px == pytest.approx(SIDE_PX, rel=1e-6)
    assert found.angle_rad == pytest.approx(LEAN_RAD, rel=1e-6)


def test_detections_that_overlap_are_averaged_by_their_score(network: BlazePoseDetector) -> None:
    image = np.maximum(scene((12, 13)), scene((13, 13), colour=tiny.PALE))
    (found,) = network.detect(image)
    full, pale = (1 / (1 + np.exp(-250 * (red / 127.5 - 1.96))) for red in (255, 251))
    assert 0.85 < pale < 0.95
    share = pale / (full + pale)
    x, y = detected_region(12, 13).center_px
    np.testing.assert_allclose(found.center_px, (x + share * tiny.CELL_PX, y), atol=1e-3)


def test_people_apart_are_found_one_by_one_the_most_confident_first(network: BlazePoseDetector) -> None:
    image = np.maximum(scene((20, 13)), scene((10, 13), colour=tiny.PALE))
    found = network.detect(image)
    np.testing.assert_allclose([r.center_px for r in found], [detected_region(x, 13).center_px for x in (20, 10)])


def test_an_image_without_people_gives_no_region(network: BlazePoseDetector) -> None:
    assert network.detect(scene()) == []


def test_the_bars_beside_the_image_are_black(network: BlazePoseDetector) -> None:
    # This cell is half bar, half image.
    image = scene()
    image[16 * 10 : 16 * 11, :8] = tiny.FULL
    assert network.detect(image) == []
