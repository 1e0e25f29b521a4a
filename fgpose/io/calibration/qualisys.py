"""Qualisys calibration (``.qca.txt``, XML written by QTM), read as Pose2Sim reads it (calib_qca_fun), but for the lens.

Focal lengths and centres are in 1/64 px of the sensor, so the corner of the recorded area is subtracted. The
coefficients of the lens have no unit and are OpenCV's. Pose2Sim divides them by 64, which leaves hardly any distortion;
on the boards in the images of its demonstration the lens has k1 = -0.05 to -0.07, the file says -0.047, divided by 64
-0.0007. Translations are millimetres; the rotation is stored by columns and turns to a camera that looks along -z with
y up, hence the half turn about x. ``viewrotation`` concerns the display only and is not applied.
"""

from __future__ import annotations

import math
import re
import reprlib
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView
from fgpose.io.camera_names import natural_key

# Qualisys states intrinsics in 1/64 px; its camera looks along -z with y up, OpenCV's along z with y down.
_SUBPIXELS = 64.0
_HALF_TURN_X = np.diag([1.0, -1.0, -1.0])
_VIDEO_MODELS = ("video", "hybrid", "none")
_DISTORTION = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
_NOMINAL_LINES = (480, 540, 720, 1080, 1440, 2160)
_SPARE_LINES = 0.03


def read(root: ElementTree.Element) -> list[CalibratedView]:
    """Video cameras in natural order of their serial, translations in millimetres.

    Warns:
        UserWarning: images are smaller than the sensor; it says of which size they are taken to be.

    Raises:
        ValueError: there are no cameras, or one lacks a value; the message names it.
    """
    cameras = root.findall("cameras/camera")
    # Marker cameras are listed beside video cameras; files of one kind only need not say which.
    video = [camera for camera in cameras if any(model in camera.get("model", "").lower() for model in _VIDEO_MODELS)]
    views = [_view(camera) for camera in video or cameras]
    if not views:
        raise ValueError("not a Qualisys calibration: it has no cameras")
    pairs = zip(video or cameras, views, strict=True)
    smaller = [f"{view.name} {view.size_px[0]}x{view.size_px[1]}" for camera, view in pairs if _shrunk(camera) < 1.0]
    if smaller:
        warnings.warn(
            "the calibration says that videos are smaller than the sensor (video_resolution), all of it being used; "
            f"their images are taken to be: {', '.join(smaller)}",
            stacklevel=4,
        )
    return sorted(views, key=lambda view: natural_key(view.name))


def _shrunk(camera: ElementTree.Element) -> float:
    """Image pixels for each pixel of the sensor: where video_resolution (540p) is less than the lines of the area."""
    name = camera.get("serial", "")
    resolution = re.fullmatch(r"(\d{3,4})[pP]?", camera.get("video_resolution", "").strip())
    area = {side: _value(camera, name, "fov_video", side) for side in ("left", "top", "right", "bottom")}
    lines = min(area["right"] - area["left"], area["bottom"] - area["top"]) + 1
    # Sensors have some lines more than the resolution is called by: 1088 and 1080.
    if resolution is None or not 0 < int(resolution[1]) < (1 - _SPARE_LINES) * lines:
        return 1.0
    nominal = min((known for known in _NOMINAL_LINES if known <= lines), key=lambda known: lines - known, default=lines)
    return int(resolution[1]) / (nominal if lines - nominal < _SPARE_LINES * lines else lines)


def _view(camera: ElementTree.Element) -> CalibratedView:
    name = camera.get("serial", "")
    area = {side: _value(camera, name, "fov_video", side) for side in ("left", "top", "right", "bottom")}
    shrunk = _shrunk(camera)

    def sensor_px(what: str) -> float:
        return _value(camera, name, "intrinsic", what) / _SUBPIXELS

    def transform(*keys: str) -> np.ndarray:
        return np.array([_value(camera, name, "transform", key) for key in keys])

    K = np.array(
        [
            [sensor_px("focalLengthU"), 0.0, sensor_px("centerPointU") - area["left"]],
            [0.0, sensor_px("focalLengthV"), sensor_px("centerPointV") - area["top"]],
            [0.0, 0.0, 1.0 / shrunk],
        ]
    )
    # Stored column by column, camera to world: read row by row it is already the inverse.
    R = _HALF_TURN_X @ transform("r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33").reshape(3, 3)
    distortion = _DISTORTION
    return CalibratedView(
        name=name,
        size_px=(
            round((area["right"] - area["left"] + 1) * shrunk),
            round((area["bottom"] - area["top"] + 1) * shrunk),
        ),
        K=K * shrunk,
        R=R,
        t=-R @ transform("x", "y", "z"),
        distortion=np.array([_value(camera, name, "intrinsic", coefficient) for coefficient in distortion]),
    )


def _value(camera: ElementTree.Element, name: str, tag: str, attribute: str) -> float:
    element = camera.find(tag)
    text = None if element is None else element.get(attribute)
    try:
        # A program with another locale has written decimal commas.
        number = float((text or "").replace(",", ".", 1))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"camera {name}: {tag} has no number {attribute}, but {reprlib.repr(text)}")
    return number
