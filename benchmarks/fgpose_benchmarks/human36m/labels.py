"""Human3.6M (Ionescu et al., 2014) on the user's own copy: its sequences, and the labels of Learnable Triangulation.

The data set is licensed to each user, so nothing of it is part of fgpose. It is read from what its users have made of
it: the labels of Learnable Triangulation (here), or the folders of h36m-fetch (h36m_fetch.py).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.pickles import read_dictionary
from fgpose.io.skeletons import load_skeleton
from fgpose.plain_files import naming

# Of the data set: rate of its videos, the joints and subjects of its usual protocol, the size of its images (two of
# the four cameras are two rows higher).
FPS = 50.0
SKELETON = "h36m_17"
N_JOINTS = 17
TEST_SUBJECTS = ("S9", "S11")
_SIZE_PX = (1000, 1000)
_SIZES_PX = {"54138969": (1000, 1002), "60457274": (1000, 1002)}

# Learnable Triangulation and MMPose took the same joints of the original 32 and call three of them differently.
_SAME_JOINT = {"neck": "thorax", "nose": "neck_base", "head_top": "head"}
# Joints lie inside the body: 3 % of a standing person's height is about 5 cm of flesh. As in synthetic.
_BOX_MARGIN = 0.03
# Fields of the labels of Learnable Triangulation, with the shape of one entry.
_TABLE_FIELDS = {"subject_idx": (), "action_idx": (), "frame_idx": (), "keypoints": (N_JOINTS, 3)}
_CAMERA_FIELDS = {"R": (3, 3), "t": (3, 1), "K": (3, 3), "dist": (5,)}

SequenceKey = tuple[str, str]
"""Subject and action: S9, Greeting-2."""


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """What is known of one recording: one action of one subject, seen by four cameras.

    Raises:
        ValueError: the arrays' lengths disagree, or frames do not increase.
    """

    subject: str
    """S9."""
    action: str
    """With the number of the sub-action: Greeting-2."""
    rig: CameraRig
    """World frame of the subject's recordings, metres; the cameras stand elsewhere for every subject."""
    frames: Int[np.ndarray, " frame"]
    """Numbers of the labelled frames in the 50 Hz video, from 0: img_000001.jpg is frame 0."""
    truth_m: Float[np.ndarray, "frame joint 3"]
    """World frame, joints of h36m_17."""
    boxes_px: Float[np.ndarray, "frame camera 4"]
    """Left, top, width and height of the person's box in the original image; NaN where the view is missing."""

    def __post_init__(self) -> None:
        n_frames = len(self.frames)
        if len(self.truth_m) != n_frames or self.boxes_px.shape[:2] != (n_frames, self.rig.n_cameras):
            raise ValueError(
                f"{self.name}: {n_frames} frames of {self.rig.n_cameras} cameras, but truth_m is {self.truth_m.shape} "
                f"and boxes_px {self.boxes_px.shape}"
            )
        if np.any(np.diff(self.frames) <= 0):
            raise ValueError(f"{self.name}: frame numbers must increase")

    @property
    def key(self) -> SequenceKey:
        return self.subject, self.action

    @property
    def name(self) -> str:
        return f"{self.subject}/{self.action}"

    @property
    def has_view(self) -> np.ndarray:
        """(T, C) whether the image exists."""
        return np.asarray(np.isfinite(self.boxes_px).all(axis=-1))

    def joint_boxes_px(self) -> Float[np.ndarray, "frame camera 4"]:
        """Boxes around the joints as the cameras see them, with some flesh; NaN where the view is missing.

        The boxes of Learnable Triangulation are squares, whose short side is the person's long one.
        """
        undistorted_px = self.rig.project(self.truth_m)
        cameras = enumerate(self.rig.cameras)
        points_px = np.stack([camera.distort(undistorted_px[:, c]) for c, camera in cameras], axis=1)
        return np.where(self.has_view[..., None], boxes_around_px(points_px), np.nan)


def boxes_around_px(points_px: Float[np.ndarray, "*shape joint 2"]) -> Float[np.ndarray, "*shape 4"]:
    """Left, top, width and height of the box around joints and some flesh; NaN unless all joints are known."""
    low, high = points_px.min(axis=-2), points_px.max(axis=-2)
    margin = _BOX_MARGIN * (high - low).max(axis=-1, keepdims=True)
    return np.concatenate([low - margin, high - low + 2 * margin], axis=-1)


def in_skeleton_order(
    positions: Float[np.ndarray, "*shape joint 3"], joints: Sequence[str]
) -> Float[np.ndarray, "*shape 17 3"]:
    """Joints named as in h36m_17 or h36m_17_lt, in the order of h36m_17.

    Raises:
        ValueError: a joint of h36m_17 is not among them.
    """
    names = [_SAME_JOINT.get(name, name) for name in joints]
    missing = [name for name in load_skeleton(SKELETON).joints if name not in names]
    if missing:
        raise ValueError(f"joint {', '.join(missing)} is missing; there is {', '.join(joints)}")
    return positions[..., [names.index(name) for name in load_skeleton(SKELETON).joints], :]


