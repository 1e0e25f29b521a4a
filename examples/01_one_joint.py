"""One joint, four cameras, one of them wrong: the smallest factor graph, and how certain its result is.

What one learns: a projection factor per camera, a robust kernel that discounts the camera that disagrees, GTSAM's
optimiser, and the marginal covariance as a standard deviation in millimetres.

    python examples/01_one_joint.py
"""

from __future__ import annotations

import gtsam
import numpy as np

from fgpose.geometry.triangulation import triangulate
from fgpose_benchmarks.synthetic import ring_rig
from fgpose_factors import Kernel, noise_model, projection_factor

SIGMA_PX = 3.0
WRIST = gtsam.symbol("x", 0)


def solve(points_px: np.ndarray, start_m: np.ndarray, kernel: Kernel) -> tuple[np.ndarray, np.ndarray]:
    """Position and its covariance, m and m^2, from one pixel per camera (camera, 2)."""
    noise = noise_model(2, SIGMA_PX, kernel, kernel_scale=1.5)
    graph = gtsam.NonlinearFactorGraph()
    for camera, point_px in zip(ring_rig().cameras, points_px, strict=True):
        graph.add(projection_factor(WRIST, point_px, noise, camera.gtsam))
    initial = gtsam.Values()
    initial.insert(WRIST, start_m)
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    return result.atPoint3(WRIST), gtsam.Marginals(graph, result).marginalCovariance(WRIST)


def main() -> None:
    rig = ring_rig()
    truth_m = np.array([0.3, -0.2, 1.1])
    points_px = rig.project(truth_m[None])[:, 0] + SIGMA_PX * np.random.default_rng(0).normal(size=(4, 2))
    points_px[2] += (60.0, -40.0)  # this camera detects something else as the wrist

    start_m = triangulate(points_px, np.ones(4), rig.projection_matrices)
    answers: dict[str, tuple[np.ndarray, np.ndarray]] = {
        "least squares": solve(points_px, start_m, "none"),
        "robust (Cauchy)": solve(points_px, start_m, "cauchy"),
    }
    print(f"truth            {np.round(truth_m, 4)} m")
    for name, (position_m, covariance_m2) in answers.items():
        error_mm = 1000 * np.linalg.norm(position_m - truth_m)
        sigma_mm = 1000 * np.sqrt(np.diag(covariance_m2))
        print(f"{name:16} {np.round(position_m, 4)} m, sigma {np.round(sigma_mm, 1)} mm, error {error_mm:.1f} mm")


if __name__ == "__main__":
    main()
