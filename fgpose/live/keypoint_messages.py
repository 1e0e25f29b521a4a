"""2D keypoints of a detector elsewhere, as messages: the format that docs/live_messages.md describes."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.packing import packed, unpacked
from fgpose.live.rejections import MessageError
from fgpose.observations import positive_definite, refuse_millimetres
from fgpose.people import Detections
from fgpose.skeleton import Skeleton

FORMAT, VERSION = "fgpose/keypoints", 1
MAX_BODY_BYTES = 1 << 20
"""Of a message that is looked at: thirty people with 133 joints each and all that a message may have take less."""
MAX_PEOPLE = 30
"""In an image: the time to tell people apart grows with them."""
_REQUIRED = {"format", "version", "camera", "time_s", "size_px", "skeleton", "points2d_px", "confidence"}
_OPTIONAL = {"points3d_camera_m", "covariance3d_camera_m2", "appearance"}


def encode_keypoints(
    camera: str,
    time_s: float,
    size_px: tuple[int, int],
    skeleton: str,
    points2d_px: Float[np.ndarray, "person joint 2"],
    confidence: Float[np.ndarray, "person joint"],
    **optional: np.ndarray,
) -> bytes:
    """A message of everybody in one image.

    Args:
        camera: name in the calibration.
        time_s: when the image was taken, by the clock of the camera.
        size_px: width and height of the image.
        skeleton: name.
        points2d_px: pixels of the original image; NaN: not detected.
        confidence: in [0, 1].
        optional: points3d_camera_m (P, J, 3) and covariance3d_camera_m2 (P, J, 3, 3) in the camera frame (x right, y
            down, z forward), appearance (P, D).
    """
    return packed(
        {
            "format": FORMAT,
            "version": VERSION,
            "camera": camera,
            "time_s": time_s,
            "size_px": size_px,
            "skeleton": skeleton,
            "points2d_px": np.asarray(points2d_px, dtype=np.float32),
            "confidence": np.asarray(confidence, dtype=np.float32),
            **{name: np.asarray(array, dtype=np.float32) for name, array in optional.items()},
        }
    )


def decode_keypoints(body: bytes | memoryview, rig: CameraRig, skeleton: Skeleton) -> Detections:
    """The detections in a message, at the time that it says; 3D joints in the world frame.

    Raises:
        MessageError: the message is refused; kind says why in a word or two, the text in full. Nothing else is raised,
            whatever the bytes are.
    """
    if len(body) > MAX_BODY_BYTES:
        raise MessageError("size", f"a message of {len(body)} bytes, at most {MAX_BODY_BYTES} are possible")
    try:
        document = unpacked(body)
    except ValueError as error:
        raise MessageError("content", str(error)) from None
    camera = _check(document, rig, skeleton)
    shape = _people_shape(document["points2d_px"], camera, skeleton)
    arrays = {"confidence": _array(document, "confidence", camera, shape)}
    if "points3d_camera_m" in document:
        points_m = _array(document, "points3d_camera_m", camera, (*shape, 3))
        arrays["points3d_m"] = camera.to_world_frame(points_m)
    if "covariance3d_camera_m2" in document:
        arrays["covariance3d_m2"] = _covariance(document, camera, shape)
    if "appearance" in document:
        arrays["appearance"] = _array(document, "appearance", camera, (shape[0], None))
    points2d_px = np.asarray(document["points2d_px"], dtype=float)
    try:
        refuse_millimetres(arrays.get("points3d_m", np.zeros(0)))
        return Detections(camera.name, float(document["time_s"]), points2d_px, **arrays)
    except ValueError as error:
        raise MessageError("values", str(error)) from None


def _check(document: Any, rig: CameraRig, skeleton: Skeleton) -> Camera:
    """Everything but the arrays."""
    if not isinstance(document, dict) or (document.get("format"), document.get("version")) != (FORMAT, VERSION):
        raise MessageError("content", f"not a message of {FORMAT}, version {VERSION}")
    wrong = sorted((_REQUIRED - document.keys()) | (document.keys() - _REQUIRED - _OPTIONAL))
    if wrong:
        raise MessageError("content", f"keys that are missing or unknown: {_short(wrong)}")
    name = document["camera"]
    if name not in rig.names:
        raise MessageError("camera", f"the rig has no camera {_short(name)}, only {', '.join(rig.names)}")
    camera = rig.cameras[rig.names.index(name)]
    if document["skeleton"] != skeleton.name:
        wanted = f"{skeleton.name} with {skeleton.n_joints} joints"
        raise MessageError("skeleton", f"camera {name}: skeleton {_short(document['skeleton'])}, not {wanted}")
    if not _same_size(document["size_px"], camera.size_px):
        raise MessageError(
            "image size", f"camera {name}: images of {_short(document['size_px'])}, calibrated are {camera.size_px}"
        )
    time_s = document["time_s"]
    if isinstance(time_s, bool) or not isinstance(time_s, int | float) or not abs(time_s) < np.inf:
        raise MessageError("time", f"camera {name}: the time of an image is {_short(time_s)}")
    if "covariance3d_camera_m2" in document and "points3d_camera_m" not in document:
        raise MessageError("content", f"camera {name}: a covariance without 3D joints")
    return camera


def _same_size(size_px: Any, calibrated_px: tuple[int, int]) -> bool:
    return isinstance(size_px, list) and tuple(size_px) == tuple(calibrated_px)


def _people_shape(points2d_px: Any, camera: Camera, skeleton: Skeleton) -> tuple[int, int]:
    shape = np.shape(points2d_px) if isinstance(points2d_px, np.ndarray) else ()
    if len(shape) != 3 or shape[1:] != (skeleton.n_joints, 2):
        wanted = f"(people, {skeleton.n_joints}, 2), got {shape or _short(points2d_px)}"
        raise MessageError("shape", f"camera {camera.name}: points2d_px must be {wanted}")
    if shape[0] > MAX_PEOPLE:
        raise MessageError("shape", f"camera {camera.name}: {shape[0]} people in an image, at most {MAX_PEOPLE}")
    return shape[:2]


def _array(document: dict[str, Any], name: str, camera: Camera, shape: tuple[int | None, ...]) -> np.ndarray:
    array = document[name]
    actual = np.shape(array) if isinstance(array, np.ndarray) else ()
    if len(actual) != len(shape) or any(n not in (None, m) for n, m in zip(shape, actual, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise MessageError("shape", f"camera {camera.name}: {name} must be ({wanted}), got {actual or _short(array)}")
    return np.asarray(array, dtype=float)


def _covariance(document: dict[str, Any], camera: Camera, shape: tuple[int, int]) -> np.ndarray:
    """In the world frame."""
    covariance_m2 = _array(document, "covariance3d_camera_m2", camera, (*shape, 3, 3))
    known = np.asarray(np.isfinite(document["points3d_camera_m"]).all(axis=-1))
    if not positive_definite(covariance_m2[known]).all():
        raise MessageError("values", f"camera {camera.name}: the covariance of a 3D joint is not positive definite")
    R = camera.world_T_camera[:3, :3]
    return R @ covariance_m2 @ R.T


def _short(value: Any) -> str:
    """For a message, however long the value is."""
    return reprlib.repr(value)
