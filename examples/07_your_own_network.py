"""A network of one's own: a class that finds joints in an image, and everything else stays as it is.

What one learns: the interface (fgpose.monocular.network), and how to say "2D only". The "network" here finds the three
coloured balls of an arm in images that the example draws itself, so that the truth is known. Yours would run an ONNX
file in detect(); fgpose.monocular.networks.sessions opens one.

    python examples/07_your_own_network.py
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import fgpose
from fgpose.monocular.detection import detect
from fgpose.monocular.network import Image, People
from fgpose.monocular.sources import open_sources
from fgpose_benchmarks.synthetic import ring_rig

ARM = fgpose.Skeleton("arm", ("shoulder", "elbow", "wrist"), ((0, 1), (1, 2)), (0,), ())
COLOURS_RGB = ((255, 40, 40), (40, 255, 40), (40, 40, 255))


@dataclass(frozen=True)
class BallTracker:
    """Sees the images of one camera, one after the other; could remember something from one to the next."""

    def detect(self, image: Image) -> People:
        nearness = [cv2.inRange(image, np.subtract(rgb, 60), np.add(rgb, 60)) for rgb in COLOURS_RGB]
        points2d_px = np.array([np.argwhere(near).mean(axis=0)[::-1] for near in nearness])
        corner_px, far_px = points2d_px.min(axis=0), points2d_px.max(axis=0)
        return People(
            boxes=np.array([[*corner_px, *(far_px - corner_px), 1.0]]),
            points2d_px=points2d_px[None],
            confidence=np.ones((1, ARM.n_joints)),
            points3d_m=np.full((1, ARM.n_joints, 3), np.nan),  # 2D only: triangulation does the rest
            covariance_m2=np.full((1, ARM.n_joints, 3, 3), np.nan),
        )


@dataclass(frozen=True)
class BallNetwork:
    """What fgpose asks for: a name, a skeleton, and a tracker for each camera."""

    name: str = "balls"
    skeleton: fgpose.Skeleton = ARM

    def tracker(self, camera: fgpose.Camera) -> BallTracker:
        return BallTracker()


def waving_m(time_s: np.ndarray) -> np.ndarray:
    """(T, 3, 3) shoulder, elbow and wrist of an arm that waves, world frame."""
    angle = 0.6 * np.sin(2 * np.pi * time_s)[:, None]
    lower = 0.27 * np.concatenate([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    elbow = np.tile([0.3, 0.0, 1.2], (len(time_s), 1))
    return np.stack([np.tile([0.0, 0.0, 1.4], (len(time_s), 1)), elbow, elbow + lower], axis=1)


def draw(camera: fgpose.Camera, truth_m: np.ndarray, folder: Path) -> None:
    """One image per frame; names are frame numbers."""
    folder.mkdir()
    for frame, points_px in enumerate(camera.distort(camera.project(truth_m))):
        image = np.full((camera.size_px[1], camera.size_px[0], 3), 90, np.uint8)
        for (x, y), colour in zip(points_px.round().astype(int).tolist(), COLOURS_RGB, strict=True):
            cv2.circle(image, (x, y), 9, colour[::-1], -1)
        cv2.imwrite(str(folder / f"{frame:04d}.png"), image)


def main() -> None:
    rig, fps = ring_rig(), 25.0
    truth_m = waving_m(np.arange(20) / fps)
    with tempfile.TemporaryDirectory() as folder:
        for camera in rig.cameras:
            draw(camera, truth_m, Path(folder) / camera.name)
        detected = detect(open_sources(Path(folder), rig, fps=fps), BallNetwork())
    smoothed = fgpose.smooth(detected.observations(), detected.rig)
    errors_mm = 1000 * np.linalg.norm(smoothed.positions_m - truth_m, axis=-1)
    print(f"{detected.n_images} images, joints {', '.join(ARM.joints)}")
    print(f"mean error {errors_mm.mean():.1f} mm, largest {errors_mm.max():.1f} mm")


if __name__ == "__main__":
    main()
