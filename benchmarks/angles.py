"""Errors of joint angles on the recordings of the benchmark, and how well their standard deviations hold.

    python benchmarks/angles.py                          # clean and occluded, the five test clips; some 20 s
    python benchmarks/angles.py --variants industrial --method oracle
    python benchmarks/angles.py --given left_hip right_hip   # what is left if these joints were where they truly are

Angles of the batch smoother against those of the true joints, both by fgpose.joint_angles. Left and right are put
together. Within one and two standard deviations there should be 68 and 95 % of the errors. Below the table is how
honest the covariances of the positions are, and how much of their errors the joints share: angles do not notice that.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fgpose.kinematics.angles import JointAngles, joint_angles
from fgpose.kinematics.segments import across, unit
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.accuracy.families import find_variant
from fgpose_benchmarks.accuracy.methods import find_methods, methods
from fgpose_benchmarks.accuracy.variants import TEST_CLIPS, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording, MethodResult

_LOST_M = 0.1  # a joint that is farther off was lost for a while, and would count for all others

Scores = dict[str, list[np.ndarray]]
"""Errors and standard deviations in degrees, (2, frame), by the name of the angle without its side."""


def scored(recording: BenchmarkRecording, result: MethodResult, given: Sequence[str], scores: Scores) -> None:
    """Add the errors of one recording, some joints at their true places."""
    known = [recording.observations.skeleton.index(joint) for joint in given]
    positions_m = result.positions_m.copy()
    positions_m[:, known] = recording.truth_m[:, known]
    angles = _angles(recording, positions_m, result.covariance_m2)
    true_deg = _angles(recording, recording.truth_m, None).angle_deg
    error_deg = (angles.angle_deg - true_deg + 180.0) % 360.0 - 180.0
    for index, name in enumerate(angles.names):
        pairs = np.stack([error_deg[:, index], angles.sigma_deg[:, index]])
        pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
        scores[name.removeprefix("left_").removeprefix("right_")].append(pairs)
        scores["all"].append(pairs)


def _angles(recording: BenchmarkRecording, positions_m: np.ndarray, covariance_m2: np.ndarray | None) -> JointAngles:
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


@dataclass
class SharedErrors:
    """How the errors of the positions of a recording go together."""

    whitened: list[np.ndarray] = field(default_factory=list)
    """Errors along the axes of their covariances, in standard deviations."""
    whitened_of_body: list[np.ndarray] = field(default_factory=list)
    """Of the errors less their median over the joints of the frame."""
    products_m2: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Of the errors at both ends of a bone, across it: of both, of the one, and of the other."""

    def add(self, recording: BenchmarkRecording, result: MethodResult) -> None:
        """Add those of one recording. Raises ValueError if the method states no covariances."""
        if result.covariance_m2 is None:
            raise ValueError("the method states no covariances")
        error_m = result.positions_m - recording.truth_m
        shared_m = np.nanmedian(error_m, axis=1, keepdims=True)
        self.whitened.append(_whitened(error_m, result.covariance_m2))
        self.whitened_of_body.append(_whitened(error_m - shared_m, result.covariance_m2))
        for start, end in recording.observations.skeleton.bones:
            along = unit(recording.truth_m[:, end] - recording.truth_m[:, start])
            ends_m = [across(error_m[:, joint], along) for joint in (start, end)]
            good = np.all([np.linalg.norm(each_m, axis=-1) < _LOST_M for each_m in ends_m], axis=0)
            one_m, other_m = (each_m[good] for each_m in ends_m)
            self.products_m2 += [np.sum(one_m * other_m), np.sum(one_m**2), np.sum(other_m**2)]

    def __str__(self) -> str:
        within = [100 * np.mean(np.abs(np.concatenate(each)) < 1) for each in (self.whitened, self.whitened_of_body)]
        both, one, other = self.products_m2
        return (
            f"positions within 1 sigma: {within[0]:.1f} %, without the error that the whole body shares "
            f"{within[1]:.1f} %; correlation of the errors at both ends of a bone, across it: "
            f"{both / np.sqrt(one * other):.2f}"
        )


def _whitened(error_m: np.ndarray, covariance_m2: np.ndarray) -> np.ndarray:
    known = np.isfinite(error_m).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-2, -1))
    values, vectors = np.linalg.eigh(covariance_m2[known])
    return np.einsum("nab,na->nb", vectors, error_m[known]) / np.sqrt(values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variants", nargs="+", default=["clean", "occluded"], help="of fgpose benchmark")
    parser.add_argument("--method", default="fgpose batch", help="one that states covariances")
    parser.add_argument("--given", nargs="+", default=[], metavar="JOINT", help="joints at their true places")
    options = parser.parse_args()
    (method,) = find_methods([options.method], methods())
    for variant in options.variants:
        scores: Scores = defaultdict(list)
        shared = SharedErrors()
        for clip in TEST_CLIPS:
            recording = record(find_variant(variant), clip)
            result = method.solve(recording)
            scored(recording, result, options.given, scores)
            shared.add(recording, result)
        sys.stdout.write(f"\n{options.method}, {variant}\n\n{table(scores)}\n\n{shared}\n")


if __name__ == "__main__":
    main()
