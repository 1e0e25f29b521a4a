"""Damage to the calibration, and to which images the keypoints are of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.finding import Code
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.intrinsics import stretched, zoomed
from fgpose_benchmarks.faults.damage import Damage, Damaged, some_camera, with_points
from fgpose_benchmarks.faults.take import Take

_DISTORTION = np.array([-0.28, 0.09, 0.001, -0.001, -0.01])  # of a wide lens: k1 k2 p1 p2 k3

Points = Float[np.ndarray, "frame camera joint 2"]


def of_points(change: Callable[[Points, np.ndarray], Points], *, one: bool) -> Callable[..., Damaged]:
    """Damage of the pixels of one camera, or of all.

    Args:
        change: from the pixels and the sizes (camera, 1, 2) of the images to what stands in the files.
        one: of one camera only.
    """

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        sizes_px = np.array([camera.size_px for camera in take.rig.cameras], dtype=float)[:, None]
        changed = change(take.observations.points2d_px, sizes_px)
        camera = some_camera(take, rng)
        points = take.observations.points2d_px.copy()
        which = [camera] if one else slice(None)
        points[:, which] = changed[:, which]
        names = (take.rig.names[camera],) if one else ()
        return Damaged(take.rig, with_points(take.observations, points), take.truth_m, names)

    return inflict


def of_cameras(change: Callable[[Camera, np.random.Generator], Camera], *, one: bool) -> Callable[..., Damaged]:
    """Damage of what the calibration says of one camera, or of all."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        which = some_camera(take, rng)
        cameras = [change(each, rng) if not one or c == which else each for c, each in enumerate(take.rig.cameras)]
        names = (take.rig.names[which],) if one else ()
        return Damaged(CameraRig(tuple(cameras)), take.observations, take.truth_m, names)

    return inflict


def _turned_image(points: Points, sizes_px: np.ndarray) -> Points:
    """By 90 degrees, clockwise."""
    return np.stack([sizes_px[..., 1] - 1 - points[..., 1], points[..., 0]], axis=-1)


def _upside_down(points: Points, sizes_px: np.ndarray) -> Points:
    return sizes_px - 1 - points


def _mirrored(points: Points, sizes_px: np.ndarray) -> Points:
    return np.stack([sizes_px[..., 0] - 1 - points[..., 0], points[..., 1]], axis=-1)


def _from_the_bottom(points: Points, sizes_px: np.ndarray) -> Points:
    return np.stack([points[..., 0], sizes_px[..., 1] - 1 - points[..., 1]], axis=-1)


def _letterboxed(points: Points, sizes_px: np.ndarray) -> Points:
    """With borders that make the image square, resized to 640 pixels."""
    longer = sizes_px.max(axis=-1, keepdims=True)
    return (points + (longer - sizes_px) / 2) * 640 / longer


def _cut(points: Points, sizes_px: np.ndarray) -> Points:
    """The middle of the image, square."""
    return points - (sizes_px - sizes_px.min(axis=-1, keepdims=True)) / 2


def _copied(take: Take, rng: np.random.Generator) -> Damaged:
    """A camera has the keypoints of another one."""
    a, b = rng.permutation(take.rig.n_cameras)[:2]
    order = np.arange(take.rig.n_cameras)
    order[a] = b
    return _reordered(take, order, (take.rig.names[a], take.rig.names[b]))


def _exchanged(take: Take, rng: np.random.Generator) -> Damaged:
    a, b = rng.permutation(take.rig.n_cameras)[:2]
    order = np.arange(take.rig.n_cameras)
    order[[a, b]] = order[[b, a]]
    return _reordered(take, order, (take.rig.names[a], take.rig.names[b]))


def _counted_on(take: Take, rng: np.random.Generator) -> Damaged:
    return _reordered(take, np.roll(np.arange(take.rig.n_cameras), 1), ())


def _reordered(take: Take, order: np.ndarray, names: tuple[str, ...]) -> Damaged:
    seen = take.observations
    damaged = with_points(seen, seen.points2d_px[:, order], seen.confidence[:, order])
    return Damaged(take.rig, damaged, take.truth_m, names)


def _pose(camera: Camera, world_T_camera: np.ndarray) -> Camera:
    return replace(camera, world_T_camera=world_T_camera)


def in_unit(per_metre: float) -> Callable[[Take, np.random.Generator], Damaged]:
    """Lengths of the calibration in another unit, read as metres."""

    def change(camera: Camera, rng: np.random.Generator) -> Camera:
        pose = camera.world_T_camera.copy()
        pose[:3, 3] *= per_metre
        return _pose(camera, pose)

    return of_cameras(change, one=False)


