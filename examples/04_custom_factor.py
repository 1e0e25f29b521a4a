"""The factors in a graph of your own, with plain GTSAM and without the rest of fgpose.

What one learns: the symmetric bone-length factor between the two arms, how a pure function of your own becomes a factor
(here: the hand rests on a table), and how its Jacobians are checked in one line.

    python examples/04_custom_factor.py
"""

from __future__ import annotations

import gtsam
import numpy as np

from fgpose_factors import custom_factor, noise_model, symmetric_bone_length_factor
from fgpose_factors.testing import numerical_jacobians

LEFT_ELBOW, LEFT_WRIST, RIGHT_ELBOW, RIGHT_WRIST = (gtsam.symbol("x", joint) for joint in range(4))
TABLE_HEIGHT_M = 0.75

MEASURED_M = {
    LEFT_ELBOW: np.array([0.10, 0.25, 1.00]),
    LEFT_WRIST: np.array([0.33, 0.22, 1.04]),
    RIGHT_ELBOW: np.array([0.12, -0.24, 0.90]),
    RIGHT_WRIST: np.array([0.35, -0.20, 0.70]),
}


def height_above_table(point_m: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Residual (1,) in metres, and its Jacobian (1, 3) by the point."""
    return point_m[2:] - TABLE_HEIGHT_M, (np.array([[0.0, 0.0, 1.0]]),)


def forearms_mm(values: gtsam.Values) -> tuple[float, float]:
    """Length of the left and of the right forearm."""

    def distance_mm(start: int, end: int) -> float:
        return 1000 * float(np.linalg.norm(values.atPoint3(end) - values.atPoint3(start)))

    return distance_mm(LEFT_ELBOW, LEFT_WRIST), distance_mm(RIGHT_ELBOW, RIGHT_WRIST)


def main() -> None:
    (analytic,) = height_above_table(MEASURED_M[RIGHT_WRIST])[1]
    (numerical,) = numerical_jacobians(lambda point_m: height_above_table(point_m)[0], [MEASURED_M[RIGHT_WRIST]])
    print(f"Jacobian: largest difference to central differences {np.abs(analytic - numerical).max():.1e}")

    graph, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, position_m in MEASURED_M.items():
        graph.add(gtsam.PriorFactorPoint3(key, position_m, noise_model(3, sigma=0.03)))
        initial.insert(key, position_m)
    graph.add(
        symmetric_bone_length_factor((LEFT_ELBOW, LEFT_WRIST), (RIGHT_ELBOW, RIGHT_WRIST), noise_model(1, sigma=0.005))
    )
    graph.add(custom_factor((RIGHT_WRIST,), noise_model(1, sigma=0.002), height_above_table, (gtsam.Values.atPoint3,)))

    result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    for name, values in (("measured", initial), ("estimated", result)):
        left_mm, right_mm = forearms_mm(values)
        height_mm = 1000 * (values.atPoint3(RIGHT_WRIST)[2] - TABLE_HEIGHT_M)
        print(
            f"{name:9} left {left_mm:.1f} mm, right {right_mm:.1f} mm, difference {left_mm - right_mm:.1f} mm,"
            f" right hand {height_mm:.1f} mm above the table"
        )


if __name__ == "__main__":
    main()
