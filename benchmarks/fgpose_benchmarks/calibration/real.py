"""Real recordings whose calibration is known, and thrown away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fgpose.calibration.from_people.walk import Walk
from fgpose.config import Config
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.arrays import checked, read_arrays
from fgpose.io.calibration import load_rig
from fgpose.io.recordings import load_recording, recordings
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.sampling import frames_per_second
from fgpose_benchmarks.calibration.recording import Given, KnownRigRecording

REAL = {
    "balance_blazepose": "A man on one leg, 1.7 s, four cameras; per-view 3D",
    "balance_openpose": "The same, 2D only",
    "webcam_mediapipe": "The upper half of a person close to four webcams, 9 s, 2D only: too little, to be noticed",
}
"""What they show, by name."""
WEBCAM = Path("tests/data/webcam_mediapipe")
"""Not part of the installed package: from the folder of the source code."""


def available() -> tuple[str, ...]:
    """Those that can be read from here."""
    return (*recordings(), *(("webcam_mediapipe",) if (WEBCAM / "landmarks.npz").is_file() else ()))


def record_real(name: str) -> KnownRigRecording:
    """A recording by name. Its joints are those of the batch smoother with the true rig.

    Raises:
        ValueError: it is not available.
    """
    if name not in available():
        raise ValueError(f"no recording {name!r} here; there is {', '.join(available())}")
    rig, observations = load_recording(name) if name in recordings() else webcam()
    observations = replace(observations, covariance3d_m2=None)
    joints_m = smooth(observations, rig, Config().replace(solver={"covariance": False})).positions_m
    own = _in_camera_frames(observations, rig)
    time_s = own.time_s if own.time_s.ndim == 2 else np.repeat(own.time_s[:, None], rig.n_cameras, axis=1)
    frame_s = own.time_s if own.time_s.ndim == 1 else _first_known(time_s)
    return KnownRigRecording(
        clip="real",
        variant=name,
        people=PeopleObservations.of_one(own),
        intrinsics=CameraRig(tuple(without_pose(camera) for camera in rig.cameras)),
        given=Given(),
        rig=rig,
        told=Walk(own.skeleton, rig.names, frame_s, own.points2d_px, own.confidence, own.points3d_m),
        image_s=time_s,
        on_time_s=time_s,
        joints_m=joints_m,
        fps=frames_per_second(frame_s),
    )


def without_pose(camera: Camera) -> Camera:
    """The intrinsics alone."""
    return replace(camera, world_T_camera=np.eye(4), time_offset_s=0.0)


def _first_known(time_s: np.ndarray) -> np.ndarray:
    """Of each frame, the time of the first camera that has an image."""
    return np.take_along_axis(time_s, np.argmax(np.isfinite(time_s), axis=1)[:, None], axis=1)[:, 0]


def _in_camera_frames(observations: Observations, rig: CameraRig) -> Observations:
    """Per-view 3D joints in the frame of each camera instead of the world."""
    if observations.points3d_m is None:
        return observations
    views_m = [camera.to_camera_frame(observations.points3d_m[:, c]) for c, camera in enumerate(rig.cameras)]
    return replace(observations, points3d_m=np.stack(views_m, axis=1))


def webcam() -> tuple[CameraRig, Observations]:
    """The rig, and the detections of the person; from the folder of the source code."""
    rig, skeleton = load_rig(WEBCAM / "config.toml"), load_skeleton("blazepose_33")
    arrays = read_arrays(WEBCAM / "landmarks.npz")
    points2d_px = checked(arrays, "points2d_px", "numbers", None, rig.n_cameras, skeleton.n_joints, 2).astype(float)
    time_s = checked(arrays, "time_s", "numbers", len(points2d_px), rig.n_cameras).astype(float)
    return rig, Observations(skeleton, time_s, points2d_px, camera_names=rig.names)
