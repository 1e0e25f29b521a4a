from __future__ import annotations

import errno
import itertools
import json
import os
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rrd_contents import rows
from scipy.interpolate import CubicSpline

from fgpose.assessment.recording_info import recording_info
from fgpose.cli import app, delivery, main, viewers
from fgpose.cli.calibration import calibrated
from fgpose.cli.commands import estimators, view
from fgpose.cli.commands.info import print_info
from fgpose.cli.console import new_console, new_table
from fgpose.cli.live_consumers import Consumers, LiveOutputs
from fgpose.cli.viewers import warn_if_others_reach
from fgpose.config import Config
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.io.calibration import load_calibration_origin, load_rig, save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.origin import Origin
from fgpose.io.recordings import load_recording
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.live.clock import Clock
from fgpose.pipeline import Outputs, Source
from fgpose_benchmarks.synthetic import Scene

pytestmark = pytest.mark.usefixtures("without_search_for_faults")
COMMANDS = (
    "demo",
    "calibrate",
    "run",
    "study",
    "detect",
    "synchronise",
    "smooth",
    "track",
    "refine",
    "info",
    "angles",
    "evaluate",
    "view",
    "models",
    "benchmark",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten frames of a real recording as a user would have them."""
    folder = tmp_path_factory.mktemp("recording")
    rig, observations = load_recording("balance_openpose")
    save_rig(rig, folder / "Calib.toml")
    save_observations(observations.frames(slice(0, 10)), folder / "walk.npz")
    return folder


@pytest.fixture
def source(folder: Path) -> list[str]:
    return [str(folder / "walk.npz"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b"]


def failure(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error."""
    assert main(arguments) == 2
    line = capsys.readouterr().err
    assert line.startswith("fgpose: error: ")
    assert line.count("\n") == 1
    return line


@pytest.mark.parametrize("command", COMMANDS)
def test_help_explains_and_gives_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    assert f"Example: fgpose {command}" in capsys.readouterr().out


def test_help_of_the_program_lists_the_commands_and_needs_no_heavy_package() -> None:
    code = (
        "import sys\nfrom fgpose.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'rerun', 'cv2', 'pyarrow', 'ezc3d', 'scipy', 'onnxruntime', 'onnx', 'tflite'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(command in run.stdout for command in COMMANDS)
    assert run.stdout.splitlines()[-1] == "[]"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("fgpose 0.")


@pytest.mark.parametrize("recording", [pytest.param("balance_blazepose", marks=pytest.mark.slow), "balance_openpose"])
def test_demo(recording: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--recording", recording, "--output", str(tmp_path), "--frames", "6"]) == 0
    printed = capsys.readouterr().out
    written = {"demo.parquet", "demo.rrd", "demo.trc", "demo_calibration.toml"}
    assert {path.name for path in tmp_path.iterdir()} == written
    for what in (
        "6 frames at 60 Hz, 4 cameras",
        "cam_03",
        "jitter",
        "joints predicted",
        "ms per frame",
        "rerun",
        "99 %",
    ):
        assert what in printed
    demo = load_trajectory(tmp_path / "demo.parquet")
    assert demo.n_frames == 6
    assert demo.covariance_m2 is not None


def test_smooth_takes_every_parameter(source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--projection.sigma-px", "4", "--symmetry.form", "none", "--solver.no-covariance"]
    assert main(["smooth", *source, "--output", str(tmp_path), "--name", "mine", *options]) == 0
    assert "smoothed" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"mine.parquet", "mine.rrd", "mine.trc"}
    trajectory = load_trajectory(tmp_path / "mine.parquet")
    assert trajectory.config is not None
    assert trajectory.config.projection.sigma_px == 4
    assert trajectory.config.symmetry.form == "none"
    assert trajectory.covariance_m2 is None


def test_refine_calibration(source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The calibration that is written is the one that was used, and reads back."""
    options = ["--refine-calibration", "--name", "mine", "--formats", "npz"]
    assert main(["smooth", *source, "--output", str(tmp_path), *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "turned by [deg]" in printed
    assert {path.name for path in tmp_path.iterdir()} == {"mine.npz", "mine_calibration.toml"}
    known = load_calibration_origin(tmp_path / "mine_calibration.toml")
    assert f"may be shifted by {1000 * known.shift_sigma_m:.0f} mm along each axis" in printed
    assert known.shift_sigma_m > 0.001
    sigmas = " ".join(f"{each.rotation_sigma_deg:.2f}" for each in known.moved)
    assert f"standard deviation about each axis [deg] {sigmas}" in printed
    sigmas = " ".join(f"{1000 * each.translation_sigma_m:.0f}" for each in known.moved)
    assert f"standard deviation along each axis [mm] {sigmas}" in printed
    assert all(each.rotation_sigma_deg > 0 and each.translation_sigma_m > 0 for each in known.moved)
    rig = load_rig(tmp_path / "mine_calibration.toml")
    trajectory = load_trajectory(tmp_path / "mine.npz")
    observations = load_recording("balance_openpose")[1].frames(slice(0, trajectory.n_frames))
    residual_px = reprojection_residual_px(rig.undistort(observations.points2d_px), rig, trajectory.positions_m)
    # The file has 15 digits; the keypoints were stored as float32, which rounds by 1e-4 px.
    assert trajectory.residual_px is not None
    np.testing.assert_allclose(residual_px, trajectory.residual_px, atol=1e-3)


@pytest.mark.parametrize("with_poses", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_estimate_time_offsets(
    with_poses: bool, tmp_path: Path, walking_scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    """Alone, and together with the poses of the cameras; the calibration that is written carries both."""
    observations = walking_scene.observations
    points2d_px = observations.points2d_px.copy()
    points2d_px[2:, 1] = points2d_px[:-2, 1]  # two frames late: taken 2/30 s earlier than the images say
    save_observations(replace(observations, points2d_px=points2d_px, points3d_m=None), tmp_path / "walk.npz")
    save_rig(walking_scene.rig, tmp_path / "Calib.toml")
    source = [str(tmp_path / "walk.npz"), "--rig", str(tmp_path / "Calib.toml"), "--skeleton", "h36m_17"]
    options = ["--estimate-time-offsets", *(["--refine-calibration"] if with_poses else [])]
    assert main(["smooth", *source, "--output", str(tmp_path / "out"), "--formats", "npz", *options]) == 0
    printed = capsys.readouterr().out
    assert ("turned by [deg]" in printed) == with_poses
    assert "taken later [frames]" in printed
    rig = load_rig(tmp_path / "out" / "walk_calibration.toml")
    assert rig.time_offsets_s[0] == 0
    # Two seconds of walking tell the time to a third of a frame (1/100 s).
    np.testing.assert_allclose(rig.time_offsets_s, [0.0, -2 / 30, 0.0, 0.0], atol=0.02)
    # A round trip through the file costs a few units in the last of 16 digits.
    same = np.allclose(rig.projection_matrices, walking_scene.rig.projection_matrices, rtol=1e-9, atol=1e-9)
    assert same != with_poses
    smoothed = load_trajectory(tmp_path / "out" / "walk.npz")
    # A frame has the mean time at which its images were taken.
    np.testing.assert_allclose(smoothed.time_s - observations.frame_time_s, rig.time_offsets_s.mean(), atol=1e-9)
    truth_m = CubicSpline(observations.frame_time_s, walking_scene.truth_m)(smoothed.time_s)
    error_m = np.linalg.norm(smoothed.positions_m - truth_m, axis=-1)
    # As for synchronous cameras: detections are off by 5 px, 20 mm at 4.5 m and 1145 px, before they are smoothed.
    assert np.mean(error_m) < 0.02


def test_the_starts_of_cameras_stay_in_the_calibration_that_is_written(
    tmp_path: Path, walking_scene: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images of cameras that began seconds apart have been put together: only what is left is estimated."""
    starts_s = np.array([0.0, 2.5, -1.0, 0.0])
    origin = Origin((), walking_scene.rig.with_time_offsets(starts_s))
    source = Source(walking_scene.rig, walking_scene.observations, origin)
    calibrated(source, Config(), Outputs(tmp_path, "walk", ()), new_console(), poses=False, clocks=True)
    written = load_rig(tmp_path / "walk_calibration.toml")
    # Two seconds of walking tell the time to a third of a frame.
    np.testing.assert_allclose(written.time_offsets_s, starts_s, atol=0.02)
    row = next(line for line in capsys.readouterr().out.splitlines() if "taken later [ms]" in line)
    printed_ms = np.array(row.split("]")[1].split(), dtype=float)
    np.testing.assert_allclose(printed_ms, 1000 * written.time_offsets_s, atol=0.05)  # its last digit


@pytest.mark.slow
@pytest.mark.usefixtures("with_search_for_faults")
def test_a_recording_can_be_used_again_with_the_calibration_that_was_written(
    walking_scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_observations(replace(walking_scene.observations, points3d_m=None), tmp_path / "walk.npz")
    late = walking_scene.rig.with_time_offsets(np.array([0.0, 0.1, 0.0, 0.0]))
    save_rig(late, tmp_path / "Calib.toml")
    source = [str(tmp_path / "walk.npz"), "--rig", str(tmp_path / "Calib.toml"), "--skeleton", "h36m_17"]
    assert main(["info", *source]) == 0
    # The calibration claims an offset that is not there.
    printed = " ".join(capsys.readouterr().out.split())
    assert "ring_1 takes its images 3." in printed or "ring_1 takes its images 2." in printed
    assert "earlier than their times say" in printed
    assert "Use --estimate-time-offsets" in printed


def test_command_line_overrides_the_file(source: list[str], tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[projection]\nsigma_px = 9.0\nkernel_scale = 2.5\n")
    options = ["--config", str(file), "--projection.sigma-px", "7", "--formats", "npz"]
    assert main(["smooth", *source, "--output", str(tmp_path / "out"), *options]) == 0
    config = load_trajectory(tmp_path / "out" / "walk.npz").config
    assert config is not None
    assert (config.projection.sigma_px, config.projection.kernel_scale) == (7.0, 2.5)


def test_track_writes_newest_and_lagged(source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--output", str(tmp_path), "--online.lag-s", "0.05", "--formats", "npz", "rrd"]
    assert main(["track", *source, *options]) == 0
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("median", "90 %", "99 %", "max"))
    assert {path.name for path in tmp_path.iterdir()} == {"walk_online.npz", "walk_smoothed.npz", "walk_online.rrd"}
    assert load_trajectory(tmp_path / "walk_online.npz").n_frames == 10


@pytest.mark.parametrize("command", [pytest.param("smooth", marks=pytest.mark.slow), "track"])
def test_live_serves_until_ctrl_c(
    command: str,
    source: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def ctrl_c() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(viewers, "_sleep_forever", ctrl_c)
    options = ["--output", str(tmp_path), "--live", "--port", "0", "--formats", "npz", "rrd", "--online.lag-s", "0.05"]
    assert main([command, *source, *options]) == 0
    assert "rerun rerun+http://127.0.0.1:" in capsys.readouterr().err
    rrd = "walk_online.rrd" if command == "track" else "walk.rrd"
    assert (tmp_path / rrd).stat().st_size > 1000


def test_refine_with_some_cameras(source: list[str], tmp_path: Path) -> None:
    options = ["--output", str(tmp_path), "--cameras", "cam_04", "cam_02", "--formats", "parquet", "trc", "c3d"]
    assert main(["refine", *source, *options]) == 0
    assert load_trajectory(tmp_path / "walk_refined.parquet").camera_names == ("cam_04", "cam_02")
    assert {path.suffix for path in tmp_path.iterdir()} == {".parquet", ".trc", ".c3d"}


def test_info_lists_a_gap_of_all_joints_once(walking_scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    seen = walking_scene.observations
    hidden = np.zeros(seen.confidence.shape, dtype=bool)
    hidden[20:41] = hidden[19, :, 0] = hidden[41, :, 1] = True
    hidden[5:9] |= np.arange(hidden.shape[2]) == 2
    print_info(Console(width=200), recording_info(seen.without(hidden), walking_scene.rig, 0.1))
    gaps = [line for line in capsys.readouterr().out.splitlines() if line.startswith("gap:")]
    assert gaps == [
        f"gap: all {seen.skeleton.n_joints} joints seen by fewer than two cameras for 0.77 s from 0.60 s",
        f"gap: {seen.skeleton.joints[2]} seen by fewer than two cameras for 0.17 s from 0.13 s",
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("with_search_for_faults")
def test_info_names_the_suspect(capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(app.__file__).parents[1] / "data" / "balance_blazepose"
    arguments = [str(folder / "observations.npz"), "--rig", str(folder / "calibration.toml")]
    assert main(["info", *arguments, "--skeleton", "blazepose_33"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "cam_03 seems to have been moved since it was calibrated" in printed
    assert "Use --refine-calibration." in printed
    assert "Nothing" not in printed
    assert "takes its images" not in printed


@pytest.mark.slow
@pytest.mark.usefixtures("with_search_for_faults")
def test_info_settles_the_calibration_first(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = load_rig(folder / "Calib.toml")
    exchanged = [replace(rig.cameras[0], world_T_camera=rig.cameras[1].world_T_camera), *rig.cameras[1:]]
    save_rig(CameraRig(tuple(exchanged)), tmp_path / "Calib.toml")
    source = [str(folder / "walk.npz"), "--rig", str(tmp_path / "Calib.toml"), "--skeleton", "body_25b"]
    assert main(["info", *source]) == 0
    printed = capsys.readouterr().out
    assert "!! " in printed
    assert "cam_01" in printed
    assert "takes its images" not in printed


def test_evaluate_against_itself(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, observations = load_recording("balance_openpose")
    trajectory = smooth(observations.frames(slice(0, 10)), rig)
    for name in ("estimate.parquet", "reference.trc"):
        save_trajectory(trajectory, tmp_path / name)
    assert main(["evaluate", str(tmp_path / "estimate.parquet"), str(tmp_path / "reference.trc")]) == 0
    printed = capsys.readouterr().out
    assert "10 frames and 25 joints in common" in printed
    assert "left_ankle" in printed
    (mpjpe,) = (line for line in printed.splitlines() if "MPJPE, absolute" in line)
    assert mpjpe.split()[-1] == "0.0"


def test_angles_are_written_where_they_can_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, observations = load_recording("balance_openpose")
    save_trajectory(smooth(observations.frames(slice(0, 3)), rig), tmp_path / "walk.parquet")
    full, nobody, other = tmp_path / "full.csv", tmp_path / "nobody.bvh", tmp_path / "angles.csv"

    def save(people: object, path: Path, up: object, origin: object) -> tuple[Path, ...]:
        if path == full:
            raise OSError(errno.ENOSPC, "No space left on device")
        if path == nobody:
            raise ValueError(f"{path}: hips and shoulders are known in no frame")
        return (path,)

    monkeypatch.setattr("fgpose.io.trajectories.kinematics.save_kinematics", save)
    assert main(["angles", str(tmp_path / "walk.parquet"), "-o", str(full), "-o", str(nobody), "-o", str(other)]) == 1
    printed = capsys.readouterr()
    assert f"wrote {other}" in printed.out.replace("\n", "")
    assert f"cannot write {full}: No space left on device" in printed.err
    assert f"cannot write {nobody}: hips and shoulders are known in no frame" in printed.err


@pytest.mark.filterwarnings("default:2 of 3 windows were solved")
def test_an_interrupted_run_goes_on_where_it_was(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    windows = ["--solver.window-s", "0.05", "--solver.overlap-s", "0.02", "--formats", "npz"]
    assert main(["smooth", *source, "--output", str(tmp_path / "whole"), *windows]) == 0

    @contextmanager
    def interrupted(task: str) -> Iterator[Callable[[int, int], None]]:
        def progress(done: int, total: int) -> None:
            if done > total / 2:
                raise KeyboardInterrupt

        yield progress

    with monkeypatch.context() as patched:
        patched.setattr(delivery, "progress_bar", interrupted)
        assert main(["smooth", *source, "--output", str(tmp_path / "out"), *windows]) == 130
    kept = tmp_path / "out" / ".walk_unfinished"
    said = f"fgpose: interrupted; 2 windows that are solved are kept in {kept}; the same command goes on from there\n"
    assert capsys.readouterr().err.endswith(said)
    assert list((tmp_path / "out").iterdir()) == [kept]
    assert main(["smooth", *source, "--output", str(tmp_path / "out"), *windows]) == 0
    assert "2 of 3 windows were solved by a run that did not end; it goes on from there" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["walk.npz"]
    resumed, whole = (load_trajectory(tmp_path / folder / "walk.npz") for folder in ("out", "whole"))
    np.testing.assert_array_equal(resumed.positions_m, whole.positions_m)


@pytest.mark.slow
def test_a_part_of_what_the_viewer_shows_by_some_frames(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ["--output", str(tmp_path), "--formats", "parquet", "rrd", "--rrd-fps", "20"]
    assert main(["smooth", *source, *options]) == 0
    rrd, parquet = tmp_path / "walk.rrd", tmp_path / "walk.parquet"
    said = f"{rrd} shows one frame in 3, 20 a second (--rrd-fps); all of a minute: fgpose view {parquet} --from 0"
    assert said in capsys.readouterr().out
    shown: list[list[float]] = []

    def run(command: list[str]) -> int:
        of_either = (f"/world/{name}/joints" for name in ("smoothed", "walk"))
        found = [rows(Path(command[1]), entity, "Points3D:positions") for entity in of_either]
        shown.append([time_s for of_entity in found for time_s, _ in of_entity.values()])
        return 0

    monkeypatch.setattr(view, "run_program", run)
    part = ["--web", "--from", "0.05", "--to", "0.1"]
    assert main(["view", str(rrd), *part]) == main(["view", str(parquet), *part]) == 0
    # Of frames at 60 Hz, and of every third of them.
    np.testing.assert_allclose(shown[0], [0.05, 0.1], atol=1e-9)
    np.testing.assert_allclose(shown[1], np.arange(3, 7) / 60, atol=1e-9)
    capsys.readouterr()
    for path in (rrd, parquet):
        assert f"{path}: no frame is from 3 s on: there are frames from 0 s to 0.15" in failure(
            ["view", str(path), "--from", "3"], capsys
        )
    assert "--rrd-fps must be positive" in failure(["smooth", *source, "--rrd-fps", "0"], capsys)


@pytest.mark.parametrize("with_rig", [False, True])
def test_view_opens_a_trajectory(with_rig: bool, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, observations = load_recording("balance_openpose")
    save_trajectory(smooth(observations.frames(slice(0, 3)), rig), tmp_path / "walk.parquet")
    opened: list[str] = []

    def run(command: list[str]) -> int:
        opened.extend(command)
        assert Path(command[1]).stat().st_size > 1000
        return 0

    monkeypatch.setattr(view, "run_program", run)
    options = ["--rig", str(folder / "Calib.toml")] if with_rig else []
    assert main(["view", str(tmp_path / "walk.parquet"), "--web", *options]) == 0
    assert Path(opened[1]).name == "walk.rrd"
    assert opened[2:5] == ["--bind", "127.0.0.1", "--web-viewer"]
    assert not Path(opened[1]).exists()


def test_a_recording_is_shown_to_others_only_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rerun serves the pictures at all addresses unless it is told otherwise, from its window too."""
    bound: list[str] = []

    def run(command: list[str]) -> int:
        bound.append(command[command.index("--bind") + 1])
        return 0

    monkeypatch.setattr(view, "run_program", run)
    monkeypatch.setattr(view, "has_display", lambda: True)
    (tmp_path / "walk.rrd").write_bytes(b"RRF2")
    assert main(["view", str(tmp_path / "walk.rrd")]) == 0
    assert main(["view", str(tmp_path / "walk.rrd"), "--web"]) == 0
    assert "warning" not in capsys.readouterr().err
    assert main(["view", str(tmp_path / "walk.rrd"), "--web", "--host", "0.0.0.0"]) == 0
    warning = capsys.readouterr().err
    assert "every computer in the network reaches the recording, with its pictures, at " in warning
    assert socket.gethostname() in warning
    assert bound == ["127.0.0.1", "127.0.0.1", "0.0.0.0"]


def test_other_computers_are_let_in_with_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    console, options = ExitStack(), LiveOutputs(host="127.0.0.1", inputs_host="::")
    rig, observations = load_recording("balance_openpose")
    Consumers(Clock()).open(console, options, rig, observations.skeleton, Config())
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("warning: --inputs-host ::: every computer in the network reaches the inputs (keypoints, ")
    for host in ("localhost", "127.0.0.1", "::1"):
        warn_if_others_reach(host, "--host", "it")
    assert not capsys.readouterr().err
    warn_if_others_reach("192.168.7.1", "--host", "it")
    assert "reaches it, at 192.168.7.1; there is no password" in capsys.readouterr().err


def test_rerun_sends_nothing_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "")
    monkeypatch.delenv("CI")
    told: list[str | None] = []

    def run(command: list[str]) -> int:
        told.append(os.environ.get("CI"))
        return 0

    monkeypatch.setattr(view, "run_program", run)
    (tmp_path / "walk.rrd").write_bytes(b"RRF2")
    assert main(["view", str(tmp_path / "walk.rrd"), "--web"]) == 0
    assert told == ["1"]


@pytest.mark.parametrize("code", ["\x1b]52;c;cm0gLXJm\x07", "\x9b2J", "\x08", "\r", "\u202e", "\udcff"])
def test_names_do_not_command_the_terminal(code: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a terminal obeys is printed as an escape, in errors, lines and tables."""
    named = f"a{code}b"
    assert main(["view", str(tmp_path / named)]) == 2
    table = new_table(named)
    table.add_row(named)
    for thing in (named, table):
        new_console().print(thing)
    said = capsys.readouterr()
    escaped = f"a{ascii(code)[1:-1]}b"
    assert said.out.count(escaped) == 3
    assert escaped in said.err or code == "\r"
    assert code not in said.out + said.err


def test_missing_keypoints_are_named(source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = failure(["info", "no/such/folder", *source[1:]], capsys)
    assert line == "fgpose: error: no/such/folder: No such file or directory\n"


@pytest.mark.parametrize(
    ("command", "what"),
    [
        *(("smooth", what) for what in ("empty", "garbage", "folder", "missing", "circle")),
        *((command, "garbage") for command in ("track", "refine", "info", "evaluate", "view", "detect", "run")),
    ],
)
def test_a_file_that_is_something_else_is_named(
    command: str, what: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").touch()
    (tmp_path / "garbage").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "folder").mkdir()
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    path = str(tmp_path / what)
    rig = ["--rig", str(folder / "Calib.toml")]
    more = {
        "evaluate": [path],
        "view": [],
        "detect": [*rig, "--output", str(tmp_path / "out")],
        "run": [*rig, "--output", str(tmp_path / "out")],
        "info": [*rig, "--skeleton", "body_25b", "--fps", "60"],
    }
    estimator = [*rig, "--skeleton", "body_25b", "--fps", "60", "--output", str(tmp_path / "out")]
    assert path in failure([command, path, *more.get(command, estimator)], capsys)


@pytest.mark.parametrize("fps", ["-1", "0", "nan", "inf", "1e300", "1e-300"])
def test_an_impossible_rate_is_refused(
    fps: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pose").mkdir()
    for camera in ("cam_01", "cam_02", "cam_03", "cam_04"):
        instances = [{"keypoints": [[10.0, 20.0]] * 25, "keypoint_scores": [0.5] * 25}]
        images = [{"frame_id": frame, "instances": instances} for frame in range(3)]
        (tmp_path / "pose" / f"{camera}.json").write_text(json.dumps({"instance_info": images}))
    arguments = [str(tmp_path / "pose"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b", "--fps", fps]
    assert "pose: " in failure(["smooth", *arguments, "--output", str(tmp_path / "out")], capsys)


def test_truncated_keypoints_are_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for camera in ("cam_01", "cam_02", "cam_03", "cam_04"):
        (tmp_path / "pose" / camera).mkdir(parents=True)
        (tmp_path / "pose" / camera / f"{camera}_000000.json").write_text('{"version": 1.3, "people": [{"pose_key')
    arguments = [str(tmp_path / "pose"), "--rig", str(folder / "Calib.toml"), "--skeleton", "body_25b", "--fps", "60"]
    line = failure(["smooth", *arguments, "--output", str(tmp_path / "out")], capsys)
    assert "cam_01_000000.json" in line
    assert not (tmp_path / "out").exists()


def test_folder_that_cannot_be_written_is_found_before_the_work(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_work(self: object) -> None:
        raise AssertionError("the recording was read before the output was checked")

    monkeypatch.setattr(estimators.Smooth, "load", no_work)
    (tmp_path / "file").touch()
    line = failure(["smooth", *source, "--output", str(tmp_path / "file" / "out")], capsys)
    assert str(tmp_path / "file" / "out") in line


def test_result_never_replaces_its_input(source: list[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "walk.npz").read_bytes()
    assert "walk.npz" in failure(["smooth", *source, "--output", str(folder), "--formats", "npz"], capsys)
    assert (folder / "walk.npz").read_bytes() == before


def test_missing_package_is_one_line(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    line = failure(["smooth", *source, "--output", str(tmp_path), "--formats", "c3d"], capsys)
    assert 'pip install "fgpose[c3d]"' in line


@pytest.mark.filterwarnings("default:no .rrd file")
@pytest.mark.parametrize(
    "command", [pytest.param("smooth", marks=pytest.mark.slow), "track", pytest.param("refine", marks=pytest.mark.slow)]
)
def test_without_rerun_all_else_is_written(
    command: str, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main([command, *source, "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    lacking = "fgpose: warning: no .rrd file for the viewer is written: it needs Rerun, pip install 'fgpose[viewer]'\n"
    assert printed.err.count(lacking) == 1
    assert ".rrd" not in printed.out
    assert {path.suffix for path in tmp_path.glob("*.*")} == {".parquet", ".trc"}
    # What was asked for by name is not left out.
    assert "needs Rerun" in failure([command, *source, "--output", str(tmp_path), "--formats", "trc", "rrd"], capsys)


@pytest.mark.filterwarnings("default:no .rrd file")
def test_the_demonstration_without_rerun(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["demo", "--output", str(tmp_path), "--frames", "6"]) == 0
    printed = capsys.readouterr()
    assert "needs Rerun" in printed.err
    assert "rerun" not in printed.out
    assert (tmp_path / "demo.parquet").is_file()


def test_a_report_without_its_extra_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bokeh", None)
    assert "pip install 'fgpose[report]'" in failure(["report", str(folder)], capsys)


def test_an_error_of_several_lines_is_one_line() -> None:
    assert app._one_line(ValueError("camera a: gone\n\n  camera b:  gone\n")) == "camera a: gone; camera b: gone"


def test_unknown_option_suggests_the_nearest(source: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["smooth", *source, "--projection.sigma-pxx", "4"])
    assert end.value.code == 2
    assert "--projection.sigma-px" in capsys.readouterr().err


def test_unknown_key_of_a_file_suggests_the_nearest(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.toml").write_text("[projection]\nsigma_pxx = 4.0\n")
    line = failure(["smooth", *source, "--config", str(tmp_path / "mine.toml")], capsys)
    assert "mine.toml" in line
    assert "projection.sigma_px?" in line


@pytest.mark.parametrize("how", ["option", "environment"])
def test_traceback_on_request(
    how: str, source: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["info", "no/such/folder", *source[1:]]
    if how == "option":
        arguments.append("--traceback")
    else:
        monkeypatch.setenv("FGPOSE_TRACEBACK", "1")
    assert main(arguments) == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("live", [False, True])
def test_ctrl_c_leaves_what_was_there(
    live: bool, source: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(delivery, "run_smooth", interrupted)
    (tmp_path / "walk.rrd").write_bytes(b"made by fgpose smooth before")
    options = ["--live", "--port", "0"] if live else []
    assert main(["smooth", *source, "--output", str(tmp_path), *options]) == 130
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"made by fgpose smooth before"]


@pytest.mark.slow
def test_results_do_not_depend_on_the_terminal(source: list[str], tmp_path: Path) -> None:
    """Piped into a file, with a locale that knows ASCII only."""
    environment = {**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "fgpose", "refine", *source, "--output", str(tmp_path), "--formats", "npz"]
    run = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr
    assert np.isfinite(load_trajectory(tmp_path / "walk_refined.npz").positions_m).any()


@pytest.mark.parametrize(
    ("formats", "live"),
    [
        (("c3d", "npz", "rrd"), False),
        pytest.param(("npz", "rrd", "c3d"), True, marks=pytest.mark.slow),
        pytest.param(("c3d", "npz", "rrd"), True, marks=pytest.mark.slow),
        pytest.param(("npz", "rrd", "c3d"), False, marks=pytest.mark.slow),
    ],
)
def test_a_format_that_fails_does_not_take_the_others_along(
    formats: tuple[str, ...],
    live: bool,
    source: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*arguments: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fgpose.io.trajectories.saving.write_c3d", full)
    options = ["--output", str(tmp_path), "--formats", *formats, *(["--live", "--port", "0"] if live else [])]
    assert main(["smooth", *source, *options]) == 1
    printed = capsys.readouterr()
    assert f"fgpose: error: cannot write {tmp_path / 'walk.c3d'}: No space left on device" in printed.err
    assert {path.name for path in tmp_path.iterdir()} == {"walk.npz", "walk.rrd"}
    assert f"wrote {tmp_path / 'walk.npz'}" in printed.out
    assert (tmp_path / "walk.rrd").stat().st_size > 1000


@pytest.mark.parametrize("live", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_viewer_file_that_fails_does_not_take_the_others_along(
    live: bool,
    source: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from fgpose.viewer.rerun.recording import RerunRecording

    def broken(*arguments: object) -> None:
        raise RuntimeError("the viewer's library is broken")

    monkeypatch.setattr(RerunRecording, "log_trajectory", broken)
    options = ["--output", str(tmp_path), "--formats", "rrd", "npz", *(["--live", "--port", "0"] if live else [])]
    assert main(["smooth", *source, *options]) == 1
    what = "the viewer" if live else tmp_path / "walk.rrd"
    assert f"fgpose: error: cannot write {what}: the viewer's library is broken" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["walk.npz"]


@pytest.mark.parametrize("command", ["smooth", "refine", "track"])
def test_a_port_that_is_taken_is_found_before_the_work(
    command: str,
    source: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_work(*arguments: object, **options: object) -> None:
        raise AssertionError("estimated before the port was tried")

    monkeypatch.setattr(f"fgpose.pipeline.run_{command}", no_work)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        line = failure([command, *source, "--output", str(tmp_path), "--live", "--port", port], capsys)
    assert f":{port}" in line


def test_a_recording_shorter_than_the_lag_does_not_replace_its_input(folder: Path, tmp_path: Path) -> None:
    """It has no lagged estimates, so one trajectory is written alone: still under its own name."""
    for name in ("walk.npz", "Calib.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    source = [str(tmp_path / "walk.npz"), "--rig", str(tmp_path / "Calib.toml"), "--skeleton", "body_25b"]
    assert main(["track", *source, "--output", str(tmp_path), "--formats", "npz", "--online.lag-s", "5"]) == 0
    assert (tmp_path / "walk.npz").read_bytes() == (folder / "walk.npz").read_bytes()
    assert load_trajectory(tmp_path / "walk_online.npz").n_frames == 10


def test_the_calibration_that_is_read_is_not_replaced(
    source: list[str], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "walk_calibration.toml"
    rig.write_bytes((folder / "Calib.toml").read_bytes())
    arguments = [source[0], "--rig", str(rig), *source[3:], "--output", str(tmp_path), "--formats", "npz"]
    line = failure(["smooth", *arguments, "--refine-calibration"], capsys)
    assert "walk_calibration.toml would replace an input" in line
    assert main(["smooth", *arguments]) == 0
    assert rig.read_bytes() == (folder / "Calib.toml").read_bytes()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        *((["--visibility.sigma-m", value], "visibility.sigma_m") for value in ("1e-99", "1e300", "nan", "0", "-1")),
        (["--fusion.inlier-px", "1e300"], "fusion.inlier_px"),
        (["--projection.sigma-px", "4,5"], "--projection.sigma-px 4,5: write a point, 4.5"),
        (["--fps=59,94"], "--fps 59,94: write a point, 59.94"),
        (["--solver.max-iterations", "0"], "solver.max_iterations"),
        (["--tracking.max-processes", "-1"], "tracking.max_processes"),
        (["--frames", "0"], "--frames"),
        (["--min-confidence", "7"], "confidence"),
        (["--name", "."], "'.' is no name"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
        (["--rig", "no/such.toml"], "no/such.toml"),
        (["--skeleton", "body_99"], "body_99"),
        (["--skeleton", "coco_17"], "coco_17"),
        (["--cameras", "cam_01", "cam_09"], "cam_09"),
        (["--cameras", "door"], "Calib"),
    ],
)
def test_what_cannot_be_is_refused_by_name_and_writes_nothing(
    options: list[str], named: str, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kinds of command lines that ended in a traceback, wrote elsewhere or named nothing."""
    before = sorted(Path.cwd().iterdir())
    assert named in failure(["smooth", *source, "--output", str(tmp_path / "out"), *options], capsys)
    assert not (tmp_path / "out").exists()
    assert sorted(Path.cwd().iterdir()) == before


def test_a_demo_that_is_refused_makes_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--frames must be at least 1" in failure(["demo", "--frames", "-3", "-o", str(tmp_path / "a" / "b")], capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", ["smooth --help", "smooth --help-all", "run --help", "live --help"])
def test_lines_of_the_help_end_where_they_are_full(
    arguments: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit):
        main(arguments.split())
    lines = [line.strip("│").rstrip() for line in capsys.readouterr().out.splitlines()]
    # The column of the explanations, which ends at 77.
    begins = [len(line) - len(line.lstrip()) for line in lines]
    (column, n_lines), *_ = Counter(begin for begin in begins if begin > 4).most_common(1)
    assert n_lines > 10
    early = [
        line.strip()
        for (line, begin), (following, begin_after) in itertools.pairwise(zip(lines, begins, strict=True))
        if begin == begin_after == column and len(line) + 1 + len(following.split()[0]) <= 77
    ]
    assert not early
