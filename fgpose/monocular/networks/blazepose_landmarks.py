"""The landmark network of BlazePose GHUM: 33 joints in the image and in metres, and where to look in the next image.

Bazarevsky et al., BlazePose: On-device Real-time Body Pose Tracking, 2020; Grishchenko et al., BlazePose GHUM Holistic,
2022; decoding as in MediaPipe's pose_landmark.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.monocular.network import Image
from fgpose.monocular.networks.blazepose_detector import BODY_SCALE
from fgpose.monocular.networks.crops import Region
from fgpose.monocular.networks.devices import Device
from fgpose.monocular.networks.sessions import check_signature, identity, open_session

# Of the network: sides of its input and heatmaps; 33 joints, then six auxiliary landmarks, of which two tell where to
# look in the next image.
_SIZE, _HEATMAP_SIZE = 256, 64
_N_JOINTS = 33
_N_LANDMARKS = 39
_MID_HIP, _BODY_CIRCLE = 33, 34
_INPUTS = {"input_1": (None, _SIZE, _SIZE, 3)}
_OUTPUTS = {
    "Identity": (None, _N_LANDMARKS * 5),
    "Identity_1": (None, 1),
    "Identity_3": (None, _HEATMAP_SIZE, _HEATMAP_SIZE, _N_LANDMARKS),
    "Identity_4": (None, _N_LANDMARKS * 3),
}
_WINDOW = np.arange(-3, 4)
"""Cells around a landmark over which its heatmap is averaged, along each axis."""
_MAX_LOGIT = 100.0  # exp() does not overflow, and the sigmoid is 0 or 1 long before
_MIN_PEAK = 0.5
"""A heatmap that stays below this around its landmark is not used."""
_MIN_SCORE = 0.5  # of a person, as in MediaPipe


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The output of the network for one region."""

    points2d_px: Float[np.ndarray, "33 2"]
    """Pixels of the image."""
    world_m: Float[np.ndarray, "33 3"]
    """Relative to the middle of the hips, metres, along the image's axes: x right, y down, z away from the camera."""
    visibility: Float[np.ndarray, " 33"]
    """Probability that the joint is not occluded."""
    presence: Float[np.ndarray, " 33"]
    """Probability that the joint lies in the picture. Beyond its border the network guesses."""
    score: float
    """Probability that the region shows a person."""
    next_region: Region
    """Where this person's body is, for the next image."""

    @property
    def is_person(self) -> bool:
        return self.score >= _MIN_SCORE and self.next_region.side_px >= 1


class LandmarkNetwork:
    """Finds the joints of the person in a region. Its session may be used from several threads.

    Raises:
        OSError: there is no such file.
        ValueError: it is not an ONNX network of BlazePose's landmarks.
    """

    def __init__(self, path: Path, threads: int = 1, device: Device = "auto") -> None:
        self._session = open_session(path, threads, device)
        check_signature(self._session, path, _INPUTS, _OUTPUTS)
        self.name = identity(path, self._session)

    def locate(self, image: Image, region: Region) -> Landmarks:
        """Landmarks of the person in the region, whether or not there is one."""
        pixels = region.crop(image, _SIZE).astype(np.float32) / 255
        # One region at a time: at which others to look depends on what is found in this one, and on a processor a batch
        # of four takes 0.98 to 1.04 of the processor time of four runs.
        outputs = self._session.run(list(_OUTPUTS), {"input_1": pixels[None]})
        raw, score, heatmaps, world = (np.asarray(output)[0] for output in outputs)
        raw = raw.reshape(_N_LANDMARKS, 5).astype(float)
        points_px = region.to_image(_refine(raw[:, :2], heatmaps), _SIZE)
        world_m = world.reshape(_N_LANDMARKS, 3)[:_N_JOINTS].astype(float)
        world_m[:, :2] = world_m[:, :2] @ region.rotation.T
        return Landmarks(
            points_px[:_N_JOINTS],
            world_m,
            _sigmoid(raw[:_N_JOINTS, 3]),
            _sigmoid(raw[:_N_JOINTS, 4]),
            float(score[0]),
            Region.around(points_px[_MID_HIP], points_px[_BODY_CIRCLE], BODY_SCALE),
        )


def _refine(
    points_crop: Float[np.ndarray, "landmark 2"], logits: Float[np.ndarray, "row column landmark"]
) -> Float[np.ndarray, "landmark 2"]:
    """Each landmark moved to the centre of mass of the heatmap around it, if the heatmap has a clear peak there."""
    scale = _SIZE / _HEATMAP_SIZE
    column, row = (points_crop / scale).astype(int).T
    columns, rows = column[:, None, None] + _WINDOW, row[:, None, None] + _WINDOW[:, None]
    inside = _on_heatmap(columns) & _on_heatmap(rows)
    last = _HEATMAP_SIZE - 1
    cells = logits[np.clip(rows, 0, last), np.clip(columns, 0, last), np.arange(len(column))[:, None, None]]
    mass = np.where(inside, _sigmoid(cells.astype(float)), 0.0)
    sure = _on_heatmap(column) & _on_heatmap(row) & (mass.max(axis=(1, 2)) >= _MIN_PEAK)
    total = np.maximum(mass.sum(axis=(1, 2)), _MIN_PEAK)
    center = np.stack([(mass * columns).sum(axis=(1, 2)), (mass * rows).sum(axis=(1, 2))], axis=1) / total[:, None]
    return np.where(sure[:, None], center * scale, points_crop)


def _on_heatmap(cell: np.ndarray) -> np.ndarray:
    return (cell >= 0) & (cell < _HEATMAP_SIZE)


def _sigmoid(logits: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return 1 / (1 + np.exp(-np.clip(logits, -_MAX_LOGIT, _MAX_LOGIT)))
