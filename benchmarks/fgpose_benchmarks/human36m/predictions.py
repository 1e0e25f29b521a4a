"""The results of any method on Human3.6M, as files, so that the same code scores all methods."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fgpose.io.arrays import read_arrays, texts, write_arrays
from fgpose.io.skeletons import load_skeleton
from fgpose.plain_files import naming
from fgpose_benchmarks.human36m.labels import N_JOINTS, SKELETON, SequenceKey, in_skeleton_order

# Rooms are smaller: a median coordinate beyond this is a unit mistake.
_MAX_PLAUSIBLE_M = 100.0
# Names of the array of positions, and the metres of its unit.
_POSITIONS = {"positions_m": 1.0, "positions_mm": 1e-3}
# The numbers by which the data set and the tools around it call the actions.
_ACTION_NUMBERS = {
    2: "Directions",
    3: "Discussion",
    4: "Eating",
    5: "Greeting",
    6: "Phoning",
    7: "Posing",
    8: "Purchases",
    9: "Sitting",
    10: "SittingDown",
    11: "Smoking",
    12: "TakingPhoto",
    13: "Waiting",
    14: "Walking",
    15: "WalkingDog",
    16: "WalkingTogether",
}


@dataclass(frozen=True, eq=False)
class SequencePrediction:
    """The poses that a method gives for one sequence."""

    frames: Int[np.ndarray, " frame"]
    """As in PoseSequence: from 0, increasing. Any of the sequence's, at least those that are scored."""
    positions_m: Float[np.ndarray, "frame joint 3"]
    """World frame, joints of h36m_17; NaN where the method gives nothing."""


Predictions = Mapping[SequenceKey, SequencePrediction]


def save_predictions(predictions: Predictions, path: str | Path) -> None:
    """Write predictions as the npz that load_predictions reads.

    Raises:
        OSError: the file cannot be written.
    """
    counts = [len(each.frames) for each in predictions.values()]
    subjects, actions = ([key[part] for key in predictions] for part in (0, 1))
    arrays = {
        "subject": np.repeat(np.array(subjects, dtype=str), np.array(counts, dtype=int)),
        "action": np.repeat(np.array(actions, dtype=str), np.array(counts, dtype=int)),
        "frame": np.concatenate([np.zeros(0, dtype=int), *(each.frames for each in predictions.values())]),
        "positions_m": np.concatenate(
            [np.zeros((0, N_JOINTS, 3)), *(each.positions_m for each in predictions.values())]
        ),
        "joints": np.array(load_skeleton(SKELETON).joints),
    }
    write_arrays(Path(path), arrays)


def load_predictions(path: str | Path) -> dict[SequenceKey, SequencePrediction]:
    """Predictions of any method, by sequence.

    An npz of N rows, one for each frame, in any order, without pickles:
    - subject (N,): S9, or the number 9
    - action (N,): Greeting-2; or the number of the action from 2 (Directions) to 16 (WalkingTogether), as in
      s_09_act_05_subact_02, and then subaction (N,): 1 or 2
    - frame (N,): number of the image in the 50 Hz video from 0 (img_000001.jpg is frame 0)
    - positions_m (N, 17, 3), or positions_mm: joints in the world frame; NaN = none
    - joints (17,), if they are not in the order of h36m_17: their names as in h36m_17 or h36m_17_lt

    Raises:
        ValueError: the file is damaged, an array is missing or of the wrong shape or unit, or a frame is there twice.
            The message names the file.
        OSError: it cannot be read.
    """
    path = Path(path)
    with naming(path, "not predictions for Human3.6M"):
        arrays = read_arrays(path)
        positions_m = _positions_m(arrays)
        keys, frames = _keys(arrays, len(positions_m)), _frames(arrays, len(positions_m))
    rows_of: dict[SequenceKey, list[int]] = {}
    for row, key in enumerate(keys):
        rows_of.setdefault(key, []).append(row)
    return {key: _prediction(path, key, frames[rows], positions_m[rows]) for key, rows in rows_of.items()}


def _prediction(path: Path, key: SequenceKey, frames: np.ndarray, positions_m: np.ndarray) -> SequencePrediction:
    numbers, order = np.unique(frames, return_index=True)
    if len(numbers) < len(frames):
        twice = next(number for number in numbers if np.sum(frames == number) > 1)
        raise ValueError(f"{path}: {'/'.join(key)} has frame {twice} twice")
    return SequencePrediction(numbers, positions_m[order])


def _array(arrays: dict[str, np.ndarray], name: str, n_rows: int) -> np.ndarray:
    if name not in arrays:
        raise ValueError(f"the array {name} is missing")
    if arrays[name].shape != (n_rows,):
        raise ValueError(f"{name} must be ({n_rows},), one for each pose, got {arrays[name].shape}")
    return arrays[name]


def _positions_m(arrays: dict[str, np.ndarray]) -> Float[np.ndarray, "frame joint 3"]:
    given = [name for name in _POSITIONS if name in arrays]
    if len(given) != 1:
        raise ValueError(f"one of the arrays positions_m and positions_mm is needed, there is {len(given)}")
    positions = arrays[given[0]]
    if positions.ndim != 3 or positions.shape[1:] != (N_JOINTS, 3) or positions.dtype.kind != "f":
        raise ValueError(
            f"{given[0]} must be ({N_JOINTS}, 3) numbers for each row, got {positions.shape} {positions.dtype}"
        )
    positions_m = positions.astype(float) * _POSITIONS[given[0]]
    if np.isinf(positions_m).any():
        raise ValueError(f"{given[0]} is infinite in row {np.argwhere(np.isinf(positions_m))[0][0]}")
    known_m = np.abs(positions_m[np.isfinite(positions_m)])
    if known_m.size and np.median(known_m) > _MAX_PLAUSIBLE_M:
        raise ValueError(f"a median coordinate is {np.median(known_m):.0f} m: name the array positions_mm")
    if "joints" not in arrays:
        return positions_m
    return in_skeleton_order(positions_m, list(texts(arrays, "joints")))


def _frames(arrays: dict[str, np.ndarray], n_rows: int) -> Int[np.ndarray, " frame"]:
    frames = _array(arrays, "frame", n_rows)
    if frames.dtype.kind not in "iu" or np.any(frames < 0):
        raise ValueError(f"frame must be whole numbers from 0, got {frames.dtype}")
    return frames.astype(int)


def _keys(arrays: dict[str, np.ndarray], n_rows: int) -> list[SequenceKey]:
    subjects, actions = _array(arrays, "subject", n_rows), _array(arrays, "action", n_rows)
    for name, array in (("subject", subjects), ("action", actions)):
        if array.dtype.kind not in "iuU":
            raise ValueError(f"{name} must be texts or whole numbers, got {array.dtype}")
    if subjects.dtype.kind in "iu":
        subjects = np.array([f"S{number}" for number in subjects.tolist()])
    if actions.dtype.kind in "iu":
        actions = np.array(_action_names(actions.tolist(), _array(arrays, "subaction", n_rows).tolist()))
    return list(zip(map(str, subjects.tolist()), map(str, actions.tolist()), strict=True))


def _action_names(numbers: list[int], subactions: list[int]) -> list[str]:
    unknown = sorted(set(numbers) - set(_ACTION_NUMBERS))
    if unknown:
        raise ValueError(f"action {unknown[0]} is none of 2 (Directions) to 16 (WalkingTogether)")
    return [f"{_ACTION_NUMBERS[number]}-{subaction}" for number, subaction in zip(numbers, subactions, strict=True)]
