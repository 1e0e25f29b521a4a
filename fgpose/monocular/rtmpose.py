"""RTMPose: 2D joints of people in the boxes of a detector (Jiang et al. 2023, "RTMPose")."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgpose.geometry.camera import Camera
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.network import Image, People
from fgpose.monocular.sessions import identity
from fgpose.monocular.simcc import SimccNetwork
from fgpose.monocular.topdown import Boxes, PersonDetector, TopDown, TopDownTracker
from fgpose.monocular.yolox import person_detector

_SKELETONS = {17: "coco_17", 26: "halpe_26"}  # by the number of keypoints


class RTMPose:
    """A Network that gives 2D joints only; its skeleton is coco_17 or halpe_26, by the number of its keypoints.

    Raises:
        OSError: there is no such file.
        ValueError: a file has other inputs or outputs, or another number of keypoints; the message names it.
    """

    def __init__(
        self,
        landmarks: Path,
        detector: Path | PersonDetector,
        *,
        threads: int = 1,
        max_people: int = 4,
        detect_every_frame: bool = True,
    ) -> None:
        """
        Args:
            landmarks: an ONNX file as mmdeploy exports it: [1, 3, 256, 192] (or any other size) -> simcc_x [1, K, 384],
                simcc_y [1, K, 512], two bins per pixel.
            detector: an ONNX file of YOLOX, or a detector of your own.
            threads: how many threads one run may use.
            max_people: how many people are looked at in an image, the most confident first.
            detect_every_frame: False follows the joints from image to image, see TopDownTracker.
        """
        self._simcc = SimccNetwork(landmarks, ("simcc_x", "simcc_y"), threads)
        count = self._simcc.n_keypoints
        if count not in _SKELETONS:
            known = " or ".join(f"{n} ({name})" for n, name in _SKELETONS.items())
            raise ValueError(f"{landmarks} gives {count} keypoints; known are {known}")
        self.skeleton = load_skeleton(_SKELETONS[count])
        self._top_down = TopDown(person_detector(detector, threads), max_people, detect_every_frame)
        self.name = f"rtmpose {identity(landmarks)}, {self._top_down.name}"

    def tracker(self, camera: Camera) -> TopDownTracker:
        """For the images of one camera, of which 2D joints need nothing but the image size."""
        return TopDownTracker(self._top_down, self._people, camera, self.skeleton.n_joints)

    def _people(self, image: Image, boxes: Boxes) -> People:
        poses = [self._simcc.pose(image, box) for box in boxes]
        shape = len(poses), self.skeleton.n_joints
        return People(
            boxes,
            np.stack([pose.points2d_px for pose in poses]),
            np.stack([pose.confidence for pose in poses]),
            np.full((*shape, 3), np.nan),
            np.full((*shape, 3, 3), np.nan),
        )
