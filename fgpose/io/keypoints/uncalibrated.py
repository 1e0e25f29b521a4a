"""Keypoints of cameras that are not calibrated yet, and what they tell of the size of the images."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import UNKNOWN_SIZE_PX, guessed_intrinsics
from fgpose.io.keypoints import live_files, people_files, recording_files
from fgpose.io.keypoints.keypoint_files import Points3dUnit, keypoint_cameras, load_people
from fgpose.io.names import match_cameras, named_cameras
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.skeleton import Skeleton

# Of videos, upright or not. Rarer ones between them would be taken where somebody stays near the middle.
_USUAL_SIZES_PX = ((640, 480), (1280, 720), (1920, 1080), (2704, 1520), (3840, 2160), (5312, 2988))
_OUTLIERS = 0.005
"""Share of the joints that may lie further out."""
_BEYOND = 0.05
"""By this share of the image's side joints that are out of sight may lie beyond it, as detectors put them."""
# Somebody who walks through a room is seen nearly everywhere in some camera.
_FILLED = 0.55


def load_uncalibrated(
    path: str | Path,
    skeleton: str | Path | Skeleton | None = None,
    *,
    fps: float | None = None,
    points3d_unit: Points3dUnit = "mm",
    cameras: tuple[str, ...] = (),
    made_with: CameraRig | None = None,
) -> PeopleObservations:
    """Everybody in keypoints of any format that load_people reads, of cameras without a calibration.

    Cameras have the names that the keypoints give them, without ``_json``. Per-view 3D is in the frame of each camera;
    that of SAM 3D Body and NLF needs the focal length, and is left out.
    That of fgpose's own files is in the world of the calibration that it was made with (fgpose detect --rig), which
    they do not contain: without made_with it is left out.

    Args:
        path: the folder or file.
        skeleton: what the keypoints are; None: as they say.
        fps: frames per second, see load_people.
        points3d_unit: of per-view 3D.
        cameras: use only these, in this order.
        made_with: the calibration that a file of fgpose was made with. Its poses only take per-view 3D back to the
            frames of the cameras that saw it, and only if it lies where these saw it.

    Warns:
        UserWarning: per-view 3D was left out.

    Raises:
        ValueError: as load_people; there are fewer than two cameras.
        OSError: a file cannot be read.
    """
    path = Path(path)
    names = tuple(re.sub(r"_json$", "", name, flags=re.IGNORECASE) for name in keypoint_cameras(path))
    if len(cameras or names) < 2:
        raise ValueError(f"{path}: one camera ({', '.join(cameras or names)}) cannot be calibrated; two are needed")
    match_cameras(names, names)
    # Of the rig only the names and the poses, the identity, are used.
    rig = guessed_intrinsics(names, [UNKNOWN_SIZE_PX] * len(names))
    people = load_people(path, rig, skeleton, fps=fps, points3d_unit=points3d_unit)
    if _is_own(path) and any(image.points3d_m is not None for image in people.images):
        in_cameras = None if made_with is None else _in_camera_frames(people, made_with)
        if in_cameras is None:
            warnings.warn(
                f"{path}: its per-view 3D is in the world of the calibration that it was made with, and not used "
                "without that",
                stacklevel=2,
            )
        people = _without_3d(people) if in_cameras is None else in_cameras
    return people.subset(cameras) if cameras else people


def _is_own(path: Path) -> bool:
    if path.is_dir():
        return False
    return people_files.is_people(path) or recording_files.is_recording(path) or live_files.is_live(path)


def _without_3d(people: PeopleObservations) -> PeopleObservations:
    images = (replace(image, points3d_m=None, covariance3d_m2=None) for image in people.images)
    return replace(people, images=tuple(images))


def _in_camera_frames(people: PeopleObservations, made_with: CameraRig) -> PeopleObservations | None:
    """With per-view 3D in the frames of the cameras; None if it does not lie where these saw it."""
    try:
        own = named_cameras(people.camera_names, made_with.names)
    except ValueError:
        return None
    camera_of = {name: made_with.cameras[made_with.names.index(own[name])] for name in people.camera_names}
    if not all(_lies_where_seen(people.by_camera[name], camera) for name, camera in camera_of.items()):
        return None
    return replace(people, images=tuple(_in_camera_frame(image, camera_of[image.camera]) for image in people.images))


def _in_camera_frame(image: Detections, camera: Camera) -> Detections:
    if image.points3d_m is None:
        return image
    R = camera.camera_T_world[:3, :3]
    covariance_m2 = None if image.covariance3d_m2 is None else R @ image.covariance3d_m2 @ R.T
    return replace(image, points3d_m=camera.to_camera_frame(image.points3d_m), covariance3d_m2=covariance_m2)


