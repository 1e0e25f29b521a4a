"""Keypoints of images of another size than the calibration's, or of a part of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis, each_view
from fgpose.diagnosis.hypotheses.scene import CameraView, SynchronousViews
from fgpose.finding import Code
from fgpose.geometry.intrinsics import is_of_another_size

Points = Float[np.ndarray, "*points 2"]
# Sizes that videos and inputs of networks commonly have, the larger side first.
_SIZES_PX = (
    (3840, 2160), (2704, 1520), (2560, 1440), (2048, 1536), (1920, 1200), (1920, 1080), (1600, 1200), (1440, 1080),
    (1280, 960), (1280, 720), (1024, 768), (960, 540), (854, 480), (848, 480), (800, 600), (720, 576), (640, 480),
    (640, 360), (640, 640), (512, 512), (416, 416), (320, 240), (256, 256), (256, 192),
)  # fmt: skip
# Neighbours on this grid differ by 4 %: at the border of an image 2 % of half its width, 20 of 1920 px, which is near
# enough for the right one to stand out.
_FACTORS = np.exp(np.arange(np.log(1 / 4), np.log(4), 0.04))
_UNCHANGED = 0.02  # a factor this near to 1 is the calibration's own size
_SAME_SIZE = 0.015
_SHAPES = (16 / 9, 16 / 10, 3 / 2, 4 / 3, 5 / 4, 1.0, 9 / 16, 3 / 4)  # width over height
_RATIOS, _SAME_RATIO = (4 / 3, 3 / 2, 2.0, 8 / 3, 3.0, 4.0), 0.004
# What networks are given, and what is left if the sides of an image are cut off.
_SQUARES_PX, _CUTS, _HEIGHTS_PX = (1280, 640, 512, 416, 384, 320, 256, 192), (4 / 3, 1.0), (720, 640, 512, 480, 256)
_MOSTLY, _BEYOND_PX = 0.95, 30.0  # networks place hidden feet a little outside


def of_points(change: Callable[[CameraView], Points]) -> Callable[[CameraView], CameraView]:
    return lambda view: view.with_points(change(view))


def size_px(view: CameraView) -> tuple[float, float]:
    """Of the images that the calibration is for, by the centre of the lens: it is turned with the images, where the
    stated size may not be."""
    width_px, height_px = view.camera.size_px
    portrait = view.camera.K[1, 2] > view.camera.K[0, 2]
    sides = sorted((float(width_px), float(height_px)))
    return (sides[0], sides[1]) if portrait else (sides[1], sides[0])


def _calibrated_px(view: CameraView) -> tuple[float, float]:
    """The same by the principal point, where that says that the stated size is not the calibration's."""
    width_px, height_px = (2 * view.camera.K[:2, 2] + 1).tolist()
    is_given = min(width_px, height_px) > 1 and is_of_another_size(view.camera)
    return _probable_size((width_px, height_px), (1.0, 1.0)) if is_given else size_px(view)


def size_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Other sizes, by a coarse grid, and parts of the images."""
    yield from _common_sizes(scene, cameras)
    yield from _parts(scene, cameras)
    for factor in _FACTORS.tolist():
        if abs(factor - 1) > _UNCHANGED:
            yield resized(scene, cameras, (factor, factor))


def simple_size_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Smaller or larger by a simple ratio, as programs make images."""
    for ratio in _RATIOS:
        yield resized(scene, cameras, (ratio, ratio))
        yield resized(scene, cameras, (1 / ratio, 1 / ratio))


def resized(scene: SynchronousViews, cameras: tuple[int, ...], factor: tuple[float, float]) -> Hypothesis:
    """Keypoints of images of another size; the calibration's is so many times as large."""
    calibrated_px = _calibrated_px(scene.views[cameras[0]])
    given_px = _probable_size(calibrated_px, factor)
    same = abs(factor[0] - factor[1]) < _SAME_SIZE * factor[0]
    times = f"{factor[0]:.3g}" if same else f"{factor[0]:.3g} (x) and {factor[1]:.3g} (y)"
    whose = "all cameras" if len(cameras) == scene.n_cameras else "{cameras}"
    return Hypothesis(
        Code.IMAGE_SIZE,
        cameras,
        each_view(of_points(lambda each: each.points_px * np.array(factor)), cameras),
        f"The keypoints of {whose} are of images of another size than the calibration's: probably "
        f"{given_px[0]}x{given_px[1]}, the calibration is for {calibrated_px[0]:.0f}x{calibrated_px[1]:.0f}",
        f"Multiply the keypoints by {times}, or give the calibration of images of {given_px[0]}x{given_px[1]} (its "
        "focal lengths and centres divided by as much).",
        {"factor_x": factor[0], "factor_y": factor[1]},
        preference=1,
    )


def simple_ratio(factor: float) -> float:
    """A simple ratio where one is near: lenses are off the middle by some pixels."""
    near = min((*_RATIOS, *(1 / ratio for ratio in _RATIOS)), key=lambda ratio: abs(ratio / factor - 1))
    return near if abs(near / factor - 1) < _UNCHANGED else factor


