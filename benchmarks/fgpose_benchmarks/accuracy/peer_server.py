"""aniposelib at work, for peer.py: runs in an environment of its own and knows nothing of fgpose.

Writes {"version"} when it is ready. Then reads one JSON request a line and writes one JSON answer a line:
{"recording": npz file, "settings": keywords of triangulate_optim, "scores": whether it gets the confidences, "output":
npz file} -> {"wall_s", "cpu_s"}.
"""

from __future__ import annotations

import json
import os
import sys
import time
import warnings
from importlib.metadata import version
from typing import Any

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup  # pyright: ignore[reportMissingImports]


def _group(recording: Any) -> CameraGroup:
    poses = zip(recording["K"], recording["camera_T_world"], strict=True)
    cameras = [
        Camera(matrix=K, dist=np.zeros(5), rvec=cv2.Rodrigues(pose[:3, :3])[0].ravel(), tvec=pose[:3, 3], name=str(n))
        for n, (K, pose) in enumerate(poses)
    ]
    return CameraGroup(cameras)


def _answer(request: dict[str, Any]) -> dict[str, float]:
    recording = np.load(request["recording"])
    group = _group(recording)
    points = np.ascontiguousarray(recording["undistorted_px"].transpose(1, 0, 2, 3))
    settings = dict(request["settings"], constraints=recording["bones"].tolist())
    if request["scores"]:
        settings["scores"] = np.ascontiguousarray(recording["confidence"].transpose(1, 0, 2))
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    positions_m = group.triangulate_optim(points, **settings)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    np.savez(request["output"], positions_m=positions_m)
    return {"wall_s": wall_s, "cpu_s": cpu_s}


def _main() -> None:
    # numba tells at length that it falls back to plain Python, aniposelib prints: neither may reach the answers.
    warnings.simplefilter("ignore")
    with os.fdopen(os.dup(sys.stdout.fileno()), "w") as answers:
        sys.stdout = sys.stderr
        answers.write(json.dumps({"version": version("aniposelib")}) + "\n")
        answers.flush()
        for line in sys.stdin:
            answers.write(json.dumps(_answer(json.loads(line))) + "\n")
            answers.flush()


if __name__ == "__main__":
    _main()
