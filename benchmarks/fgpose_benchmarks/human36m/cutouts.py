"""Cut-outs of objects, and how they are pasted over a person."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from fgpose.monocular.network import Image
from fgpose.plain_files import naming

Cutout = UInt8[np.ndarray, "height width 4"]
"""RGB and alpha, not premultiplied."""

# All four as Sárándi et al. load the objects of Pascal VOC: smaller ones are left out, a rim of this width gets this
# alpha, the size is halved.
_MIN_OBJECT_PX = 500
_RIM_PX = 8
_RIM_ALPHA = 192
_VOC_FACTOR = 0.5
_SIDES = ("xmin", "ymin", "xmax", "ymax")


def load_cutouts(folder: str | Path) -> dict[str, Cutout]:
    """Cut-outs by name: the PNG files with alpha in a folder and those below it, or the objects of Pascal VOC 2012.

    Pascal VOC is a folder with Annotations, JPEGImages and SegmentationObject (VOCdevkit/VOC2012). Its objects are
    chosen as by Sárándi et al. (2018, synthetic-occlusion): 500 px or more, and neither persons, nor truncated, nor
    difficult. They are halved in size, and their rim gets alpha 192.

    Raises:
        ValueError: there is no cut-out, or a file is damaged or has no alpha; the message names it.
        OSError: a file cannot be read.
        ImportError: Pillow is not installed, which the palettes of Pascal VOC need.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder}: there is no such folder of cut-outs")
    is_voc = (folder / "SegmentationObject").is_dir()
    cutouts = dict(_voc_cutouts(folder) if is_voc else _png_cutouts(folder))
    if not cutouts:
        expected = "no object that is whole and no person" if is_voc else "no PNG file"
        raise ValueError(f"{folder}: there is no cut-out: {expected} is in it")
    return cutouts


def read_image(path: Path) -> Image:
    """An image as RGB.

    Raises:
        ValueError: it is damaged or no image.
        OSError: it cannot be opened.
    """
    return np.asarray(cv2.cvtColor(_decoded(path, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _decoded(path: Path, flags: int) -> np.ndarray:
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(content, flags) if content.size else None
    if image is None:
        raise ValueError(f"{path}: not an image, or damaged")
    return np.asarray(image)


def _png_cutouts(folder: Path) -> Iterator[tuple[str, Cutout]]:
    for path in sorted(folder.rglob("*.png")):
        image = _decoded(path, cv2.IMREAD_UNCHANGED)
        if image.ndim != 3 or image.shape[2] != 4 or image.dtype != np.uint8:
            raise ValueError(f"{path}: a cut-out needs 8 bits of red, green, blue and alpha")
        name = path.relative_to(folder).as_posix()
        yield name, np.asarray(cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA), dtype=np.uint8)


def _voc_cutouts(folder: Path) -> Iterator[tuple[str, Cutout]]:
    for path in sorted((folder / "Annotations").glob("*.xml")):
        with naming(path, "not an annotation of Pascal VOC", damage=(ElementTree.ParseError, LookupError)):
            root = ElementTree.fromstring(path.read_bytes())
            if _text(root, "segmented") == "0":
                continue
            boxes_px = dict(_whole_objects(root))
        if not boxes_px:
            continue
        image = read_image(folder / "JPEGImages" / f"{path.stem}.jpg")
        labels = _palette_indices(folder / "SegmentationObject" / f"{path.stem}.png")
        if labels.shape != image.shape[:2]:
            raise ValueError(f"{path.stem}: image and SegmentationObject differ in size")
        for number, (left, top, right, bottom) in boxes_px.items():
            part = slice(top, bottom), slice(left, right)
            mask = np.where(labels[part] == number + 1, 255, 0).astype(np.uint8)
            if np.count_nonzero(mask) >= _MIN_OBJECT_PX:
                yield f"{path.stem}:{number}", _with_soft_rim(image[part], mask)


def _whole_objects(root: ElementTree.Element) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
    """Number and box (left, top, right, bottom) of the objects that are whole, and no persons."""
    for number, each in enumerate(root.findall("object")):
        if _text(each, "name") == "person" or _text(each, "difficult") != "0" or _text(each, "truncated") != "0":
            continue
        left, top, right, bottom = (int(float(_text(each, f"bndbox/{side}"))) for side in _SIDES)
        yield number, (left, top, right, bottom)


def _text(element: ElementTree.Element, path: str) -> str:
    text = element.findtext(path)
    if text is None:
        raise ValueError(f"{path} is missing")
    return text.strip()


def _palette_indices(path: Path) -> UInt8[np.ndarray, "height width"]:
    """Numbers of the colours, which OpenCV would turn into colours."""
    import PIL.Image

    with (
        naming(
            path,
            "not a mask of Pascal VOC",
            damage=(OSError, PIL.Image.DecompressionBombError, SyntaxError),
        ),
        PIL.Image.open(path, formats=["PNG"]) as image,
    ):
        if image.mode not in ("P", "L"):
            raise ValueError(f"a mask of {image.mode} pixels")
        return np.asarray(image, dtype=np.uint8)


def _with_soft_rim(
    colours: Image, mask: UInt8[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "half_height half_width 4"]:
    alpha = mask.copy()
    eroded = np.asarray(cv2.erode(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_RIM_PX, _RIM_PX))))
    alpha[eroded < mask] = _RIM_ALPHA
    height, width = mask.shape
    size_px = max(1, round(_VOC_FACTOR * width)), max(1, round(_VOC_FACTOR * height))
    cutout = np.dstack([colours, alpha])
    return np.asarray(cv2.resize(cutout, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Occluder:
    """A cut-out at its place in the person's box."""

    cutout: Cutout
    scale: float
    """Its short side over that of the box."""
    centre: Float[np.ndarray, " 2"]
    """From the upper left corner of the box, over its size."""

    def pasted(self, image: Image, box_px: Float[np.ndarray, " 4"]) -> Image:
        """A copy of the image with the cut-out on it, as far as it reaches into the image.

        Args:
            image: RGB.
            box_px: left, top, width and height of the person's box.
        """
        height, width = self.cutout.shape[:2]
        factor = self.scale * min(box_px[2:]) / min(width, height)
        size_px = max(1, round(factor * width)), max(1, round(factor * height))
        corner_px = box_px[:2] + self.centre * box_px[2:] - np.array(size_px) / 2
        left, top = np.round(corner_px).astype(int).tolist()
        return _blended(image, _resized(self.cutout, size_px), left, top)


def _resized(cutout: Cutout, size_px: tuple[int, int]) -> Float[np.ndarray, "layer_height layer_width 4"]:
    """Of another size, with colours multiplied by alpha and all in [0, 1]: else colours of invisible pixels would bleed
    into the rim."""
    layer = cutout.astype(np.float64) / 255
    layer[..., :3] *= layer[..., 3:]
    shrinks = size_px[0] < cutout.shape[1]
    return np.asarray(cv2.resize(layer, size_px, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR))


def _blended(image: Image, layer: Float[np.ndarray, "layer_height layer_width 4"], left: int, top: int) -> Image:
    """Copy of the image with the layer over it, its first pixel at (left, top), which may lie outside."""
    rows, columns = (
        slice(*np.clip((start, start + length), 0, end).tolist())
        for start, end, length in ((top, image.shape[0], layer.shape[0]), (left, image.shape[1], layer.shape[1]))
    )
    visible = layer[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    result = image.copy()
    below = result[rows, columns]
    result[rows, columns] = np.round(255 * visible[..., :3] + (1 - visible[..., 3:]) * below)
    return result
