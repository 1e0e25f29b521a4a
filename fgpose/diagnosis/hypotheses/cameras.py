"""Cameras that are not as they are read: conventions of poses that are mistaken for each other, and other lenses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.hypotheses.consistency import NEAR_M
from fgpose.diagnosis.hypotheses.hypothesis import Hypothesis, each_view
from fgpose.diagnosis.hypotheses.scene import CameraView, SynchronousViews
from fgpose.finding import Code
from fgpose.geometry.intrinsics import is_central, with_exchanged_centre, zoomed
from fgpose.geometry.rigid import pose_of
from fgpose.sampling import spread_evenly

Pose = Float[np.ndarray, "4 4"]
_BEST, _RAYS = 4, 60  # ways to take rotation vectors that are looked at; rays that tell them
_LAST = 20  # preference: so many turns of each camera come near to much
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_FACTORS = (*np.exp(np.arange(np.log(0.4), np.log(2.5), 0.05)),)
_UNCHANGED = 0.04


class Convention(NamedTuple):
    """How a pose was meant, from how it was read."""

    meant: Callable[[Pose], Pose]
    words: str


def _of_camera_T_world(
    R: Float[np.ndarray, "*poses 3 3"], t_m: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "*poses 4 4"]:
    """x_camera = R x_world + t, as poses of the camera."""
    poses = np.broadcast_to(np.eye(4), (*R.shape[:-2], 4, 4)).copy()
    poses[..., :3, :3] = np.swapaxes(R, -1, -2)
    poses[..., :3, 3] = -np.einsum("...ji,j->...i", R, t_m)
    return poses


def _of_rotation(R: Callable[[Float[np.ndarray, "3 3"]], Float[np.ndarray, "3 3"]]) -> Callable[[Pose], Pose]:
    """Another rotation, with the translation as it is stored."""

    def meant(pose: Pose) -> Pose:
        camera_R_world = pose[:3, :3].T
        return _of_camera_T_world(R(camera_R_world), -camera_R_world @ pose[:3, 3])

    return meant


def _vector_in_degrees(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Whose rotation vector has so many radians as this one has degrees."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(np.rad2deg(Rotation.from_matrix(R).as_rotvec())).as_matrix()


_AS_READ = Convention(lambda pose: pose, "")
_OF_PLACES = (
    _AS_READ,
    Convention(
        lambda pose: pose_of(pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]),
        "the poses are stored from the camera to the world, not from the world to the camera",
    ),
    Convention(
        lambda pose: pose_of(pose[:3, :3], -pose[:3, :3].T @ pose[:3, 3]),
        "what is stored as translation is the position of the camera",
    ),
    Convention(lambda pose: pose_of(pose[:3, :3].T, pose[:3, 3]), "the rotations are stored transposed"),
    Convention(
        _of_rotation(lambda R: R.T), "the rotations are stored transposed, the translations are as they should be"
    ),
    Convention(
        _of_rotation(_vector_in_degrees), "the rotation vectors are in radians, but were taken to be in degrees"
    ),
)
_OF_AXES = (
    _AS_READ,
    Convention(
        lambda pose: pose @ _OPENGL,
        "the cameras have the axes of OpenGL (y up, z backwards), not of OpenCV (y down, z forwards)",
    ),
)


def pose_hypotheses(scene: SynchronousViews) -> Iterator[Hypothesis]:
    """Of all cameras alike; of three or more also of one: with two, something makes almost any pose agree."""
    everybody = tuple(range(scene.n_cameras))
    for cameras in [everybody, *((c,) for c in everybody if scene.n_cameras > 2)]:
        for place in _OF_PLACES:
            for axes in _OF_AXES:
                words = " and ".join(each.words for each in (place, axes) if each.words)
                if words:
                    yield _hypothesis(cameras, [_both(place, axes)] * len(cameras), words)
    for rotations in _read_as_radians(scene):
        words = "the rotation vectors are in degrees, but were taken to be in radians"
        turned = _hypothesis(everybody, [_of_rotation(lambda _, R=R: R) for R in rotations], words, _LAST)
        yield replace(turned, of_many=True)


def _both(place: Convention, axes: Convention) -> Callable[[Pose], Pose]:
    return lambda pose: axes.meant(place.meant(pose))


def _hypothesis(
    cameras: tuple[int, ...], meant: Sequence[Callable[[Pose], Pose]], words: str, preference: int = 0
) -> Hypothesis:
    def mend(given: SynchronousViews) -> SynchronousViews:
        views = [given.views[c] for c in cameras]
        poses = [mean(view.camera.world_T_camera) for mean, view in zip(meant, views, strict=True)]
        return given.with_views({c: view.at(pose) for c, view, pose in zip(cameras, views, poses, strict=True)})

    return Hypothesis(
        Code.CAMERA_AXES,
        cameras,
        mend,
        f"The calibration of {{cameras}} is read in another convention than it was written in: {words}",
        "Convert it: fgpose reads x_camera = R x_world + t, with x to the right, y down and z forwards in the camera, "
        "and rotation vectors in radians.",
        preference=preference,
    )


def _read_as_radians(scene: SynchronousViews) -> Iterator[list[Float[np.ndarray, "3 3"]]]:
    """What the rotations of all cameras were in degrees. What was read tells them but for whole turns, of which 180
    degrees as radians have 29: each camera takes the ones with which it meets the first one best."""
    rotations = [_in_degrees(view.camera.camera_T_world[:3, :3]) for view in scene.views]
    poses = [
        _of_camera_T_world(R, view.camera.camera_T_world[:3, 3]) for R, view in zip(rotations, scene.views, strict=True)
    ]
    rays = [view.in_camera.reshape(-1, 3) for view in scene.views]
    costs = [_meeting(poses[0], rays[0], poses[c], rays[c]) for c in range(1, scene.n_cameras)]
    for first in np.argsort(sum(cost.min(axis=1) for cost in costs), kind="stable")[:_BEST].tolist():
        chosen = [first, *(int(np.argmin(cost[first])) for cost in costs)]
        yield [R[own] for R, own in zip(rotations, chosen, strict=True)]


def _in_degrees(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "turn 3 3"]:
    """All rotations that this one may be if degrees were taken for radians."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = max(float(np.linalg.norm(vector)), 1e-9)
    turns = 2 * np.pi * np.arange(np.ceil(180 / (2 * np.pi)) + 1)
    degrees = np.concatenate([turns + angle, angle - turns[1:]])
    degrees = degrees[np.abs(degrees) <= 180]
    return Rotation.from_rotvec(np.deg2rad(degrees)[:, None] * vector / angle).as_matrix()


