"""Why a view has no sound 3D, from the network that notices it to the table that fgpose prints."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tiny_blazepose as tiny

from fgpose.cli import main
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.calibration import save_rig
from fgpose.monocular.detection import detect
from fgpose.monocular.networks.blazepose import BlazePose
from fgpose.monocular.sources import Sources, open_sources

FPS = 20.0
N_IMAGES, N_CUT = 6, 4
# The person goes to the right and out of the image of the camera "edge", in the last N_CUT images.
INSIDE, CUT = (13, 13), (22, 13)


def camera(name: str) -> Camera:
    K = np.array([[700.0, 0.0, 170.0], [0.0, 690.0, 220.0], [0.0, 0.0, 1.0]])
    world_T_camera = np.eye(4)
    world_T_camera[0, 3] = 1.0 if name == "edge" else 0.0
    return Camera(name, tiny.SIZE_PX, K, world_T_camera, np.zeros(0))


RIG = CameraRig((camera("edge"), camera("middle")))


def networks(folder: Path) -> tuple[Path, Path]:
    """Landmarks and detector; the landmarks fit their 3D joints about 4.3 m in front of the camera."""
    truth_m = np.random.default_rng(5).uniform((-0.4, -0.7, 4.0), (0.4, 0.7, 4.6), (33, 3))
    points_px = RIG.cameras[1].project(truth_m)
    to_crop = tiny.detected_region(*INSIDE).crop_T_image(256)
    offsets_px = (points_px - tiny.square_middle_px(*INSIDE)) @ to_crop[:, :2].T
    relative_m = tiny.turned(truth_m - truth_m.mean(axis=0), -tiny.LEAN_RAD)
    return tiny.landmarks(folder / "landmarks.onnx", offsets_px, relative_m), tiny.detector(folder / "detector.onnx")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Folder of the images, lossless as the networks want their red pure; the calibration is beside it."""
    for name in RIG.names:
        (tmp_path / "walk" / name).mkdir(parents=True)
        for n in range(N_IMAGES):
            cut = name == "edge" and n >= N_IMAGES - N_CUT
            image = cv2.cvtColor(tiny.scene(CUT if cut else INSIDE), cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(tmp_path / "walk" / name / f"{n}.png"), image)
    save_rig(RIG, tmp_path / "Calib.toml")
    return tmp_path / "walk"


@pytest.fixture
def sources(recording: Path) -> Sources:
    return open_sources(recording, RIG, fps=FPS)


def test_problems_are_those_of_the_person_and_survive_the_cache(sources: Sources, tmp_path: Path) -> None:
    network = BlazePose(*networks(tmp_path))
    first = detect(sources, network, cache=tmp_path / "cache").follow()
    again = detect(sources, network, cache=tmp_path / "cache")
    assert again.n_new_images == 0
    for problems in (first.problems, again.follow().problems):
        cut = np.array([[problem.startswith("cut by the border: ") for problem in row] for row in problems])
        np.testing.assert_array_equal(cut[:, 0], np.arange(N_IMAGES) >= N_IMAGES - N_CUT)
        assert (problems[~cut] == "").all()
    np.testing.assert_array_equal(first.problems, again.follow().problems)


@pytest.mark.parametrize("cameras", [("edge", "middle"), ("middle",)])
def test_detect_prints_how_many_images_had_which_problem(
    cameras: tuple[str, ...], recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    landmarks, detector = networks(tmp_path)
    arguments = ["detect", str(recording), "--rig", str(recording.parent / "Calib.toml"), "--fps", str(FPS)]
    arguments += ["--model", str(landmarks), "--network", "blazepose", "--detector", str(detector)]
    arguments += ["--cache", str(tmp_path / "cache"), "-o", str(tmp_path / "out"), "--cameras", *cameras]
    for _ in ("from the network", "from the cache"):
        assert main(arguments) == 0
        printed = capsys.readouterr().out
        rows = [line.split(": ")[1].split() for line in printed.splitlines() if "3D missing or uncertain" in line]
        # Only when there are any.
        assert rows == ([["cut", "by", "the", "border", str(N_CUT), "0"]] if "edge" in cameras else [])
