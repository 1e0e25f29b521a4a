"""Memory that a long recording takes: what each frame more adds, in what its observations take."""

from __future__ import annotations

import tracemalloc
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from fgpose.config import Config
from fgpose.diagnosis.camera_checks import few_cameras
from fgpose.diagnosis.clock_checks import late_cameras
from fgpose.diagnosis.finished import FinishedRecording
from fgpose.diagnosis.motion_checks import perhaps_same
from fgpose.estimation import smoother
from fgpose.estimation.evidence import gathered
from fgpose.estimation.evidence.credibility import credible
from fgpose.estimation.segment import Segment
from fgpose.estimation.solution import Solution
from fgpose.geometry.camera import CameraRig
from fgpose.io.calibration import save_rig
from fgpose.io.keypoints import save_observations
from fgpose.observations import Observations
from fgpose.pipeline import load_source, run_smooth, show
from fgpose.pipeline.source import Source
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Status, Trajectory
from fgpose.viewer import Recording

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


@pytest.mark.slow
def test_a_file_of_one_person_is_read_into_the_arrays_of_the_recording(
    recording: Observations, rig: CameraRig, tmp_path: Path
) -> None:
    """Arrays in single precision, as in the file, and those of the recording: 1.0. With an object for each image it
    were 6."""
    save_rig(rig, tmp_path / "rig.toml")
    for n_frames in (SHORT, LONG):
        save_observations(recording.first_frames(n_frames), tmp_path / f"{n_frames}.npz")
    skeleton = recording.skeleton

    def load(part: Observations) -> object:
        return load_source(tmp_path / f"{part.n_frames}.npz", tmp_path / "rig.toml", skeleton)

    assert growth(load, recording) < 1.3


@pytest.mark.slow
def test_evidence_of_a_long_recording_is_made_where_it_is_needed(
    recording: Observations, rig: CameraRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is needed of all frames (guesses, credibilities), and sums of the confidences."""
    monkeypatch.setattr(gathered, "LONG_FRAMES", SHORT - 1)
    assert growth(lambda part: gathered.gather_long(part, rig, Config()), recording) < 1.0


@pytest.mark.slow
def test_the_smoother_keeps_its_result_and_little_else(
    recording: Observations, rig: CameraRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A result takes the observations once, much of it covariances; the rest is first guesses."""
    monkeypatch.setattr(gathered, "LONG_FRAMES", SHORT - 1)
    monkeypatch.setattr(smoother, "_solve", first_guess)

    def smoothed(part: Observations) -> object:
        return smoother.smooth(part, rig, unfinished=tmp_path / str(part.n_frames))

    assert growth(smoothed, recording) < 3.0


@pytest.mark.slow
def test_of_residuals_that_the_viewer_shows_the_others_are_not_kept(
    recording: Observations, rig: CameraRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one frame in twenty, of eight factors: 0.03. With those of all frames it were 0.55."""
    monkeypatch.setattr(gathered, "LONG_FRAMES", SHORT - 1)
    monkeypatch.setattr(smoother, "_solve", first_guess)
    results = {
        n_frames: run_smooth(Source(rig, recording.first_frames(n_frames)), Config(), compare=20)
        for n_frames in (SHORT, LONG)
    }
    viewers = {n_frames: Mock(spec=Recording) for n_frames in results}
    assert growth(lambda part: show(results[part.n_frames], viewers[part.n_frames]), recording) < 0.1
    for n_frames, viewer in viewers.items():
        _, residuals, every = viewer.log_residuals.call_args.args
        assert {len(of_factor) * every for of_factor in residuals.values()} == {n_frames}


def first_guess(segment: Segment) -> Solution:
    """In place of the optimum: what it takes to find that depends on the window, not on the recording."""
    nobody = Solution.of_nobody(segment)
    covariance_m2 = np.broadcast_to(1e-4 * np.eye(3), (*segment.active.shape, 3, 3)).copy()
    return replace(nobody, positions_m=segment.evidence.guess_m, covariance_m2=covariance_m2)


def test_what_is_usual_of_confidences_is_asked_for_without_copies_of_all(recording: Observations) -> None:
    """A copy of the confidences, 0.33, or what is said of each joint, with sums of one camera and the result, 0.36.
    With the places of all confidences and the sums of all cameras it were 1.0."""
    assert growth(lambda part: credible(part.confidence, part.time_s), recording) < 0.5


def test_a_recording_that_was_looked_at_is_not_kept(recording: Observations, rig: CameraRig) -> None:
    shape = 10, recording.skeleton.n_joints
    somebody = Trajectory(recording.skeleton, np.arange(10.0), np.zeros((*shape, 3)), np.full(shape, Status.OBSERVED))
    finished = FinishedRecording("walk", {0: somebody}, rig)
    assert late_cameras(finished) == []
    looked_at = weakref.ref(finished)
    del finished
    assert looked_at() is None


def test_how_far_cameras_are_apart_is_told_by_some_frames(recording: Observations, rig: CameraRig) -> None:
    joints = (LONG, recording.skeleton.n_joints)
    body_m = np.random.default_rng(0).normal(0.0, 0.3, (*joints, 3))
    whole = Trajectory(recording.skeleton, recording.frame_time_s, body_m, np.full(joints, Status.OBSERVED))

    def work(part: Observations) -> object:
        return few_cameras(FinishedRecording("walk", {0: whole.frames(slice(0, part.n_frames))}, rig))

    # The positions of one person of four cameras take half as much as their detections do, and are not copied.
    assert growth(work, recording) < 0.05


def test_of_one_person_nobody_is_looked_for_who_may_be_the_same(recording: Observations, rig: CameraRig) -> None:
    """Of several people the places of all frames would take as much as the observations."""
    joints = (LONG, recording.skeleton.n_joints)
    body_m = np.random.default_rng(0).normal(0.0, 0.3, (*joints, 3))
    whole = Trajectory(recording.skeleton, recording.frame_time_s, body_m, np.full(joints, Status.OBSERVED))

    def work(part: Observations) -> object:
        return perhaps_same(FinishedRecording("walk", {0: whole.frames(slice(0, part.n_frames))}, rig))

    assert growth(work, recording) < 0.15
