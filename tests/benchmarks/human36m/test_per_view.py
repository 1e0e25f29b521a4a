"""Per-view predictions for Human3.6M, and what fgpose makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.human36m.labels import PoseSequence
from fgpose_benchmarks.human36m.per_view import Estimation, estimate, load_views
from fgpose_benchmarks.human36m.protocol import evaluate
from tests.benchmarks.human36m.human36m_files import sequence, write_views


def seen(each: PoseSequence, sigma_px: float = 0.0) -> Observations:
    noise_px = np.random.default_rng(0).normal(0.0, sigma_px, (len(each.frames), 4, 17, 2))
    undistorted_px = each.rig.project(each.truth_m)
    points_px = [camera.distort(undistorted_px[:, c]) for c, camera in enumerate(each.rig.cameras)]
    return Observations(
        skeleton=load_skeleton("h36m_17"),
        time_s=each.frames / 50.0,
        points2d_px=np.stack(points_px, axis=1) + noise_px,
        points3d_m=np.repeat(each.truth_m[:, None], 4, axis=1),
        camera_names=each.rig.names,
    )


WALK = sequence("S9", "Walking-1", np.arange(30))
SPARSE = sequence("S11", "Posing-2", np.array([0, 64, 128]))


def test_what_is_saved_comes_back_with_its_frames(tmp_path: Path):
    write_views({each.key: seen(each) for each in (WALK, SPARSE)}, tmp_path)
    assert (tmp_path / "S11" / "Posing-2.npz").is_file()
    views = load_views(tmp_path, [WALK, SPARSE])
    predictions = estimate([WALK, SPARSE], views, "fuse")
    np.testing.assert_array_equal(predictions["S11", "Posing-2"].frames, [0, 64, 128])
    np.testing.assert_array_equal(predictions["S9", "Walking-1"].frames, np.arange(30))


@pytest.mark.parametrize(("estimation", "limit_mm"), [("fuse", 1.0), ("refine", 4.0), ("smooth", 4.0)])
def test_fgpose_recovers_the_motion(estimation: Estimation, limit_mm: float):
    # 1 px at 4.5 m and 1145 px is 4 mm, of which four views leave about half; the 3D joints are exact
    predictions = estimate([WALK], {WALK.key: seen(WALK, 1.0)}, estimation)
    score = evaluate([WALK], predictions, step=5)
    assert score.absolute.mean_mm < limit_mm


def test_a_time_between_two_frames_is_refused(tmp_path: Path):
    late = replace(seen(WALK), time_s=WALK.frames / 50.0 + 0.01)
    write_views({WALK.key: late}, tmp_path)
    with pytest.raises(ValueError, match=r"Walking-1\.npz: time_s must be the number of a 50 Hz frame"):
        load_views(tmp_path, [WALK])


def test_a_sequence_without_a_file_is_refused(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"Posing-2\.npz"):
        load_views(tmp_path, [SPARSE])
