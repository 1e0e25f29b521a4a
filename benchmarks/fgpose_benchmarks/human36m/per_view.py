"""Poses of each camera alone for Human3.6M, as files, and the poses that fgpose estimates from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from fgpose.config import Config
from fgpose.estimation.evidence.fusion import fuse
from fgpose.estimation.refinement import refine
from fgpose.estimation.smoother import smooth
from fgpose.io.keypoints import load_observations
from fgpose.observations import Observations
from fgpose.plain_files import naming
from fgpose_benchmarks.human36m.labels import FPS, SKELETON, PoseSequence, SequenceKey
from fgpose_benchmarks.human36m.predictions import SequencePrediction

Estimation = Literal["smooth", "refine", "fuse"]
# Single precision keeps an hour of frame times to a hundredth of a frame.
_MAX_FRAME_FRACTION = 0.02


def load_views(folder: str | Path, sequences: Iterable[PoseSequence]) -> dict[SequenceKey, Observations]:
    """Per-view predictions of these sequences: a recording of fgpose for each, SUBJECT/ACTION.npz.

    It is the npz of fgpose.files.save_observations: time_s (T,), the number of each frame in the 50 Hz video from 0,
    divided by 50; points2d_px (T, C, 17, 2) in pixels of the original image, NaN = none; confidence (T, C, 17) in
    [0, 1]; points3d_m (T, C, 17, 3), if there are any, in the world frame, metres; camera_names (C,), as 54138969;
    joints (17,), the names of h36m_17 in its order. Any frames will do, all of the video or only those that are scored.

    Raises:
        ValueError: a file is damaged, of another skeleton or other cameras, or a time is that of no frame; the message
            names the file.
        OSError: a file is missing or cannot be read.
    """
    views = {}
    for sequence in sequences:
        path = Path(folder) / sequence.subject / f"{sequence.action}.npz"
        observations = load_observations(path, sequence.rig, SKELETON)
        with naming(path):
            frame_numbers(observations)
        views[sequence.key] = observations
    return views


def frame_numbers(observations: Observations) -> np.ndarray:
    """(T,) numbers of the frames in the 50 Hz video.

    Raises:
        ValueError: a time lies between two frames.
    """
    position = observations.frame_time_s * FPS
    frames = np.round(position).astype(int)
    between = np.flatnonzero((np.abs(position - frames) > _MAX_FRAME_FRACTION) | (frames < 0))
    if between.size:
        time_s = observations.frame_time_s[between[0]]
        raise ValueError(f"time_s must be the number of a 50 Hz frame divided by 50, got {time_s:g} s")
    return frames


def estimate(
    sequences: Sequence[PoseSequence],
    views: Mapping[SequenceKey, Observations],
    estimation: Estimation = "smooth",
    config: Config | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[SequenceKey, SequencePrediction]:
    """What fgpose makes of the views: smooth the whole motion, refine each frame by the paper's method, fuse eq. 1-2.

    Args:
        sequences: those wanted, for their cameras.
        views: see load_views.
        estimation: which of the three.
        config: parameters; the defaults without.
        progress: called with the number of sequences done and of all.
    """
    config = (config or Config()).replace(solver={"covariance": False})
    predictions = {}
    for number, sequence in enumerate(sequences):
        observations = views[sequence.key]
        match estimation:
            case "smooth":
                positions_m = smooth(observations, sequence.rig, config).positions_m
            case "refine":
                positions_m = refine(observations, sequence.rig, config).positions_m
            case "fuse":
                positions_m = fuse(observations, sequence.rig, config).positions_m
        predictions[sequence.key] = SequencePrediction(frame_numbers(observations), positions_m)
        progress(number + 1, len(sequences))
    return predictions
