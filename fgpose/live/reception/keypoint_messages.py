"""2D keypoints of a detector elsewhere, as messages: the format that docs/live_messages.md describes."""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.live.packing import packed
from fgpose.live.reception.message_schema import PackedArray, Schema, quoted
from fgpose.live.reception.rejections import MessageError
from fgpose.observations import positive_definite, refuse_millimetres
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

FORMAT, VERSION = "fgpose/keypoints", 1
MAX_BODY_BYTES = 1 << 20
"""Of a message that is looked at: thirty people with 133 joints each and all that a message may have take less."""
MAX_PEOPLE = 30
"""In an image: the time to tell people apart grows with them."""


class _Keypoints(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A message."""

    format: Literal["fgpose/keypoints"]
    version: Literal[1]
    camera: str
    time_s: float
    size_px: tuple[int, int]
    skeleton: str
    points2d_px: PackedArray
    confidence: PackedArray
    points3d_camera_m: PackedArray | msgspec.UnsetType = msgspec.UNSET
    covariance3d_camera_m2: PackedArray | msgspec.UnsetType = msgspec.UNSET
    appearance: PackedArray | msgspec.UnsetType = msgspec.UNSET
    key: str = ""


_SCHEMA = Schema(_Keypoints, f"{FORMAT}, version {VERSION}", MAX_BODY_BYTES)


def encode_keypoints(
    camera: str,
    time_s: float,
    size_px: tuple[int, int],
    skeleton: str,
    points2d_px: Float[np.ndarray, "person joint 2"],
    confidence: Float[np.ndarray, "person joint"],
    *,
    key: str = "",
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
        key: of the camera in the rig file, where it has one.
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
            **({"key": key} if key else {}),
        }
    )


def decode_keypoints(
    body: bytes | memoryview, rig: CameraRig, skeleton: Skeleton, keys: Mapping[str, str] | None = None
) -> Detections:
    """The detections in a message, at the time that it says; 3D joints in the world frame.

    Args:
        body: the message.
        rig: the cameras that may send.
        skeleton: of the joints.
        keys: of cameras whose messages must have one.

    Raises:
        MessageError: the message is refused; kind says why in a word or two, the text in full. Nothing else is raised,
            whatever the bytes are.
    """
    document = _SCHEMA.document(body)
    camera = _checked_camera(document, rig, skeleton)
    wanted = (keys or {}).get(camera.name, "")
    if wanted and not hmac.compare_digest(document.key.encode(), wanted.encode()):
        raise MessageError("key", "a message without the key of the rig file", camera.name)
    points2d_px = document.points2d_px.array()
    shape = _people_shape(points2d_px, camera, skeleton)
    arrays = {"confidence": _array(document.confidence, "confidence", camera, shape)}
    if document.points3d_camera_m:
        points_m = _array(document.points3d_camera_m, "points3d_camera_m", camera, (*shape, 3))
        arrays["points3d_m"] = camera.to_world_frame(points_m)
        if document.covariance3d_camera_m2:
            arrays["covariance3d_m2"] = _covariance(document.covariance3d_camera_m2, points_m, camera)
    if document.appearance:
        arrays["appearance"] = _array(document.appearance, "appearance", camera, (shape[0], None))
    try:
        if "points3d_m" in arrays:
            refuse_millimetres(arrays["points3d_m"])
        return Detections(camera.name, document.time_s, points2d_px, **arrays)
    except ValueError as error:
        reason = str(error).removeprefix(f"camera {camera.name}, ")
        raise MessageError("values", reason, camera.name) from None


def _checked_camera(document: _Keypoints, rig: CameraRig, skeleton: Skeleton) -> Camera:
    """Everything but the arrays is as here."""
    name = document.camera
    if name not in rig.names:
        raise MessageError("camera", f"the rig has no camera {quoted(name)}, only {', '.join(rig.names)}")
    camera = rig.cameras[rig.names.index(name)]
    if document.skeleton != skeleton.name:
        wanted = f"{skeleton.name} with {skeleton.n_joints} joints"
        raise MessageError("skeleton", f"skeleton {quoted(document.skeleton)}, not {wanted}", name)
    if document.size_px != tuple(camera.size_px):
        raise MessageError("image size", f"images of {quoted(document.size_px)}, calibrated are {camera.size_px}", name)
    if not np.isfinite(document.time_s):
        raise MessageError("time", f"the time of an image is {document.time_s}", name)
    if document.covariance3d_camera_m2 and not document.points3d_camera_m:
        raise MessageError("content", "a covariance without 3D joints", name)
    return camera


def _people_shape(points2d_px: np.ndarray, camera: Camera, skeleton: Skeleton) -> tuple[int, int]:
    shape = points2d_px.shape
    if len(shape) != 3 or shape[1:] != (skeleton.n_joints, 2):
        wanted = f"(people, {skeleton.n_joints}, 2), got {shape}"
        raise MessageError("shape", f"points2d_px must be {wanted}", camera.name)
    if shape[0] > MAX_PEOPLE:
        raise MessageError("shape", f"{shape[0]} people in an image, at most {MAX_PEOPLE}", camera.name)
    return shape[:2]


def _array(sent: PackedArray, name: str, camera: Camera, shape: tuple[int | None, ...]) -> np.ndarray:
    if len(sent.shape) != len(shape) or any(n not in (None, m) for n, m in zip(shape, sent.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise MessageError("shape", f"{name} must be ({wanted}), got {sent.shape}", camera.name)
    return sent.array()


def _covariance(sent: PackedArray, points_m: np.ndarray, camera: Camera) -> np.ndarray:
    """In the world frame."""
    covariance_m2 = _array(sent, "covariance3d_camera_m2", camera, (*points_m.shape, 3))
    known = np.isfinite(points_m).all(axis=-1)
    if not positive_definite(covariance_m2[known]).all():
        raise MessageError("values", "the covariance of a 3D joint is not positive definite", camera.name)
    R = camera.world_T_camera[:3, :3]
    return R @ covariance_m2 @ R.T