def _lies_where_seen(images: Sequence[Detections], camera: Camera) -> bool:
    """Whether per-view 3D is projected onto its detections, to within half of the size of the body: errors of a network
    are a tenth of it, and another calibration puts the body elsewhere."""
    missed = []
    for image in images:
        if image.points3d_m is None:
            continue
        seen_px, there_px = camera.undistort(image.points2d_px), camera.project(image.points3d_m)
        for own_px, own_there_px in zip(seen_px, there_px, strict=True):
            known = np.isfinite(own_px + own_there_px).all(axis=-1)
            if known.sum() > 1:
                size_px = np.linalg.norm(own_px[known].std(axis=0))
                missed.append(np.median(np.linalg.norm(own_px - own_there_px, axis=-1)[known]) / size_px)
    return not missed or bool(np.median(missed) < 0.5)


def extents_px(people: PeopleObservations) -> Float[np.ndarray, "camera 2"]:
    """How far to the right and down each camera saw joints, but for half a per cent; NaN for one that saw nobody."""
    extents = np.full((len(people.camera_names), 2), np.nan)
    for c, name in enumerate(people.camera_names):
        points_px = np.concatenate([np.zeros((0, 2)), *(i.points2d_px.reshape(-1, 2) for i in people.by_camera[name])])
        known = points_px[np.isfinite(points_px).all(axis=1)]
        if len(known):
            extents[c] = np.quantile(known, 1 - _OUTLIERS, axis=0)
    return extents


def likely_sizes_px(people: PeopleObservations) -> tuple[tuple[int, int], ...]:
    """The size of each camera's images, where no file says it: the smallest usual one in which the joints of all
    cameras are; where some seem to be upright and some not, of those of each kind.

    Warns:
        UserWarning: always; it says what was assumed.

    Raises:
        ValueError: nobody was seen, or joints are further out than in any usual image.
    """
    extents = extents_px(people)
    if not np.isfinite(extents).any():
        raise ValueError("the keypoints have no joint in any camera")
    sizes = [_smallest_usual(np.nanmax(extents, axis=0))] * len(extents)
    upright = extents[:, 1] > extents[:, 0]
    of_each = {
        each: _smallest_usual(np.nanmax(extents[upright == each], axis=0)) for each in np.unique(upright).tolist()
    }
    # Some upright and some lying images together would only fit into a much larger one.
    if _area_px(sizes[0]) > max(map(_area_px, of_each.values())):
        sizes = [of_each[each] for each in upright.tolist()]
    assumed = ", ".join(f"{name} {w} x {h}" for name, (w, h) in zip(people.camera_names, sizes, strict=True))
    warnings.warn(
        f"the keypoints do not say how large the images are; from where the joints are taken to be {assumed}; "
        "if that is wrong give --size, or intrinsics",
        stacklevel=2,
    )
    return tuple(sizes)


def _smallest_usual(extent_px: Float[np.ndarray, " 2"]) -> tuple[int, int]:
    fitting = [
        size
        for long, short in _USUAL_SIZES_PX
        for size in ((long, short), (short, long))
        if (extent_px <= np.array(size) * (1 + _BEYOND)).all()
    ]
    if not fitting:
        x, y = extent_px
        raise ValueError(
            f"joints reach to ({x:.0f}, {y:.0f}) px, further than in images of any usual size; give --size"
        )
    return min(fitting, key=_area_px)


def _area_px(size_px: tuple[int, int]) -> int:
    return size_px[0] * size_px[1]


def check_sizes(people: PeopleObservations, rig: CameraRig) -> None:
    """Compare where joints were seen with the size of the images that the intrinsics are for.

    Warns:
        UserWarning: no camera saw anybody in the right or the lower half: the keypoints may be of smaller images.

    Raises:
        ValueError: a camera saw joints far beyond its image; the message names it.
    """
    extents, sizes = extents_px(people), np.array([camera.size_px for camera in rig.cameras])
    for camera, extent in zip(rig.cameras, extents, strict=True):
        if (extent > np.array(camera.size_px) * (1 + _BEYOND)).any():
            raise ValueError(
                f"camera {camera.name}: joints reach to ({extent[0]:.0f}, {extent[1]:.0f}) px, but the images are of "
                f"{camera.size_px[0]} x {camera.size_px[1]} by the intrinsics or --size; give the size of the images "
                "that the keypoints are from (--size)"
            )
    filled = extents / sizes
    if np.isfinite(filled).any() and np.nanmax(filled) < _FILLED:
        warnings.warn(
            f"no camera saw a joint beyond {100 * np.nanmax(filled):.0f} % of its image's sides; if the keypoints are "
            "of smaller images than the intrinsics, give their size (--size)",
            stacklevel=2,
        )
