"""aniposelib or the Ensemble Kalman Smoother at work, for peer.py: runs in an environment of its own and knows nothing
of fgpose.

``peer_server.py PACKAGE`` writes {"version"} when it is ready. Then it reads one JSON request a line and writes one
JSON answer a line: {"recording": npz file, "settings": keywords of the package's function, "scores": whether aniposelib
gets the confidences, "output": npz file} -> {"wall_s", "cpu_s"}.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup

_NO_CONFIDENCE = 1e-5
_Solve = Callable[[], dict[str, np.ndarray]]


def _group(recording: Any) -> CameraGroup:
    poses = zip(recording["K"], recording["camera_T_world"], strict=True)
    cameras = [
        Camera(matrix=K, dist=np.zeros(5), rvec=cv2.Rodrigues(pose[:3, :3])[0].ravel(), tvec=pose[:3, 3], name=str(n))
        for n, (K, pose) in enumerate(poses)
    ]
    return CameraGroup(cameras)


def _triangulation(recording: Any, request: dict[str, Any]) -> _Solve:
    """By triangulate_optim."""
    group = _group(recording)
    points = np.ascontiguousarray(recording["undistorted_px"].transpose(1, 0, 2, 3))
    settings = dict(request["settings"], constraints=recording["bones"].tolist())
    if request["scores"]:
        settings["scores"] = np.ascontiguousarray(recording["confidence"].transpose(1, 0, 2))
    return lambda: {"positions_m": group.triangulate_optim(points, **settings)}


def _smoothing(recording: Any, request: dict[str, Any]) -> _Solve:
    """By ensemble_kalman_smoother_multicam, as somebody uses it who has one network: of an ensemble of one it takes the
    variance of a detection to be one over its confidence. Each call compiles its functions anew, which counts."""
    from eks.marker_array import MarkerArray
    from eks.multicam_smoother import ensemble_kalman_smoother_multicam

    markers = MarkerArray(_everywhere(recording)[None], data_fields=["x", "y", "likelihood"])
    _, n_cameras, n_frames, n_joints, _ = markers.shape
    names = [f"joint{j}" for j in range(n_joints)], [f"{c}" for c in range(n_cameras)]
    # The default of inflate_vars_kwargs is changed by each call.
    settings = {"inflate_vars_kwargs": {}, "camgroup": _group(recording)} | request["settings"]

    def solve() -> dict[str, np.ndarray]:
        *_, table = ensemble_kalman_smoother_multicam(markers, *names, **settings)
        numbers = table.to_numpy().reshape(n_frames, n_joints, 2, 3)
        return {"positions_m": numbers[:, :, 0], "variance_m2": numbers[:, :, 1]}

    return solve


def _everywhere(recording: Any) -> np.ndarray:
    """(C, F, J, 3) pixels and confidence: the smoother cannot do without a detection. One that is missing is
    interpolated in time, with the least confidence that it knows."""
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
    return np.concatenate([points, confidence[..., None]], axis=-1)


_PREPARED = {"aniposelib": _triangulation, "ensemble-kalman-smoother": _smoothing}


def _answer(package: str, request: dict[str, Any]) -> dict[str, float]:
    solve = _PREPARED[package](np.load(request["recording"]), request)
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    solved = solve()
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    np.savez(request["output"], allow_pickle=False, **solved)
    return {"wall_s": wall_s, "cpu_s": cpu_s}


def _main(package: str) -> None:
    # numba tells at length that it falls back to plain Python, aniposelib prints: neither may reach the answers.
    warnings.simplefilter("ignore")
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as answers:
        sys.stdout = sys.stderr
        answers.write(json.dumps({"version": version(package)}) + "\n")
        answers.flush()
        for line in sys.stdin:
            answers.write(json.dumps(_answer(package, json.loads(line))) + "\n")
            answers.flush()


if __name__ == "__main__":
    _main(sys.argv[1])
