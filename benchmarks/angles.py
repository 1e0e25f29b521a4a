"""Errors of joint angles on the recordings of the benchmark, and how well their standard deviations hold.

    python benchmarks/angles.py                          # clean and occluded, the five test clips; some 20 s
    python benchmarks/angles.py --variants industrial --method oracle

Angles of the batch smoother against those of the true joints, both by fgpose.joint_angles. Left and right are put
together. Within one and two standard deviations there should be 68 and 95 % of the errors.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import replace

import numpy as np

from fgpose.benchmark.families import find_variant
from fgpose.benchmark.methods import find_methods, methods
from fgpose.benchmark.recording import Recording
from fgpose.benchmark.variants import TEST_CLIPS, record
from fgpose.kinematics.angles import JointAngles, joint_angles
from fgpose.trajectory import Status, Trajectory

Scores = dict[str, list[np.ndarray]]
"""Errors and standard deviations in degrees, (2, frame), by the name of the angle without its side."""


def scored(recording: Recording, method: str, scores: Scores) -> None:
    """Add the errors of one recording."""
    result = find_methods([method], methods())[0].solve(recording)
    angles = _angles(recording, result.positions_m, result.covariance_m2)
    true_deg = _angles(recording, recording.truth_m, None).angle_deg
    error_deg = (angles.angle_deg - true_deg + 180.0) % 360.0 - 180.0
    for index, name in enumerate(angles.names):
        pairs = np.stack([error_deg[:, index], angles.sigma_deg[:, index]])
        pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
        scores[name.removeprefix("left_").removeprefix("right_")].append(pairs)
        scores["all"].append(pairs)


def _angles(recording: Recording, positions_m: np.ndarray, covariance_m2: np.ndarray | None) -> JointAngles:
    status = np.full(positions_m.shape[:2], int(Status.OBSERVED))
    time_s = np.arange(len(positions_m)) / recording.fps
    trajectory = Trajectory(recording.observations.skeleton, time_s, positions_m.copy(), status)
    return joint_angles(replace(trajectory, covariance_m2=covariance_m2))


def table(scores: Scores) -> str:
    """One line per angle, all of them last."""
    lines = [
        "| angle | rms error [deg] | mean error [deg] | rms sigma [deg] | within 1 sigma [%] | within 2 sigma [%] |"
    ]
    lines.append("|---|---:|---:|---:|---:|---:|")
    for name in sorted(scores, key=lambda name: name == "all"):
        error_deg, sigma_deg = np.concatenate(scores[name], axis=1)
        ratio = np.abs(error_deg / sigma_deg)
        numbers = [np.sqrt(np.mean(error_deg**2)), np.mean(np.abs(error_deg)), np.sqrt(np.mean(sigma_deg**2))]
        shares = [100 * np.mean(ratio < limit) for limit in (1, 2)]
        cells = [*(f"{number:.2f}" for number in numbers), *(f"{share:.1f}" for share in shares)]
        lines.append(f"| {name.replace('_', ' ')} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", default=["clean", "occluded"], help="of fgpose benchmark")
    parser.add_argument("--method", default="fgpose batch", help="one that states covariances")
    options = parser.parse_args()
    for variant in options.variants:
        scores: Scores = defaultdict(list)
        for clip in TEST_CLIPS:
            scored(record(find_variant(variant), clip), options.method, scores)
        sys.stdout.write(f"\n{options.method}, {variant}\n\n{table(scores)}\n")


if __name__ == "__main__":
    main()
