"""Calibrations in XML: Qualisys' ``.qca.txt`` and Vicon's ``.xcp``, told apart by their root.

Qualisys (written by QTM) is read as Pose2Sim reads it (calib_qca_fun), but for the lens. Focal lengths and centres are
in 1/64 px of the sensor, so the corner of the recorded area is subtracted. The coefficients of the lens have no unit
and are OpenCV's. Pose2Sim divides them by 64, which leaves hardly any distortion; on the boards in the images of its
demonstration the lens has k1 = -0.05 to -0.07, the file says -0.047, divided by 64 -0.0007. Translations are
millimetres; the rotation is stored by columns and turns to a camera that looks along -z with y up, hence the half turn
about x. ``viewrotation`` concerns the display only and is not applied.

Vicon (written by Nexus and Shogun) is read as Pose2Sim and OpenCap read it. Focal length and principal point are
pixels, positions millimetres; ORIENTATION is the quaternion x y z w of the rotation from the world to the camera. Of
VICON_RADIAL2 (a name, the centre, k1, k2, k3) or VICON_RADIAL (k1, k2) the coefficients are taken to be OpenCV's. The
newest key frame counts.
"""

from __future__ import annotations

import math
import re
import reprlib
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

from fgpose.io.calibration.calibrated_view import CalibratedView
from fgpose.io.names import natural_key

# Qualisys states intrinsics in 1/64 px; its camera looks along -z with y up, OpenCV's along z with y down.
_SUBPIXELS = 64.0
_HALF_TURN_X = np.diag([1.0, -1.0, -1.0])
_VIDEO_MODELS = ("video", "hybrid", "none")
_QUALISYS_DISTORTION = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
_NOMINAL_LINES = (480, 540, 720, 1080, 1440, 2160)
_SPARE_LINES = 0.03


def is_xml(content: bytes) -> bool:
    """By its beginning."""
    return content.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<") or content.startswith(
        (b"\xff\xfe<", b"\xfe\xff\x00<")
    )


def read(content: bytes) -> list[CalibratedView]:
    """Video cameras of the file in natural order of their serial, translations in millimetres.

    Raises:
        ValueError: the XML is damaged, is of neither program, has no cameras, or lacks a value of one; the message
            names it.
    """
    try:
        root = ElementTree.fromstring(content)
    # LookupError: the header names an encoding that does not exist.
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"not a Qualisys or Vicon calibration, or a truncated one: {error}") from None
    return read_vicon(root) if root.tag.lower() == "cameras" else read_qualisys(root)


def read_qualisys(root: ElementTree.Element) -> list[CalibratedView]:
    """Video cameras in natural order of their serial, translations in millimetres.

    Warns:
        UserWarning: images are smaller than the sensor; it says of which size they are taken to be.

    Raises:
        ValueError: there are no cameras, or one lacks a value; the message names it.
    """
    cameras = root.findall("cameras/camera")
    # Marker cameras are listed beside video cameras; files of one kind only need not say which.
    video = [camera for camera in cameras if any(model in camera.get("model", "").lower() for model in _VIDEO_MODELS)]
    views = [_qualisys_view(camera) for camera in video or cameras]
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
    area = {side: _attribute(camera, name, "fov_video", side) for side in ("left", "top", "right", "bottom")}
    lines = min(area["right"] - area["left"], area["bottom"] - area["top"]) + 1
    # Sensors have some lines more than the resolution is called by: 1088 and 1080.
    if resolution is None or not 0 < int(resolution[1]) < (1 - _SPARE_LINES) * lines:
        return 1.0
    nominal = min((known for known in _NOMINAL_LINES if known <= lines), key=lambda known: lines - known, default=lines)
    return int(resolution[1]) / (nominal if lines - nominal < _SPARE_LINES * lines else lines)


def _qualisys_view(camera: ElementTree.Element) -> CalibratedView:
    name = camera.get("serial", "")
    area = {side: _attribute(camera, name, "fov_video", side) for side in ("left", "top", "right", "bottom")}
    shrunk = _shrunk(camera)

    def sensor_px(what: str) -> float:
        return _attribute(camera, name, "intrinsic", what) / _SUBPIXELS

    def transform(*keys: str) -> np.ndarray:
        return np.array([_attribute(camera, name, "transform", key) for key in keys])

    K = np.array(
        [
            [sensor_px("focalLengthU"), 0.0, sensor_px("centerPointU") - area["left"]],
            [0.0, sensor_px("focalLengthV"), sensor_px("centerPointV") - area["top"]],
            [0.0, 0.0, 1.0 / shrunk],
        ]
    )
    # Stored column by column, camera to world: read row by row it is already the inverse.
    R = _HALF_TURN_X @ transform("r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33").reshape(3, 3)
    distortion = _QUALISYS_DISTORTION
    return CalibratedView(
        name=name,
        size_px=(
            round((area["right"] - area["left"] + 1) * shrunk),
            round((area["bottom"] - area["top"] + 1) * shrunk),
        ),
        K=K * shrunk,
        R=R,
        t=-R @ transform("x", "y", "z"),
        distortion=np.array([_attribute(camera, name, "intrinsic", coefficient) for coefficient in distortion]),
    )


def _attribute(camera: ElementTree.Element, name: str, tag: str, attribute: str) -> float:
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


def read_vicon(root: ElementTree.Element) -> list[CalibratedView]:
    """Video cameras in natural order of their DEVICEID, all cameras where none is said to be one.

    Raises:
        ValueError: there are no cameras, or one lacks a value; the message names it.
    """
    cameras = root.findall("Camera")
    if not cameras:
        raise ValueError("not a Vicon calibration: it has no cameras")
    video = [camera for camera in cameras if _is_video(camera)]
    return sorted((_vicon_view(camera) for camera in video or cameras), key=lambda view: natural_key(view.name))


def _is_video(camera: ElementTree.Element) -> bool:
    return any(
        word in camera.get(attribute, "").lower()
        for attribute in ("TYPE", "DISPLAY_TYPE", "SYSTEM")
        for word in ("video", "vue")
    )


def _vicon_view(camera: ElementTree.Element) -> CalibratedView:
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
        distortion=_vicon_distortion(frame, name),
    )


def _vicon_distortion(frame: ElementTree.Element, name: str) -> np.ndarray:
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
