"""Random recordings: the same at each call, with errors that are what their conditions say, and their report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tyro

from fgpose_benchmarks.accuracy.methods import find_methods
from fgpose_benchmarks.cli.benchmark import Benchmark
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.comparison.scores import Score, load_scores
from fgpose_benchmarks.people.scores import PeopleScore
from fgpose_benchmarks.random_recordings import crowds, scene
from fgpose_benchmarks.random_recordings.benchmark import ONE_PERSON
from fgpose_benchmarks.random_recordings.conditions import Conditions, draw
from fgpose_benchmarks.random_recordings.crowds import draw_crowd, record_crowd
from fgpose_benchmarks.random_recordings.errors import switching
from fgpose_benchmarks.random_recordings.recording import LEAST_TOLD, record, recordings, share_told

HOPELESS = 40  # two cameras, of which one sees nothing

SIMPLE = replace(
    draw(0),
    n_cameras=4,
    size_px=(1920, 1080),
    radius_m=4.5,
    turned_deg=0.0,
    moved_m=0.0,
    zoomed=0.0,
    late_s=0.0,
    sigma_m=0.006,
    heavy_tails=False,
    bias_m=0.0,
    body_m=0.0,
    hidden="nothing",
    swapped_s=0.0,
    outlier_share=0.0,
    stride_px=0.0,
    dropped_share=0.0,
    outside_are="missing",
    confidence="of the error",
    views3d="none",
)


def errors_px(recording: BenchmarkRecording) -> np.ndarray:
    undistorted_px = recording.true_rig.undistort(recording.observations.points2d_px)
    return np.linalg.norm(undistorted_px - recording.true_rig.project(recording.truth_m), axis=-1)


def test_a_recording_is_the_same_at_each_call() -> None:
    first, again = (record(draw(7)) for _ in range(2))
    for name in ("points2d_px", "confidence", "points3d_m"):
        np.testing.assert_array_equal(getattr(first.observations, name), getattr(again.observations, name))
    assert first.rig.positions_m.tolist() == again.rig.positions_m.tolist()


def test_both_solvers_of_the_online_window_run() -> None:
    assert {"fgpose online, lag 0.2 s", "fgpose online by window, lag 0.2 s"} <= set(ONE_PERSON.names)
    find_methods(ONE_PERSON.names, ONE_PERSON.methods)


def test_seeds_differ_in_every_condition() -> None:
    drawn = [draw(seed) for seed in range(60)]
    for name in vars(drawn[0]):
        assert len({getattr(conditions, name) for conditions in drawn}) > 1, name


def test_without_anything_wrong_detections_are_off_by_their_deviation_alone() -> None:
    recording = record(SIMPLE)
    assert recording.sigma_px is not None
    sigma_m = errors_px(recording) / recording.true_rig.px_per_m(recording.truth_m)
    # Each joint has its own deviation, exp(N(0, 0.4)) times as much; the mean length of a normal vector is 1.25 sigma.
    assert np.nanmean(sigma_m) == pytest.approx(1.25 * 0.006 * np.exp(0.08), rel=0.3)  # of 17 joints: 10 %
    # Of a mixture the root mean square is larger than the median tells: exp(0.16).
    assert recording.sigma_px == pytest.approx(np.sqrt(np.nanmean(errors_px(recording) ** 2) / 2), rel=0.3)


@pytest.mark.parametrize("changes", [{"turned_deg": 0.3}, {"moved_m": 0.015}, {"zoomed": 0.015}], ids=str)
def test_a_rig_is_wrong_about_a_mean_that_is_right(changes: dict[str, Any]) -> None:
    recording = record(replace(SIMPLE, **changes))
    true, believed = recording.true_rig, recording.rig
    off_px = believed.project(recording.truth_m) - true.project(recording.truth_m)
    assert np.nanmedian(np.abs(off_px)) > 0.5
    middle_m = np.array([0.0, 0.0, 1.0, 1.0])
    moved = [
        c.world_T_camera @ t.camera_T_world @ middle_m for c, t in zip(believed.cameras, true.cameras, strict=True)
    ]
    np.testing.assert_allclose(np.mean(moved, axis=0), middle_m, atol=1e-3)  # second order in 15 mm and 0.3 degrees


def test_late_cameras_are_on_time_on_average() -> None:
    recording = record(replace(SIMPLE, late_s=0.02))
    assert abs(recording.true_offsets_s.mean()) < 1e-12
    assert np.abs(recording.true_offsets_s).max() > 0.005


@pytest.mark.parametrize("what", ["adrift", "frozen", "towards the body", "in the background", "missing"])
def test_what_is_hidden_is_wrong_or_missing(what: str) -> None:
    conditions: Conditions = replace(SIMPLE, hidden="whole body", hidden_are=what, hidden_s=1.0, visible_s=1.0)
    recording = record(conditions)
    hidden, error_px = recording.occluded, errors_px(recording)
    assert 0.2 < hidden.mean() < 0.8
    if what == "missing":
        assert np.isnan(error_px[hidden]).all()
    else:
        assert np.nanmedian(error_px[hidden]) > 3 * np.nanmedian(error_px[~hidden])
    assert recording.oracle_observations is not None
    assert not (recording.oracle_observations.seen & hidden).any()


@pytest.mark.parametrize(
    ("what", "joints"),
    [
        ("legs", {"left_hip", "left_knee", "left_ankle", "right_hip", "right_knee", "right_ankle"}),
        ("arms", {"left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist"}),
        ("both legs on one", {"right_hip", "right_knee", "right_ankle"}),
    ],
)
def test_sides_that_are_taken_for_each_other(what: str, joints: set[str]) -> None:
    recording = record(replace(SIMPLE, swapped_s=2.0, swapped_are=what))
    plain, skeleton = record(SIMPLE), recording.observations.skeleton
    usual_px = np.nanmedian(errors_px(plain), axis=(0, 1))
    off = np.nanmax(errors_px(recording), axis=(0, 1)) > 10 * usual_px
    assert {skeleton.joints[joint] for joint in np.flatnonzero(off)} == joints


def test_hidden_and_visible_last_as_long_as_they_should() -> None:
    on = switching(np.random.default_rng(0), (20000, 20), fps=50.0, on_s=0.3, off_s=1.0)
    assert on.mean() == pytest.approx(0.3 / 1.3, rel=0.05)
    starts = np.sum(on[1:] & ~on[:-1])
    assert on.sum() / starts / 50.0 == pytest.approx(0.3, rel=0.05)  # 6,000 periods


def test_what_nobody_could_tell_is_left_out() -> None:
    assert share_told(record(draw(HOPELESS))) < LEAST_TOLD
    assert [each.clip for each in recordings([HOPELESS, 7])] == ["0007"]


def test_from_arguments_to_the_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(scene, "_MAX_FRAMES", 15)
    arguments = ["random", "--first", "5", "--recordings", "2", "--workers", "0", "-o", str(tmp_path)]
    methods = ("MSAC by confidence, 6 Hz", "fgpose batch", "oracle")
    tyro.cli(Benchmark, args=Benchmark.completed([*arguments, "--methods", *methods])).run()
    scores = load_scores(tmp_path / "scores.json", Score)
    assert {(score.clip, score.method) for score in scores} == {(c, m) for c in ("0005", "0006") for m in methods}
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| oracle | " in report
    assert draw(6).unusual() in report


@pytest.mark.parametrize("option", ["--recordings=0", "--first=-1", "--workers=-1"])
def test_impossible_numbers_are_named(option: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=option.split("=")[0]):
        tyro.cli(Benchmark, args=["random", option, "-o", str(tmp_path)]).run()


def test_crowds_are_the_same_at_each_call_and_have_the_errors_that_were_drawn() -> None:
    conditions = replace(draw_crowd(3), n_people=2, duration_s=2.0)
    errors = replace(conditions.errors, grabbed_share=0.0, flipped_share=0.0, min_visible_joints=1)
    conditions = replace(conditions, errors=errors)
    simple = replace(SIMPLE, radius_m=5.5, n_cameras=4, sigma_m=0.02)
    first, again = (record_crowd(replace(conditions, detector=simple)) for _ in range(2))
    exact = record_crowd(replace(conditions, detector=replace(simple, sigma_m=0.0)))
    off_m = []
    for image, same, right, hidden in zip(
        first.observations.images, again.observations.images, exact.observations.images, first.scene.hidden, strict=True
    ):
        np.testing.assert_array_equal(image.points2d_px, same.points2d_px)
        camera = first.rig.cameras[first.rig.names.index(image.camera)]
        off_m.append((image.points2d_px - right.points2d_px)[~hidden] / camera.K[0, 0] * 5.5)
    # Each joint its own 0.4 to 2.5 times as much, and people up to a third nearer or farther than the ring is wide.
    assert 0.01 < np.nanmedian(np.abs(np.concatenate(off_m))) / 0.6745 < 0.04


def test_several_people_from_arguments_to_the_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(crowds._CROWD, "duration_s", (1.0,))
    arguments = ["random", "--people", "--first", "5", "--recordings", "1", "--workers", "0", "-o", str(tmp_path)]
    tyro.cli(Benchmark, args=Benchmark.completed([*arguments, "--methods", "greedy triangulation"])).run()
    (score,) = load_scores(tmp_path / "scores.json", PeopleScore)
    assert (score.clip, score.n_people) == ("0005", draw_crowd(5).n_people)
    assert "| greedy triangulation | " in (tmp_path / "report.md").read_text(encoding="utf-8")