def _opengl(camera: Camera, rng: np.random.Generator) -> Camera:
    return _pose(camera, camera.world_T_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))


def _inverse(camera: Camera, rng: np.random.Generator) -> Camera:
    return _pose(camera, np.linalg.inv(camera.world_T_camera))


def _position_as_translation(camera: Camera, rng: np.random.Generator) -> Camera:
    pose = camera.world_T_camera.copy()
    pose[:3, 3] = -pose[:3, :3] @ pose[:3, 3]
    return _pose(camera, pose)


def _y_down(take: Take, rng: np.random.Generator) -> Damaged:
    """The whole world is turned, and so are the truth and what views see in 3D."""
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    cameras = tuple(_pose(camera, turn @ camera.world_T_camera) for camera in take.rig.cameras)
    R, seen = turn[:3, :3], take.observations
    if seen.points3d_m is not None:
        covariance_m2 = None if seen.covariance3d_m2 is None else R @ seen.covariance3d_m2 @ R.T
        seen = replace(seen, points3d_m=seen.points3d_m @ R.T, covariance3d_m2=covariance_m2)
    return Damaged(CameraRig(cameras), seen, take.truth_m @ R.T)


def moved(degrees: float, metres: float) -> Callable[[Take, np.random.Generator], Damaged]:
    """A camera that was turned and moved after the calibration, in a random direction."""

    def change(camera: Camera, rng: np.random.Generator) -> Camera:
        return _pose(camera, camera.world_T_camera @ nudge(rng, degrees, metres))

    return of_cameras(change, one=True)