def image_size_px(camera: str) -> tuple[int, int]:
    """Width and height of a camera's images."""
    return _SIZES_PX.get(camera, _SIZE_PX)


def image_path(folder: Path, sequence: PoseSequence, camera: str, frame: int) -> Path:
    """Where h36m-fetch, and Learnable Triangulation after it, put the image of a frame, below a folder."""
    images = folder / sequence.subject / sequence.action / "imageSequence" / camera
    return images / f"img_{frame + 1:06d}.jpg"


def load_labels(path: str | Path, subjects: Iterable[str] = TEST_SUBJECTS) -> list[PoseSequence]:
    """Sequences of the labels of Learnable Triangulation (Iskakov et al., 2019), human36m-multiview-labels-*.npy.

    The file is a pickled dictionary, written by their generate-labels-npy-multiview.py: the lists subject_names,
    camera_names, action_names; cameras, a structured array (subject, camera) of R, t, K, dist, world to camera in
    millimetres, distortion in OpenCV's order; table, a structured array with one row per frame of subject_idx,
    action_idx, frame_idx (from 0), keypoints (17, 3) in millimetres of the world, and bbox_by_camera_tlbr (camera, 4),
    all zero where the view is missing. No code in it is run.

    Args:
        path: the file.
        subjects: those wanted, in the order of the result.

    Raises:
        ValueError: the file is damaged, something else, or not safe to load; a wanted subject is not in it.
        OSError: it cannot be read.
    """
    path = Path(path)
    labels = read_dictionary(path)
    with naming(path, "not the labels of Learnable Triangulation, or damaged", damage=(TypeError, IndexError)):
        _check(labels)
        return [
            sequence
            for subject in subjects
            for sequence in _sequences_of_subject(labels, _index(labels["subject_names"], subject))
        ]


def load_label_rigs(path: str | Path) -> dict[str, CameraRig]:
    """The cameras of every subject in the labels of Learnable Triangulation. Raises as load_labels."""
    path = Path(path)
    labels = read_dictionary(path)
    with naming(path, "not the labels of Learnable Triangulation, or damaged", damage=(TypeError, IndexError)):
        _check(labels)
        return {subject: _rig(labels, index) for index, subject in enumerate(labels["subject_names"])}


def _check(labels: dict[str, Any]) -> None:
    missing = {"subject_names", "camera_names", "action_names", "cameras", "table"} - labels.keys()
    if missing:
        raise ValueError(f"{', '.join(sorted(missing))} is missing")
    n_cameras = len(labels["camera_names"])
    table_fields = _TABLE_FIELDS | {"bbox_by_camera_tlbr": (n_cameras, 4)}
    for name, fields in (("table", table_fields), ("cameras", _CAMERA_FIELDS)):
        dtype = getattr(labels[name], "dtype", None)
        for field, shape in fields.items():
            if dtype is None or dtype.names is None or field not in dtype.names or dtype[field].shape != shape:
                raise ValueError(f"{name} has no field {field} of shape {shape}")
    if labels["cameras"].shape != (len(labels["subject_names"]), n_cameras):
        raise ValueError(f"cameras must be (subject, camera), got {labels['cameras'].shape}")


def _index(names: Sequence[str], wanted: str) -> int:
    if wanted not in names:
        raise ValueError(f"there is no subject {wanted}; there is {', '.join(names)}")
    return list(names).index(wanted)


def _rig(labels: dict[str, Any], subject: int) -> CameraRig:
    cameras = []
    for name, row in zip(labels["camera_names"], labels["cameras"][subject], strict=True):
        R, t_mm, K, distortion = (np.asarray(row[field], dtype=float) for field in _CAMERA_FIELDS)
        cameras.append(Camera.from_world_to_camera(name, image_size_px(name), K, R, t_mm[:, 0] / 1000, distortion))
    return CameraRig(tuple(cameras))


def _sequences_of_subject(labels: dict[str, Any], subject: int) -> Iterable[PoseSequence]:
    rows = labels["table"][labels["table"]["subject_idx"] == subject]
    if not len(rows):
        raise ValueError(f"subject {labels['subject_names'][subject]} has no frame")
    rig = _rig(labels, subject)
    joints = load_skeleton("h36m_17_lt").joints
    for action in np.unique(rows["action_idx"]):
        of_action = rows[rows["action_idx"] == action]
        of_action = of_action[np.argsort(of_action["frame_idx"], kind="stable")]
        yield PoseSequence(
            subject=labels["subject_names"][subject],
            action=labels["action_names"][action],
            rig=rig,
            frames=of_action["frame_idx"].astype(int),
            truth_m=in_skeleton_order(of_action["keypoints"].astype(float) / 1000, joints),
            boxes_px=_from_corners(of_action["bbox_by_camera_tlbr"].astype(float)),
        )


def _from_corners(top_left_bottom_right: Float[np.ndarray, "frame camera 4"]) -> Float[np.ndarray, "frame camera 4"]:
    top, left, bottom, right = np.moveaxis(top_left_bottom_right, -1, 0)
    boxes_px = np.stack([left, top, right - left, bottom - top], axis=-1)
    return np.where((bottom > top)[..., None], boxes_px, np.nan)
