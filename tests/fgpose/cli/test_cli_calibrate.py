"""fgpose calibrate and fgpose run --calibrate, with a chain that knows the truth in place of the real one."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from calibrated_walks import FPS, N_FRAMES, Chain, calibrated, failure, named, seen_px, true_rig, write_openpose
from rrd_contents import entities, rows, static_value

import fgpose
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, CalibrationFinding, Grade
from fgpose.cli import main
from fgpose.io.calibration import CalibrationOrigin, load_calibration_origin, load_rig, save_rig
from fgpose.io.calibration.calibration_origin import MovedCamera, Reason
from fgpose.io.trajectories import load_trajectory
from fgpose.people_observations import PeopleObservations
from tests.wrong_rigs import turned

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

pytestmark = pytest.mark.usefixtures("without_search_for_faults")
NAMES = ("cam1", "cam2", "cam3")
COARSE = CalibrationFinding("cam3", Grade.COARSE, "the person was on one line only", "walk across its view")
WHOLE = Reason("", "coarse", "few people", "walk longer")
BAD = CalibrationFinding("", Grade.FAILED, "the cameras do not agree", "walk where all cameras see you")


@pytest.fixture
def chain(monkeypatch: pytest.MonkeyPatch, without_search_for_faults: None) -> Chain:
    chain = Chain()
    monkeypatch.setattr("fgpose.calibration.from_people.calibrate.calibrate_from_people", chain)
    return chain


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_openpose(tmp_path_factory.mktemp("walk") / "pose", seen_px(true_rig()))


@pytest.fixture
def source(keypoints: Path) -> list[str]:
    return ["calibrate", str(keypoints), "--skeleton", "coco_17", "--fps", str(FPS)]


def plain(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def test_help_explains_and_gives_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["calibrate", "--help"])
    assert end.value.code == 0
    printed = plain(capsys.readouterr().out)
    assert "Example: fgpose calibrate videos/ --intrinsics Lens.toml --height 1.78 -o rig.toml" in printed
    for option in ("--focal-px", "--distance", "--synchronised", "--from", "--size", "--format", "--skeleton", "--fps"):
        assert option in printed


def test_keypoints_become_a_rig_a_scene_a_table_and_a_verdict(
    source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chain.findings = (COARSE,)
    options = ["--focal-px", "1145", "--size", "1920x1080", "--height", "1.78", "--distance", "cam1", "cam3", "4.2"]
    assert main([*source, *options, "-o", str(tmp_path / "out" / "rig.toml")]) == 0
    assert chain.given["stature_m"] == 1.78
    assert chain.given["distances"] == (("cam1", "cam3", 4.2),)
    assert (chain.given["focal"], chain.given["synchronised"]) == ("known", False)
    assert chain.intrinsics is not None
    assert [camera.size_px for camera in chain.intrinsics.cameras] == [(1920, 1080)] * 3
    np.testing.assert_array_equal(chain.intrinsics.cameras[1].world_T_camera, np.eye(4))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["rig.rrd", "rig.toml"]
    rig = load_rig(tmp_path / "out" / "rig.toml")
    assert rig.names == NAMES
    np.testing.assert_array_equal(rig.time_offsets_s, [0.0, 61.25, -0.5])
    known = load_calibration_origin(tmp_path / "out" / "rig.toml")
    assert known.grade == "coarse"
    assert known.findings == (Reason("cam3", "coarse", COARSE.reason, COARSE.remedy),)
    assert known.offset_sigma_s == {"cam2": 0.002, "cam3": 0.002}
    printed = capsys.readouterr()
    for words in (
        "start [s] 0.000 61.250 -0.500",
        "± [%] given 1.2 1.2",
        f"joints used {N_FRAMES * 17}",
        "Scale from stature 1.78 m, ± 1.5 %; vertical ± 0.5 deg; floor ± 12 mm.",
        "Verdict: coarse",
        "camera cam3: the person was on one line only. Remedy: walk across its view.",
    ):
        assert words in plain(printed.out)
    assert "calibrating" in printed.err


def test_a_failed_calibration_writes_no_rig_but_shows_why(
    source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chain.findings = (COARSE, BAD, replace(COARSE, camera="cam1"))
    rig = tmp_path / "rig.toml"
    save_rig(true_rig(), rig, origin=CalibrationOrigin(step="calibrate"))
    older = rig.read_bytes()
    assert main([*source, "--focal-px", "1145", "--size", "1920x1080", "-o", str(rig)]) == 1
    assert rig.read_bytes() == older
    assert (tmp_path / "rig.rrd").exists()
    printed = capsys.readouterr()
    assert "the calibration has failed" in printed.err
    lines = [line for line in printed.out.splitlines() if line.startswith(("Verdict", "- "))]
    # The gravest first.
    assert [line.partition(":")[0] for line in lines] == ["Verdict", "- failed, all cameras", "- coarse, camera cam3"]
    # What the same helps against, together.
    assert "line only; camera cam1: the person was on one line only. Remedy: walk across its view." in plain(
        printed.out
    )


@pytest.mark.filterwarnings("default")
def test_with_nothing_known_all_is_guessed_and_said(
    source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*source, "--synchronised", "--no-rrd", "-o", str(tmp_path / "rig.npz")]) == 0
    assert (chain.given["focal"], chain.given["synchronised"], chain.given["stature_m"]) == ("shared", True, None)
    printed = capsys.readouterr()
    assert "Focal lengths are estimated, one for all cameras. They begin at cam1 1632" in plain(printed.out)
    assert "taken to be cam1 1920 x 1080" in printed.err
    assert [path.name for path in tmp_path.iterdir()] == ["rig.npz"]


def test_which_cameras_share_a_focal_length_is_said(
    source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lying and upright images are of one kind of camera, and are not estimated together."""
    sizes_px = [(1920, 1080), (1080, 1920), (1920, 1080)]
    monkeypatch.setattr("fgpose.io.keypoints.likely_sizes_px", lambda people: sizes_px)
    monkeypatch.setattr("fgpose.io.keypoints.check_sizes", lambda people, rig: None)
    assert main([*source, "--no-rrd", "-o", str(tmp_path / "rig.npz")]) == 0
    assert chain.given["focal"] == "shared"
    said = "Focal lengths are estimated, one for cam1 and cam3, one for cam2, as their images have the same size."
    assert said in plain(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("file_format", "name", "written"),
    [
        pytest.param("aniposelib", "rig.toml", ["rig.rrd", "rig.toml"], marks=pytest.mark.slow),
        ("caliscope", "rig.toml", ["rig.rrd", "rig.toml"]),
        ("easymocap", "rig", ["rig", "rig.rrd"]),
    ],
)
@pytest.mark.filterwarnings("default")
def test_the_formats_of_others(
    file_format: str, name: str, written: list[str], source: list[str], chain: Chain, tmp_path: Path
) -> None:
    options = ["--focal-px", "1145", "--size", "1920x1080", "--format", file_format]
    assert main([*source, *options, "-o", str(tmp_path / name)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == written
    assert load_rig(tmp_path / name).names == NAMES
    if file_format == "caliscope":
        assert list(tomllib.loads((tmp_path / name).read_text())) == ["cameras"]


def test_intrinsics_of_a_file(source: list[str], chain: Chain, tmp_path: Path) -> None:
    save_rig(named(true_rig(), ["CAM_1", "CAM_2", "CAM_3"]), tmp_path / "lens.toml")
    assert main([*source, "--intrinsics", str(tmp_path / "lens.toml"), "-o", str(tmp_path / "rig.toml")]) == 0
    assert chain.given["focal"] == "known"
    assert chain.intrinsics is not None
    assert chain.intrinsics.names == NAMES
    np.testing.assert_array_equal(chain.intrinsics.cameras[0].K, true_rig().cameras[0].K)
    options = ["--intrinsics", str(tmp_path / "lens.toml"), "--focal", "each", "--no-rrd"]
    assert main([*source, *options, "-o", str(tmp_path / "rig.toml")]) == 0
    assert chain.given["focal"] == "each"


@pytest.fixture
def network(squares_network: SquaresNetwork, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SquaresNetwork:
    """In place of every network. The videos here are short."""
    monkeypatch.setattr("fgpose.calibration.from_people.walk.SHORT_S", 0.1)
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("fgpose.monocular.networks.open_network", lambda *arguments, **options: squares_network)
    return squares_network


def squares_result(
    squares: SquaresScene, offsets_s: Sequence[float] = (0.0, 0.0, 0.0), findings: Sequence[CalibrationFinding] = ()
) -> Callable[[PeopleObservations, fgpose.CameraRig], CalibratedFromPeople]:
    """The true rig of the squares. The walk in it is somebody else's, which only the picture shows."""

    def result(people: PeopleObservations, intrinsics: fgpose.CameraRig) -> CalibratedFromPeople:
        return calibrated(people, squares.rig, findings, offsets_s)

    return result


def test_videos_are_detected_with_the_intrinsics(
    squares: SquaresScene, network: SquaresNetwork, chain: Chain, tmp_path: Path
) -> None:
    squares.write_all(tmp_path / "walk", 6)
    chain.result = squares_result(squares)
    arguments = ["calibrate", str(tmp_path / "walk"), "--focal-px", "300", "--frames", "4"]
    assert main([*arguments, "-o", str(tmp_path / "rig.toml")]) == 0
    assert len(network.seen) == 12
    # The images that were looked at, in the frames of the walk that are nearest to them; then none is shown.
    pictures = rows(tmp_path / "rig.rrd", "/world/camera/ring_1/image/picture", "EncodedImage:blob")
    assert {frame: len(blob) for frame, (_, blob) in sorted(pictures.items())} == {0: 1, 1: 1, 2: 1, 3: 1, 5: 0}
    assert chain.people is not None
    assert chain.people.camera_names == squares.rig.names
    # In the frame of each camera: the network sees them 4 m away.
    in_3d = chain.people.by_camera["ring_1"][0].points3d_m
    assert in_3d is not None
    np.testing.assert_allclose(in_3d[..., 2], network.depth_m)
    squares.write_all(tmp_path / "alone" / "x", 6)
    for name in squares.rig.names[1:]:
        (tmp_path / "alone" / "x" / f"{name}.mp4").unlink()
    assert main(["calibrate", str(tmp_path / "alone" / "x"), "-o", str(tmp_path / "rig.toml")]) == 2


def test_run_goes_from_bare_videos_to_the_motion(
    squares: SquaresScene,
    network: SquaresNetwork,
    chain: Chain,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Videos that began at different moments, and no calibration."""
    late = (0.0, 0.5, -0.25)
    for c, name in enumerate(squares.rig.names):
        squares.write_video(tmp_path / "walk" / f"{name}.mp4", c, 24, begin_s=late[c])
    chain.result = squares_result(squares, late)
    arguments = ["run", str(tmp_path / "walk"), "--calibrate", "--height", "1.8", "--formats", "npz"]
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 0
    assert chain.given["stature_m"] == 1.8
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"walk.npz", "walk_calibration.toml"}
    trajectory = load_trajectory(tmp_path / "out" / "walk.npz")
    # By the clock of the first camera; a pixel is 13 mm at 4 m, and the squares are found to about one, at the ends by
    # two cameras only.
    seen = (trajectory.status == fgpose.Status.OBSERVED).all(axis=1)
    assert seen.sum() >= 12
    truth_m = np.stack([squares.positions_m(t)[0] for t in trajectory.time_s])
    np.testing.assert_allclose(trajectory.positions_m[seen], truth_m[seen], atol=0.05)
    # Later, with the calibration that it wrote.
    n_seen = len(network.seen)
    again = ["run", str(tmp_path / "walk"), "--rig", str(tmp_path / "out" / "walk_calibration.toml")]
    assert main([*again, "--formats", "npz", "-o", str(tmp_path / "again")]) == 0
    assert len(network.seen) >= n_seen
    same = load_trajectory(tmp_path / "again" / "walk.npz")
    np.testing.assert_allclose(same.time_s, trajectory.time_s, atol=1e-9)


def test_run_ends_where_the_calibration_fails(
    squares: SquaresScene, network: SquaresNetwork, chain: Chain, tmp_path: Path
) -> None:
    squares.write_all(tmp_path / "walk", 6)
    chain.result = squares_result(squares, findings=(BAD,))
    arguments = ["run", str(tmp_path / "walk"), "--calibrate", "--formats", "npz", "rrd", "-o", str(tmp_path / "out")]
    assert main(arguments) == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["walk_calibration.rrd"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "give either --rig FILE, or --calibrate"),
        (["--rig", "a.toml", "--calibrate"], "give either --rig FILE, or --calibrate"),
        (["--rig", "a.toml", "--height", "1.8"], "go with --calibrate, not --rig"),
        (["--calibrate", "--height", "180"], "--height: a stature is in metres"),
        (["--calibrate", "--world-up", "y"], "has z up"),
        (["--calibrate", "--distance", "ring_0", "ring_7", "3"], "there is no camera ring_7"),
    ],
)
def test_run_asks_for_cameras(
    options: list[str],
    message: str,
    squares: SquaresScene,
    network: SquaresNetwork,
    chain: Chain,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    squares.write_all(tmp_path / "walk", 3)
    assert message in failure(["run", str(tmp_path / "walk"), *options, "-o", str(tmp_path / "out")], capsys)
    assert network.seen == []


def test_a_bumped_camera_is_named_and_the_rest_is_kept(
    source: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = named(true_rig(), NAMES).with_time_offsets(np.array([0.0, 0.002, 0.0]))
    known = CalibrationOrigin({"cam2": 0.003}, (MovedCamera("cam3", 0.1, 0.01),), "coarse", (WHOLE,))
    save_rig(turned(rig, 1, 2.0), tmp_path / "old.toml", origin=known)
    assert main([*source, "--from", str(tmp_path / "old.toml"), "-o", str(tmp_path / "new.toml")]) == 0
    printed = plain(capsys.readouterr().out)
    assert "Moved: cam2. The others keep their poses." in printed
    assert re.search(r"turned by \[deg\] 0\.00 [12]\.\d\d 0\.00", printed)
    assert "Verdict: good" in printed
    found, old = load_rig(tmp_path / "new.toml"), load_rig(tmp_path / "old.toml")
    np.testing.assert_array_equal(found.time_offsets_s, rig.time_offsets_s)
    # What was known before stays; what has moved is of the last time.
    after = load_calibration_origin(tmp_path / "new.toml")
    assert (after.offset_sigma_s, after.grade, after.findings) == (known.offset_sigma_s, "coarse", (WHOLE,))
    assert [each.camera for each in after.moved] == ["cam2"]
    assert after.moved[0].rotation_deg > 1
    for c in (0, 2):
        np.testing.assert_allclose(found.cameras[c].world_T_camera, old.cameras[c].world_T_camera, atol=1e-12)
    # The one that was moved is shown where it was, too.
    K = static_value(tmp_path / "new.rrd", "/world/cameras_before/cam2", "Pinhole:image_from_camera")
    np.testing.assert_allclose(np.reshape(K, (3, 3)).T, rig.cameras[1].K)
    label = static_value(tmp_path / "new.rrd", "/world/camera_moves/names", "Points3D:labels")
    assert label == "cam2, before"
    assert "/world/walk/bones" in entities(tmp_path / "new.rrd")
    assert "Moved: cam2." in static_value(tmp_path / "new.rrd", "/report", "TextDocument:text")
    # Keypoints are exact here; 1.2 m/s times 2 ms are 0.5 px. What a turn of 2 degrees moves is 40 px.
    moved_px = found.cameras[1].project(np.zeros((1, 3))) - rig.cameras[1].project(np.zeros((1, 3)))
    assert np.abs(moved_px).max() < 2


def test_a_result_never_replaces_its_input(source: list[str], tmp_path: Path, capsys: Any) -> None:
    save_rig(named(true_rig(), NAMES), tmp_path / "rig.toml")
    before = (tmp_path / "rig.toml").read_bytes()
    arguments = [*source, "--from", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "rig.toml")]
    assert "would replace an input" in failure(arguments, capsys)
    assert (tmp_path / "rig.toml").read_bytes() == before


def test_the_scene_beside_the_rig(source: list[str], chain: Chain, tmp_path: Path) -> None:
    assert main([*source, "--focal-px", "1145", "--size", "1920x1080", "-o", str(tmp_path / "rig.toml")]) == 0
    assert "/world/walk/joints" in entities(tmp_path / "rig.rrd")


def test_the_demonstration_throws_the_calibration_away(
    squares: SquaresScene,
    network: SquaresNetwork,
    chain: Chain,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    squares.write_all(tmp_path / "demo" / "videos", 4)
    save_rig(squares.rig, tmp_path / "demo" / "calibration" / "Calib.toml")
    (tmp_path / "demo" / "calibration" / "Calib.toml").rename(tmp_path / "demo" / "calibration" / "Calib.qca.txt")
    monkeypatch.setattr("fgpose.monocular.downloads.demo_videos.fetch_demo_videos", lambda **options: tmp_path / "demo")
    chain.result = squares_result(squares)
    assert main(["demo", "--calibrate", "--output", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["demo_calibrated.rrd", "demo_calibrated.toml"]
    assert chain.intrinsics is not None
    np.testing.assert_array_equal(chain.intrinsics.cameras[0].world_T_camera, np.eye(4))
    np.testing.assert_allclose(chain.intrinsics.cameras[0].K, squares.rig.cameras[0].K)
    assert re.search(r"demo_calibrated\.rrd +the cameras and the verdict: ", capsys.readouterr().out)


def test_a_camera_that_could_not_be_calibrated_is_left_out(
    squares: SquaresScene, network: SquaresNetwork, chain: Chain, tmp_path: Path
) -> None:
    squares.write_all(tmp_path / "walk", 12)
    kept = ["ring_0", "ring_2"]
    chain.result = lambda people, intrinsics: calibrated(people, squares.rig.subset(kept))
    arguments = ["run", str(tmp_path / "walk"), "--calibrate", "--formats", "npz", "rrd", "-o", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert load_rig(tmp_path / "out" / "walk_calibration.toml").names == tuple(kept)
    trajectory = load_trajectory(tmp_path / "out" / "walk.npz")
    assert trajectory.camera_names == tuple(kept)
    # Two cameras at 120 degrees; a pixel is 13 mm.
    truth_m = np.stack([squares.positions_m(t)[0] for t in trajectory.time_s])
    np.testing.assert_allclose(trajectory.positions_m, truth_m, atol=0.04)
