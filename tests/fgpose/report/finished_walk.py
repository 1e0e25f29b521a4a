"""A result in which nothing is wrong, so that faults can be planted in it one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.report import FinishedRecording
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Convergence, Status, Trajectory
from fgpose_benchmarks.synthetic import walking

FPS, SECONDS, SPREAD_PX = 30.0, 10, 4.0


def finished_walk(rig: CameraRig, skeleton: Skeleton) -> FinishedRecording:
    """Ten seconds of walking to and fro. Errors of detections are independent, normal, 4 px along each axis."""
    rng, n_frames = np.random.default_rng(0), int(FPS * SECONDS)
    stride_m = walking(30, FPS, skeleton)
    place_m = np.stack([np.sin(np.arange(n_frames) / 60), np.zeros(n_frames), np.zeros(n_frames)], axis=-1)
    truth_m = (stride_m - stride_m[:, :1] * (1, 1, 0))[_to_and_fro(n_frames, 30)] + place_m[:, None]
    error_px = rng.normal(scale=SPREAD_PX, size=(n_frames, rig.n_cameras, skeleton.n_joints, 2))
    positions_m = truth_m + rng.normal(scale=0.0005, size=truth_m.shape)
    trajectory = Trajectory(
        skeleton=skeleton,
        time_s=np.arange(n_frames) / FPS,
        positions_m=positions_m,
        status=np.full(truth_m.shape[:2], Status.OBSERVED, dtype=np.int8),
        # 10 mm: about what four cameras at 4.5 m give with 4 px.
        covariance_m2=np.broadcast_to(0.01**2 * np.eye(3), (*truth_m.shape, 3)).copy(),
        residual_px=np.linalg.norm(error_px, axis=-1),
        visibility=np.full(error_px.shape[:3], 0.97),
        camera_names=rig.names,
        convergence=Convergence(True, 7, 100.0, 10.0),
    )
    seen = Observations(
        skeleton=skeleton,
        time_s=trajectory.time_s.copy(),
        points2d_px=rig.project(positions_m) + error_px,
        confidence=rng.uniform(0.6, 1.0, error_px.shape[:3]),
        camera_names=rig.names,
    )
    return FinishedRecording("walk", {0: trajectory}, rig, {0: seen})


def _to_and_fro(n_frames: int, period: int) -> np.ndarray:
    """Through the frames of a stride and back, so that nothing jumps."""
    phase = np.arange(n_frames) % (2 * period - 2)
    return np.minimum(phase, 2 * period - 2 - phase)


def changed(recording: FinishedRecording, **arrays: Any) -> FinishedRecording:
    """With other arrays in the trajectory; what the cameras saw stays."""
    return replace(recording, people={0: replace(recording.main, **arrays)})
