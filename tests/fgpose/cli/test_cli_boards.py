"""fgpose board and fgpose calibrate --board on rendered images."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filmed_boards import FILMED, film, film_carried
from rrd_contents import rows, static_values

import fgpose
from fgpose.assessment.rig_alignment import rig_similarity
from fgpose.assessment.rigs import angle_deg
from fgpose.cli import main
from fgpose.cli.commands.detect import NetworkOptions
from fgpose.io.calibration import load_calibration_origin, load_intrinsics, save_rig
from fgpose.io.keypoints import save_observations
from fgpose.io.made_by import made_by
from fgpose.io.skeletons import load_skeleton
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection_cache import ViewDetections
from fgpose.monocular.network import People
from fgpose.monocular.sources import Sources
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

OF_BOARDS = "--lens, --origin, --unsynchronised and --lenses-only are of a calibration with --board"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, fgpose.CameraRig]:
    folder = tmp_path_factory.mktemp("filmed") / "images"
    return folder, film(folder)


def failure(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    return " ".join(capsys.readouterr().err.split())


def test_images_become_a_rig(
    filmed: tuple[Path, fgpose.CameraRig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, true = filmed
    path = tmp_path / "rig.toml"
    assert main(["calibrate", str(folder), "--board", FILMED.text, "-o", str(path)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "Verdict: " in printed
    assert f"The board {FILMED.text} at" in printed
    assert f"wrote {path}" in printed
    # Folders of images have numbers, and no times.
    assert "The world is the board in image 0: z = 0 on it" in printed
    # The images of ring_0 and of ring_1 that show nothing but a grey wall.
    assert "images without the board 7 6" in printed
    rig = fgpose.load_rig(path)
    assert rig.names == true.names
    apart_m, truly_m = (np.linalg.norm(np.diff(each.positions_m, axis=0)) for each in (rig, true))
    # Corners of small images are good to 0.1 px; 1 % of the focal length would be 44 mm.
    assert apart_m == pytest.approx(truly_m, rel=0.01)
    np.testing.assert_allclose(rig.focal_px, true.focal_px, rtol=0.01)
    assert (tmp_path / "rig.rrd").stat().st_size > 0
    known = load_calibration_origin(path)
    assert known.grade in ("good", "coarse")
    assert known.method == "with a board"
    assert "image covered [%]" in printed
    assert {name: np.shape(counts) for name, counts in known.coverage.items()} == dict.fromkeys(true.names, (6, 8))
    for name in true.names:
        # All corners that are used, and nothing else, are shown in the image.
        points_px = static_values(tmp_path / "rig.rrd", f"/world/camera/{name}/image/coverage", "Points2D:positions")
        assert len(points_px) == np.sum(known.coverage[name]) > 100
        # Behind the corners of each moment is the image that they were found in, which has its number for its time.
        image = f"/world/camera/{name}/image"
        pictures, corners = (
            rows(tmp_path / "rig.rrd", f"{image}/{what}", component)
            for what, component in (("picture", "EncodedImage:blob"), ("detections", "Points2D:positions"))
        )
        assert {each: time_s for each, (time_s, _) in pictures.items()} == {
            each: time_s for each, (time_s, _) in corners.items()
        }
    assert made_by(path) == "calibrate"


def test_with_lenses_that_are_known(filmed: tuple[Path, fgpose.CameraRig], tmp_path: Path) -> None:
    folder, true = filmed
    save_rig(true, tmp_path / "Lens.toml")
    options = ["--intrinsics", str(tmp_path / "Lens.toml"), "--origin", "camera", "--no-rrd"]
    assert main(["calibrate", str(folder), "--board", FILMED.text, *options, "-o", str(tmp_path / "rig.npz")]) == 0
    rig = fgpose.load_rig(tmp_path / "rig.npz")
    np.testing.assert_allclose(rig.K, true.K, atol=1e-3)
    np.testing.assert_allclose(rig.cameras[0].world_T_camera, np.eye(4), atol=1e-9)


@pytest.fixture(scope="module")
def lenses(filmed: tuple[Path, fgpose.CameraRig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lenses") / "lenses.toml"
    assert main(["calibrate", str(filmed[0]), "--board", FILMED.text, "--lenses-only", "-o", str(path)]) == 0
    return path


@pytest.mark.slow
def test_lenses_alone(filmed: tuple[Path, fgpose.CameraRig], lenses: Path) -> None:
    assert made_by(lenses) == "calibrate"
    assert [path.name for path in lenses.parent.iterdir()] == ["lenses.toml"]
    true = filmed[1]
    np.testing.assert_allclose(load_intrinsics(lenses, true.names).focal_px, true.focal_px, rtol=0.01)
    # Nobody takes it for a rig.
    with pytest.raises(ValueError, match=r"camera ring_0 has no rotation and translation. If these are lenses only"):
        fgpose.load_rig(lenses)


@pytest.mark.slow
def test_lenses_from_a_board_and_poses_from_a_walk(
    filmed: tuple[Path, fgpose.CameraRig], lenses: Path, tmp_path: Path
) -> None:
    """Two commands, with the file handed over. The walk is simulated before the true cameras."""
    near = filmed[1]
    true = fgpose.CameraRig(
        tuple(
            replace(camera, world_T_camera=on_ring.world_T_camera)
            for camera, on_ring in zip(near.cameras, ring_rig(4, 4.0, 1.9).cameras, strict=False)
        )
    )
    skeleton = load_skeleton("h36m_17")
    seen = simulate(walking(600, 30.0, skeleton), skeleton, true, 30.0, DetectionNoise(), NO_OCCLUSION, seed=0)
    save_observations(replace(seen.observations, points3d_m=None), tmp_path / "walk.npz")
    options = ["--intrinsics", str(lenses), "--synchronised", "--skeleton", "h36m_17", "--no-rrd", "--height", "1.75"]
    path = tmp_path / "rig.toml"
    assert main(["calibrate", str(tmp_path / "walk.npz"), *options, "-o", str(path)]) == 0
    rig, known = fgpose.load_rig(path), load_intrinsics(lenses, true.names)
    # The lenses are those of the board, the poses those of the walk.
    np.testing.assert_allclose(rig.K, known.K, atol=1e-3)
    np.testing.assert_allclose(rig.focal_px, true.focal_px, rtol=0.01)
    turned = [each.cameras[0].world_T_camera[:3, :3].T @ each.cameras[1].world_T_camera[:3, :3] for each in (rig, true)]
    assert angle_deg(*turned) < 2.0


@pytest.mark.slow
def test_videos_that_were_started_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = film_carried(tmp_path / "videos", (0.0, 1.37))
    save_rig(true, tmp_path / "Lens.toml")
    options = ["--unsynchronised", "--intrinsics", str(tmp_path / "Lens.toml"), "--no-rrd"]
    path = tmp_path / "rig.toml"
    assert main(["calibrate", str(tmp_path / "videos"), "--board", FILMED.text, *options, "-o", str(path)]) == 0
    (said,) = [line for line in capsys.readouterr().out.splitlines() if "began after the first [s]" in line]
    # Of a tenth of a second from image to image.
    assert float(said.split()[-1]) == pytest.approx(1.37, abs=0.005)
    rig = fgpose.load_rig(path)
    apart_m, truly_m = (np.linalg.norm(np.diff(each.positions_m, axis=0)) for each in (rig, true))
    assert apart_m == pytest.approx(truly_m, rel=0.01)
    np.testing.assert_array_equal(rig.time_offsets_s, 0.0)


@pytest.mark.slow
def test_a_failed_calibration_writes_no_rig(
    filmed: tuple[Path, fgpose.CameraRig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade

    reason = CalibrationFinding("ring_1", Grade.FAILED, "it is upside down", "turn it")
    monkeypatch.setattr("fgpose.calibration.board.calibrate.findings", lambda inputs: (reason,))
    path = tmp_path / "rig.toml"
    assert main(["calibrate", str(filmed[0]), "--board", FILMED.text, "-o", str(path)]) == 1
    captured = capsys.readouterr()
    assert "- failed, camera ring_1: it is upside down. Remedy: turn it." in captured.out
    assert f"{path} was not written" in " ".join(captured.err.split())
    assert not path.exists()
    assert path.with_suffix(".rrd").exists()


def walked(true: fgpose.CameraRig, sources: Sources) -> Detected:
    """What a network that errs by a pixel would see of somebody who walks through the images, who is not rendered."""
    skeleton, rng = fgpose.load_skeleton("h36m_17"), np.random.default_rng(0)
    views = []
    for camera, clip in zip(true.cameras, sources.clips, strict=True):
        stamps_s = clip.stamps_s()
        pixels = camera.project(walking(len(stamps_s), clip.fps)) + rng.normal(0, 1, (len(stamps_s), 17, 2))
        seen = [
            People(
                np.zeros((1, 5)),
                px[None],
                np.ones((1, 17)),
                np.full((1, 17, 3), np.nan),
                np.full((1, 17, 3, 3), np.nan),
            )
            for px in pixels
        ]
        views.append(ViewDetections.stacked(stamps_s.tolist(), seen, skeleton.n_joints, ended=True))
    return Detected(sources, skeleton, tuple(views), 0)


def test_level_from_somebody_who_walks(
    filmed: tuple[Path, fgpose.CameraRig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, true = filmed
    monkeypatch.setattr(NetworkOptions, "detect_in", lambda _, sources, frames, console: walked(true, sources))
    path = tmp_path / "rig.toml"
    options = ["--board", FILMED.text, "--origin", "people", "--fps", "5", "--no-rrd", "-o", str(path)]
    assert main(["calibrate", str(folder), *options]) == 0
    assert "The world is level as somebody walked" in " ".join(capsys.readouterr().out.split())
    truth = rig_similarity(fgpose.load_rig(path), true, with_scale=False)
    # Four seconds of two cameras whose lenses are good to a percent.
    assert np.rad2deg(np.hypot(*truth.R[:2, 2])) < 2.0
    assert abs(truth.of(np.zeros(3))[2]) < 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--board", "chessboard:9x6"], "does not have the parts of a chessboard board"),
        (["--board", "no/such.toml"], "no/such.toml"),
        (["--board", FILMED.text, "--height", "1.8"], "--board takes scale and lenses from the board"),
        (["--board", FILMED.text, "--origin", "floor"], "the origin is board, board@SECONDS, camera, level or"),
        (["--board", FILMED.text, "--unsynchronised"], "camera ring_0: images have no times"),
        (
            ["--unsynchronised"],
            OF_BOARDS,
        ),
        (
            ["--board", FILMED.text, "--lenses-only", "--unsynchronised"],
            "--lenses-only has no world and no common clock",
        ),
        (["--board", FILMED.text, "--lenses-only", "--format", "npz"], "--lenses-only finds lenses and writes a .toml"),
        (
            ["--lens", "fisheye"],
            OF_BOARDS,
        ),
        (["--board", FILMED.text, "--cameras", "ring_0", "ring_7"], "ring_7"),
        (["--board", FILMED.text, "--cameras", "ring_0", "--origin", "people"], "--origin people needs two cameras"),
        (["--board", FILMED.text, "--intrinsics", "no/such.yml"], "no/such.yml"),
        # Said before the images are searched, where another would be "no image shows".
        (["--board", "chessboard:8x6:25mm"], "chessboard:8x6:25mm looks the same after half a turn"),
        (["--board", "charuco:6x5:160mm:120mm:DICT_6X6_50"], "camera ring_0, ring_1: no image shows charuco:6x5"),
    ],
)
def test_bad_input_is_one_error(
    options: list[str],
    message: str,
    filmed: tuple[Path, fgpose.CameraRig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert message in failure(["calibrate", str(filmed[0]), *options, "-o", str(tmp_path / "rig.toml")], capsys)
    assert list(tmp_path.iterdir()) == []


def test_an_image_of_another_size_is_named(
    filmed: tuple[Path, fgpose.CameraRig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import cv2

    folder = tmp_path / "images"
    shutil.copytree(filmed[0], folder)
    cv2.imwrite(str(folder / "ring_1" / "003.png"), np.zeros((50, 50), np.uint8))
    arguments = ["calibrate", str(folder), "--board", FILMED.text, "-o", str(tmp_path / "rig.toml")]
    assert "003.png: the image is 50 x 50, the first is 640 x 360" in failure(arguments, capsys)


@pytest.mark.filterwarnings("default")
def test_a_board_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.pdf"
    assert main(["board", "charuco:7x5:30mm:22mm:DICT_5X5_100", "-o", str(path)]) == 0
    assert "charuco:7x5:30mm:22mm:DICT_5X5_100 on A4 (297 x 210 mm). Print it at 100 %." in capsys.readouterr().out
    assert path.read_bytes().startswith(b"%PDF-1.4")
    assert main(["board", "chessboard:9x6:25mm", "-o", str(path)]) == 0
    assert capsys.readouterr().err == ""
    for board in ("chessboard:8x6:25mm", "circles:4x10:25mm"):
        assert main(["board", board, "-o", str(path)]) == 0
        assert f"warning: {board} looks the same after half a turn" in capsys.readouterr().err
    assert main(["board", "chessboard:9x6:25cm", "-o", str(path)]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "needs a sheet of 2.52 x 1.78 m, larger than A0. On A4 fit lengths of 26 mm in place of 250 mm" in said
    assert "a board is written as .pdf" in failure(["board", "chessboard:9x6:25mm", "-o", "board.png"], capsys)
