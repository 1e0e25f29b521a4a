"""Small files in the layouts in which people have Human3.6M, of a motion and cameras that are known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.keypoints import save_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.human36m.labels import PoseSequence, SequenceKey
from fgpose_benchmarks.synthetic import ring_rig, walking

CAMERAS = ("54138969", "55011271", "58860488", "60457274")
DISTORTION = np.array([-0.2, 0.24, -0.0019, -0.0015, -0.0027])
# As their generate-labels-npy-multiview.py picks them of the original 32.
LT_OF_32 = (3, 2, 1, 6, 7, 8, 0, 12, 13, 15, 27, 26, 25, 17, 18, 19, 14)
NAMES_OF_32 = {
    0: "pelvis",
    1: "right_hip",
    2: "right_knee",
    3: "right_ankle",
    6: "left_hip",
    7: "left_knee",
    8: "left_ankle",
    12: "spine",
    13: "thorax",
    14: "neck_base",
    15: "head",
    17: "left_shoulder",
    18: "left_elbow",
    19: "left_wrist",
    25: "right_shoulder",
    26: "right_elbow",
    27: "right_wrist",
}
"""Joints of the original by number (H36M_NAMES of Martinez et al., 2017), in fgpose's words."""


def h36m_rig(turn: float = 0.0) -> CameraRig:
    """Four cameras named as those of Human3.6M, with its distortion, turned about the vertical."""
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return CameraRig(
        tuple(
            Camera(name, (1000, 1002) if name in ("54138969", "60457274") else (1000, 1000), camera.K, pose, DISTORTION)
            for name, camera in zip(CAMERAS, ring_rig().cameras, strict=True)
            for pose in [turned @ camera.world_T_camera]
        )
    )


def motion_of_32(n_frames: int, seed: int = 0) -> np.ndarray:
    """(T, 32, 3) metres: a walk, and for the joints that nobody uses something far away."""
    skeleton = load_skeleton("h36m_17")
    walk_m = walking(n_frames, 50.0, skeleton)
    points_m = np.random.default_rng(seed).uniform(20.0, 30.0, (n_frames, 32, 3))
    for number, name in NAMES_OF_32.items():
        points_m[:, number] = walk_m[:, skeleton.index(name)]
    return points_m


def truth_of(points_m: np.ndarray) -> np.ndarray:
    """(T, 17, 3) in the order of h36m_17, by name."""
    numbers = {name: number for number, name in NAMES_OF_32.items()}
    return points_m[:, [numbers[name] for name in load_skeleton("h36m_17").joints]]


def sequence(subject: str, action: str, frames: np.ndarray, rig: CameraRig | None = None) -> PoseSequence:
    """A walk with all views."""
    rig = rig or h36m_rig()
    boxes_px = np.broadcast_to([300.0, 200.0, 250.0, 600.0], (len(frames), rig.n_cameras, 4)).copy()
    return PoseSequence(subject, action, rig, frames, truth_of(motion_of_32(len(frames))), boxes_px)


def labels(
    actions: dict[tuple[str, str], np.ndarray], rigs: dict[str, CameraRig], missing_view: tuple[int, int] | None = None
) -> dict:
    """The dictionary of Learnable Triangulation for these sequences and frames, dtypes as in its generator.

    missing_view: row and camera without an image.
    """
    subjects = list(rigs)
    action_names = sorted({action for _, action in actions})
    camera_type = [("R", np.float32, (3, 3)), ("t", np.float32, (3, 1)), ("K", np.float32, (3, 3))]
    cameras = np.empty((len(subjects), 4), dtype=[*camera_type, ("dist", np.float32, 5)])
    for row, rig in zip(cameras, rigs.values(), strict=True):
        for cell, camera in zip(row, rig.cameras, strict=True):
            cell["R"], cell["t"] = camera.camera_T_world[:3, :3], 1000 * camera.camera_T_world[:3, 3:]
            cell["K"], cell["dist"] = camera.K, camera.distortion
    index_type = [("subject_idx", np.int8), ("action_idx", np.int8), ("frame_idx", np.int16)]
    table_type = [*index_type, ("keypoints", np.float32, (17, 3)), ("bbox_by_camera_tlbr", np.int16, (4, 4))]
    segments = []
    for (subject, action), frames in actions.items():
        segment = np.empty(len(frames), dtype=table_type)
        segment["subject_idx"], segment["action_idx"] = subjects.index(subject), action_names.index(action)
        segment["frame_idx"] = frames
        segment["keypoints"] = 1000 * motion_of_32(len(frames))[:, LT_OF_32]
        segment["bbox_by_camera_tlbr"] = (200, 300, 800, 900)
        segments.append(segment)
    table = np.concatenate(segments)
    if missing_view is not None:
        table["bbox_by_camera_tlbr"][missing_view] = 0
    return {
        "subject_names": subjects,
        "camera_names": list(CAMERAS),
        "action_names": action_names,
        "cameras": cameras,
        "table": table,
    }


def write_annotation(
    folder: Path, subject: str, action: str, frames: np.ndarray, rig: CameraRig, without: str = ""
) -> None:
    """SUBJECT/ACTION/annot.h5 as process_all.py of h36m-fetch writes it; frames from 0."""
    import h5py

    points_m = motion_of_32(len(frames))
    views = [camera for camera in rig.cameras if camera.name != without]
    path = folder / subject / action / "annot.h5"
    path.parent.mkdir(parents=True)
    with h5py.File(path, "w") as file:
        in_camera_mm = [1000 * camera.to_camera_frame(points_m) for camera in views]
        points_px = [camera.distort(camera.project(points_m)) for camera in views]
        file["pose/2d"], file["pose/3d"] = np.concatenate(points_px), np.concatenate(in_camera_mm)
        file["pose/3d-univ"] = 0.9 * np.concatenate(in_camera_mm)
        file["frame"] = np.tile(frames + 1, len(views))
        file["camera"] = np.repeat([int(camera.name) for camera in views], len(frames))
        for camera in views:
            K = camera.K
            file[f"intrinsics/{camera.name}"] = np.array([K[0, 0], K[0, 2], K[1, 1], K[1, 2]])


def write_camera_parameters(path: Path, rigs: dict[str, CameraRig]) -> None:
    """camera-parameters.json as in karfly/human36m-camera-parameters."""
    first = next(iter(rigs.values()))
    intrinsics = {
        camera.name: {"calibration_matrix": camera.K.tolist(), "distortion": camera.distortion.tolist()}
        for camera in first.cameras
    }
    extrinsics = {
        subject: {
            camera.name: {
                "R": camera.camera_T_world[:3, :3].tolist(),
                "t": (1000 * camera.camera_T_world[:3, 3:]).tolist(),
            }
            for camera in rig.cameras
        }
        for subject, rig in rigs.items()
    }
    path.write_text(json.dumps({"intrinsics": intrinsics, "extrinsics": extrinsics}))


def write_views(views: Mapping[SequenceKey, Observations], folder: Path) -> None:
    """Per-view predictions as load_views reads them."""
    for (subject, action), observations in views.items():
        save_observations(observations, folder / subject / f"{action}.npz")