def within_image(cause: Hypothesis, scene: SynchronousViews) -> bool:
    """Whether nearly all keypoints lie in the images of the calibration, if a hypothesis is true."""
    mended = cause.mend(scene)
    for c in cause.cameras:
        points_px = mended.views[c].points_px[np.isfinite(mended.views[c].points_px).all(axis=-1)]
        inside = (points_px > -_BEYOND_PX).all(axis=-1)
        inside &= (points_px < np.array(size_px(scene.views[c])) + _BEYOND_PX).all(axis=-1)
        if np.mean(inside) < _MOSTLY:
            return False
    return True


def is_part(cause: Hypothesis) -> bool:
    """Whether the images would begin elsewhere than the calibration's: borders, or sides that were cut off."""
    return "offset_x_px" in cause.numbers


def is_common_size(cause: Hypothesis, scene: SynchronousViews) -> bool:
    """Whether the images would be of a size that cameras and networks have, as wide for their height as before, or
    smaller or larger by a simple ratio, as programs make them."""
    factor = cause.numbers["factor_x"], cause.numbers["factor_y"]
    if abs(factor[0] / factor[1] - 1) > _SAME_SIZE:
        return False
    if any(abs(factor[0] * ratio - 1) < _SAME_RATIO or abs(factor[0] / ratio - 1) < _SAME_RATIO for ratio in _RATIOS):
        return True
    return _probable_size(size_px(scene.views[cause.cameras[0]]), factor) in _turned_too(_SIZES_PX)


def _probable_size(calibrated_px: tuple[float, float], factor: tuple[float, float]) -> tuple[int, int]:
    """A common size where one is near."""
    width_px, height_px = calibrated_px[0] / factor[0], calibrated_px[1] / factor[1]
    for size in _turned_too(_SIZES_PX):
        if abs(size[0] / width_px - 1) < _SAME_SIZE and abs(size[1] / height_px - 1) < _SAME_SIZE:
            return size
    return round(width_px), round(height_px)


def _turned_too(sizes: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
    return (*sizes, *((height, width) for width, height in sizes if height != width))


def _common_sizes(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Also those with another ratio of width to height, and those too small for the grid; and one side alone shorter
    or longer, to another usual ratio."""
    width_px, height_px = size_px(scene.views[cameras[0]])
    squeezed = [(height_px * ratio, height_px) for ratio in _SHAPES] + [(width_px, width_px / r) for r in _SHAPES]
    for given in (*_turned_too(_SIZES_PX), *squeezed):
        factor = width_px / given[0], height_px / given[1]
        same = abs(factor[0] / factor[1] - 1) < _SAME_SIZE
        if not same or not _FACTORS[0] < factor[0] < _FACTORS[-1]:
            yield resized(scene, cameras, factor)


def _parts(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Images with borders that make them square, or of which the sides were cut off, be it resized."""
    size = np.array(size_px(scene.views[cameras[0]]))
    longer, shorter = float(size.max()), float(size.min())
    for side_px in (longer, *_SQUARES_PX):
        if longer != shorter:
            words = f"have borders that make them square, {side_px:.0f}x{side_px:.0f}"
            yield _part(scene, cameras, longer / side_px, (size - longer) / 2, words)
    for ratio in _CUTS:
        cut = np.array([ratio, 1.0]) * shorter if size[0] > size[1] else np.array([1.0, ratio]) * shorter
        if cut.max() < (1 - _SAME_SIZE) * longer:
            for height_px in (shorter, *(shorter / ratio for ratio in _RATIOS), *_HEIGHTS_PX):
                factor = shorter / height_px
                words = f"are the middle of the calibration's, {cut[0] / factor:.0f}x{cut[1] / factor:.0f}"
                yield _part(scene, cameras, factor, (size - cut) / 2, words)


def _part(
    scene: SynchronousViews, cameras: tuple[int, ...], factor: float, offset_px: Float[np.ndarray, " 2"], words: str
) -> Hypothesis:
    """Of which a pixel is so many of the calibration's, and whose corner is at this one of it."""
    width_px, height_px = size_px(scene.views[cameras[0]])
    by = f"Multiply the keypoints by {factor:.3g} and add" if factor != 1 else "Add"
    return Hypothesis(
        Code.IMAGE_SIZE,
        cameras,
        each_view(of_points(lambda view: view.points_px * factor + offset_px), cameras),
        f"The images that the keypoints of {{cameras}} are of {words}; the calibration is for "
        f"{width_px:.0f}x{height_px:.0f}",
        f"{by} {offset_px[0]:+.0f} to x and {offset_px[1]:+.0f} to y.",
        {"factor_x": factor, "factor_y": factor, "offset_x_px": offset_px[0], "offset_y_px": offset_px[1]},
        preference=1,
    )
