"""Predictions of other methods for Human3.6M, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.human36m.predictions import SequencePrediction, load_predictions, save_predictions

RNG = np.random.default_rng(0)
POSES_M = RNG.normal(0.0, 1.0, (5, 17, 3))


def arrays(**changed: Any) -> dict[str, Any]:
    """Two sequences in no order."""
    basic = {
        "subject": np.array(["S9", "S11", "S9", "S9", "S11"]),
        "action": np.array(["Eating-1", "Eating-1", "Eating-1", "Greeting-2", "Eating-1"]),
        "frame": np.array([64, 0, 0, 0, 64]),
        "positions_m": POSES_M,
    }
    return {name: value for name, value in (basic | changed).items() if value is not None}


def load(folder: Path, **changed: Any) -> dict:
    np.savez(folder / "adafuse.npz", **arrays(**changed))
    return load_predictions(folder / "adafuse.npz")


def assert_basic(predictions: dict, atol: float = 0.0) -> None:
    assert set(predictions) == {("S9", "Eating-1"), ("S11", "Eating-1"), ("S9", "Greeting-2")}
    eating = predictions["S9", "Eating-1"]
    np.testing.assert_array_equal(eating.frames, [0, 64])
    np.testing.assert_allclose(eating.positions_m, POSES_M[[2, 0]], atol=atol)


def test_rows_are_sorted_into_sequences(tmp_path: Path):
    assert_basic(load(tmp_path))


def test_millimetres_are_named_so(tmp_path: Path):
    # the last bit
    assert_basic(load(tmp_path, positions_m=None, positions_mm=1000 * POSES_M), atol=1e-12)


def test_subjects_and_actions_may_be_numbers(tmp_path: Path):
    by_number = {
        "subject": np.array([9, 11, 9, 9, 11]),
        "action": np.array([4, 4, 4, 5, 4]),
        "subaction": np.array([1, 1, 1, 2, 1]),
    }
    assert_basic(load(tmp_path, **by_number))


def test_joints_may_come_in_the_order_of_learnable_triangulation(tmp_path: Path):
    same = {"neck": "thorax", "nose": "neck_base", "head_top": "head"}
    names = load_skeleton("h36m_17_lt").joints
    order = [load_skeleton("h36m_17").index(same.get(name, name)) for name in names]
    assert_basic(load(tmp_path, positions_m=POSES_M[:, order], joints=np.array(names)))


def test_what_is_saved_comes_back(tmp_path: Path):
    predictions = {
        ("S9", "Eating-1"): SequencePrediction(np.array([0, 5]), POSES_M[:2]),
        ("S11", "Posing-1"): SequencePrediction(np.array([3]), np.full((1, 17, 3), np.nan)),
    }
    save_predictions(predictions, tmp_path / "mine.npz")
    loaded = load_predictions(tmp_path / "mine.npz")
    assert loaded.keys() == predictions.keys()
    for key, each in predictions.items():
        np.testing.assert_array_equal(loaded[key].frames, each.frames)
        np.testing.assert_array_equal(loaded[key].positions_m, each.positions_m)
    save_predictions({}, tmp_path / "none.npz")
    assert load_predictions(tmp_path / "none.npz") == {}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"positions_m": None}, "positions_m and positions_mm is needed, there is 0"),
        ({"positions_mm": POSES_M}, "there is 2"),
        ({"positions_m": 1000 * POSES_M}, "name the array positions_mm"),
        ({"positions_m": POSES_M[:, :16]}, r"must be \(17, 3\) numbers for each row, got \(5, 16, 3\)"),
        ({"positions_m": np.where(POSES_M[3, 1, 1] == POSES_M, np.inf, POSES_M)}, "infinite in row 3"),
        ({"frame": None}, "the array frame is missing"),
        ({"frame": np.arange(4)}, r"frame must be \(5,\), one for each pose, got \(4,\)"),
        ({"frame": np.arange(5) / 2}, "frame must be whole numbers from 0"),
        ({"frame": np.zeros(5, dtype=int)}, "S9/Eating-1 has frame 0 twice"),
        ({"action": np.arange(5)}, "the array subaction is missing"),
        ({"action": np.arange(5), "subaction": np.ones(5, dtype=int)}, "action 0 is none of 2"),
        ({"joints": np.array(["pelvis"])}, "is missing; there is pelvis"),
    ],
)
def test_what_is_wrong_is_said_with_the_file(changed: dict[str, Any], message: str, tmp_path: Path):
    with pytest.raises(ValueError, match=rf"adafuse\.npz: .*{message}"):
        load(tmp_path, **changed)


def test_a_damaged_file_is_refused(tmp_path: Path):
    (tmp_path / "other.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ValueError, match=r"other\.npz: not predictions"):
        load_predictions(tmp_path / "other.npz")
