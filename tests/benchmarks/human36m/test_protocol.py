"""The protocol of Human3.6M."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose_benchmarks.human36m.labels import PoseSequence, SequenceKey
from fgpose_benchmarks.human36m.predictions import SequencePrediction
from fgpose_benchmarks.human36m.protocol import ACTIONS, DAMAGED, evaluate, scored_frames, to_markdown
from tests.benchmarks.human36m.human36m_files import sequence


def predicted(
    sequences: list[PoseSequence], shift_m: dict[SequenceKey, float]
) -> dict[SequenceKey, SequencePrediction]:
    """The truth, moved as a whole by so much, and the left wrist once more by 34 mm."""
    predictions = {}
    for each in sequences:
        positions_m = each.truth_m + np.array([shift_m.get(each.key, 0.0), 0.0, 0.0])
        positions_m[:, 13, 1] += 0.034
        predictions[each.key] = SequencePrediction(each.frames, positions_m)
    return predictions


@pytest.fixture(scope="module")
def sequences() -> list[PoseSequence]:
    every = {("S9", "Eating-1"): 65, ("S9", "Eating-2"): 193, ("S11", "Eating-1"): 1, ("S9", "Greeting-1"): 64}
    return [sequence(*key, np.arange(length)) for key, length in (every | {("S9", "Greeting-2"): 64}).items()]


def test_every_64th_frame_is_scored(sequences: list[PoseSequence]):
    assert scored_frames(np.arange(200)).tolist() == [0, 64, 128, 192]
    score = evaluate(sequences, predicted(sequences, {}))
    # 2 + 4 + 1 frames of eating, 1 of greeting; the damaged one counts in relative errors alone
    assert (score.absolute.n_frames, score.relative.n_frames) == (8, 9)


def test_labels_of_every_fifth_frame_are_scored_every_65th():
    assert scored_frames(np.arange(0, 300, 5)).tolist() == [0, 13, 26, 39, 52]
    assert scored_frames(np.array([0, 64, 128])).tolist() == [0, 1, 2]
    assert scored_frames(np.array([], dtype=int)).tolist() == []
    with pytest.raises(ValueError, match="step must be at least 1, got 0"):
        scored_frames(np.arange(3), 0)


def test_errors_are_absolute_and_relative_to_the_pelvis(sequences: list[PoseSequence]):
    shift_m = {("S9", "Greeting-1"): 0.1}
    score = evaluate(sequences, predicted(sequences, shift_m))
    # 34 mm in one joint of 17 are 2 mm; beside 100 mm across they are sqrt(100^2 + 34^2)
    assert score.absolute.by_action_mm["Eating"] == pytest.approx(2.0)
    assert score.absolute.by_action_mm["Greeting"] == pytest.approx((16 * 100 + np.hypot(100, 34)) / 17)
    assert score.relative.by_action_mm["Greeting"] == pytest.approx(2.0)
    assert np.isnan(score.absolute.by_action_mm["Walking"])
    assert score.share_missing == 0


def test_sequences_with_damaged_truth_count_in_relative_errors_alone(sequences: list[PoseSequence]):
    assert sorted(DAMAGED) == [("S9", "Greeting-2"), ("S9", "SittingDown-2"), ("S9", "Waiting-1")]
    score = evaluate(sequences, predicted(sequences, {("S9", "Greeting-2"): 0.5}))
    assert score.absolute.by_action_mm["Greeting"] == pytest.approx(2.0)
    assert score.absolute.mean_mm == pytest.approx(2.0)
    of_s11 = [sequence("S11", "Greeting-2", np.arange(3))]
    damaged_elsewhere = evaluate(of_s11, predicted(of_s11, {("S11", "Greeting-2"): 0.5}))
    assert damaged_elsewhere.absolute.by_action_mm["Greeting"] > 500


def test_sub_actions_and_the_average_weigh_by_frames(sequences: list[PoseSequence]):
    shift_m = {("S9", "Eating-2"): 0.1}
    score = evaluate(sequences, predicted(sequences, shift_m))
    far = (16 * 100 + np.hypot(100, 34)) / 17
    assert score.absolute.by_action_mm["Eating"] == pytest.approx((4 * far + 3 * 2.0) / 7)
    assert score.absolute.mean_mm == pytest.approx((4 * far + 4 * 2.0) / 8)


def test_missing_predictions_are_refused_or_stated(sequences: list[PoseSequence]):
    predictions = predicted(sequences, {})
    del predictions["S9", "Greeting-1"]
    eating = predictions["S9", "Eating-2"]
    predictions["S9", "Eating-2"] = SequencePrediction(eating.frames[100:], eating.positions_m[100:])
    with pytest.raises(ValueError, match="S9/Eating-2 lacks 2 of 4 frames; S9/Greeting-1 lacks 1 of 1 frames"):
        evaluate(sequences, predictions)
    score = evaluate(sequences, predictions, allow_missing=True)
    assert score.share_missing == pytest.approx(3 / 9)
    assert score.absolute.mean_mm == pytest.approx(2.0)
    assert np.isnan(score.absolute.by_action_mm["Greeting"])
    with pytest.raises(ValueError, match="and 1 more sequences"):
        evaluate([*sequences, sequence("S11", "Posing-1", np.arange(2))], {})


def test_joints_that_a_method_does_not_give_are_stated(sequences: list[PoseSequence]):
    predictions = predicted(sequences, {})
    positions_m = predictions["S9", "Eating-1"].positions_m.copy()
    positions_m[0, 3] = np.nan
    predictions["S9", "Eating-1"] = SequencePrediction(np.arange(65), positions_m)
    assert evaluate(sequences, predictions).share_missing == pytest.approx(1 / (9 * 17))


def test_nothing_to_score_is_an_error():
    with pytest.raises(ValueError, match="no sequence to score"):
        evaluate([], {})


def test_methods_are_lines_and_actions_columns(sequences: list[PoseSequence]):
    scores = {
        "mine": evaluate(sequences, predicted(sequences, {})),
        "other": evaluate(sequences, predicted(sequences, {("S9", "Greeting-1"): 0.1})),
    }
    lines = to_markdown(scores).splitlines()
    tables = [line for line in lines if line.startswith("|")]
    assert len({line.count("|") for line in tables}) == 1
    assert tables[0].split(" | ")[1:16] == list(ACTIONS.values())
    assert [line.split(" | ")[0] for line in tables[2:4]] == ["| mine", "| other"]
    cells = tables[3].strip("| ").split(" | ")
    assert dict(zip(ACTIONS, cells[1:16], strict=True))["Greeting"] == "100.3"
    assert dict(zip(ACTIONS, cells[1:16], strict=True))["Walking"] == "–"
    assert cells[-2:] == ["8", "0.0"]
