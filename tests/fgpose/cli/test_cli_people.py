"""Several people on the command line: everybody, one of them, and one in a region; from files to files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rrd_contents import entities, rows

from fgpose.assessment.people import evaluate_people
from fgpose.association.chosen_person import main_person
from fgpose.calibration.rig_refinement import refine_rig
from fgpose.cli import main, viewers
from fgpose.cli.commands import view
from fgpose.config import Config
from fgpose.io.calibration import load_rig, save_rig
from fgpose.io.keypoints import load_observations, load_people, save_observations, save_people_observations
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_origin, load_people_trajectories, load_trajectory, save_people
from fgpose.observations import Observations
from fgpose.people_observations import Detections
from fgpose.pipeline import Outputs, Source, run_smooth, run_track, write_outputs
from fgpose.tracking import Tracked, Tracker
from fgpose_benchmarks.synthetic import (
    CameraTimes,
    CrowdErrors,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
    walking,
)

FAST_CONFIG = Config(solver={"covariance": False}, online={"covariance": False, "lag_s": 0.2})
FAST = ["--solver.no-covariance", "--online.no-covariance"]
pytestmark = pytest.mark.usefixtures("without_search_for_faults")


def scene_of(n_people: int, times: CameraTimes | None = None) -> CrowdScene:
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a")]
    motion = crowd_motion(n_people, 60, 30.0, walks, works, seed=1)
    rig = ring_rig(3, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), 1, times)


@pytest.fixture(scope="module")
def scene() -> CrowdScene:
    return scene_of(2)


@pytest.fixture(scope="module")
def folder(scene: CrowdScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people for two seconds, as a user would have them."""
    folder = tmp_path_factory.mktemp("recording")
    save_rig(scene.rig, folder / "Calib.toml")
    save_people_observations(scene.observations, folder / "room.parquet")
    return folder


@pytest.fixture
def source(folder: Path) -> list[str]:
    return [str(folder / "room.parquet"), "--rig", str(folder / "Calib.toml"), "--skeleton", "h36m_17"]


def test_smooth_writes_everybody(
    scene: CrowdScene, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["smooth", *source, *FAST, "--formats", "parquet", "trc", "rrd", "-o", str(tmp_path)]) == 0
    people = load_people_trajectories(tmp_path / "room.parquet")
    time_s = scene.observations.frames.frame_time_s
    score = evaluate_people(people, scene.truth(time_s), time_s=time_s)
    # As smooth_people alone in its own tests.
    assert (score.n_identities, score.switches) == (2, 0)
    assert score.recall > 0.97
    assert score.mpjpe_mm < 40
    assert set(pq.read_table(tmp_path / "room.parquet")["person"].to_pylist()) == set(people)
    for person, trajectory in people.items():
        alone = load_trajectory(tmp_path / f"room_person{person}.trc")
        # TRC has a hundredth of a millimetre.
        np.testing.assert_allclose(alone.positions_m, trajectory.positions_m, atol=1e-5)
    assert (tmp_path / "room.rrd").stat().st_size > 10_000
    printed = capsys.readouterr().out
    for name in ("room.parquet", "room_person0.trc", "room_person1.trc", "room.rrd"):
        assert f"wrote {tmp_path / name}" in printed
    assert "detections belong to nobody" in printed
    assert "person 1 confirmed: " in printed


@pytest.mark.slow
def test_people_seen_by_late_cameras_are_written(scene: CrowdScene, tmp_path: Path) -> None:
    """Their frames have the mean time of their images, 5 ms after the stamps."""
    rig = scene.rig.with_time_offsets(np.array([0.0, 0.005, 0.01]))
    source = Source(rig, scene.observations.first_frames(20))
    for name, run in (("smoothed", run_smooth), ("online", run_track)):
        result = run(source, FAST_CONFIG)
        (path,) = write_outputs(result, Outputs(tmp_path, name, ("parquet",)))[-1:]
        for person, trajectory in load_people_trajectories(path).items():
            np.testing.assert_array_equal(trajectory.time_s, result.main[person].time_s)
            first = result.first_frame(trajectory)
            np.testing.assert_allclose(trajectory.time_s[0], source.observations.frame_time_s[first] + 0.005, atol=1e-9)


