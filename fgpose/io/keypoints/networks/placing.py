"""From the 3D joints of a monocular network, however it gives them, to absolute ones in the world.

A network's depth follows from the focal length that it assumed, and that of the calibration is better known. So the
translation of every person is solved anew from the 2D keypoints; of the network only the shape of the body is taken.
Across the ray a joint lies on its 2D keypoint. This one is the projection of the same 3D joint: together they are one
observation, of which the 2D tells two coordinates and the 3D the depth, once each.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import UNKNOWN_SIZE_PX
from fgpose.geometry.per_view.absolute_pose import absolute_pose
from fgpose.io.keypoints.detections import CameraDetections, ImageDetections, NetworkJoints
from fgpose.people_observations import Detections
from fgpose.skeleton import Skeleton

# Of a body in metres, whichever its unit: no body is 20 m large, and none is 20 mm.
_MAX_BODY = 20.0
_MIN_DEPTH_M = 0.1
# Largest distance of projected joints from their pixels over the size of the body in the image. Principal points and
# lenses that a network does not know shift bodies by less, other axes by more.
_MAX_MISS = 0.25
# The focal length of a network may be read, or has to be told from joints that know no lens distortion.
_MAX_STATED_RATIO, _MAX_FITTED_RATIO = 1.01, 1.05
_MAX_FOCAL_RATIO = 10.0


@dataclass(frozen=True, eq=False)
class _Bodies:
    """The people in all images of a camera, as the network gives them, in metres."""

    camera: Camera
    joints_m: Float[np.ndarray, "person joint 3"]
    points_px: Float[np.ndarray, "person joint 2"]
    translation_m: Float[np.ndarray, "person 3"]
    focal_px: Float[np.ndarray, " person"]


@dataclass(frozen=True)
class _Given:
    """A way in which 3D joints may be given."""

    name: str
    in_camera_m: Callable[[_Bodies], Float[np.ndarray, "person joint 3"]]


_IN_WORLD = _Given("in the world of the calibration", lambda bodies: bodies.camera.to_camera_frame(bodies.joints_m))
_WAYS = (
    _Given("relative to the body", lambda bodies: bodies.joints_m + bodies.translation_m[:, None]),
    _Given("absolute in the frame of each camera", lambda bodies: bodies.joints_m),
    _IN_WORLD,
)


def is_of_network(cameras: Sequence[CameraDetections]) -> bool:
    """Whether there is somebody whom a monocular network found."""
    return any(image.of_network is not None for images in cameras for image in images.values())


def placed(
    cameras: Sequence[CameraDetections], rig: CameraRig, skeleton: Skeleton, fps: float
) -> tuple[tuple[Detections, ...], tuple[str, ...]]:
    """Everybody in all images with absolute 3D and its covariance in the world frame, and what is to be said.

    Joints beyond the border of the image are hallucinated: their 3D is kept, their 2D is no detection. For cameras of
    UNKNOWN_SIZE_PX there is no 3D.

    Args:
        cameras: the images of each camera of the rig, in its order, by frame number.
        rig: the calibration.
        skeleton: the joints; those whose depth is known best find the translation.
        fps: frame n is at n / fps.

    Raises:
        ValueError: 3D and 2D joints of a camera do not belong together, however the 3D may be given; the message names
            it.
    """
    if all(camera.size_px == UNKNOWN_SIZE_PX for camera in rig.cameras):
        return _flat(cameras, rig, fps)
    unit_m, of_unit = _unit_m(cameras)
    all_bodies = {
        camera.name: _bodies(camera, images, unit_m)
        for camera, images in zip(rig.cameras, cameras, strict=True)
        if is_of_network([images])
    }
    bodies = {name: each for name, each in all_bodies.items() if len(each.joints_m)}
    if not bodies:
        raise ValueError(f"none of the 3D joints of {_networks(cameras)} is a number")
    way, of_way = _way(bodies)
    solving = _Solving(skeleton, unit_m, way is _IN_WORLD)
    images = tuple(
        solving.solved(camera, frame / fps, found)
        for camera, frames in zip(rig.cameras, cameras, strict=True)
        for frame, found in frames.items()
    )
    of_focal = _focal_remarks(bodies, way)
    return images, (*of_unit, *of_way, *of_focal, *_confidence_remarks(cameras), *solving.remarks())


def _flat(
    cameras: Sequence[CameraDetections], rig: CameraRig, fps: float
) -> tuple[tuple[Detections, ...], tuple[str, ...]]:
    """Without 3D."""
    images = tuple(
        Detections(camera.name, frame / fps, found.points2d_px, found.confidence)
        for camera, frames in zip(rig.cameras, cameras, strict=True)
        for frame, found in frames.items()
    )
    return images, (
        f"the 3D joints of {_networks(cameras)} follow the focal length that it assumed; they are not used without a "
        "calibration",
    )


def _networks(cameras: Sequence[CameraDetections]) -> str:
    names = (image.of_network.network for frames in cameras for image in frames.values() if image.of_network)
    return " and ".join(dict.fromkeys(names))


def _unit_m(cameras: Sequence[CameraDetections]) -> tuple[float, tuple[str, ...]]:
    """How many metres a unit of the file is: a body tells it by its size."""
    extents = [
        np.linalg.norm(np.ptp(joints[known], axis=0))
        for images in cameras
        for image in images.values()
        if image.of_network is not None and image.points3d is not None
        for joints in image.points3d
        if (known := np.isfinite(joints).all(axis=1)).any()
    ]
    extent = float(np.median(extents)) if extents else 0.0
    if extent < _MAX_BODY:
        return 1.0, ()
    return 1e-3, (f"bodies measure {extent:.0f} in the files: their 3D joints are taken as millimetres",)


def _bodies(camera: Camera, images: CameraDetections, unit_m: float) -> _Bodies:
    def all_people(of_image: Callable[[ImageDetections, NetworkJoints], np.ndarray]) -> np.ndarray:
        return np.concatenate([of_image(each, each.of_network) for each in images.values() if each.of_network])

    def points3d(image: ImageDetections, _: NetworkJoints) -> np.ndarray:
        assert image.points3d is not None
        return image.points3d * unit_m

    joints_m, points_px = all_people(points3d), all_people(lambda image, _: image.points2d_px)
    known = np.isfinite(joints_m).all(axis=-1).any(axis=-1)
    return _Bodies(
        camera,
        joints_m[known],
        points_px[known],
        all_people(lambda _, joints: joints.translation * unit_m)[known],
        all_people(lambda _, joints: joints.focal_px)[known],
    )


def _way(bodies: Mapping[str, _Bodies]) -> tuple[_Given, tuple[str, ...]]:
    """How the joints are given in all cameras: as they are projected onto their 2D."""
    surrounding = [np.abs(np.nanmedian(each.joints_m, axis=1)).max() for each in bodies.values()]
    without_translation = all(np.isnan(each.translation_m).all() for each in bodies.values())
    if without_translation and max(surrounding) < 1.0:
        # A camera cannot be inside a body.
        return _WAYS[1], ("their 3D joints are relative to the body and have no translation: it is solved for",)
    missed = {way.name: {name: _fit(each, way)[1] for name, each in bodies.items()} for way in _WAYS}
    way = min(_WAYS, key=lambda way: np.median(list(missed[way.name].values())))
    for name, miss in missed[way.name].items():
        if not miss <= _MAX_MISS:
            tried = ", ".join(f"{each} {_percent(missed[each][name])}" for each in missed)
            raise ValueError(
                f"camera {name}: its 3D joints do not project onto its 2D joints; they are off by this much of the "
                f"body's size: {tried}. Are the axes x right, y down, z forward, and are both of the same people and "
                "of images of this camera?"
            )
    return way, () if way is _WAYS[0] else (f"their 3D joints are {way.name}, as they project onto their 2D",)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "(behind the camera)"


def _fit(bodies: _Bodies, way: _Given) -> tuple[float, float]:
    """The focal length in pixels with which joints given in this way project best onto their 2D, and how far they then
    miss, over the size of the body in the image (medians)."""
    joints_m, centre_px = way.in_camera_m(bodies), bodies.camera.K[:2, 2]
    in_front = joints_m[..., 2:] > _MIN_DEPTH_M
    on_plane = np.where(in_front, joints_m[..., :2] / np.where(in_front, joints_m[..., 2:], 1.0), np.nan)
    seen_px = bodies.points_px - centre_px
    known = np.asarray(np.isfinite(on_plane + seen_px).all(axis=-1))
    seen = np.isfinite(seen_px).all(axis=-1)
    if 2 * known.sum() < seen.sum() or not known.any():
        return np.nan, np.inf
    focal_px = float(np.sum(seen_px[known] * on_plane[known]) / np.sum(on_plane[known] ** 2))
    calibrated_px = _calibrated_px(bodies.camera)
    if not calibrated_px / _MAX_FOCAL_RATIO < focal_px < calibrated_px * _MAX_FOCAL_RATIO:
        return focal_px, np.inf
    off_px = np.linalg.norm(seen_px - focal_px * on_plane, axis=-1)
    missed = [
        np.median(off[use]) / max(float(np.linalg.norm(px[use].std(axis=0))), 1e-9)
        for off, px, use in zip(off_px, seen_px, known, strict=True)
        if use.any()
    ]
    return focal_px, float(np.median(missed))


def _calibrated_px(camera: Camera) -> float:
    return float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))


def _focal_remarks(bodies: Mapping[str, _Bodies], way: _Given) -> tuple[str, ...]:
    """What to say of cameras whose focal length the network took to be another."""
    others, ratios = [], []
    for name, each in bodies.items():
        stated = each.focal_px[np.isfinite(each.focal_px) & (each.focal_px > 0)]
        assumed_px = float(np.median(stated)) if stated.size else _fit(each, way)[0]
        ratio = assumed_px / _calibrated_px(each.camera)
        if abs(np.log(ratio)) > np.log(_MAX_STATED_RATIO if stated.size else _MAX_FITTED_RATIO):
            ratios.append(ratio)
            others.append(f"{name} {assumed_px:.0f} instead of {_calibrated_px(each.camera):.0f} px")
    if not others:
        return ()
    worst = max(ratios, key=lambda ratio: abs(np.log(ratio)))
    return (
        f"the network assumed other focal lengths than the calibration has ({', '.join(others)}), so that its depths "
        f"are off by up to {100 * abs(worst - 1):.0f} %: the distance of each person was solved anew from the 2D "
        "joints. Give the network the intrinsics of the calibration, the shape of the body is then better too",
    )


def _confidence_remarks(cameras: Sequence[CameraDetections]) -> tuple[str, ...]:
    unsure = [image.of_network for frames in cameras for image in frames.values() if image.of_network is not None]
    if any(np.isfinite(joints.sigma_m).any() for joints in unsure):
        return ()
    return (
        f"{_networks(cameras)} states no confidence and answers for hidden joints too: all joints in an image count "
        "alike, and which are hidden the other cameras tell",
    )


class _Solving:
    """Finds the translations, and remembers whose distance could not be found."""

    def __init__(self, skeleton: Skeleton, unit_m: float, in_world: bool) -> None:
        self._skeleton, self._unit_m, self._in_world = skeleton, unit_m, in_world
        self._n_people, self._problems = 0, Counter[str]()

    def solved(self, camera: Camera, time_s: float, found: ImageDetections) -> Detections:
        """Everybody in an image, in the world frame."""
        if found.of_network is None or found.points3d is None:
            return Detections(camera.name, time_s, found.points2d_px, found.confidence)
        joints_m = found.points3d * self._unit_m
        if self._in_world:
            joints_m = camera.to_camera_frame(joints_m)
        poses = [
            absolute_pose(
                *person[:3],
                camera,
                self._skeleton,
                depth_sigma_m=person[3] if np.isfinite(person[3]).all() else None,
                landmarks_are_projections=True,
            )
            for person in zip(joints_m, found.points2d_px, found.confidence, found.of_network.sigma_m, strict=True)
        ]
        self._n_people += len(poses)
        self._problems.update(pose.problem.partition(":")[0] for pose in poses if pose.problem)
        R = camera.world_T_camera[:3, :3]
        points_px = found.points2d_px
        inside = np.all((points_px >= 0) & (points_px <= np.subtract(camera.size_px, 1)), axis=-1)
        return Detections(
            camera.name,
            time_s,
            np.where(inside[..., None], points_px, np.nan),
            np.where(inside, found.confidence, 0.0),
            camera.to_world_frame(np.stack([pose.points3d_m for pose in poses])),
            R @ np.stack([pose.covariance_m2 for pose in poses]) @ R.T,
        )

    def remarks(self) -> tuple[str, ...]:
        """What to say of those whose distance could not be found, or is uncertain."""
        if not self._problems:
            return ()
        kinds = ", ".join(f"{problem} {count}" for problem, count in self._problems.most_common())
        return (f"the distance of people from the camera is missing or uncertain in some of {self._n_people}: {kinds}",)
