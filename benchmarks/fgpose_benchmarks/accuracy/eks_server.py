"""The Ensemble Kalman Smoother of several cameras at work, for peer.py: runs in an environment of its own and knows
nothing of fgpose.

The protocol is that of peer_server.py; the settings are keywords of ensemble_kalman_smoother_multicam, and the output
has variances too. It is used as by somebody who has one network: of an ensemble of one it takes the variance of a
detection to be one over its confidence. It cannot do without a detection: one that is missing is interpolated in time,
with the least confidence that it knows. Each call compiles its functions anew, which counts.
"""

from __future__ import annotations

import json
import os
import sys
import time
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup  # pyright: ignore[reportMissingImports]
from eks.marker_array import MarkerArray  # pyright: ignore[reportMissingImports]
from eks.multicam_smoother import ensemble_kalman_smoother_multicam  # pyright: ignore[reportMissingImports]

_NO_CONFIDENCE = 1e-5


def _group(recording: Any) -> CameraGroup:
    poses = zip(recording["K"], recording["camera_T_world"], strict=True)
    return CameraGroup(
        [
            Camera(
                matrix=K, dist=np.zeros(5), rvec=cv2.Rodrigues(pose[:3, :3])[0].ravel(), tvec=pose[:3, 3], name=f"{n}"
            )
            for n, (K, pose) in enumerate(poses)
        ]
    )


def _markers(recording: Any) -> MarkerArray:
    """(1, C, F, J, 3) pixels and confidence."""
    points = recording["undistorted_px"].transpose(1, 0, 2, 3).copy()
    confidence = recording["confidence"].transpose(1, 0, 2).copy()
    is_missing = ~np.isfinite(points).all(axis=-1)
    confidence[is_missing] = _NO_CONFIDENCE
    frames = np.arange(points.shape[1])
    for c, j in zip(*np.nonzero(is_missing.any(axis=1)), strict=True):
        missing = is_missing[c, :, j]
        # Where a camera never sees a joint, any pixel will do.
        known, at = (np.zeros((1, 2)), [0]) if missing.all() else (points[c, ~missing, j], frames[~missing])
        for axis in range(2):
            points[c, missing, j, axis] = np.interp(frames[missing], at, known[:, axis])
    return MarkerArray(
        np.concatenate([points, confidence[..., None]], axis=-1)[None], data_fields=["x", "y", "likelihood"]
    )


def _solved(markers: MarkerArray, group: CameraGroup, settings: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """(F, J, 3) positions and variances."""
    _, n_cameras, n_frames, n_joints, _ = markers.shape
    names = [f"joint{j}" for j in range(n_joints)]
    cameras = [f"{c}" for c in range(n_cameras)]
    settings = {"inflate_vars_kwargs": {}} | settings  # its default is changed by each call
    *_, table = ensemble_kalman_smoother_multicam(markers, names, cameras, camgroup=group, **settings)
    numbers = table.to_numpy().reshape(n_frames, n_joints, 2, 3)
    return numbers[:, :, 0], numbers[:, :, 1]


def _answer(request: dict[str, Any]) -> dict[str, float]:
    recording = np.load(request["recording"])
    group, settings = _group(recording), request["settings"]
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    positions_m, variance_m2 = _solved(_markers(recording), group, settings)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    np.savez(request["output"], positions_m=positions_m, variance_m2=variance_m2)
    return {"wall_s": wall_s, "cpu_s": cpu_s}


def _main() -> None:
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as answers:
        sys.stdout = sys.stderr
        answers.write(json.dumps({"version": version("ensemble-kalman-smoother")}) + "\n")
        answers.flush()
        for line in sys.stdin:
            answers.write(json.dumps(_answer(json.loads(line))) + "\n")
            answers.flush()


if __name__ == "__main__":
    _main()
