"""Cameras calibrated with a simulated board, against the truth and against what no method can go below.

    python benchmarks/boards.py --seeds 20
    python benchmarks/boards.py --seeds 5 --aniposelib /path/to/python     # of an environment with aniposelib

Corners have a noise of 0.2 px on each axis and lenses a true distortion; the board lies on the floor, is held near to
each camera, and is carried through the middle of a ring of 4 m. Errors are those of positions after the best motion of
the whole rig, and of focal lengths. The bound is that of Cramér and Rao: the covariance of the adjustment at the truth,
where it is known which coefficients each lens has.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.calibration.board.calibrate import calibrate_from_boards
from fgpose.calibration.board.lens import LensKind, numbers_of
from fgpose.calibration.board.problem import BoardBundle, BoardProblem
from fgpose.calibration.board.verdict.sigmas import about_centroid
from fgpose.geometry.camera import Camera, CameraRig
from fgpose_benchmarks.synthetic.boards import BoardScene, simulate_boards

NOISE_PX = 0.2
_TWO_SIGMAS_3D = 8.02  # 95.4 % of the squares of three axes are below this


def bound(scene: BoardScene) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of positions (metres) and focal lengths (share) that no unbiased method can go below."""
    kinds = [LensKind(camera.lens, 4 if camera.lens == "fisheye" else 5) for camera in scene.rig.cameras]
    problem = BoardProblem(scene.sightings, kinds, np.full(scene.rig.n_cameras, NOISE_PX))
    poses = np.stack([camera.world_T_camera for camera in scene.rig.cameras])
    truth = BoardBundle.on_time(
        poses, np.stack([numbers_of(camera) for camera in scene.rig.cameras]), scene.world_T_board
    )
    # The kernel takes 1 % of the normal errors for wrong: next to nothing of the information.
    covariance = about_centroid(problem.covariance(truth), scene.rig)
    variances = np.einsum("cici->ci", covariance)
    return np.sqrt(variances[:, 3:6].sum(axis=1)), np.sqrt(variances[:, 6])


def errors(rig: CameraRig, true: CameraRig) -> tuple[np.ndarray, np.ndarray]:
    """Of positions (metres) and focal lengths (share)."""
    moved = rig_similarity(rig, true, with_scale=False).rig(rig)
    return np.linalg.norm(moved.positions_m - true.positions_m, axis=1), rig.focal_px / true.focal_px - 1


_ANIPOSE = """
import copy, json, sys, time
import numpy as np
from aniposelib.boards import CharucoBoard
from aniposelib.cameras import Camera, CameraGroup
given = json.load(open(sys.argv[1]))
columns, rows = given["size"]
board = CharucoBoard(columns, rows, given["square_mm"], given["marker_mm"], marker_bits=5, dict_size=100)
rows_of = []
for own in given["points"]:
    rows_of.append([
        {"framenum": (0, t), "corners": np.array(xy, dtype=np.float32)[:, None], "ids": np.array(ids)[:, None]}
        for t, ids, xy in own
    ])
for _ in range(2):  # the first time it compiles
    group = CameraGroup([Camera(name=name, size=size) for name, size in zip(given["names"], given["sizes"])])
    start = time.process_time()
    group.calibrate_rows(copy.deepcopy(rows_of), board, init_intrinsics=True, init_extrinsics=True, verbose=False)
    cpu_s = time.process_time() - start
print("RESULT " + json.dumps({
    "cpu_s": cpu_s,
    "K": [np.asarray(c.get_camera_matrix()).tolist() for c in group.cameras],
    "T": [np.asarray(c.get_extrinsics_mat()).tolist() for c in group.cameras],
}))
"""


