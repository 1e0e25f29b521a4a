"""Qualisys calibration (``.qca.txt``, XML written by QTM), read as Pose2Sim reads it (calib_qca_fun).

Intrinsics and distortion are in 1/64 px of the sensor, so the corner of the recorded area is subtracted; translations
are millimetres; the rotation is stored by columns and turns to a camera that looks along -z with y up, hence the half
turn about x. ``viewrotation`` concerns the display only and is not applied.
"""

from __future__ import annotations

import math
import reprlib
import xml.etree.ElementTree as ElementTree

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView
from fgpose.io.camera_names import natural_key

# Qualisys states intrinsics in 1/64 px; its camera looks along -z with y up, OpenCV's along z with y down.
_SUBPIXELS = 64.0
_HALF_TURN_X = np.diag([1.0, -1.0, -1.0])
_VIDEO_MODELS = ("video", "none")


def read(content: bytes) -> list[CalibratedView]:
    """Video cameras of the file in natural order of their serial, translations in millimetres.

    Raises:
        ValueError: the XML is damaged, has no cameras, or lacks a value of one; the message names it.
    """
    try:
        root = ElementTree.fromstring(content)
    # LookupError: the header names an encoding that does not exist.
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"not a Qualisys calibration, or a truncated one: {error}") from None
    cameras = root.findall("cameras/camera")
    # Marker cameras are listed beside video cameras; files of one kind only need not say which.
    video = [camera for camera in cameras if any(model in camera.get("model", "").lower() for model in _VIDEO_MODELS)]
    views = [_view(camera) for camera in video or cameras]
    if not views:
        raise ValueError("not a Qualisys calibration: it has no cameras")
    return sorted(views, key=lambda view: natural_key(view.name))


def _view(camera: ElementTree.Element) -> CalibratedView:
    name = camera.get("serial", "")
    area = {side: _value(camera, name, "fov_video", side) for side in ("left", "top", "right", "bottom")}

    def intrinsic(what: str) -> float:
        return _value(camera, name, "intrinsic", what) / _SUBPIXELS

    def transform(*keys: str) -> np.ndarray:
        return np.array([_value(camera, name, "transform", key) for key in keys])

    K = np.array(
        [
            [intrinsic("focalLengthU"), 0.0, intrinsic("centerPointU") - area["left"]],
            [0.0, intrinsic("focalLengthV"), intrinsic("centerPointV") - area["top"]],
            [0.0, 0.0, 1.0],
        ]
    )
    # Stored column by column, camera to world: read row by row it is already the inverse.
    R = _HALF_TURN_X @ transform("r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33").reshape(3, 3)
    distortion = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
    return CalibratedView(
        name=name,
        size_px=(round(area["right"] - area["left"] + 1), round(area["bottom"] - area["top"] + 1)),
        K=K,
        R=R,
        t=-R @ transform("x", "y", "z"),
        distortion=np.array([intrinsic(coefficient) for coefficient in distortion]),
    )


def _value(camera: ElementTree.Element, name: str, tag: str, attribute: str) -> float:
    element = camera.find(tag)
    text = None if element is None else element.get(attribute)
    try:
        number = float(text or "")
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"camera {name}: {tag} has no number {attribute}, but {reprlib.repr(text)}")
    return number
