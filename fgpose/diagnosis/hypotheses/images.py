"""Keypoints that are not in the pixels that the calibration is for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis, each_view, with_sides_exchanged
from fgpose.diagnosis.hypotheses.scene import CameraView, SynchronousViews
from fgpose.diagnosis.hypotheses.sizes import Points, of_points, simple_ratio, size_hypotheses, size_px
from fgpose.finding import Code
from fgpose.geometry.intrinsics import is_of_another_size, middle_px

# Shifts that are tried, as shares of the side of the image; the best one is looked for between them.
_SHIFTS = (0.03, 0.06, 0.09, 0.12, 0.16, 0.2)


def image_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """All that may be wrong of the pixels of these cameras alike; the size by a coarse grid."""
    yield from normalised_hypotheses(scene, cameras)
    yield from _off_centre(scene, cameras)
    yield from turned_hypotheses(scene, cameras)
    yield from size_hypotheses(scene, cameras)
    yield from _shifts(scene, cameras)


def turned_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Turned or mirrored, or with other axes."""
    yield from _turned(scene, cameras)
    yield from mirrored_hypotheses(cameras)
    yield from _other_axes(cameras)


def shifted(scene: SynchronousViews, cameras: tuple[int, ...], by_px: Mapping[str, float]) -> Hypothesis:
    """Keypoints of images that begin so many pixels further on, in x or y, than the calibration's."""
    offset_px = np.array([by_px.get("cx_px", 0.0), by_px.get("cy_px", 0.0)])
    reason, remedy = shift_in_words(by_px)
    return Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(of_points(lambda view: view.points_px - offset_px), cameras),
        reason,
        remedy,
        by_px,
        preference=2,
    )


def shift_in_words(by_px: Mapping[str, float]) -> tuple[str, str]:
    """What is wrong of all cameras, and what to do; by how much their cx_px and cy_px would have to be larger."""
    axes = {name[1]: px for name, px in by_px.items()}
    return (
        "The images of all cameras are shifted against those of the calibration, by "
        f"{' and '.join(f'{px:.0f} px in {axis}' for axis, px in axes.items())}",
        f"Were they cut, or stabilised? Add {' and '.join(f'{px:.0f} to c{axis}' for axis, px in axes.items())}, or "
        "give the calibration of these images.",
    )


def is_shift(cause: Hypothesis) -> bool:
    return bool(cause.numbers.keys() & {"cx_px", "cy_px"})


