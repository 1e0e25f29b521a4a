"""Cut-outs: loading them, and pasting them over a person."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest

from fgpose_benchmarks.human36m.cutouts import Occluder, load_cutouts

BOX_PX = np.array([40.0, 20.0, 30.0, 60.0])


def solid(width: int, height: int, alpha: int = 255) -> np.ndarray:
    cutout = np.full((height, width, 4), alpha, np.uint8)
    cutout[..., :3] = [200, 100, 50]
    return cutout


def changed(image: np.ndarray) -> np.ndarray:
    """Rows and columns of the pixels that are not grey."""
    return np.argwhere((image != 90).any(axis=-1))


def test_short_side_is_a_share_of_that_of_the_box_and_the_centre_lies_where_it_says():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(20, 40), 0.5, np.array([0.5, 0.25])).pasted(image, BOX_PX)
    (top, left), (bottom, right) = changed(pasted).min(axis=0), changed(pasted).max(axis=0)
    assert (right - left + 1, bottom - top + 1) == (15, 30)
    # half a pixel of rounding
    assert abs((left + right + 1) / 2 - 55) <= 0.5
    assert abs((top + bottom + 1) / 2 - 35) <= 0.5
    assert pasted[35, 55].tolist() == [200, 100, 50]
    assert (image == 90).all()


def test_what_reaches_beyond_the_image_is_clipped():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(30, 30), 1.0, np.array([0.0, 0.0])).pasted(image, np.array([0.0, 0.0, 40.0, 40.0]))
    assert changed(pasted).max(axis=0).tolist() == [19, 19]
    beyond = Occluder(solid(30, 30), 1.0, np.array([0.0, 0.0])).pasted(image, np.array([300.0, 300.0, 40.0, 40.0]))
    np.testing.assert_array_equal(beyond, image)


@pytest.mark.parametrize("corner_px", [(130.0, 50.0), (50.0, 110.0), (-700.0, 50.0), (50.0, -700.0)])
def test_a_large_one_wholly_outside_leaves_the_image_as_it_is(corner_px: tuple[float, float]):
    image = np.full((100, 120, 3), 90, np.uint8)
    # 300 px across, its centre in the middle of a box of 400 px
    pasted = Occluder(solid(30, 30), 0.75, np.array([0.5, 0.5])).pasted(image, np.array([*corner_px, 400.0, 400.0]))
    np.testing.assert_array_equal(pasted, image)


def test_half_transparent_is_half_of_both():
    image = np.full((100, 120, 3), 90, np.uint8)
    pasted = Occluder(solid(30, 30, alpha=128), 1.0, np.array([0.5, 0.5])).pasted(image, BOX_PX)
    # 128 / 255 of the one and the rest of the other, rounded
    np.testing.assert_allclose(pasted[50, 55], [145, 95, 70], atol=1)


def test_pngs_with_alpha_are_found_in_any_folder(tmp_path: Path):
    (tmp_path / "animals").mkdir()
    cv2.imwrite(str(tmp_path / "animals" / "dog.png"), solid(6, 4)[..., [2, 1, 0, 3]])
    cv2.imwrite(str(tmp_path / "box.png"), solid(3, 5, alpha=7)[..., [2, 1, 0, 3]])
    cutouts = load_cutouts(tmp_path)
    assert list(cutouts) == ["animals/dog.png", "box.png"]
    np.testing.assert_array_equal(cutouts["animals/dog.png"], solid(6, 4))
    np.testing.assert_array_equal(cutouts["box.png"], solid(3, 5, alpha=7))


def test_a_folder_without_cutouts_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="no PNG file"):
        load_cutouts(tmp_path)
    with pytest.raises(ValueError, match="no such folder"):
        load_cutouts(tmp_path / "nowhere")
    cv2.imwrite(str(tmp_path / "opaque.png"), solid(3, 5)[..., :3])
    with pytest.raises(ValueError, match=r"opaque\.png: a cut-out needs 8 bits of red, green, blue and alpha"):
        load_cutouts(tmp_path)


OBJECT = """<object><name>{name}</name><truncated>{truncated}</truncated><difficult>{difficult}</difficult>
<bndbox><xmin>{left}</xmin><ymin>{top}</ymin><xmax>{right}</xmax><ymax>{bottom}</ymax></bndbox></object>"""


def write_voc(folder: Path, *, segmented: int = 1) -> None:
    """One image of Pascal VOC 2012 with a person, a chair, a truncated sofa, a difficult dog and a small bottle."""
    for name in ("Annotations", "JPEGImages", "SegmentationObject"):
        (folder / name).mkdir(parents=True)
    boxes = [(10, 10, 60, 90), (70, 20, 110, 80), (0, 100, 60, 140), (120, 20, 170, 80), (120, 100, 130, 140)]
    kinds = [("person", 0, 0), ("chair", 0, 0), ("sofa", 1, 0), ("dog", 0, 1), ("bottle", 0, 0)]
    mask = np.zeros((150, 200), np.uint8)
    objects = ""
    for number, ((left, top, right, bottom), (name, truncated, difficult)) in enumerate(zip(boxes, kinds, strict=True)):
        mask[top:bottom, left:right] = number + 1
        values = {"left": left, "top": top, "right": right, "bottom": bottom}
        objects += OBJECT.format(name=name, truncated=truncated, difficult=difficult, **values)
    mask[20:40, 70:90] = 255  # a corner of the chair is void
    image = PIL.Image.frombytes("P", (200, 150), mask.tobytes())
    image.putpalette(np.random.default_rng(0).integers(0, 255, 768).astype(np.uint8).tobytes())
    image.save(folder / "SegmentationObject" / "2007_000001.png")
    colours = np.full((150, 200, 3), (30, 60, 90), np.uint8)
    cv2.imwrite(str(folder / "JPEGImages" / "2007_000001.jpg"), colours)
    xml = f"<annotation><filename>2007_000001.jpg</filename><segmented>{segmented}</segmented>{objects}</annotation>"
    (folder / "Annotations" / "2007_000001.xml").write_text(xml)


def test_whole_objects_of_pascal_voc_are_cut_out(tmp_path: Path):
    write_voc(tmp_path)
    cutouts = load_cutouts(tmp_path)
    assert list(cutouts) == ["2007_000001:1"]
    chair = cutouts["2007_000001:1"]
    # 40 x 60 px at half size
    assert chair.shape == (30, 20, 4)
    # JPEG
    np.testing.assert_allclose(chair[..., :3].reshape(-1, 3).mean(axis=0), [90, 60, 30], atol=3)
    assert chair[20, 10, 3] == 255
    assert chair[3, 3, 3] == 0
    # the inner rim of the void corner is softer
    assert chair[11, 5, 3] == 192


def test_images_of_pascal_voc_without_masks_are_left_out(tmp_path: Path):
    write_voc(tmp_path, segmented=0)
    with pytest.raises(ValueError, match="no object that is whole and no person"):
        load_cutouts(tmp_path)


def test_a_damaged_annotation_is_named(tmp_path: Path):
    write_voc(tmp_path)
    (tmp_path / "Annotations" / "2007_000001.xml").write_text("<annotation>")
    with pytest.raises(ValueError, match=r"2007_000001\.xml: not an annotation of Pascal VOC"):
        load_cutouts(tmp_path)
