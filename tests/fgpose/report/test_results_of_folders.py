"""Which file of a folder a report is of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import save_trajectory
from fgpose.io.trajectories.kinematics import save_kinematics
from fgpose.report import find_result
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.synthetic import walking


def test_joint_angles_beside_a_result_are_none(tmp_path: Path) -> None:
    pytest.importorskip("ezc3d")
    positions_m = walking(40, 50.0)
    status = np.zeros(positions_m.shape[:2], dtype=int)
    walk = Trajectory(load_skeleton("h36m_17"), np.arange(40) / 50, positions_m, status)
    save_trajectory(walk, tmp_path / "walk.parquet")
    save_kinematics(walk, tmp_path / "walk_angles.parquet")
    save_kinematics(walk, tmp_path / "turned.c3d")
    assert find_result(tmp_path) == tmp_path / "walk.parquet"
    for path, name in ((tmp_path, "walk_angles"), (tmp_path / "walk_angles.parquet", None)):
        with pytest.raises(ValueError, match=r"walk_angles\.parquet holds joint angles: a report is of the motion"):
            find_result(path, name)
    # It has the points too.
    assert find_result(tmp_path, "turned") == tmp_path / "turned.c3d"
    (tmp_path / "walk.parquet").unlink()
    assert find_result(tmp_path) == tmp_path / "turned.c3d"
