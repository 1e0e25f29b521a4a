"""The protocol of Human3.6M: S9 and S11, every 64th frame, absolute and relative errors, one number for each action."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.metrics import joint_errors_m, mean_known, share_missing
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.human36m.labels import N_JOINTS, SKELETON, PoseSequence, SequenceKey
from fgpose_benchmarks.human36m.predictions import Predictions, SequencePrediction

# Of the field's protocol: every 64th frame of the 50 Hz videos.
STEP = 64
DAMAGED: frozenset[SequenceKey] = frozenset({("S9", "Greeting-2"), ("S9", "SittingDown-2"), ("S9", "Waiting-1")})
"""Sequences in which parts of the truth are shifted against the images: left out of absolute errors. The list is that
of Iskakov et al. (2019), with_damaged_actions in their human36m.py."""

ACTIONS = {
    "Directions": "Dir.",
    "Discussion": "Disc.",
    "Eating": "Eat",
    "Greeting": "Greet",
    "Phoning": "Phone",
    "TakingPhoto": "Photo",
    "Posing": "Pose",
    "Purchases": "Purch.",
    "Sitting": "Sit",
    "SittingDown": "SitD.",
    "Smoking": "Smoke",
    "Waiting": "Wait",
    "WalkingDog": "WalkD.",
    "Walking": "Walk",
    "WalkingTogether": "WalkT.",
}
"""Names of the actions and their headings, in the order of the field's tables."""

_MAX_NAMED = 5  # more names would make the message unreadable


@dataclass(frozen=True)
class ActionErrors:
    """One line of a table of the field, mm; NaN for an action without a frame."""

    by_action_mm: Mapping[str, float]
    """MPJPE over the frames of all subjects in both sub-actions."""
    mean_mm: float
    """MPJPE over all frames, so that long actions count more, as Iskakov et al. (2019) average."""
    n_frames: int


@dataclass(frozen=True)
class ProtocolScore:
    """How good one method is."""

    absolute: ActionErrors
    """Without the sequences whose truth is damaged."""
    relative: ActionErrors
    """Pelvis aligned (joint 0)."""
    share_missing: float
    """Share of the joints to be scored that the method does not give; no mean contains them."""


def evaluate(
    sequences: Iterable[PoseSequence], predictions: Predictions, *, step: int = STEP, allow_missing: bool = False
) -> ProtocolScore:
    """Score predictions by the protocol.

    Args:
        sequences: those to be scored, see load_labels and load_annotations.
        predictions: by subject and action. Other frames are ignored.
        step: score every so many frames, see scored_frames.
        allow_missing: score the frames that are there, and state how much is missing. By default no frame may be
            missing, but joints may be NaN.

    Raises:
        ValueError: there is nothing to score, or predictions lack a sequence or a frame.
    """
    absolute, relative, missing = [], [], []
    lacking: list[str] = []
    for sequence in sequences:
        scored = scored_frames(sequence.frames, step)
        positions_m, n_lacking = _predicted_m(predictions.get(sequence.key), sequence.frames[scored])
        if n_lacking:
            lacking.append(f"{sequence.name} lacks {n_lacking} of {len(scored)} frames")
        truth_m = sequence.truth_m[scored]
        errors_mm = 1000 * joint_errors_m(positions_m, truth_m)
        if sequence.key not in DAMAGED:
            absolute.append((sequence.action, errors_mm))
        root = load_skeleton(SKELETON).root
        relative.append((sequence.action, 1000 * joint_errors_m(positions_m, truth_m, root)))
        missing.append(errors_mm)
    if not missing:
        raise ValueError("there is no sequence to score")
    if lacking and not allow_missing:
        more = f" and {len(lacking) - _MAX_NAMED} more sequences" if len(lacking) > _MAX_NAMED else ""
        raise ValueError(f"predictions are missing: {'; '.join(lacking[:_MAX_NAMED])}{more}")
    return ProtocolScore(_by_action(absolute), _by_action(relative), share_missing(np.concatenate(missing)))


def scored_frames(frames: Int[np.ndarray, " frame"], step: int = STEP) -> Int[np.ndarray, " scored"]:
    """Indices of the labelled frames to be scored: the first, then each that is at least step after the one before.

    Of all frames that is every 64th. Labels that have only every 5th, as those of Learnable Triangulation do, give
    every 65th, which is what their retain_every_n_frames_in_test of 13 takes.

    Raises:
        ValueError: step is not positive.
    """
    if step < 1:
        raise ValueError(f"step must be at least 1, got {step}")
    scored: list[int] = []
    for index, frame in enumerate(frames.tolist()):
        if not scored or frame >= frames[scored[-1]] + step:
            scored.append(index)
    return np.array(scored, dtype=int)


def _predicted_m(
    prediction: SequencePrediction | None, frames: Int[np.ndarray, " frame"]
) -> tuple[Float[np.ndarray, "frame joint 3"], int]:
    """The poses in these frames, NaN where there is none, and how many there are not."""
    positions_m = np.full((len(frames), N_JOINTS, 3), np.nan)
    if prediction is None:
        return positions_m, len(frames)
    _, here, there = np.intersect1d(frames, prediction.frames, assume_unique=True, return_indices=True)
    positions_m[here] = prediction.positions_m[there]
    return positions_m, len(frames) - len(here)


def _by_action(errors_mm: Sequence[tuple[str, np.ndarray]]) -> ActionErrors:
    """From the (T, J) errors of each sequence, under the name of its action."""

    def mean(chosen: Iterable[np.ndarray]) -> float:
        return float(mean_known(np.concatenate([np.zeros((0, N_JOINTS)), *chosen])))

    return ActionErrors(
        {action: mean(each for name, each in errors_mm if without_number(name) == action) for action in ACTIONS},
        mean(each for _, each in errors_mm),
        sum(len(each) for _, each in errors_mm),
    )


def without_number(action: str) -> str:
    """Name of an action without the number of the sub-action: Greeting-2 is Greeting."""
    return action.rpartition("-")[0] or action


def to_markdown(scores: Mapping[str, ProtocolScore]) -> str:
    """The two tables of the field, one line for each method, mm."""
    damaged = ", ".join(sorted(action for _, action in DAMAGED))
    return "\n".join(
        [
            f"### Human3.6M, absolute MPJPE [mm], without S9 {damaged}",
            "",
            *_table({name: score.absolute for name, score in scores.items()}, scores),
            "",
            "### Human3.6M, MPJPE relative to the pelvis [mm]",
            "",
            *_table({name: score.relative for name, score in scores.items()}, scores),
            "",
        ]
    )


def _table(lines: Mapping[str, ActionErrors], scores: Mapping[str, ProtocolScore]) -> Iterable[str]:
    headings = ("Method", *ACTIONS.values(), "Avg", "frames", "missing [%]")
    yield f"| {' | '.join(headings)} |"
    yield f"|:--|{'--:|' * (len(headings) - 1)}"
    for name, errors in lines.items():
        numbers = (*errors.by_action_mm.values(), errors.mean_mm)
        cells = (
            *(_cell(number) for number in numbers),
            str(errors.n_frames),
            f"{100 * scores[name].share_missing:.1f}",
        )
        yield f"| {name} | {' | '.join(cells)} |"


def _cell(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.1f}"
