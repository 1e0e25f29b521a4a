"""Bad input of fgpose calibrate: one error that names it, before any work, and no file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from calibrated_walks import FPS, Chain, failure, named, seen_px, true_rig, write_openpose

from fgpose.cli import main
from fgpose.io.calibration import save_rig

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresScene

NAMES = ("cam1", "cam2", "cam3")


@pytest.fixture
def chain(monkeypatch: pytest.MonkeyPatch) -> Chain:
    chain = Chain()
    monkeypatch.setattr("fgpose.calibration.from_people.calibrate.calibrate_from_people", chain)
    return chain


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_openpose(tmp_path_factory.mktemp("walk") / "pose", seen_px(true_rig()))


@pytest.fixture
def source(keypoints: Path) -> list[str]:
    return ["calibrate", str(keypoints), "--skeleton", "coco_17", "--fps", str(FPS)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--height", "178"], "--height: a stature is in metres: 1.78, not 178"),
        (["--height", "5"], "--height: a stature is from 0.7 to 2.5 metres, got 5"),
        (["--distance", "cam1", "cam9", "4.2"], "--distance: there is no camera cam9; there are cam1, cam2, cam3"),
        (["--distance", "cam1", "cam1", "4.2"], "two different cameras"),
        (["--distance", "cam1", "cam2", "4200"], "more than 0 and at most 100 metres"),
        (["--cameras", "cam1"], "one camera (cam1) cannot be calibrated; two are needed"),
        (["--cameras", "cam1", "cam9"], "no camera cam9"),
        (["--sound"], "--sound needs videos"),
        (["--sound", "--synchronised"], "both say when the cameras began"),
        (["--size", "1080p"], "--size is width x height in pixels, as 1920x1080, got '1080p'"),
        (["--size", "1280x720"], "joints reach to"),
        (["--focal", "known"], "--focal known needs --intrinsics or --focal-px"),
        (["--distance", "cam1", "cam2", "0"], "--distance cam1 cam2 0: a distance is more than 0"),
        (["--intrinsics", "no/such.toml"], "no/such.toml"),
        (["--intrinsics", "a.toml", "--focal-px", "1000"], "leave one of them out"),
        (["--format", "easymocap"], "easymocap is written into a folder"),
        (["--from", "no/such.toml", "--height", "1.8"], "--from takes lenses, scale and clocks from its rig"),
        (["--from", "no/such.toml"], "no/such.toml"),
        (["--skeleton", "body_25"], "body_25"),
    ],
)
@pytest.mark.filterwarnings("default")
def test_bad_input_is_one_error_before_any_work(
    options: list[str],
    message: str,
    source: list[str],
    chain: Chain,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    size = [] if "--size" in options else ["--size", "1920x1080"]
    assert message in failure([*source, *size, *options, "-o", str(tmp_path / "rig.toml")], capsys)
    assert chain.given == {}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("of_two.toml", "of_two.toml: it has no camera cam3, only cam1, cam2"),
        ("others.toml", "others.toml: it has no camera cam1, cam2, cam3, only left, right, top"),
        ("truncated.toml", "truncated.toml: no intrinsics, or a damaged file"),
        ("empty.toml", "empty.toml: the file is empty"),
        ("photo.png", "photo.png: no intrinsics, or a damaged file"),
        ("of_720p.yml", "(640, 360) is far from the middle of an image of 1920 x 1080: these intrinsics are for"),
    ],
)
def test_intrinsics_that_do_not_fit(
    name: str, message: str, source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = named(true_rig(), NAMES)
    save_rig(rig.subset(NAMES[:2]), tmp_path / "of_two.toml")
    save_rig(named(true_rig(), ["left", "right", "top"]), tmp_path / "others.toml")
    save_rig(rig, tmp_path / "whole.toml")
    whole = (tmp_path / "whole.toml").read_bytes()
    (tmp_path / "truncated.toml").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.toml").touch()
    (tmp_path / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(64))
    (tmp_path / "of_720p.yml").write_text("camera_matrix: [[1000, 0, 640], [0, 1000, 360], [0, 0, 1]]\ndist: []")
    arguments = ["--size", "1920x1080", "--intrinsics", str(tmp_path / name), "-o", str(tmp_path / "rig.toml")]
    assert message in failure([*source, *arguments], capsys)
    assert chain.given == {}
    assert not (tmp_path / "rig.toml").exists()


@pytest.mark.parametrize(
    ("output", "message"),
    [("folder.toml", "folder.toml is a folder"), ("a_file/rig.toml", "cannot write results into ")],
)
def test_a_result_that_cannot_be_written(
    output: str, message: str, source: list[str], chain: Chain, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "folder.toml").mkdir()
    (tmp_path / "a_file").touch()
    arguments = ["--focal-px", "1145", "--size", "1920x1080", "-o", str(tmp_path / output)]
    assert message in failure([*source, *arguments], capsys)
    assert chain.given == {}


def test_what_allows_no_calibration_is_said_and_nothing_is_written(
    keypoints: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The real chain: in 2 s of unknown starts nothing is found.
    arguments = ["calibrate", str(keypoints), "--skeleton", "coco_17", "--fps", str(FPS), "--size", "1920x1080"]
    assert main([*arguments, "--focal-px", "1145", "-o", str(tmp_path / "rig.toml")]) == 2
    printed = capsys.readouterr().err
    assert f"fgpose: the calibration has failed; {tmp_path / 'rig.toml'} was not written" in printed
    assert "cam1, cam2, cam3: the person is seen for 2.0 s only: too short" in printed
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [["calibrate"], ["run", "--calibrate"]])
def test_without_the_weights_of_a_network(
    command: list[str],
    squares: SquaresScene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def unreachable(*arguments: Any, **options: Any) -> Any:
        raise OSError("cannot fetch the PyPI package weights 1.2: no route to host")

    monkeypatch.setattr("fgpose.monocular.networks.open_network", unreachable)
    squares.write_all(tmp_path / "walk", 3)
    arguments = [*command, str(tmp_path / "walk"), "-o", str(tmp_path / "out" / "rig.toml")]
    assert "cannot fetch the PyPI package weights 1.2" in failure([*arguments, "--synchronised"], capsys)
    # Too short to find when they begin, which is said before the network is opened.
    assert "too short to find when each of them begins" in failure(arguments, capsys)
    assert not [path for path in (tmp_path / "out").rglob("*") if path.is_file()]


def test_what_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    line = failure(["calibrate", str(tmp_path / "empty"), "-o", str(tmp_path / "rig.toml")], capsys)
    assert "no keypoints" in line
    assert "nor is there a video" in line
    assert "no such file" in failure(["calibrate", str(tmp_path / "absent"), "-o", str(tmp_path / "rig.toml")], capsys)
    (tmp_path / "cam1").mkdir()
    cv2.imwrite(str(tmp_path / "cam1" / "0001.png"), np.zeros((8, 8), np.uint8))
    assert "the images of one camera" in failure(["calibrate", str(tmp_path / "cam1"), "-o", "rig.toml"], capsys)
    (tmp_path / "mine").mkdir()
    for camera in ("cam1", "cam2"):
        images = [{"frame_id": 0, "instances": [{"keypoints": [[1, 2]] * 25, "keypoint_scores": [0.9] * 25}]}]
        (tmp_path / "mine" / f"{camera}.json").write_text(json.dumps({"instance_info": images}))
    line = failure(["calibrate", str(tmp_path / "mine"), "-o", str(tmp_path / "rig.toml")], capsys)
    assert "give the skeleton (--skeleton): of 25 joints is body_25 or body_25b" in line


def test_nobody_in_the_keypoints(tmp_path: Path, chain: Chain, capsys: pytest.CaptureFixture[str]) -> None:
    # OpenPose writes 0, 0, 0 for a joint that it does not find.
    folder = write_openpose(tmp_path / "pose", np.zeros((3, 2, 17, 2)))
    for file in folder.rglob("*.json"):
        file.write_text(file.read_text().replace("0.9", "0.0"))
    arguments = ["calibrate", str(folder), "--skeleton", "coco_17", "--fps", "20", "-o", str(tmp_path / "rig.toml")]
    assert "no joint in any camera" in failure(arguments, capsys)