def by_aniposelib(scene: BoardScene, python: Path) -> tuple[CameraRig, float]:
    """The rig that it finds from the same corners, and its processor time without compilation."""
    sightings = scene.sightings
    points = [
        [
            (t, np.flatnonzero(seen).tolist(), sightings.points_px[t, c, seen].tolist())
            for t, seen in enumerate(sightings.seen[:, c])
            if seen.any()
        ]
        for c in range(scene.rig.n_cameras)
    ]
    board = sightings.board
    given = {
        "size": board.size,
        "square_mm": 1e3 * board.square_m,
        "marker_mm": 1e3 * board.marker_m,
        "names": scene.rig.names,
        "sizes": sightings.sizes_px,
        "points": points,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "given.json"
        path.write_text(json.dumps(given))
        done = subprocess.run([python, "-c", _ANIPOSE, path], capture_output=True, text=True)
    found = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    if not found:
        raise RuntimeError(f"aniposelib failed: {done.stderr[-2000:]}")
    result = json.loads(found[0].removeprefix("RESULT "))
    cameras = []
    for camera, K, T in zip(scene.rig.cameras, result["K"], result["T"], strict=True):
        R, t_m = np.array(T)[:3, :3], np.array(T)[:3, 3] / 1e3
        cameras.append(Camera.from_world_to_camera(camera.name, camera.size_px, np.array(K), R, t_m))
    return CameraRig(tuple(cameras)), result["cpu_s"]


def measure(n_cameras: int, seeds: Sequence[int], model: str, python: Path | None) -> None:
    """Print a line for each method."""
    rows: dict[str, list[tuple[np.ndarray, ...]]] = {"fgpose": [], "aniposelib": []}
    cpu_s: dict[str, list[float]] = {"fgpose": [], "aniposelib": []}
    claims, bounds = [], []
    for seed in seeds:
        scene = simulate_boards(n_cameras, seed, noise_px=NOISE_PX, model=model)  # pyrefly: ignore[bad-argument-type]
        start = time.process_time()
        result = calibrate_from_boards(scene.sightings)
        cpu_s["fgpose"].append(time.process_time() - start)
        rows["fgpose"].append(errors(result.rig, scene.rig))
        claims.append((result.sigmas.position_m, result.sigmas.focal))
        bounds.append(bound(scene))
        if python is not None:
            rig, own_s = by_aniposelib(scene, python)
            rows["aniposelib"].append(errors(rig, scene.rig))
            cpu_s["aniposelib"].append(own_s)
    least_m, least = np.swapaxes(np.array(bounds), 0, 1)
    for method, found in rows.items():
        if not found:
            continue
        position_m, focal = np.swapaxes(np.array(found), 0, 1)
        rms_m = np.sqrt(np.mean(position_m**2))
        print(
            f"{n_cameras} {model} cameras, {len(seeds)} rigs, {method}: position RMS {1e3 * rms_m:.2f} mm, median "
            f"{1e3 * np.median(position_m):.2f} mm ({rms_m / np.sqrt(np.mean(least_m**2)):.2f} x the bound), focal "
            f"length RMS {100 * np.sqrt(np.mean(focal**2)):.3f} % "
            f"({np.sqrt(np.mean(focal**2) / np.mean(least**2)):.2f} x), {np.median(cpu_s[method]):.1f} s of processor"
        )
    position_m, focal = np.swapaxes(np.array(rows["fgpose"]), 0, 1)
    sigma_m, sigma = np.swapaxes(np.array(claims), 0, 1)
    print(
        f"  within two stated sigmas: positions {np.mean(3 * (position_m / sigma_m) ** 2 < _TWO_SIGMAS_3D):.1%}, focal "
        f"lengths {np.mean(np.abs(focal) < 2 * sigma):.1%}; error over sigma, RMS: "
        f"{np.sqrt(np.mean((position_m / sigma_m) ** 2)):.2f}, {np.sqrt(np.mean((focal / sigma) ** 2)):.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="rigs of each kind")
    parser.add_argument("--cameras", type=int, nargs="+", default=[4, 8])
    parser.add_argument("--models", nargs="+", default=["pinhole", "fisheye"], choices=["pinhole", "fisheye"])
    parser.add_argument("--aniposelib", type=Path, help="Python of an environment that has it; pinhole only")
    options = parser.parse_args()
    for model in options.models:
        for n_cameras in options.cameras:
            python = options.aniposelib if model == "pinhole" else None
            measure(n_cameras, range(options.seeds), model, python)
            sys.stdout.flush()


if __name__ == "__main__":
    main()