def _meeting(
    poses_a: Float[np.ndarray, "a 4 4"],
    rays_a: Float[np.ndarray, "point 3"],
    poses_b: Float[np.ndarray, "b 4 4"],
    rays_b: Float[np.ndarray, "point 3"],
) -> Float[np.ndarray, "a b"]:
    """How well rays of two cameras, each in its own frame, meet in front of both for every pair of their poses: mean of
    the squared distances, in units of NEAR_M and no more than 1 each."""
    known = np.flatnonzero(np.isfinite(rays_a[:, 0]) & np.isfinite(rays_b[:, 0]))
    if not len(known):
        return np.ones((len(poses_a), len(poses_b)))
    some = known[spread_evenly(len(known), _RAYS)]
    a, b = (rays[some] @ np.swapaxes(poses[:, :3, :3], 1, 2) for rays, poses in ((rays_a, poses_a), (rays_b, poses_b)))
    base_m = poses_b[None, :, :3, 3] - poses_a[:, None, :3, 3]
    cosine = np.einsum("ipk,jpk->ijp", a, b)
    along_a, along_b = np.einsum("ipk,ijk->ijp", a, base_m), np.einsum("jpk,ijk->ijp", b, base_m)
    square = np.maximum(1 - cosine**2, 1e-6)
    depth_a, depth_b = (along_a - cosine * along_b) / square, (cosine * along_a - along_b) / square
    between = base_m[:, :, None] + depth_b[..., None] * b[None] - depth_a[..., None] * a[:, None]
    cost = np.minimum(np.sum(between**2, axis=-1) / NEAR_M**2, 1.0)
    return np.where((depth_a > 0) & (depth_b > 0), cost, 1.0).mean(axis=-1)


def lens_hypotheses(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Another focal length, no distortion, or cx and cy in the place of each other."""
    yield from _undistorted(scene, cameras)
    yield from _exchanged_centres(scene, cameras)
    for factor in _FACTORS:
        if abs(factor - 1) > _UNCHANGED:
            yield other_focal(scene, cameras, float(factor))


def other_focal(scene: SynchronousViews, cameras: tuple[int, ...], factor: float) -> Hypothesis:
    """A focal length that is so many times as long."""

    def longer(given: SynchronousViews) -> SynchronousViews:
        views = {c: CameraView(zoomed(given.views[c].camera, factor), given.views[c].points_px) for c in cameras}
        # Where all look at the body, it is made smaller and all misses with it.
        smaller = factor if len(cameras) == given.n_cameras else 1.0
        return replace(given.with_views(views), shrunk=smaller * given.shrunk)

    given_px = float(np.median([scene.views[c].camera.K[0, 0] for c in cameras]))
    return Hypothesis(
        Code.WRONG_LENS,
        cameras,
        longer,
        f"The focal length of {{cameras}} is not that of the calibration: about {factor * given_px:.0f} px instead of "
        f"{given_px:.0f}",
        "Was the lens zoomed, or a crop or stabilisation of the camera switched on? Calibrate its lens anew, or "
        f"multiply its focal lengths by {factor:.3g}.",
        {"focal_factor": factor},
        preference=2,
    )


def _exchanged_centres(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Rows before columns. The middle of the image is where it would be."""
    given = [scene.views[c].camera for c in cameras]
    meant = [with_exchanged_centre(camera) for camera in given]
    if any(is_central(camera) for camera in given) or not all(is_central(camera) for camera in meant):
        return
    yield Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(lambda view: CameraView(with_exchanged_centre(view.camera), view.points_px), cameras),
        f"The principal point of {{cameras}} has cx and cy exchanged: it is ({given[0].K[0, 2]:.0f}, "
        f"{given[0].K[1, 2]:.0f}) in images of {given[0].size_px[0]}x{given[0].size_px[1]}",
        "Exchange cx and cy in the calibration.",
    )


def _undistorted(scene: SynchronousViews, cameras: tuple[int, ...]) -> Iterator[Hypothesis]:
    """Keypoints of images from which the distortion was removed already."""
    if not any(scene.views[c].camera.distortion.any() for c in cameras):
        return
    yield Hypothesis(
        Code.WRONG_LENS,
        cameras,
        each_view(
            lambda view: CameraView(replace(view.camera, distortion=np.zeros(0), lens="pinhole"), view.points_px),
            cameras,
        ),
        "The distortion in the calibration of {cameras} is not that of the images that the keypoints are of",
        "Were the images undistorted before? Then leave the distortion out of the calibration.",
        {"distortion_factor": 0.0},
        preference=2,
    )
