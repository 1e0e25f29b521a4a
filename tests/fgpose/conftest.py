"""Videos of people made of three coloured squares each, and a network that finds them; Rerun as tests want it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import pytest

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.monocular.network import Image, People
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

SKELETON = Skeleton("squares", ("pelvis", "left_hand", "right_hand"), ((0, 1), (0, 2)), (0,), ((1, 2),))
# One colour per joint, the three of the first person and those of the second: corners of the cube, far from grey.
_COLOURS = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]], [[255, 255, 0], [0, 255, 255], [255, 0, 255]]])
_BACKGROUND = 60
_HALF_SIDE_PX = 5
_SIGMA_M = 0.05


def draw(points2d_px: np.ndarray, size_px: tuple[int, int]) -> Image:
    """Squares around the joints (people, 3, 2); a joint that is NaN is not drawn."""
    image = np.full((size_px[1], size_px[0], 3), _BACKGROUND, np.uint8)
    for person, joint in np.ndindex(points2d_px.shape[:2]):
        center_px = points2d_px[person, joint]
        if np.isfinite(center_px).all():
            x, y = np.round(center_px).astype(int)
            rows, columns = (slice(middle - _HALF_SIDE_PX, middle + _HALF_SIDE_PX + 1) for middle in (y, x))
            image[rows, columns] = _COLOURS[person, joint]
    return image


@pytest.fixture
def with_search_for_faults() -> None:
    """For what is about faults, where others of the file do without."""


@pytest.fixture
def without_search_for_faults(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """For what is about commands: short recordings are smoothed a dozen times to find moved and late cameras, and
    other orders of the joints and other lenses are tried where nothing contradicts those that are given."""
    if "with_search_for_faults" in request.fixturenames:
        return
    monkeypatch.setattr("fgpose.diagnosis.changes.camera_faults_checks.faults_of_short", lambda examined: [])
    monkeypatch.setattr("fgpose.diagnosis.body.skeletons.better_order", lambda positions_m, skeleton: None)
    monkeypatch.setattr("fgpose.diagnosis.hypotheses.geometry._clearly_better", lambda scene: False)


@dataclass
class SquaresNetwork:
    """Finds the squares; absolute 3D at the depth that it is told, known to 5 cm."""

    name: str = "squares"
    skeleton: Skeleton = SKELETON
    depth_m: float = 4.0
    before_image: Callable[[int], None] = lambda n_seen: None
    """Called with the number of images seen so far, by all trackers, before the next."""
    seen: list[str] = field(default_factory=list)
    """Camera of every image seen."""
    trackers: list[str] = field(default_factory=list)
    """Camera of every tracker made."""
    threads: set[str] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def tracker(self, camera: Camera) -> SquaresTracker:
        self.trackers.append(camera.name)
        return SquaresTracker(self, camera)

    def note(self, camera: str) -> None:
        with self._lock:
            self.before_image(len(self.seen))
            self.seen.append(camera)
            self.threads.add(threading.current_thread().name)


@dataclass
class SquaresTracker:
    network: SquaresNetwork
    camera: Camera

    def detect(self, image: Image) -> People:
        assert image.shape[:2] == self.camera.size_px[::-1]
        self.network.note(self.camera.name)
        found = [joints for colours in _COLOURS if np.isfinite(joints := self._locate(image, colours)).any()]
        if not found:
            return People.nobody(3)
        points2d_px = np.stack(found)
        confidence = np.where(np.isfinite(points2d_px).all(axis=-1), 0.9, 0.0)
        points3d_m = self._on_ray(points2d_px)
        covariance_m2 = np.where(np.isnan(points3d_m)[..., None], np.nan, np.diag([1.0, 1.0, 4.0]) * _SIGMA_M**2)
        boxes = np.array([[*np.nanmin(p, axis=0), *np.ptp(p[np.isfinite(p[:, 0])], axis=0), 0.9] for p in found])
        return People(boxes, points2d_px, confidence, points3d_m, covariance_m2)

    def _locate(self, image: Image, colours: np.ndarray) -> np.ndarray:
        points_px = np.full((3, 2), np.nan)
        for joint, colour in enumerate(colours):
            # Lossy compression changes colours by tens; the next colour is 255 away.
            low, high = (np.clip(colour + change, 0, 255).astype(float) for change in (-90, 90))
            rows, columns = np.nonzero(cv2.inRange(image, low, high))
            if len(rows) > _HALF_SIDE_PX**2:
                points_px[joint] = columns.mean(), rows.mean()
        return points_px

    def _on_ray(self, points2d_px: np.ndarray) -> np.ndarray:
        direction = self.camera.ray(self.camera.undistort(points2d_px)) @ self.camera.world_T_camera[:3, :3]
        return direction * (self.network.depth_m / direction[..., 2:])


@dataclass(frozen=True)
class SquaresScene:
    """Two people who move slowly, and three cameras around them. Times are those of the person, not of an image."""

    rig: CameraRig = field(default_factory=lambda: ring_rig(3, 4.0, 1.7, focal_px=300.0, size_px=(320, 240)))
    first_leaves_s: float = np.inf

    def positions_m(self, time_s: float, n_people: int = 1) -> np.ndarray:
        """(people, 3, 3): the first walks along x with 0.4 m/s, the second along y with 0.3 m/s."""
        hands = np.array([[0.0, 0.0, 1.0], [0.0, 0.45, 1.35], [0.0, -0.45, 1.3]])
        gone = 0.0 if time_s < self.first_leaves_s else np.nan
        first = hands + np.array([0.4 * time_s + 0.3, -0.52, gone])
        second = 0.8 * hands + np.array([-0.67, 0.3 * time_s - 0.89, -0.46])
        return np.stack([first, second])[:n_people]

    def image(self, camera: int, time_s: float, n_people: int = 1) -> Image:
        of_camera = self.rig.cameras[camera]
        return draw(of_camera.project(self.positions_m(time_s, n_people)), of_camera.size_px)

    def write_video(
        self, path: Path, camera: int, n_images: int, fps: float = 20.0, *, n_people: int = 1, begin_s: float = 0.0
    ) -> Path:
        """What a camera films from a time on."""
        images = [self.image(camera, begin_s + n / fps, n_people) for n in range(n_images)]
        return write_video(path, images, fps)

    def write_all(self, folder: Path, n_images: int = 20, fps: float = 20.0, *, n_people: int = 1) -> Path:
        """One video per camera, by the camera's name."""
        for camera, name in enumerate(self.rig.names):
            self.write_video(folder / f"{name}.mp4", camera, n_images, fps, n_people=n_people)
        return folder


def write_video(path: Path, images: list[Image], fps: float) -> Path:
    """An MPEG-4 video of RGB images."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = images[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (width, height))
    for image in images:
        video.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    video.release()
    return path


@pytest.fixture(scope="session")
def squares() -> SquaresScene:
    return SquaresScene()


@pytest.fixture
def squares_network() -> SquaresNetwork:
    return SquaresNetwork()


@pytest.fixture(scope="session")
def video_writer() -> Callable[[Path, list[Image], float], Path]:
    return write_video


@pytest.fixture(scope="module")
def strict_and_silent(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Rerun raises instead of logging, and finds no home to write analytics into."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(tmp_path_factory.mktemp("home")))
        patch.setattr("rerun.error_utils._strict_mode", True)
        yield
