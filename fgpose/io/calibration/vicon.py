"""Vicon calibration (``.xcp``, XML written by Nexus and Shogun), read as Pose2Sim and OpenCap read it.

Focal length and principal point are pixels, positions millimetres; ORIENTATION is the quaternion x y z w of the
rotation from the world to the camera. Of VICON_RADIAL2 (a name, the centre, k1, k2, k3) or VICON_RADIAL (k1, k2) the
coefficients are taken to be OpenCV's. The newest key frame counts.
"""

from __future__ import annotations

import math
import reprlib
import xml.etree.ElementTree as ElementTree

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView
from fgpose.io.camera_names import natural_key


def read(root: ElementTree.Element) -> list[CalibratedView]:
    """Video cameras in natural order of their DEVICEID, all cameras where none is said to be one.

    Raises:
        ValueError: there are no cameras, or one lacks a value; the message names it.
    """
    cameras = root.findall("Camera")
    if not cameras:
        raise ValueError("not a Vicon calibration: it has no cameras")
    video = [camera for camera in cameras if _is_video(camera)]
    return sorted((_view(camera) for camera in video or cameras), key=lambda view: natural_key(view.name))


def _is_video(camera: ElementTree.Element) -> bool:
    return any(
        word in camera.get(attribute, "").lower()
        for attribute in ("TYPE", "DISPLAY_TYPE", "SYSTEM")
        for word in ("video", "vue")
    )


def _view(camera: ElementTree.Element) -> CalibratedView:
    from scipy.spatial.transform import Rotation

    name = camera.get("DEVICEID") or camera.get("USERID", "")
    frames = camera.findall("KeyFrames/KeyFrame")
    if not frames:
        raise ValueError(f"camera {name}: it has no KeyFrame: it is not calibrated")
    frame = frames[-1]
    width, height = _numbers(camera, name, "SENSOR_SIZE", 2)
    focal_px = _numbers(frame, name, "FOCAL_LENGTH", 1)[0]
    aspect = _numbers(camera, name, "PIXEL_ASPECT_RATIO", 1)[0] if camera.get("PIXEL_ASPECT_RATIO") else 1.0
    centre_px = _numbers(frame, name, "PRINCIPAL_POINT", 2)
    quaternion = _numbers(frame, name, "ORIENTATION", 4)
    if not np.linalg.norm(quaternion) > 0 or not aspect > 0:
        raise ValueError(f"camera {name}: ORIENTATION is no quaternion, or PIXEL_ASPECT_RATIO is not positive")
    R = Rotation.from_quat(quaternion).as_matrix()
    return CalibratedView(
        name=name,
        size_px=(round(width), round(height)),
        K=np.array([[focal_px, 0.0, centre_px[0]], [0.0, focal_px / aspect, centre_px[1]], [0.0, 0.0, 1.0]]),
        R=R,
        t=-R @ _numbers(frame, name, "POSITION", 3),
        distortion=_distortion(frame, name),
    )


def _distortion(frame: ElementTree.Element, name: str) -> np.ndarray:
    """k1, k2, p1, p2, k3; none where the file has none."""
    for attribute, first in (("VICON_RADIAL2", 2), ("VICON_RADIAL", 0)):
        if frame.get(attribute):
            words = frame.get(attribute, "").split()
            given = _finite(words[1:] if words and words[0][:1].isalpha() else words, name, attribute)[first:]
            k1, k2, k3 = [*given, 0.0, 0.0, 0.0][:3]
            return np.array([k1, k2, 0.0, 0.0, k3])
    return np.zeros(0)


def _numbers(element: ElementTree.Element, name: str, attribute: str, count: int) -> np.ndarray:
    values = _finite((element.get(attribute) or "").split(), name, attribute)
    if len(values) != count:
        raise ValueError(
            f"camera {name}: {attribute} must have {count} numbers, but is {reprlib.repr(element.get(attribute))}"
        )
    return np.array(values)


def _finite(words: list[str], name: str, attribute: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise ValueError(f"camera {name}: {attribute} has something that is no number: {reprlib.repr(' '.join(words))}")
    return values
