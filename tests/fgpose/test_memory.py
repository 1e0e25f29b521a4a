"""Memory that a long recording takes: what each frame more adds, in what its observations take."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.observations import Observations
from fgpose.pipeline import load_source
from fgpose.skeleton import Skeleton

# Both are so long that what is done in parts has its largest memory in both.
SHORT, LONG = 6000, 12000


@pytest.fixture(scope="module")
def recording(rig: CameraRig, skeleton: Skeleton) -> Observations:
    """Somebody who moves a little."""
    rng = np.random.default_rng(0)
    body_m = rng.normal((0.0, 0.0, 1.0), (0.2, 0.2, 0.4), (skeleton.n_joints, 3))
    sway_m = 0.1 * np.sin(np.arange(LONG) / 60)[:, None, None]
    points2d_px = rig.project(body_m + sway_m)
    points2d_px += rng.normal(0, 2, points2d_px.shape)
    confidence = rng.uniform(0.6, 1.0, points2d_px.shape[:-1])
    return Observations(skeleton, np.arange(LONG) / 60, points2d_px, confidence, camera_names=rig.names)


def growth(work: Callable[[Observations], object], recording: Observations) -> float:
    """By how much the largest memory while this is done grows with each frame, over that of its observations."""
    peaks = []
    for n_frames in (SHORT, LONG):
        part = recording.first_frames(n_frames)
        tracemalloc.start()
        try:
            result = work(part)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        del result
    of_frame = recording.points2d_px[0].nbytes + recording.confidence[0].nbytes
    return (peaks[1] - peaks[0]) / (LONG - SHORT) / of_frame


def test_a_file_of_one_person_is_read_into_the_arrays_of_the_recording(
    recording: Observations, rig: CameraRig, tmp_path: Path
) -> None:
    """Arrays in single precision, as in the file, and those of the recording: 1.5. With an object for each image it
    were 6."""
    save_rig(rig, tmp_path / "rig.toml")
    for n_frames in (SHORT, LONG):
        save_observations(recording.first_frames(n_frames), tmp_path / f"{n_frames}.npz")
    skeleton = recording.skeleton

    def load(part: Observations) -> object:
        return load_source(tmp_path / f"{part.n_frames}.npz", tmp_path / "rig.toml", skeleton)

    assert growth(load, recording) < 2.0