def nudge(rng: np.random.Generator, degrees: float, metres: float) -> Float[np.ndarray, "4 4"]:
    """By a random axis, Rodrigues' formula; and in a random direction."""
    axis, direction = (each / np.linalg.norm(each) for each in rng.standard_normal((2, 3)))
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle, pose = np.radians(degrees), np.eye(4)
    pose[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    pose[:3, 3] = metres * direction
    return pose


def _other_lens(camera: Camera, rng: np.random.Generator) -> Camera:
    return zoomed(camera, 1.25)


def _distorting(camera: Camera, rng: np.random.Generator) -> Camera:
    return replace(camera, distortion=_DISTORTION)


def _wrong_height(camera: Camera, rng: np.random.Generator) -> Camera:
    return stretched(camera, 1.12, axis=1)


def _without_centre(camera: Camera, rng: np.random.Generator) -> Camera:
    K = camera.K.copy()
    K[:2, 2] = 0.0
    return replace(camera, K=K)


def _transposed(camera: Camera, rng: np.random.Generator) -> Camera:
    """The rotation alone, of x_camera = R x_world + t."""
    camera_T_world = camera.camera_T_world.copy()
    camera_T_world[:3, :3] = camera_T_world[:3, :3].T
    return _pose(camera, np.linalg.inv(camera_T_world))


def _without_distortion(*, one: bool) -> Callable[[Take, np.random.Generator], Damaged]:
    """Filmed by lenses that distort, of which the calibration knows nothing."""

    def inflict(take: Take, rng: np.random.Generator) -> Damaged:
        true = of_cameras(_distorting, one=one)(take, rng)
        return Damaged(take.rig, take.film(true.rig), take.truth_m, true.cameras)

    return inflict


def _with_distortion_of_another(take: Take, rng: np.random.Generator) -> Damaged:
    """Filmed by lenses that distort, of which the calibration has half."""
    true = of_cameras(_distorting, one=False)(take, rng)
    given = of_cameras(lambda camera, _: replace(camera, distortion=_DISTORTION / 2), one=False)(take, rng)
    return Damaged(given.rig, take.film(true.rig), take.truth_m)


def _with_placeholders(take: Take, rng: np.random.Generator) -> Damaged:
    """Every tenth joint is missing, and was written as (-1, -1)."""
    missing = rng.random(take.observations.confidence.shape) < 0.1
    points = np.where(missing[..., None], -1.0, take.observations.points2d_px)
    confidence = np.where(missing, 0.5, take.observations.confidence)
    return Damaged(take.rig, with_points(take.observations, points, confidence), take.truth_m)


_OF_CUT = Code.WRONG_LENS, Code.IMAGE_SIZE
_CONSTANT: tuple[Damage, ...] = (
    Damage("half as large images", (Code.IMAGE_SIZE,), of_points(lambda p, _: p / 2, one=False)),
    Damage("720p instead of 1080p", (Code.IMAGE_SIZE,), of_points(lambda p, _: p / 1.5, one=False)),
    Damage("twice as large images", (Code.IMAGE_SIZE,), of_points(lambda p, _: 2 * p, one=False)),
    Damage("half as large images, one camera", (Code.IMAGE_SIZE,), of_points(lambda p, _: p / 2, one=True), 3),
    Damage("from 0 to 1", (Code.NORMALISED,), of_points(lambda p, size: p / size, one=False)),
    Damage("from -1 to 1", (Code.NORMALISED,), of_points(lambda p, size: 2 * p / size - 1, one=False)),
    Damage("missing joints at (-1, -1)", (Code.PLACEHOLDER_KEYPOINTS,), _with_placeholders),
    Damage("turned by 90 degrees", (Code.TURNED_IMAGE,), of_points(_turned_image, one=False)),
    Damage("turned by 90 degrees, one camera", (Code.TURNED_IMAGE,), of_points(_turned_image, one=True), 3),
    Damage("upside down, one camera", (Code.TURNED_IMAGE,), of_points(_upside_down, one=True), 3),
    Damage("mirrored images", (Code.MIRRORED_IMAGE,), of_points(_mirrored, one=False)),
    Damage("mirrored images, one camera", (Code.MIRRORED_IMAGE,), of_points(_mirrored, one=True), 3),
    Damage("y from the bottom", (Code.MIRRORED_IMAGE,), of_points(_from_the_bottom, one=False)),
    Damage("x and y exchanged", (Code.TURNED_IMAGE,), of_points(lambda p, _: p[..., ::-1], one=False)),
    Damage("letterboxed for a network", (Code.IMAGE_SIZE,), of_points(_letterboxed, one=False)),
    Damage("sides cut off", (Code.IMAGE_SIZE,), of_points(_cut, one=False)),
    Damage("two cameras exchanged", (Code.EXCHANGED_CAMERAS,), _exchanged),
    Damage("cameras counted from another number", (Code.EXCHANGED_CAMERAS,), _counted_on),
    Damage("one folder twice", (Code.EXCHANGED_CAMERAS,), _copied),
    Damage("millimetres as metres", (Code.UNIT,), in_unit(1000.0)),
    Damage("centimetres as metres", (Code.UNIT,), in_unit(100.0)),
    Damage("inches as metres", (Code.UNIT,), in_unit(1 / 0.0254)),
    Damage("squares of 54 mm as metres", (Code.UNIT,), in_unit(1 / 0.054)),
    Damage("metres taken for millimetres", (Code.UNIT,), in_unit(0.001)),
    Damage("OpenGL axes", (Code.CAMERA_AXES,), of_cameras(_opengl, one=False)),
    Damage("camera to world stored as world to camera", (Code.CAMERA_AXES,), of_cameras(_inverse, one=False)),
    Damage("position in place of translation", (Code.CAMERA_AXES,), of_cameras(_position_as_translation, one=False)),
    Damage("y down", (Code.WORLD_UP,), _y_down, of_simulated=True),
    Damage("moved by 2 degrees, 3 cm", (Code.MOVED_CAMERA, Code.WRONG_CAMERA), moved(2.0, 0.03), 3),
    Damage("moved by 6 degrees, 10 cm", (Code.MOVED_CAMERA, Code.WRONG_CAMERA), moved(6.0, 0.1), 3),
    Damage("moved by 40 degrees, 1 m", (Code.WRONG_CAMERA, Code.MOVED_CAMERA), moved(40.0, 1.0), 3),
    Damage("another zoom, one camera", (Code.WRONG_LENS, Code.WRONG_CAMERA), of_cameras(_other_lens, one=True), 3),
    Damage("another zoom, all cameras", (Code.WRONG_LENS, Code.IMAGE_SIZE), of_cameras(_other_lens, one=False)),
    Damage("distortion left out", (Code.WRONG_LENS,), _without_distortion(one=False)),
    Damage("distortion left out, one camera", (Code.WRONG_LENS, Code.WRONG_CAMERA), _without_distortion(one=True), 3),
    Damage("distortion of another lens", (Code.WRONG_LENS,), _with_distortion_of_another),
    Damage("undistorted before, distortion kept", (Code.WRONG_LENS,), of_cameras(_distorting, one=False)),
    Damage("principal point left out", (Code.WRONG_LENS, Code.IMAGE_SIZE), of_cameras(_without_centre, one=False)),
    Damage("rotations transposed", (Code.CAMERA_AXES,), of_cameras(_transposed, one=False)),
    Damage("images cut by 60 and 40 pixels", _OF_CUT, of_points(lambda p, _: p - np.array([60, 40]), one=False), 3),
    Damage("fy of another image", (Code.WRONG_LENS, Code.IMAGE_SIZE), of_cameras(_wrong_height, one=False), 3),
)

GEOMETRY = tuple(replace(each, is_constant=True) for each in _CONSTANT)
