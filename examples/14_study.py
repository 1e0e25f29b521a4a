"""Many recordings as one data set: a small study is made from motion capture, estimated on all cores, and asked.

What one learns: the study file, what happens to a recording that is damaged, that nothing is done twice, and how the
results of all recordings are read as one table.

    python examples/14_study.py --output out/study
"""

from __future__ import annotations

from pathlib import Path

import pyarrow.compute as pc
import pyarrow.dataset as ds
import tyro

from fgpose.study import StudyResult, load_study, run_study
from fgpose_benchmarks.demo_study import SESSIONS, write_demo_study


def describe(result: StudyResult) -> None:
    print(", ".join(f"{number} {status}" for status, number in sorted(result.counts.items())))
    for recording, reason in result.failures:
        print(f"failed: {recording}: {reason}")


def main(output: Path = Path("out/study"), seconds: float = 1.0, sessions: tuple[str, ...] = SESSIONS) -> None:
    """Make a study, and run it twice.

    Args:
        output: folder of the recordings and of the results.
        seconds: length of each recording.
        sessions: of each subject.
    """
    file = write_demo_study(output, seconds, sessions=sessions, report=False)
    print(file.read_text())
    study = load_study(file)
    describe(run_study(study))
    # Only what has failed is tried again.
    describe(run_study(study))

    angles = ds.dataset(study.output / "angles", partitioning="hive")
    knees = angles.to_table(filter=pc.field("name") == "left_knee_flexion")
    largest = knees.group_by("subject").aggregate([("value", "max")]).sort_by("subject")
    for row in largest.to_pylist():
        print(f"{row['subject']}: largest flexion of the left knee {row['value_max']:.0f} degrees")


# The processes of a study import this file.
if __name__ == "__main__":
    tyro.cli(main)