def _off_centre(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Principal points alone that are of images of another size, or left out, with focal lengths that are right."""
    own = [scene.views[c].camera for c in cameras]
    if not all(is_of_another_size(camera) for camera in own):
        return
    centres_px = np.array([camera.K[:2, 2] for camera in own])
    middles_px = np.array([middle_px(camera) for camera in own])
    was_left_out = bool((centres_px <= 0).any())
    factor = 0.0 if was_left_out else simple_ratio(float(np.sum(middles_px * centres_px) / np.sum(centres_px**2)))

    def mended(view: CameraView) -> Points:
        centre_px = view.camera.K[:2, 2]
        return view.points_px + centre_px - (middle_px(view.camera) if was_left_out else factor * centre_px)

    (cx, cy), (x, y), (width, height) = centres_px[0], middles_px[0], own[0].size_px
    yield Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(of_points(mended), cameras),
        f"The principal point of {{cameras}} (cx = {cx:.0f}, cy = {cy:.0f}) is far from the middle of images of "
        f"{width}x{height}, whose focal length is right",
        f"It was left out: give the middle, cx = {x:.0f} and cy = {y:.0f}."
        if was_left_out
        else f"It is that of images of another size: multiply cx and cy, and not the focal length, by {factor:.3g}.",
    )


def _shifts(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """In one direction. That of one camera alone looks like a turn of it, and of two nearly so."""
    if len(cameras) < max(scene.n_cameras, 3):
        return
    for name, side_px in zip(("cx_px", "cy_px"), size_px(scene.views[cameras[0]]), strict=True):
        for share in _SHIFTS:
            yield from (shifted(scene, cameras, {name: sign * share * side_px}) for sign in (-1, 1))


def normalised_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Coordinates from 0 to 1, or from -1 to 1."""
    for low, words in ((0.0, "0 to 1"), (-1.0, "-1 to 1")):

        def pixels(view: CameraView, low: float = low) -> Points:
            return (view.points_px - low) / (1.0 - low) * np.array(size_px(view))

        if all(_is_normalised(scene.views[c], low) for c in cameras):
            yield Hypothesis(
                Code.NORMALISED,
                cameras,
                each_view(of_points(pixels), cameras),
                f"The keypoints of {{cameras}} are no pixels: they go from {words}",
                "Multiply them by the width and the height of the image"
                + ("." if low == 0.0 else ", after adding 1 and dividing by 2."),
            )


def _is_normalised(view: CameraView, low: float) -> bool:
    points = view.points_px[np.isfinite(view.points_px)]
    if not points.size or np.quantile(np.abs(points), 0.99) > 3.0:
        return False
    return bool((points.min() < 0) == (low < 0))


def _turned(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Images that were turned before the network saw them, or before the camera was calibrated."""
    for degrees, words in ((90, "by 90 degrees clockwise"), (180, "upside down"), (270, "by 90 degrees anticlockwise")):

        def turned_back(view: CameraView, degrees: int = degrees) -> Points:
            x, y = np.moveaxis(view.points_px, -1, 0)
            width_px, height_px = size_px(view)
            if degrees == 90:
                return np.stack([y, height_px - 1 - x], axis=-1)
            if degrees == 180:
                return np.stack([width_px - 1 - x, height_px - 1 - y], axis=-1)
            return np.stack([width_px - 1 - y, x], axis=-1)

        yield Hypothesis(
            Code.TURNED_IMAGE,
            cameras,
            each_view(of_points(turned_back), cameras),
            f"The images that the keypoints of {{cameras}} are of are turned {words} against those of the calibration",
            "Turn the keypoints back, or calibrate with images that are turned alike.",
            {"degrees": float(degrees)},
        )


def mirrored_hypotheses(cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """As a front camera shows them: the network then takes the left hand for the right one. Second: it does not."""
    for sides, words in ((True, ""), (False, ", with left and right as they are on the body")):

        def mirrored_back(given: SynchronousViews, sides: bool = sides) -> SynchronousViews:
            views = {c: _mirrored_back(given.views[c]) for c in cameras}
            return with_sides_exchanged(given.with_views(views), cameras) if sides else given.with_views(views)

        yield Hypothesis(
            Code.MIRRORED_IMAGE,
            cameras,
            mirrored_back,
            f"The images that the keypoints of {{cameras}} are of are mirrored{words}",
            "Switch mirroring off in the camera's program; here: replace x by width - 1 - x"
            + (", and exchange left and right joints." if sides else "."),
        )


def _other_axes(cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """As programs count that have the origin at the bottom, or rows before columns."""

    def from_the_top(view: CameraView) -> Points:
        x, y = np.moveaxis(view.points_px, -1, 0)
        return np.stack([x, size_px(view)[1] - 1 - y], axis=-1)

    yield Hypothesis(
        Code.MIRRORED_IMAGE,
        cameras,
        each_view(of_points(from_the_top), cameras),
        "The keypoints of {cameras} count y from the bottom of the image, not from the top",
        "Replace y by height - 1 - y.",
        preference=1,
    )
    yield Hypothesis(
        Code.TURNED_IMAGE,
        cameras,
        each_view(of_points(lambda view: view.points_px[..., ::-1]), cameras),
        "The keypoints of {cameras} have x and y exchanged",
        "Exchange them: x goes to the right, y down.",
        preference=1,
    )


def _mirrored_back(view: CameraView) -> CameraView:
    x, y = np.moveaxis(view.points_px, -1, 0)
    return view.with_points(np.stack([size_px(view)[0] - 1 - x, y], axis=-1))
