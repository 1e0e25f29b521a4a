"""MeTRAbs: absolute 3D joints from a crop and its intrinsics (Sarandi et al. 2021, "MeTRAbs").

For a user's own ONNX export of the crop model (``crop_model.predict_multi`` of the published models, whose licence is
non-commercial). Around it stands what the authors' ``detect_poses`` does: the crop is the view of a camera at the same
place, turned towards the middle of the box and zoomed to it, without lens distortion; its gamma is brightened a little;
with test-time augmentation it is also turned, scaled and mirrored, and the answers are averaged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from fgpose.geometry.camera import Camera
from fgpose.geometry.per_view.absolute_pose import (
    UNSTATED_CONFIDENCE,
    AbsolutePose,
    absolute_pose,
    confidence_of_spread,
)
from fgpose.io.skeletons import as_skeleton
from fgpose.monocular.network import Image, People
from fgpose.monocular.networks.batches import Batches
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.sessions import identity, open_session
from fgpose.monocular.networks.topdown import Box, Boxes, PersonDetector, TopDown, TopDownTracker
from fgpose.monocular.networks.yolox import person_detector
from fgpose.skeleton import Skeleton

# Gamma of the images, and the ranges of the augmentations (gamma, angle, scale) as MeTRAbs has them.
_GAMMA = 2.2
_GAMMAS = (0.6, 1.0)
_MAX_ANGLE_RAD = np.deg2rad(25.0)
_SCALES = (0.8, 1.0, 1.1)
_NEAREST_MM = 50.0  # no lens shows a person who is nearer; as metres it is a hall
_PYRAMID_LEVELS = 3  # more would only help people who are more than four times as large as the crop
_CAMERA_UP = (0.0, -1.0, 0.0)  # y points down in the image
_MAX_ROUND_TRIP_PX = 1.0  # as in geometry/camera.py
_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True)
class Augmentation:
    """One of the ways in which a crop is shown to the network."""

    angle_rad: float
    scale: float
    gamma: float
    mirrored: bool


def augmentations(n: int) -> tuple[Augmentation, ...]:
    """Those of MeTRAbs. If their number is odd, the middle one is neither turned nor scaled nor mirrored."""
    if n == 1:
        return (Augmentation(0.0, 1.0, sum(_GAMMAS) / 2, False),)
    angles, gammas = np.linspace(-_MAX_ANGLE_RAD, _MAX_ANGLE_RAD, n), np.linspace(*_GAMMAS, n)
    small, one, large = _SCALES
    scales = np.concatenate([np.linspace(small, one, n // 2, endpoint=False), np.linspace(one, large, n - n // 2)])
    mirrored = (np.arange(n) - n // 2) % 2 != 0
    return tuple(map(Augmentation, angles.tolist(), scales.tolist(), gammas.tolist(), mirrored.tolist()))


class MeTRAbs:
    """A Network for an ONNX export of a MeTRAbs crop model.

    Raises:
        OSError: there is no such file.
        ValueError: a file has other inputs or outputs, or another number of joints than the skeleton; the message names
            it. There is no such skeleton.
    """

    def __init__(
        self,
        landmarks: Path,
        detector: Path | PersonDetector,
        skeleton: Skeleton | str | Path,
        *,
        num_aug: int = 1,
        world_up: tuple[float, float, float] | None = None,
        threads: int = 1,
        device: Device = "auto",
        max_people: int = 4,
        detect_every_frame: bool = True,
    ) -> None:
        """
        Args:
            landmarks: an ONNX file: image [1, S, S, 3] or [1, 3, S, S], RGB in [0, 1], float32 or float16, and the
                intrinsic matrix [1, 3, 3] of the crop -> joints [1, J, 3] in millimetres in the frame of the crop's
                camera, x right, y down, z forward. A file without the second input must know the intrinsics itself.
            detector: an ONNX file of YOLOX, or a detector of your own.
            skeleton: of the J joints that the file gives; mirroring needs its left_right pairs.
            num_aug: how many augmentations are averaged; MeTRAbs's own default is 5. Above 1 the confidence of a joint
                comes from how well they agree.
            world_up: direction in the world that is to be up in the crops, for cameras that are not upright. By default
                up in the image.
            threads: how many threads one run may use.
            device: where the networks run.
            max_people: how many people are looked at in an image, the most confident first.
            detect_every_frame: False follows the joints from image to image, see TopDownTracker. Without augmentation
                every joint in the image counts as seen, so the next detection is the first to show that a person left.
        """
        if num_aug < 1:
            raise ValueError(f"num_aug must be at least 1, got {num_aug}")
        self.skeleton = as_skeleton(skeleton)
        self._model = _CropModel(landmarks, self.skeleton, threads, device)
        self._augmentations, self._world_up = augmentations(num_aug), world_up
        self._mirrored = [self.skeleton.mirrored((joint, joint))[0] for joint in range(self.skeleton.n_joints)]
        self._top_down = TopDown(person_detector(detector, threads, device), max_people, detect_every_frame)
        up = "" if world_up is None else f" up {world_up}"
        self.name = f"metrabs {self._model.name} {num_aug} augmentations{up}, {self._top_down.name}"

    def tracker(self, camera: Camera) -> TopDownTracker:
        """For the images of one camera, whose size and intrinsics are those of the images."""
        view = _View(camera, self._world_up)

        def people(image: Image, boxes: Boxes) -> People:
            poses = [self._pose(answers_m, view) for answers_m in self._answers_m(_pyramid(image), boxes, view)]
            return People.stacked(boxes, *zip(*poses, strict=True))

        return TopDownTracker(self._top_down, people, camera, self.skeleton.n_joints)

    def _pose(
        self, answers_m: Float[np.ndarray, "augmentation joint 3"], view: _View
    ) -> tuple[np.ndarray, np.ndarray, AbsolutePose]:
        """points2d_px, confidence and absolute pose of a person."""
        mean_m = answers_m.mean(axis=0)
        points2d_px = view.project(mean_m)
        absolute = absolute_pose(mean_m, points2d_px, np.ones(len(mean_m)), view.camera, self.skeleton)
        # A joint beyond the border is hallucinated: its 3D is kept, its 2D point is no detection.
        seen = np.all((points2d_px >= 0) & (points2d_px <= np.subtract(view.camera.size_px, 1)), axis=1)
        confidence = np.where(seen, agreement(answers_m), 0.0)
        absolute = replace(absolute, covariance_m2=absolute.covariance_m2 + _spread_m2(answers_m))
        return np.where(seen[:, None], points2d_px, np.nan), confidence, absolute

    def _answers_m(
        self, pyramid: list[np.ndarray], boxes: Boxes, view: _View
    ) -> Float[np.ndarray, "person augmentation joint 3"]:
        """The joints in the camera frame, metres, as the network gives them for each crop; NaN where the lens model has
        no inverse at a box."""
        hows = len(boxes) * self._augmentations
        n = len(self._augmentations)
        crops = [_CropCamera.towards(boxes[k // n], view, self._model.side, how) for k, how in enumerate(hows)]
        known = [
            k for k, crop in enumerate(crops) if np.isfinite(crop.crop_R_camera).all() and np.isfinite(crop.K).all()
        ]
        answers_m = np.full((len(crops), self.skeleton.n_joints, 3), np.nan)
        if known:
            shown = np.stack([crops[k].of(pyramid, view, hows[k].gamma) for k in known])
            answers_mm = self._model.joints_mm(shown, np.stack([crops[k].K for k in known]))
            for k, answer_mm in zip(known, answers_mm, strict=True):
                if hows[k].mirrored:
                    answer_mm = answer_mm[self._mirrored]
                answers_m[k] = answer_mm @ crops[k].crop_R_camera / 1000.0
        return answers_m.reshape(len(boxes), n, -1, 3)


def agreement(answers_m: Float[np.ndarray, "augmentation joint 3"]) -> Float[np.ndarray, " joint"]:
    """Confidence of each joint: how well the augmentations agree on it, without shifts of the whole body."""
    if len(answers_m) == 1:
        return np.full(answers_m.shape[1], UNSTATED_CONFIDENCE)
    relative_m = answers_m - answers_m.mean(axis=1, keepdims=True)
    variance_m2 = np.sum(np.var(relative_m, axis=0, ddof=1), axis=-1)
    return confidence_of_spread(variance_m2)


def _spread_m2(answers_m: Float[np.ndarray, "augmentation joint 3"]) -> Float[np.ndarray, "joint 3 3"]:
    """Covariance over the augmentations. Their errors are correlated, so it is not divided by their number."""
    deviation_m = answers_m - answers_m.mean(axis=0)
    return np.einsum("aji,ajk->jik", deviation_m, deviation_m) / max(len(answers_m) - 1, 1)


class _View:
    """What is needed of a camera to make crops."""

    def __init__(self, camera: Camera, world_up: tuple[float, float, float] | None) -> None:
        self.camera = camera
        self.up = np.array(_CAMERA_UP) if world_up is None else camera.camera_T_world[:3, :3] @ world_up
        width, height = camera.size_px
        x, y = np.meshgrid(np.linspace(0, width - 1, 20), np.linspace(0, height - 1, 20))
        field_px = camera.undistort(np.stack([x, y], axis=-1).reshape(-1, 2))
        field_px = field_px[np.isfinite(field_px).all(axis=1)]
        self._low_px = field_px.min(axis=0, initial=np.inf) - 1
        self._high_px = field_px.max(axis=0, initial=-np.inf) + 1

    def rays(self, points_px: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 3"]:
        """Camera frame, depth one, through pixels of the original image."""
        u = (self.camera.undistort(points_px) - self.camera.K[:2, 2]) / np.diag(self.camera.K)[:2]
        return np.concatenate([u, np.ones((len(u), 1))], axis=1)

    def sample(self, rays: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 2"]:
        """Pixels of rays in the original image; far outside it where there is none. Well beyond its edge a distortion
        model is no longer monotonic and would show the image a second time.
        """
        undistorted_px = self._pinhole(rays)
        shown = np.all((undistorted_px >= self._low_px) & (undistorted_px <= self._high_px), axis=1)
        points_px = self.camera.distort(np.where(shown[:, None], undistorted_px, np.nan))
        return np.where(np.isfinite(points_px), points_px, -1e4)

    def project(self, points_m: Float[np.ndarray, "joint 3"]) -> Float[np.ndarray, "joint 2"]:
        """Pixels of the original image; NaN behind the camera and where the lens model turns back."""
        undistorted_px = self._pinhole(points_m)
        points_px = self.camera.distort(undistorted_px)
        back_px = np.linalg.norm(self.camera.undistort(points_px) - undistorted_px, axis=1)
        return np.where((back_px <= _MAX_ROUND_TRIP_PX)[:, None], points_px, np.nan)

    def _pinhole(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 2"]:
        ahead = points[:, 2:] > 0
        u = np.divide(points[:, :2], points[:, 2:], out=np.full((len(points), 2), np.nan), where=ahead)
        return u * np.diag(self.camera.K)[:2] + self.camera.K[:2, 2]


@dataclass(frozen=True, eq=False)
class _CropCamera:
    """The camera of a crop: at the place of the real one, turned and zoomed."""

    crop_R_camera: Float[np.ndarray, "3 3"]
    """A rotation, or one with a mirror."""
    K: Float[np.ndarray, "3 3"]
    scale: float
    """Pixels of the crop per pixel of the image, in its middle."""

    @staticmethod
    def towards(box: Box, view: _View, side: int, how: Augmentation) -> _CropCamera:
        """The camera whose axis passes through the middle of a box, with an image that just contains it."""
        low = np.clip(box[:2], 0, view.camera.size_px)
        high = np.clip(box[:2] + box[2:4], 0, view.camera.size_px)
        x, y = (low + high) / 2
        rays = view.rays(np.array([(x, y), (x, low[1]), (high[0], y), (x, high[1]), (low[0], y)]))
        R = _look_at(rays[0], view.up)
        turned = rays[1:] @ R.T
        focal_px = np.diag(view.camera.K)[:2]
        top, right, bottom, left = turned[:, :2] / turned[:, 2:] * focal_px
        scale = how.scale * side / max(np.linalg.norm(bottom - top), np.linalg.norm(right - left))
        K = np.array([[focal_px[0] * scale, 0, side / 2], [0, focal_px[1] * scale, side / 2], [0, 0, 1]])
        cos, sin = np.cos(how.angle_rad), np.sin(how.angle_rad)
        roll = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        mirror = np.diag([-1.0 if how.mirrored else 1.0, 1.0, 1.0])
        return _CropCamera(mirror @ roll @ R, K, float(scale))

    def of(self, pyramid: list[np.ndarray], view: _View, gamma: float) -> Float32[np.ndarray, "side side 3"]:
        """What the camera sees, in [0, 1], black where the image has nothing."""
        import cv2

        side = round(2 * self.K[0, 2])
        rows, columns = np.mgrid[:side, :side].astype(float)
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        points_px = view.sample(pixels @ np.linalg.inv(self.K @ self.crop_R_camera).T)
        level = int(np.clip(np.floor(-np.log2(self.scale)), 0, len(pyramid) - 1))
        x, y = ((points_px + 0.5) / 2**level - 0.5).astype(np.float32).reshape(side, side, 2).transpose(2, 0, 1)
        return cv2.remap(pyramid[level], x, y, cv2.INTER_LINEAR) ** np.float32(gamma / _GAMMA)


def _look_at(forward: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation to axes of which z points forward and y away from up."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-9:  # looking straight up or down any horizontal x is right; this is the choice of MeTRAbs
        x = np.array([z[2], 0.0, -z[0]])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _pyramid(image: Image) -> list[np.ndarray]:
    """The image in linear light (float32), and halved: a crop is taken from the level that is about its size."""
    import cv2

    linear = ((np.arange(256) / 255) ** _GAMMA).astype(np.float32)
    levels: list[np.ndarray] = [linear[image]]
    for _ in range(_PYRAMID_LEVELS - 1):
        height, width = (length // 2 for length in levels[-1].shape[:2])
        if not height or not width:
            break
        even = levels[-1][: 2 * height, : 2 * width]
        levels.append(np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)))
    return levels


class _CropModel:
    """The network itself, for crops with the channels first or last."""

    def __init__(self, path: Path, skeleton: Skeleton, threads: int, device: Device) -> None:
        self._session = open_session(path, threads, device)
        self._path = path
        self.name = identity(path, self._session)
        self._inputs = {len(node.shape): node for node in self._session.get_inputs()}
        self.side, self._channels_first = self._layout()
        noise = np.random.default_rng(0).random((2, self.side, self.side, 3), dtype=np.float32)
        examples = self._feeds(noise, np.tile(np.eye(3), (2, 1, 1)))
        n_joints = self._n_joints({name: values[:1] for name, values in examples.items()})
        if n_joints != skeleton.n_joints:
            raise ValueError(f"{path} gives {n_joints} joints, skeleton {skeleton.name} has {skeleton.n_joints}")
        self._batches = Batches(self._session, examples)

    def joints_mm(
        self, crops: Float32[np.ndarray, "crop side side 3"], K: Float[np.ndarray, "crop 3 3"]
    ) -> Float[np.ndarray, "crop joint 3"]:
        """In the frames of the cameras of the crops, one at least. Raises ValueError if they are metres."""
        answers_mm = self._batches.run(self._feeds(crops, K))[0].astype(float)
        away_mm = float(np.median(np.linalg.norm(answers_mm, axis=-1)))
        if 0 < away_mm < _NEAREST_MM:
            raise ValueError(
                f"{self._path} gives joints that are {away_mm:.3g} mm away: it seems to give metres; MeTRAbs gives "
                "millimetres, so let the network multiply its joints by 1000"
            )
        return answers_mm

    def _feeds(self, crops: np.ndarray, K: np.ndarray) -> dict[str, np.ndarray]:
        values = {4: crops.transpose(0, 3, 1, 2) if self._channels_first else crops, 3: K}
        return {node.name: values[rank].astype(_DTYPES[node.type]) for rank, node in self._inputs.items()}

    def _layout(self) -> tuple[int, bool]:
        """Side of the crops, and whether the colour channels come first."""
        nodes = self._session.get_inputs()
        fixed_batch = any(isinstance(node.shape[0], int) and node.shape[0] != 1 for node in nodes if node.shape)
        ranks, K = sorted(len(node.shape) for node in nodes), self._inputs.get(3)
        if ranks not in ([4], [3, 4]) or fixed_batch or (K is not None and K.shape[1:] != [3, 3]):
            raise self._another()
        if any(node.type not in _DTYPES for node in nodes):
            raise self._another()
        image = self._inputs[4].shape
        channels_first = image[1] == 3
        height, width, channels = (image[2], image[3], image[1]) if channels_first else image[1:]
        if channels != 3 or not isinstance(height, int) or height != width:
            raise self._another()
        return height, channels_first

    def _n_joints(self, example: dict[str, np.ndarray]) -> int:
        # An exporter need not write the lengths of the output into the file, so the network itself is asked.
        answer = np.asarray(self._session.run(None, example)[0])
        if answer.ndim != 3 or answer.shape[::2] != (1, 3):
            raise self._another()
        return answer.shape[1]

    def _another(self) -> ValueError:
        found = [
            ", ".join(f"{node.name} {list(node.shape)} {node.type}" for node in nodes)
            for nodes in (self._session.get_inputs(), self._session.get_outputs())
        ]
        return ValueError(
            f"{self._path} is another network: expected an image [1, S, S, 3] or [1, 3, S, S] of fixed side S, and the"
            f" intrinsics [1, 3, 3], to give joints [1, J, 3]; found {found[0]}, giving {found[1]}"
        )
