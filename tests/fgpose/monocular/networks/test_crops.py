from __future__ import annotations

import numpy as np
import pytest

from fgpose.monocular.networks.crops import Region

# The image, 640 x 480: a smooth gradient, which bilinear interpolation follows exactly up to rounding to integers.
X, Y = np.meshgrid(np.arange(640), np.arange(480))
GRADIENT = np.stack([X * 0.3 + 10, Y * 0.4 + 10, (X + Y) * 0.2], axis=-1).round().astype(np.uint8)
TURNED = Region((320.0, 240.0), 180.0, 0.7)


def test_the_square_around_a_circle_stands_on_its_centre_with_its_top_up() -> None:
    region = Region.around((100.0, 200.0), (100.0 + 30.0, 200.0 - 40.0), 1.25)
    assert region.center_px == (100.0, 200.0)
    assert region.side_px == pytest.approx(2 * 50 * 1.25)
    assert region.angle_rad == pytest.approx(np.arctan2(30, 40))
    # The top of the circle is above the middle of the crop.
    np.testing.assert_allclose(region.crop_T_image(250) @ (130.0, 160.0, 1.0), (125.0, 125.0 - 100.0), atol=1e-9)


@pytest.mark.parametrize(
    ("top", "angle_deg"), [((0.0, -1.0), 0), ((1.0, 0.0), 90), ((0.0, 1.0), 180), ((-1.0, 0.0), 270)]
)
def test_the_angle_grows_clockwise(top: tuple[float, float], angle_deg: int) -> None:
    region = Region.around((0.0, 0.0), top, 1.0)
    assert np.degrees(region.angle_rad) % 360 == pytest.approx(angle_deg)


def test_the_way_back_is_the_inverse_of_the_way_there() -> None:
    points_px = np.random.default_rng(0).uniform(0, 640, (50, 2))
    to_crop = TURNED.crop_T_image(256)
    points_crop = points_px @ to_crop[:, :2].T + to_crop[:, 2]
    np.testing.assert_allclose(TURNED.to_image(points_crop, 256), points_px, atol=1e-9)


def test_a_pixel_of_the_crop_shows_the_point_of_the_image_that_it_maps_to() -> None:
    crop = TURNED.crop(GRADIENT, 256)
    rows, columns = np.mgrid[:256, :256]
    x, y = np.moveaxis(TURNED.to_image(np.stack([columns, rows], axis=-1).astype(float), 256), -1, 0)
    shown = np.stack([x * 0.3 + 10, y * 0.4 + 10, (x + y) * 0.2], axis=-1)
    # The image and the crop are rounded to integers, by half a grey level each, and OpenCV 4 rounds places to 1/32 px.
    assert np.abs(crop - shown).max() < 1.1


def test_directions_turn_with_the_region() -> None:
    # Up in the crop is the direction from the centre to the top.
    up = TURNED.rotation @ (0.0, -1.0)
    np.testing.assert_allclose(up, (np.sin(0.7), -np.cos(0.7)), atol=1e-12)


def test_the_whole_image_is_centred_between_bars() -> None:
    crop = Region.whole((640, 480)).crop(np.full((480, 640, 3), 200, np.uint8), 160, border="black")
    # A quarter of the size: bars of (640 - 480) / 2 / 4 rows.
    assert (crop[:20] == 0).all()
    assert (crop[140:] == 0).all()
    assert (crop[20:140] == 200).all()


def test_beyond_the_image_its_border_goes_on() -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    image[:, :10] = 90
    crop = Region((0.0, 50.0), 80.0).crop(image, 80)
    assert (crop[:, :40] == 90).all()