@pytest.mark.slow
def test_track_writes_the_newest_and_the_lagged(
    scene: CrowdScene, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["track", *source, *FAST, "--online.lag-s", "0.2", "--formats", "parquet", "-o", str(tmp_path)]
    assert main(arguments) == 0
    time_s = scene.observations.frames.frame_time_s
    for name in ("online", "smoothed"):
        people = load_people_trajectories(tmp_path / f"room_{name}.parquet")
        score = evaluate_people(people, scene.truth(time_s), time_s=time_s)
        assert score.precision > 0.97
        # Confirmed within 0.3 s of 2 s.
        assert score.recall > (0.8 if name == "online" else 0.7)
        assert score.switches == 0
    assert "ms" in capsys.readouterr().out


@pytest.mark.slow
def test_track_shows_every_update_live(source: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the file of a run that is interrupted tells: all updates before."""
    update, n_updates = Tracker.update, 0

    def interrupted(tracker: Tracker, images: list[Detections]) -> list[Tracked]:
        nonlocal n_updates
        n_updates += 1
        if n_updates > 20:
            raise KeyboardInterrupt
        return update(tracker, images)

    monkeypatch.setattr(Tracker, "update", interrupted)
    options = ["--people", "all", "--live", "--port", "0", "--formats", "rrd", "parquet", "-o", str(tmp_path)]
    assert main(["track", *source, *FAST, *options]) == 130
    path = tmp_path / "room_online.rrd"
    assert list(tmp_path.iterdir()) == [path]
    assert sorted(rows(path, "/plots/people", "Scalars:scalars")) == list(range(20))
    # Confirmed within 0.3 s, 9 frames.
    people = {f"/world/person_{person}/joints" for person in (0, 1)}
    for entity in people:
        shown = rows(path, entity, "Points3D:positions")
        assert sorted(shown) == list(range(min(shown), 20))
        assert min(shown) <= 9
    assert {entity for entity in entities(path) if entity.endswith("/joints")} == people


@pytest.mark.slow
def test_track_serves_what_it_has_shown_until_ctrl_c(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ctrl_c() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(viewers, "_sleep_forever", ctrl_c)
    options = ["--formats", "rrd", "parquet", "--frames", "30", "-o", str(tmp_path)]
    paths = []
    for name, more in (("live", ["--live", "--port", "0"]), ("afterwards", [])):
        assert main(["track", *source, *FAST, *options, "--name", name, *more]) == 0
        assert f"wrote {tmp_path / f'{name}_online.parquet'}" in capsys.readouterr().out
        paths.append(tmp_path / f"{name}_online.rrd")
    live_path, afterwards = paths
    assert entities(live_path) == entities(afterwards)
    for entity, component in (
        ("/world/person_1/joints", "Points3D:positions"),
        ("/world/camera/ring_1/image/detections", "Points2D:class_ids"),
        ("/plots/reprojection_px/person_0", "Scalars:scalars"),
        ("/events", "TextLog:text"),
    ):
        assert rows(live_path, entity, component) == rows(afterwards, entity, component)


def test_one_person_among_false_detections_has_the_files_of_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scene_of(1)
    assert scene.observations.n_most > 1, "detectors make people up"
    save_rig(scene.rig, tmp_path / "Calib.toml")
    save_people_observations(scene.observations, tmp_path / "room.parquet")
    arguments = ["smooth", str(tmp_path / "room.parquet"), "--rig", str(tmp_path / "Calib.toml")]
    out = tmp_path / "out"
    options = ["--skeleton", "h36m_17", *FAST, "--formats", "parquet", "trc", "-o", str(out)]
    assert main([*arguments, *options]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["room.parquet", "room.trc"]
    trajectory = load_trajectory(out / "room.parquet")
    (truth,) = scene.truth(trajectory.time_s).values()
    assert np.nanmean(np.linalg.norm(trajectory.positions_m - truth.positions_m, axis=-1)) < 0.04
    assert f"wrote {out / 'room.trc'}" in capsys.readouterr().out


@pytest.mark.slow
def test_track_of_less_than_the_lag_has_nothing_lagged(source: list[str], tmp_path: Path) -> None:
    arguments = ["track", *source, *FAST, "--online.lag-s", "1", "--frames", "20", "--formats", "parquet"]
    assert main([*arguments, "-o", str(tmp_path)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["room_online.parquet"]


@pytest.mark.parametrize(
    "wanted", [["--people", "1"], pytest.param(["--person-region", "ring_0:{box}"], marks=pytest.mark.slow)]
)
def test_one_of_them(scene: CrowdScene, source: list[str], tmp_path: Path, wanted: list[str]) -> None:
    first = scene.observations.by_camera["ring_0"][0].points2d_px
    boxes = [(*points_px.min(axis=0), *np.ptp(points_px, axis=0)) for points_px in first]
    box = ",".join(f"{value:.1f}" for value in boxes[-1])
    wanted = [each.format(box=box) for each in wanted]
    assert main(["smooth", *source, *FAST, *wanted, "--formats", "parquet", "-o", str(tmp_path)]) == 0
    trajectory = load_trajectory(tmp_path / "room.parquet")
    truth = scene.truth(trajectory.time_s)
    errors_m = [
        np.nanmean(np.linalg.norm(trajectory.positions_m - each.positions_m, axis=-1)) for each in truth.values()
    ]
    assert min(errors_m) < 0.04
    assert max(errors_m) > 0.4


@pytest.mark.slow
def test_the_region_says_who(scene: CrowdScene, folder: Path, source: list[str], tmp_path: Path) -> None:
    """Each person of the first image in turn."""
    first = scene.observations.by_camera["ring_0"][0].points2d_px
    found_m = []
    for number, points_px in enumerate(first):
        box = ",".join(f"{value:.1f}" for value in (*points_px.min(axis=0), *np.ptp(points_px, axis=0)))
        arguments = ["refine", *source, "--person-region", f"ring_0:{box}", "--frames", "20"]
        assert main([*arguments, "--formats", "parquet", "--name", f"{number}", "-o", str(tmp_path)]) == 0
        found_m.append(np.nanmean(load_trajectory(tmp_path / f"{number}.parquet").positions_m[0], axis=0))
    rig = load_rig(folder / "Calib.toml")
    for points_px, middle_m in zip(first, found_m, strict=True):
        middle_px = rig.project(middle_m[None])[0, 0]
        assert ((points_px.min(axis=0) < middle_px) & (middle_px < points_px.max(axis=0))).all()


def test_info_says_how_many_and_when(source: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", *source]) == 0
    printed = capsys.readouterr().out
    assert "person 0" in printed
    assert "person 1" in printed
    assert "person 2" not in printed
    assert "Of the person who is seen most; late and moved cameras by everybody:" in printed


@pytest.mark.slow
def test_evaluate_compares_everybody(
    scene: CrowdScene, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time_s = scene.observations.frames.frame_time_s
    save_people(scene.truth(time_s), tmp_path / "truth.parquet")
    assert main(["smooth", *source, *FAST, "--formats", "parquet", "-o", str(tmp_path)]) == 0
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "room.parquet"), str(tmp_path / "truth.parquet")]) == 0
    assert "IDF1" in capsys.readouterr().out


@pytest.mark.parametrize("with_rig", [False, True])
def test_view_opens_everybody(
    scene: CrowdScene, folder: Path, tmp_path: Path, with_rig: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_people(scene.truth(scene.observations.frames.frame_time_s), tmp_path / "truth.parquet")
    shown: list[set[str]] = []

    def run(command: list[str]) -> int:
        shown.append(entities(Path(command[1])))
        return 0

    monkeypatch.setattr(view, "run_program", run)
    options = ["--rig", str(folder / "Calib.toml")] if with_rig else []
    assert main(["view", str(tmp_path / "truth.parquet"), "--web", *options]) == 0
    assert {"/world/person_0/joints", "/world/person_1/joints"} <= shown[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["refine", "--people", "all"], "refine estimates one person"),
        (["smooth", "--people", "all", "--person-region", "ring_0:1,2,3,4"], "leave one of them out"),
        (["smooth", "--person-region", "ring_0:1,2,3"], "CAMERA:X,Y,W,H"),
        (["smooth", "--person-region", "ring_0:1,2,3,4"], "nobody is there in the first image of ring_0"),
        (["track", "--people", "all", "--frames", "0"], "--frames must be at least 1"),
    ],
)
def test_bad_input_is_one_clear_error(
    arguments: list[str], message: str, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([arguments[0], *source, *arguments[1:], "-o", str(tmp_path)]) == 2
    line = capsys.readouterr().err
    assert line.startswith("fgpose: error: ")
    assert message in line
    assert not list(tmp_path.iterdir())


def test_nobody_is_an_error_of_one_line(
    scene: CrowdScene, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = [
        replace(image, points2d_px=image.points2d_px[:0], confidence=image.confidence[:0], points3d_m=None)
        for image in scene.observations.images
    ]
    save_people_observations(replace(scene.observations, images=tuple(empty)), tmp_path / "empty.parquet")
    arguments = ["smooth", str(tmp_path / "empty.parquet"), "--rig", str(folder / "Calib.toml")]
    assert main([*arguments, "--skeleton", "h36m_17", "--people", "all", "-o", str(tmp_path / "out")]) == 2
    assert "no camera shows anybody in any image" in capsys.readouterr().err


@pytest.mark.slow
def test_cameras_of_different_rates_keep_their_times(tmp_path: Path) -> None:
    scene = scene_of(2, CameraTimes(fps=(25.0, 30.0), random_phases=True))
    save_people_observations(scene.observations, tmp_path / "room.npz")
    people = load_people(tmp_path / "room.npz", scene.rig, scene.motion.skeleton)
    source = Source(scene.rig, people)
    for run in (run_smooth, run_track):
        result = run(source, FAST_CONFIG)
        frames_s = result.frame_time_s
        for trajectory in result.main.values():
            first = result.first_frame(trajectory)
            np.testing.assert_array_equal(trajectory.time_s, frames_s[first : first + trajectory.n_frames])
        score = evaluate_people(result.main, scene.truth(frames_s), time_s=frames_s)
        assert score.switches == 0
        assert score.mpjpe_mm < 50


def test_cameras_are_calibrated_on_everybody(
    scene: CrowdScene, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The calibration that is written is the one that everybody was estimated with."""
    options = ["--refine-calibration", *FAST, "--frames", "30", "--formats", "parquet", "-o", str(tmp_path)]
    assert main(["smooth", *source, *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "turned by [deg]" in printed
    assert "% of the joints in a camera, at most, belong to somebody else" in printed
    assert {path.name for path in tmp_path.iterdir()} == {"room.parquet", "room_calibration.toml"}
    observations = scene.observations.first_frames(30)
    refined, alone = (
        refine_rig(observations, scene.rig),
        refine_rig(observations.of_person(main_person(observations, scene.rig).seen), scene.rig),
    )
    written = load_rig(tmp_path / "room_calibration.toml").projection_matrices
    # The file has 15 digits of a rotation vector, the table of keypoints 32 bits of a pixel.
    np.testing.assert_allclose(written, refined.rig.projection_matrices, rtol=1e-4, atol=1e-2)
    assert np.abs(written - alone.rig.projection_matrices).max() > 0.1
    assert set(load_people_trajectories(tmp_path / "room.parquet")) == {0, 1}


@pytest.mark.parametrize("command", ["smooth", "track", "run"])
def test_help_says_on_whom_cameras_are_calibrated(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert printed.count("all people together") == 2


def relay(folder: Path) -> list[str]:
    """An adult for 2 s, nobody for 1 s, and a child for 1.5 s, at 15 Hz; how to read it."""
    rig, skeleton, fps = ring_rig(), load_skeleton("h36m_17"), 15.0
    adult_m = walking(30, fps, skeleton) - [0.0, 1.0, 0.0]
    child_m = 0.6 * walking(22, fps, skeleton) + [0.0, 1.0, 0.0]
    motion_m = np.concatenate([adult_m, np.full((15, *adult_m.shape[1:]), np.nan), child_m])
    points2d_px = rig.project(motion_m) + np.random.default_rng(0).normal(scale=3, size=(len(motion_m), 4, 17, 2))
    time_s = np.arange(len(motion_m)) / fps
    save_observations(Observations(skeleton, time_s, points2d_px, camera_names=rig.names), folder / "relay.npz")
    save_rig(rig, folder / "Calib.toml")
    return [str(folder / "relay.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "h36m_17", *FAST]


def test_somebody_who_comes_after_somebody_else_is_another_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = ["--formats", "parquet", "-o", str(tmp_path)]
    source = relay(tmp_path)
    assert main(["smooth", *source, *wanted, "--name", "auto"]) == 0
    printed = capsys.readouterr().out
    assert "No image shows more than one person, but who comes at 3.0 s" in printed
    assert "is somebody else" in printed
    adult, child = load_people_trajectories(tmp_path / "auto.parquet").values()
    assert adult.bone_lengths_m is not None
    assert child.bone_lengths_m is not None
    # Errors of detections make bones of some centimetres longer by up to a tenth.
    np.testing.assert_allclose(np.nansum(child.bone_lengths_m), 0.6 * np.nansum(adult.bone_lengths_m), rtol=0.1)
    assert main(["smooth", *source, *wanted, "--name", "one", "--people", "1"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("one of 2 people: seen most, by 4.0 of 4 cameras for 2.0 s; the next by 4.0 for 1.5 s.") == 1
    # as a finding says it, the table need not
    assert "The person is in no image in 55 % of the time: 2.0 to 4.5 s" in printed
    assert "frames are empty" not in printed
    one = load_trajectory(tmp_path / "one.parquet")
    np.testing.assert_array_equal(np.flatnonzero(~one.absent), np.arange(30))
    origin = load_origin(tmp_path / "one.parquet")
    assert origin is not None
    assert origin.chosen.startswith("one of 2 people: seen most")


def test_a_frame_of_garbage_is_left_out_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, skeleton = ring_rig(), load_skeleton("h36m_17")
    points2d_px = rig.project(walking(30, 15.0, skeleton))
    points2d_px[20] *= 1e6
    seen = Observations(skeleton, np.arange(30) / 15.0, points2d_px, camera_names=rig.names)
    save_observations(seen, tmp_path / "walk.npz")
    save_rig(rig, tmp_path / "Calib.toml")
    source = [str(tmp_path / "walk.npz"), "--rig", str(tmp_path / "Calib.toml"), "--skeleton", "h36m_17", *FAST]
    for command, result in (("track", "walk_online"), ("smooth", "walk")):
        assert main([command, *source, "--formats", "parquet", "-o", str(tmp_path / command)]) == 0
        printed = capsys.readouterr().out
        assert "Left out, because the detections make no body: 1 of 30 frames: frame 20 at 1.33 s" in printed
        assert load_trajectory(tmp_path / command / f"{result}.parquet").implausible_frames == (20,)


def test_keypoints_of_one_person_warn_of_another(tmp_path: Path) -> None:
    relay(tmp_path)
    rig, path = load_rig(tmp_path / "Calib.toml"), tmp_path / "people.npz"
    save_people_observations(load_people(tmp_path / "relay.npz", rig, "h36m_17"), path)
    with pytest.warns(UserWarning, match="2 people come one after the other; this is one of 2 people: seen most"):
        seen = load_observations(path, rig, "h36m_17")
    assert seen.seen[:30].any()
    assert not seen.seen[30:].any()
