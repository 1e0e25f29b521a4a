"""Lenses that are not those of the calibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis, each_view
from fgpose.diagnosis.hypotheses.scene import Scene, View
from fgpose.finding import Code
from fgpose.geometry.intrinsics import zoomed

_FACTORS = (*np.exp(np.arange(np.log(0.4), np.log(2.5), 0.05)),)
_UNCHANGED = 0.04


def lens_hypotheses(scene: Scene, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Another focal length, or no distortion."""
    yield from _undistorted(scene, cameras)
    for factor in _FACTORS:
        if abs(factor - 1) > _UNCHANGED:
            yield other_focal(scene, cameras, float(factor))


def other_focal(scene: Scene, cameras: tuple[int, ...], factor: float) -> Hypothesis:
    """A focal length that is so many times as long."""

    def longer(view: View) -> View:
        return View(zoomed(view.camera, factor), view.points_px)

    given_px = float(np.median([scene.views[c].camera.K[0, 0] for c in cameras]))
    return Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(longer, cameras),
        f"The focal length of {{cameras}} is not that of the calibration: about {factor * given_px:.0f} px instead of "
        f"{given_px:.0f}",
        "Was the lens zoomed, or a crop or stabilisation of the camera switched on? Calibrate its lens anew, or "
        f"multiply its focal lengths by {factor:.3g}.",
        {"focal_factor": factor},
        preference=2,
    )


def _undistorted(scene: Scene, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Keypoints of images from which the distortion was removed already."""
    if not any(scene.views[c].camera.distortion.any() for c in cameras):
        return
    yield Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(
            lambda view: View(replace(view.camera, distortion=np.zeros(0), lens="pinhole"), view.points_px), cameras
        ),
        "The distortion in the calibration of {cameras} is not that of the images that the keypoints are of",
        "Were the images undistorted before? Then leave the distortion out of the calibration.",
        {"distortion_factor": 0.0},
        preference=2,
    )
