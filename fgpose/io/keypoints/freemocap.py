"""FreeMoCap: one array (npy) of all cameras, without their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgpose.io.arrays import read_array
from fgpose.io.keypoints.detections import CameraDetections, Provenance, checked_detections
from fgpose.io.skeletons import load_skeleton
from fgpose.io.skeletons.joint_names import no_such_joints
from fgpose.plain_files import naming
from fgpose.skeleton import Skeleton

# Of MediaPipe with hands and face: the body, the right and the left hand come first.
_WITH_HANDS = (75, 543, 553)


def is_freemocap(path: Path) -> bool:
    """By its name, mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy: an array says nothing of itself."""
    name = path.name.casefold()
    return name.endswith(".npy") and ("2ddata" in name.replace("_", "") or "pixelxy" in name)


def camera_names(path: Path) -> tuple[str, ...]:
    """cam_0, cam_1, ... as in FreeMoCap's calibrations. Raises ValueError, which names the file, and OSError."""
    return tuple(f"cam_{camera}" for camera in range(len(_array(path))))


def stated_skeleton(path: Path) -> str | None:
    """MediaPipe's, with hands and face or without; None of other points. Raises ValueError, which names the file."""
    n_given = _array(path).shape[2]
    if n_given in _WITH_HANDS:
        return "holistic_75"
    return "blazepose_33" if n_given == load_skeleton("blazepose_33").n_joints else None


def read(path: Path, skeleton: Skeleton) -> dict[str, CameraDetections]:
    """The images of all cameras by the names of camera_names. All that is there has confidence 1; a third coordinate,
    which is no confidence, is not used.

    Raises:
        ValueError: the file is damaged, or has other joints; the message names file and camera.
        OSError: it cannot be read.
    """
    array = _array(path)
    n_given = array.shape[2]
    chosen = _of_mediapipe(skeleton) if n_given in _WITH_HANDS else list(range(skeleton.n_joints))
    if chosen is None or (n_given not in _WITH_HANDS and n_given != skeleton.n_joints):
        raise ValueError(
            f"{path}: it has {n_given} points in each image, {no_such_joints(skeleton, n_given)}. Those of MediaPipe "
            "are --skeleton blazepose_33, with hands holistic_75"
        )
    points2d_px = array[:, :, chosen, :2].astype(float)
    known = np.asarray(np.isfinite(points2d_px).all(axis=-1))
    points2d_px[~known] = np.nan
    cameras: dict[str, CameraDetections] = {}
    for c, name in enumerate(camera_names(path)):
        cameras[name] = {}
        for frame in range(array.shape[1]):
            there = slice(None, 1 if known[c, frame].any() else 0)
            source = Provenance(path, name, frame)
            of_image = points2d_px[c, frame][None][there], known[c, frame].astype(float)[None][there]
            cameras[name][frame] = checked_detections(source, skeleton, *of_image)
    return cameras


def _of_mediapipe(skeleton: Skeleton) -> list[int] | None:
    """Where the joints of the skeleton, a body and perhaps hands, are among those of MediaPipe; None: they are not."""
    whole = load_skeleton("holistic_75")
    hands = {part.name: [whole.joints[joint] for joint in part.joints] for part in whole.parts}
    body = [whole.joints[joint] for joint in whole.body]
    names = [*body, *hands["right_hand"], *hands["left_hand"]]
    is_its = set(body) <= set(skeleton.joints) <= set(names)
    return [names.index(joint) for joint in skeleton.joints] if is_its else None


def _array(path: Path) -> np.ndarray:
    with naming(path):
        array = read_array(path)
    if array.dtype.kind not in "fiu" or array.ndim != 4 or array.shape[3] not in (2, 3):
        raise ValueError(
            f"{path}: not 2D points of FreeMoCap: an array (cameras, frames, points, 2 or 3) of numbers is needed, got "
            f"{array.shape}"
        )
    return array
