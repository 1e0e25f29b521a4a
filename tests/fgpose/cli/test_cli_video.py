"""fgpose detect and fgpose run: from videos on."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from calibrated_walks import failure
from rrd_contents import entities

import fgpose
from fgpose.association.chosen_person import PersonRegion
from fgpose.cli import main
from fgpose.io.atomic import write_text
from fgpose.io.calibration import load_rig, save_rig
from fgpose.io.keypoints import load_observations, load_people
from fgpose.io.skeletons import load_skeleton
from fgpose.io.trajectories import load_people_trajectories, load_trajectory
from fgpose.monocular.network import Image, People, Tracker

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

N_IMAGES = 12
FPS = 20.0
pytestmark = pytest.mark.usefixtures("without_search_for_faults")


@pytest.fixture(autouse=True)
def no_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for each test."""
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "detections"


@pytest.fixture
def network(squares_network: SquaresNetwork, monkeypatch: pytest.MonkeyPatch) -> SquaresNetwork:
    """In place of every network; 2D only, as its depth is a guess."""
    squares_network.depth_m = float("nan")
    monkeypatch.setattr("fgpose.monocular.networks.open_network", lambda *arguments, **options: squares_network)
    return squares_network


@pytest.fixture(scope="module")
def recording(squares: SquaresScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a user has: a calibration and videos."""
    folder = tmp_path_factory.mktemp("recording")
    save_rig(squares.rig, folder / "Calib.toml")
    squares.write_all(folder / "walk", N_IMAGES, FPS)
    return folder


@pytest.fixture
def source(recording: Path) -> list[str]:
    return [str(recording / "walk"), "--rig", str(recording / "Calib.toml")]


def truth_m(squares: SquaresScene, person: int = 0) -> np.ndarray:
    return np.stack([squares.positions_m(n / FPS, 2)[person] for n in range(N_IMAGES)])


@pytest.mark.parametrize("command", ["detect", "run"])
def test_help_explains_and_gives_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert f"Example: fgpose {command} videos/ --rig Calib.qca.txt" in printed
    options = {"--model", "--network", "--detector", "--device", "--fps", "--people", "--jobs", "--cache"}
    options.add("--person-region")
    if command == "run":
        options |= {"--help-all", "--refine-calibration", "--config", "--no-images", "--image-width"}
    assert {option for option in options if option not in printed} == set()


def test_run_goes_from_videos_to_the_smoothed_motion(
    source: list[str],
    squares: SquaresScene,
    network: SquaresNetwork,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", *source, "-o", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert f"{3 * N_IMAGES} images of 3 cameras" in printed.out
    assert f"seen, of {N_IMAGES} frames" in printed.out
    assert "jitter" in printed.out
    assert "detecting" in printed.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"walk.parquet", "walk.trc", "walk.rrd"}
    trajectory = load_trajectory(tmp_path / "out" / "walk.parquet")
    np.testing.assert_allclose(trajectory.time_s, np.arange(N_IMAGES) / FPS, atol=1e-9)
    # A pixel is 13 mm at 4 m, and the squares are found to about one.
    np.testing.assert_allclose(trajectory.positions_m, truth_m(squares), atol=0.02)


def test_other_parameters_need_no_network(
    source: list[str], network: SquaresNetwork, no_home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--formats", "npz"]
    assert main(["run", *source, "-o", str(tmp_path / "a"), *options]) == 0
    assert len(list(no_home.iterdir())) == 3
    n_seen = len(network.seen)
    assert n_seen == 3 * N_IMAGES
    capsys.readouterr()
    config = tmp_path / "mine.toml"
    config.write_text("[projection]\nsigma_px = 9.0\nkernel_scale = 2.5\n")
    options += ["--config", str(config), "--projection.sigma-px", "7", "--solver.no-covariance"]
    assert main(["run", *source, "-o", str(tmp_path / "b"), *options]) == 0
    assert len(network.seen) == n_seen
    assert f"{n_seen} of them known from {no_home}" in capsys.readouterr().out
    trajectory = load_trajectory(tmp_path / "b" / "walk.npz")
    assert trajectory.config is not None
    assert (trajectory.config.projection.sigma_px, trajectory.config.projection.kernel_scale) == (7.0, 2.5)
    assert trajectory.covariance_m2 is None


def test_no_cache_keeps_nothing(source: list[str], network: SquaresNetwork, no_home: Path, tmp_path: Path) -> None:
    options = ["-o", str(tmp_path / "out"), "--formats", "npz", "--no-cache", "--jobs", "1"]
    for _ in range(2):
        assert main(["run", *source, *options]) == 0
    assert len(network.seen) == 2 * 3 * N_IMAGES
    assert not no_home.exists()


def test_ctrl_c_keeps_what_was_detected(
    source: list[str], network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(n_seen: int) -> None:
        if n_seen == 17:
            raise KeyboardInterrupt

    network.before_image = interrupt
    arguments = ["run", *source, "-o", str(tmp_path / "out"), "--cache", str(tmp_path / "mine"), "--formats", "npz"]
    assert main(arguments) == 130
    said = (
        f"fgpose: interrupted; detections so far are kept in {tmp_path / 'mine'}; the same command goes on from there\n"
    )
    assert capsys.readouterr().err.endswith(said)
    assert not (tmp_path / "out").exists()
    network.before_image = lambda n_seen: None
    assert main(arguments) == 0
    assert "17 of them known from" in capsys.readouterr().out
    assert len(network.seen) == 3 * N_IMAGES


def test_the_recording_shows_every_image_in_its_frame(
    squares: SquaresScene, network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a camera is slower: its images are in the frames of their time."""
    from fgpose.viewer.rerun.recording import RerunRecording

    save_rig(squares.rig, tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS)
    squares.write_video(tmp_path / "walk" / "ring_1.mp4", 1, N_IMAGES // 2, FPS / 2)
    logged: dict[tuple[str, int], tuple[float, np.ndarray]] = {}
    log_image = RerunRecording.log_image

    def noted(self: Any, camera: str, frame: int, time_s: float, image: np.ndarray) -> None:
        logged[camera, frame] = time_s, image
        log_image(self, camera, frame, time_s, image)

    monkeypatch.setattr(RerunRecording, "log_image", noted)
    arguments = ["run", str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "--formats", "rrd"]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0
    every = {(name, frame) for name in squares.rig.names for frame in range(N_IMAGES)}
    assert set(logged) == {(name, frame) for name, frame in every if name != "ring_1" or frame % 2 == 0}
    for (name, frame), (time_s, image) in logged.items():
        assert time_s == pytest.approx(frame / FPS)
        expected = squares.image(squares.rig.names.index(name), frame / FPS)
        # The codec blurs the edges of squares that make up a hundredth of the picture.
        assert np.abs(image.astype(int) - expected).mean() < 3
    with_images = (tmp_path / "out" / "walk.rrd").stat().st_size
    logged.clear()
    assert main([*arguments, "-o", str(tmp_path / "out"), "--no-images"]) == 0
    assert logged == {}
    assert (tmp_path / "out" / "walk.rrd").stat().st_size < with_images


def test_live_shows_the_images_too(
    source: list[str], network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    from fgpose.cli import viewers
    from fgpose.viewer.rerun.recording import RerunRecording

    def ctrl_c() -> None:
        raise KeyboardInterrupt

    logged: list[str] = []
    monkeypatch.setattr(viewers, "_sleep_forever", ctrl_c)
    monkeypatch.setattr(RerunRecording, "log_image", lambda self, camera, *rest: logged.append(camera))
    options = ["-o", str(tmp_path / "out"), "--live", "--port", "0", "--formats", "npz"]
    assert main(["run", *source, *options]) == 0
    assert "rerun rerun+http://127.0.0.1:" in capsys.readouterr().err
    assert len(logged) == 3 * N_IMAGES


def test_first_frames_and_some_cameras(source: list[str], network: SquaresNetwork, tmp_path: Path) -> None:
    options = ["-o", str(tmp_path), "--frames", "5", "--cameras", "ring_2", "ring_0", "--formats", "npz"]
    assert main(["run", *source, *options]) == 0
    trajectory = load_trajectory(tmp_path / "walk.npz")
    assert trajectory.n_frames == 5
    assert trajectory.camera_names == ("ring_2", "ring_0")
    assert sorted(network.seen) == ["ring_0"] * 5 + ["ring_2"] * 5


def test_refine_calibration(source: list[str], network: SquaresNetwork, tmp_path: Path) -> None:
    options = ["-o", str(tmp_path), "--refine-calibration", "--formats", "npz", "--name", "mine"]
    assert main(["run", *source, *options]) == 0
    assert {path.name for path in tmp_path.iterdir()} >= {"mine.npz", "mine_calibration.toml"}
    assert load_rig(tmp_path / "mine_calibration.toml").names == load_trajectory(tmp_path / "mine.npz").camera_names


@pytest.mark.parametrize("person", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_the_person_in_a_region(person: int, squares: SquaresScene, network: SquaresNetwork, tmp_path: Path) -> None:
    save_rig(squares.rig, tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS, n_people=2)
    points_px = squares.rig.cameras[1].project(squares.positions_m(0.0, 2)[person])
    (x, y), (width, height) = points_px.min(axis=0) - 8, np.ptp(points_px, axis=0) + 16
    options = ["--max-people", "2", "--person-region", f"ring_1:{x:.0f},{y:.0f},{width:.0f},{height:.0f}"]
    arguments = ["run", str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "--formats", "npz"]
    assert main([*arguments, "-o", str(tmp_path / "out"), *options]) == 0
    trajectory = load_trajectory(tmp_path / "out" / "walk.npz")
    np.testing.assert_allclose(trajectory.positions_m, truth_m(squares, person), atol=0.02)


def of_both(squares: SquaresScene, people: Mapping[int, fgpose.Trajectory]) -> bool:
    """Whether these are the two people, each once."""
    found_m = np.array([np.nanmean(each.positions_m, axis=(0, 1)) for each in people.values()])
    true_m = np.array([truth_m(squares, person).mean(axis=(0, 1)) for person in range(2)])
    distances_m = np.linalg.norm(found_m[:, None] - true_m, axis=-1)
    return sorted(distances_m.argmin(axis=1)) == [0, 1] and bool(distances_m.min(axis=1).max() < 0.03)


def test_everybody_in_the_videos(squares: SquaresScene, network: SquaresNetwork, tmp_path: Path) -> None:
    save_rig(squares.rig, tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS, n_people=2)
    arguments = [str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "-o", str(tmp_path / "out")]
    assert main(["run", *arguments]) == 0
    assert of_both(squares, load_people_trajectories(tmp_path / "out" / "walk.parquet"))
    shown = entities(tmp_path / "out" / "walk.rrd")
    assert {"/world/person_0/joints", "/world/person_1/joints"} <= shown
    assert any(entity.endswith("/picture") for entity in shown)


def test_detect_writes_everybody(squares: SquaresScene, network: SquaresNetwork, tmp_path: Path) -> None:
    save_rig(squares.rig, tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS, n_people=2)
    assert main(["detect", str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "-o", str(tmp_path)]) == 0
    observations = load_people(tmp_path / "walk.parquet", squares.rig, network.skeleton)
    assert {image.n_people for image in observations.images} == {2}
    assert of_both(squares, fgpose.smooth_people(observations, squares.rig).trajectories)


@dataclass
class Troubled:
    """Says of the first person that the fit is poor, of the second in the first half second that joints are missing."""

    tracker: Tracker
    n_seen: int = 0

    def detect(self, image: Image) -> People:
        self.n_seen += 1
        of_second = "few joints: 3 of 12 are seen, 6 are needed" if self.n_seen <= FPS / 2 else ""
        return replace(self.tracker.detect(image), problems=("poor fit: twice as much as usual", of_second))


def test_without_a_calibration_the_pixels_of_everybody_are_detected(
    squares: SquaresScene, network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS, n_people=2)
    assert main(["detect", str(tmp_path / "walk"), "-o", str(tmp_path), "--frames", "4"]) == 0
    people = fgpose.files.load_uncalibrated(tmp_path / "walk.parquet", network.skeleton)
    assert people.camera_names == squares.rig.names
    assert len(people.images) == 4 * squares.rig.n_cameras
    for image in people.images:
        assert image.points3d_m is None
        true_px = squares.rig.cameras[squares.rig.names.index(image.camera)].project(
            squares.positions_m(image.time_s, 2)
        )
        # Squares of 11 pixels, compressed.
        np.testing.assert_allclose(np.sort(image.points2d_px, axis=0), np.sort(true_px, axis=0), atol=1.5)
    capsys.readouterr()
    assert main(["detect", str(tmp_path / "walk"), "-o", str(tmp_path), "--people", "1"]) == 2
    assert "give --rig, or leave out the person" in capsys.readouterr().err


@pytest.mark.parametrize("command", [pytest.param("run", marks=pytest.mark.slow), "detect"])
def test_what_troubled_the_3d_is_printed_of_the_wanted_person_only(
    command: str,
    squares: SquaresScene,
    network: SquaresNetwork,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tracker = network.tracker
    monkeypatch.setattr(network, "tracker", lambda camera: Troubled(tracker(camera)))
    save_rig(squares.rig, tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS, n_people=2)
    x, y = squares.rig.cameras[1].project(squares.positions_m(0.0, 2)[1]).mean(axis=0)
    options = ["--max-people", "2", "--person-region", f"ring_1:{x - 60:.0f},{y - 60:.0f},120,120", "--formats", "npz"]
    arguments = [command, str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "-o", str(tmp_path / "out")]
    assert main([*arguments, *options]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if "3D missing or uncertain" in line]
    assert [re.sub(" +", " ", line) for line in lines] == ["3D missing or uncertain: few joints 10 10 10"]


@pytest.mark.parametrize(("file_format", "with_3d"), [("parquet", True), ("npz", True), ("parquet", False)])
def test_detect_writes_what_the_estimator_reads(
    file_format: str, with_3d: bool, source: list[str], squares: SquaresScene, network: SquaresNetwork, tmp_path: Path
) -> None:
    network.depth_m = 4.0 if with_3d else float("nan")
    assert main(["detect", *source, "-o", str(tmp_path / "out"), "--formats", file_format]) == 0
    assert [path.name for path in (tmp_path / "out").iterdir()] == [f"walk.{file_format}"]
    observations = load_observations(tmp_path / "out" / f"walk.{file_format}", squares.rig, network.skeleton)
    assert observations.seen.all()
    assert (observations.points3d_m is not None) == with_3d
    assert (observations.covariance3d_m2 is not None) == with_3d
    for c, camera in enumerate(squares.rig.cameras):
        expected_px = camera.project(truth_m(squares))
        np.testing.assert_allclose(observations.points2d_px[:, c], expected_px, atol=1.5)


@pytest.mark.filterwarnings("default")
def test_detect_writes_the_calibration_that_fits(
    squares: SquaresScene, network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Calibrated at twice the size of the videos: fgpose smooth must not be given the old calibration."""
    doubling = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
    doubled = [replace(view, size_px=(640, 480), K=doubling @ view.K) for view in squares.rig.cameras]
    save_rig(fgpose.CameraRig(tuple(doubled)), tmp_path / "Calib.toml")
    squares.write_all(tmp_path / "walk", N_IMAGES, FPS)
    arguments = ["detect", str(tmp_path / "walk"), "--rig", str(tmp_path / "Calib.toml"), "-o", str(tmp_path)]
    assert main(arguments) == 0
    assert "fgpose: warning: " in (warning := capsys.readouterr().err)
    assert "taken to be resized by 0.5 x 0.5" in warning
    fitted = load_rig(tmp_path / "walk_calibration.toml")
    for view, original in zip(fitted.cameras, squares.rig.cameras, strict=True):
        np.testing.assert_allclose(view.K, original.K, atol=1e-9)


def test_an_output_that_cannot_be_written_is_found_before_the_work(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_work(*arguments: object, **options: object) -> None:
        raise AssertionError("the work began before the output was checked")

    monkeypatch.setattr("fgpose.monocular.sources.open_sources", no_work)
    monkeypatch.setattr("fgpose.monocular.networks.open_network", no_work)
    (tmp_path / "file").touch()
    for command in ("run", "detect"):
        line = failure([command, *source, "-o", str(tmp_path / "file" / "out")], capsys)
        assert str(tmp_path / "file" / "out") in line


def test_a_result_never_replaces_the_calibration(
    recording: Path, network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "walk.npz"
    save_rig(load_rig(recording / "Calib.toml"), rig)
    before = rig.read_bytes()
    for command in ("run", "detect"):
        arguments = [command, str(recording / "walk"), "--rig", str(rig), "-o", str(tmp_path), "--formats", "npz"]
        assert "would replace an input" in failure(arguments, capsys)
        assert rig.read_bytes() == before
    assert network.seen == []


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        (["--rig", "no/such.toml"], "no/such.toml"),
        (["--cameras", "ring_9"], "ring_9"),
        (["--frames", "0"], "frames must be at least 1"),
        (["--jobs", "0"], "jobs must be at least 1"),
        (["--fps", "-3"], "fps must be a positive number"),
        (["--person-region", "ring_1"], "CAMERA:X,Y,W,H"),
        (["--person-region", "ring_7:1,2,30,40"], "ring_7"),
        (["--person-region", "ring_1:0,0,9,9"], "nobody is there in the first image"),
        (["--projection.sigma-px", "-1"], "projection.sigma_px"),
        (["--image-width", "0"], "--image-width must be at least 1"),
    ],
)
def test_wrong_input_is_one_line_that_names_it(
    change: list[str],
    culprit: str,
    source: list[str],
    network: SquaresNetwork,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert culprit in failure(["run", *source, "-o", str(tmp_path / "out"), *change], capsys)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("how", ["corrupt", "empty", "other camera", "no videos", "nowhere"])
def test_bad_videos_are_one_line_that_names_them(
    how: str, squares: SquaresScene, network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rig(squares.rig, tmp_path / "Calib.toml")
    folder = squares.write_all(tmp_path / "walk", 3, FPS)
    video, culprit = folder / "ring_1.mp4", "ring_1.mp4"
    if how == "corrupt":
        video.write_bytes(video.read_bytes()[:600])
    elif how == "empty":
        video.write_bytes(b"")
    elif how == "other camera":
        video.rename(folder / "ring_8.mp4")
        culprit = "ring_8"
    elif how == "no videos":
        for path in folder.iterdir():
            path.unlink()
        culprit = "no videos"
    else:
        folder, culprit = tmp_path / "nowhere", "nowhere"
    assert culprit in failure(["run", str(folder), "--rig", str(tmp_path / "Calib.toml")], capsys)
    assert network.seen == []


def test_nobody_in_the_videos(
    squares: SquaresScene, network: SquaresNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_rig(squares.rig, tmp_path / "Calib.toml")
    folder = squares.write_all(tmp_path / "walk", 3, FPS, n_people=0)
    arguments = ["run", str(folder), "--rig", str(tmp_path / "Calib.toml"), "-o", str(tmp_path / "out")]
    assert "nobody was found in any of the 9 images" in failure(arguments, capsys)


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        (["--model", "blazepose-huge"], "blazepose-huge"),
        (["--model", "no/such.onnx"], "no/such.onnx"),
        (["--model", "mine.onnx", "--network", "rtmpose"], "--detector"),
        (["--model", "mine.onnx", "--network", "metrabs", "--detector", "yolox.onnx"], "--skeleton"),
        (["--network", "rtmw3d"], "not an ONNX file"),
        (["--skeleton", "coco_17"], "metrabs only"),
    ],
)
def test_networks_that_cannot_be_opened(
    options: list[str],
    culprit: str,
    source: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: Any,
) -> None:
    from fgpose.monocular.downloads.models import PulledModel, pull

    # Of a file of one's own only the detector would be fetched.
    pulled = PulledModel(tmp_path / "landmarks.onnx", tmp_path / "detector.onnx")
    names = ("blazepose-lite", "blazepose-full", "blazepose-heavy")
    monkeypatch.setattr(
        "fgpose.monocular.downloads.models.pull",
        lambda name, progress=None: pulled if name in names else pull(name, progress),
    )
    assert culprit in failure(["run", *source, "-o", str(tmp_path / "out"), *options], capsys)


def test_the_device_of_the_configuration_unless_one_is_given(
    source: list[str], network: SquaresNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = []

    def open_network(*_: object, device: str, **__: object) -> SquaresNetwork:
        opened.append(device)
        return network

    monkeypatch.setattr("fgpose.monocular.networks.open_network", open_network)
    config = tmp_path / "mine.toml"
    write_text(config, '[monocular]\ndevice = "cuda"\n')
    own = ["--config", str(config)]
    for number, options in enumerate(([], own, [*own, "--device", "auto"], [*own, "--monocular.device", "cpu"])):
        output = str(tmp_path / f"out{number}")
        assert main(["run", *source, "-o", output, "--formats", "npz", "--frames", "6", *options]) == 0
    assert opened == ["auto", "cuda", "auto", "cpu"]


@pytest.mark.parametrize("command", ["detect", "run", "calibrate"])
def test_a_device_that_is_not_there(
    command: str, source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: ["CPUExecutionProvider"])
    if command == "calibrate":
        source = [source[0], "--synchronised"]
    output = tmp_path / "out" / "rig.toml"
    line = failure([command, *source, "-o", str(output), "--device", "cuda"], capsys)
    assert "no CUDAExecutionProvider; it has cpu. CUDAExecutionProvider comes with the wheel onnxruntime-gpu" in line
    assert not output.is_file()


def test_without_weights_and_without_a_registry_the_message_says_what_to_do(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Port 9 discards: nothing answers there.
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("PIP_RETRIES", "0")
    line = failure(["run", *source, "-o", str(tmp_path / "out")], capsys)
    assert "mediapipe" in line
    assert str(tmp_path / "cache") in line


@pytest.mark.parametrize(
    "text", ["", "ring_1", "ring_1:1,2,3", "ring_1:1,2,3,x", "ring_1:1,2,0,4", ":1,2,3,4", "a:nan,1,2,3"]
)
def test_a_region_that_is_none(text: str) -> None:
    with pytest.raises(ValueError, match=re.escape(repr(text))):
        PersonRegion.parse(text)


def test_a_region() -> None:
    assert PersonRegion.parse("hall:cam 1:-10,2.5,30,40") == PersonRegion("hall:cam 1", -10.0, 2.5, 30.0, 40.0)


def test_a_real_network_with_files_of_ones_own_is_told_apart(tmp_path: Path) -> None:
    """An image is no network: the error names the file."""
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 4, 3), np.uint8))
    (tmp_path / "a.onnx").write_bytes((tmp_path / "a.png").read_bytes())
    from fgpose.monocular.networks import open_network

    with pytest.raises(ValueError, match=r"a\.onnx"):
        open_network(tmp_path / "a.onnx", kind="blazepose", detector=tmp_path / "a.onnx")


@pytest.mark.slow
@pytest.mark.network
@pytest.mark.filterwarnings("default")
def test_run_on_the_demonstration_videos(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A man on one leg, four cameras, with the weights that are fetched; the first 20 frames."""
    from fgpose.monocular.downloads.demo_videos import fetch_demo_videos

    monkeypatch.delenv("FGPOSE_CACHE")
    try:
        folder = fetch_demo_videos()
    except OSError as error:
        pytest.skip(str(error))
    arguments = ["run", str(folder / "videos"), "--rig", str(folder / "calibration" / "Calib.qca.txt")]
    arguments += ["-o", str(tmp_path / "out"), "--frames", "20", "--refine-calibration", "--name", "demo"]
    assert main([*arguments, "--cache", str(tmp_path / "detections")]) == 0
    printed = capsys.readouterr()
    assert "80 images of 4 cameras" in printed.out
    assert "cam01: the images are 1080 x 1920, the calibration is for 1088 x 1920" in printed.err
    trajectory = load_trajectory(tmp_path / "out" / "demo.parquet")
    assert trajectory.n_frames == 20
    assert np.isfinite(trajectory.positions_m).all()
    assert trajectory.residual_px is not None
    # 5 to 8 px with this network over the whole recording; a wrong camera or a flip makes tens.
    assert np.nanmedian(trajectory.residual_px) < 12
    skeleton = trajectory.skeleton
    height_m = np.ptp(trajectory.positions_m[:, :, 2], axis=1)
    # He is about 1.8 m tall, on one leg and leaning over; the topmost joint is an eye or a raised hand.
    assert ((height_m > 1.2) & (height_m < 2.3)).all()
    limbs_m = skeleton.bone_lengths(trajectory.positions_m)
    assert np.nanmax(limbs_m) < 0.8


@pytest.mark.slow
@pytest.mark.network
@pytest.mark.filterwarnings("default")
def test_two_real_people_stay_who_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A woman who stands still, hidden in one view by a man who walks past; the views prefer him for a while."""
    from fgpose.monocular.downloads.demo_videos import fetch_demo_videos

    monkeypatch.delenv("FGPOSE_CACHE")
    try:
        folder = fetch_demo_videos(recording="Demo_MultiPerson")
    except OSError as error:
        pytest.skip(str(error))
    arguments = ["run", str(folder / "videos"), "--rig", str(folder / "calibration" / "Calib.qca.txt")]
    arguments += ["-o", str(tmp_path), "--frames", "40", "--max-people", "3", "--cache", str(tmp_path / "detections")]
    hips = [load_skeleton("blazepose_33").index(joint) for joint in ("left_hip", "right_hip")]
    places_m = {}
    for name, region in {"woman": "cam02:50,600,400,1000", "man": "cam04:100,350,400,1000"}.items():
        assert main([*arguments, "--name", name, "--person-region", region, "--formats", "npz"]) == 0
        trajectory = load_trajectory(tmp_path / f"{name}.npz")
        places_m[name] = trajectory.positions_m[:, hips, :2].mean(axis=1)
    # She shifts her weight by less than 10 cm; he is a metre and a half away from her, and comes nearer.
    assert np.ptp(places_m["woman"], axis=0).max() < 0.2
    assert np.linalg.norm(places_m["woman"] - places_m["man"], axis=1).min() > 1.0
    # Nobody jumps: 5 cm between frames would be 3 m/s.
    for place_m in places_m.values():
        assert np.linalg.norm(np.diff(place_m, axis=0), axis=1).max() < 0.05
    assert main([*arguments, "--name", "both", "--formats", "parquet"]) == 0
    both = load_people_trajectories(tmp_path / "both.parquet")
    assert len(both) == 2
    for place_m in places_m.values():
        off_m = [np.linalg.norm(each.positions_m[:, hips, :2].mean(axis=1) - place_m, axis=1) for each in both.values()]
        # Of one person alone left and right are corrected beforehand, of everybody during association.
        assert min(np.median(each) for each in off_m) < 0.05
