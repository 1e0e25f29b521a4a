"""Films with people drawn into them: what is where, at which time."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from jaxtyping import UInt8

import fgpose
from fgpose.cli import main
from fgpose.geometry.camera import CameraRig
from fgpose.io.made_by import made_by
from fgpose.io.origin import Origin
from fgpose.monocular.sources import open_sources
from fgpose.overlay.drawing import Drawing, Pose
from fgpose.overlay.moments import Moments
from fgpose.pipeline.origin import video_files
from fgpose.trajectory import Status
from fgpose.viewer.rerun.palette import person_colour

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

FPS = 20.0
LATE_S = 0.13


def trajectory(squares: SquaresScene, n_frames: int) -> fgpose.Trajectory:
    time_s = np.arange(n_frames) / FPS
    skeleton = fgpose.Skeleton("squares", ("pelvis", "left_hand", "right_hand"), ((0, 1), (0, 2)), (0,), ((1, 2),))
    positions_m = np.stack([squares.positions_m(each)[0] for each in time_s])
    status = np.full((n_frames, 3), Status.OBSERVED)
    return fgpose.Trajectory(skeleton, time_s, positions_m, status, np.tile(1e-4 * np.eye(3), (n_frames, 3, 1, 1)))


@pytest.fixture
def recorded(squares: SquaresScene, tmp_path: Path) -> list[str]:
    """Three cameras: one has begun late, as its calibration says, one has half of the rate."""
    squares.write_video(tmp_path / "walk" / "ring_0.mp4", 0, 20, FPS)
    squares.write_video(tmp_path / "walk" / "ring_1.mp4", 1, 18, FPS, begin_s=LATE_S)
    squares.write_video(tmp_path / "walk" / "ring_2.mp4", 2, 10, FPS / 2)
    late = (replace(camera, time_offset_s=LATE_S if n == 1 else 0.0) for n, camera in enumerate(squares.rig.cameras))
    fgpose.save_rig(CameraRig(tuple(late)), tmp_path / "rig.toml")
    fgpose.save_trajectory(trajectory(squares, 20), tmp_path / "pose.npz")
    return ["overlay", *(str(tmp_path / name) for name in ("pose.npz", "walk")), "--rig", str(tmp_path / "rig.toml")]


def film(path: Path) -> tuple[np.ndarray, list[UInt8[np.ndarray, "height width 3"]]]:
    """Times and images."""
    import av

    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    return np.array([float(frame.time) for frame in frames]), [frame.to_ndarray(format="rgb24") for frame in frames]


def is_drawn(image: np.ndarray, at_px: np.ndarray, person: int = 0) -> bool:
    """Whether most of the pixels around a point have the colour of the person; compression changes them by tens."""
    x, y = np.round(at_px).astype(int)
    around = image[y - 1 : y + 2, x - 1 : x + 2].astype(int)
    return bool((np.abs(around - person_colour(person)).max(axis=-1) < 70).mean() > 0.5)


def has_white(image: np.ndarray, at_px: np.ndarray) -> bool:
    """Whether the line of an ellipse, a pixel wide, goes through a point, which is known to a pixel."""
    x, y = np.round(at_px).astype(int)
    return bool((image[y - 1 : y + 2, x - 1 : x + 2].min(axis=-1) > 200).any())


def test_every_camera_has_a_film_with_the_person_where_its_images_were_taken(
    recorded: list[str], squares: SquaresScene, tmp_path: Path
) -> None:
    assert main([*recorded, "--each", "--no-ellipses", "--width", "640", "-o", str(tmp_path / "film.mp4")]) == 0
    for n, (fps, begin_s) in enumerate([(FPS, 0.0), (FPS, LATE_S), (FPS / 2, 0.0)]):
        time_s, images = film(tmp_path / f"film_ring_{n}.mp4")
        np.testing.assert_allclose(time_s, np.arange(len(images)) / fps, atol=1e-4)
        for number in (0, 4, 8):
            true_m = squares.positions_m(begin_s + number / fps)[0]
            for point_px in squares.rig.cameras[n].project(true_m):
                assert is_drawn(images[number], 2 * point_px), (n, number)


def test_all_cameras_are_in_one_film_at_the_rate_of_the_fastest(
    recorded: list[str], squares: SquaresScene, tmp_path: Path
) -> None:
    assert main([*recorded, "--no-ellipses", "--width", "968", "-o", str(tmp_path / "film.mp4"), "--to", "0.5"]) == 0
    time_s, images = film(tmp_path / "film.mp4")
    np.testing.assert_allclose(time_s, np.arange(11) / FPS, atol=1e-4)
    # Two columns of 482 pixels, 4 between them, are nearer to 16:9 than a row of three.
    assert images[0].shape == (2 * 362 + 4, 968, 3)
    half = squares.rig.cameras[0].project(squares.positions_m(0.3)[0])[0]
    assert is_drawn(images[6], 482 / 320 * half)
    # That which has begun late is black until then.
    assert images[1][:300, 500:].max() < 40
    assert images[6][:300, 500:].max() > 150


@pytest.mark.usefixtures("recorded")
@pytest.mark.filterwarnings("default")
def test_videos_of_another_recording_are_told(
    squares: SquaresScene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = open_sources(tmp_path / "walk", squares.rig)
    origin = Origin(rig=squares.rig).with_inputs(*video_files(sources.clips))
    fgpose.save_trajectory(trajectory(squares, 20), tmp_path / "pose.parquet", origin=origin)
    overlay = [str(tmp_path / "pose.parquet"), str(tmp_path / "walk"), "-o", str(tmp_path / "film.mp4"), "--to", "0.1"]
    assert main(["overlay", *overlay]) == 0
    assert "is not the file" not in capsys.readouterr().err
    squares.write_video(tmp_path / "walk" / "ring_1.mp4", 1, 12, FPS)
    assert main(["overlay", *overlay]) == 0
    assert "ring_1.mp4 is not the file that the result was made from" in capsys.readouterr().err


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("first", "code"), [(0, 0), (1, 0), (1000, 2)])
def test_a_result_of_other_times_is_told(
    recorded: list[str],
    squares: SquaresScene,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    first: int,
    code: int,
) -> None:
    """Keypoints that are not numbered as the images: from 1, and from 1000."""
    walking = trajectory(squares, 20)
    fgpose.save_trajectory(replace(walking, time_s=walking.time_s + first / FPS), tmp_path / "pose.npz")
    assert main([*recorded, "-o", str(tmp_path / "film.mp4"), "--to", "100"]) == code
    said = {
        0: "",
        1: "pose.npz: the result begins and ends 1 image after those of a camera, and is as long",
        1000: "the result is from 50 s to 50.95 s, the images are from 0 s to 0.98 s: they have no time in common",
    }
    error = capsys.readouterr().err
    assert said[first] in error
    assert ("number both alike" in error) == (first > 0)
    assert (tmp_path / "film.mp4").exists() == (code == 0)


def test_what_is_predicted_is_hollow_and_the_ellipse_holds_95_percent(squares: SquaresScene) -> None:
    camera, walking = squares.rig.cameras[0], trajectory(squares, 2)
    status = np.array([Status.OBSERVED, Status.PREDICTED, Status.OBSERVED])
    # Across and upwards, as the camera sees it.
    across, up = camera.world_T_camera[:3, 0], np.array([0.0, 0.0, 1.0])
    covariance_m2 = np.tile(0.05**2 * (np.outer(across, across) + np.outer(up, up)), (3, 1, 1))
    pose = Pose(0, walking.positions_m[0], status, covariance_m2)
    image = np.full((960, 1280, 3), 60, np.uint8)
    Drawing(walking.skeleton, ellipses=True, numbers=False).add(image, camera, pose, scale=4.0)
    places_px = 4 * camera.project(walking.positions_m[0])
    assert is_drawn(image, places_px[0])
    assert not is_drawn(image, places_px[1]), "hollow"
    # Upwards 95 % of two normal coordinates are within 2.45 standard deviations.
    top_px = 4 * camera.project(walking.positions_m[0, 0] + [0.0, 0.0, 2.4477 * 0.05])
    assert has_white(image, top_px)


def test_the_ellipse_of_a_well_known_joint_is_not_covered_by_its_dot(squares: SquaresScene) -> None:
    camera, walking = squares.rig.cameras[0], trajectory(squares, 2)
    sigma_m = 0.005
    pose = Pose(0, walking.positions_m[0], walking.status[0], np.tile(sigma_m**2 * np.eye(3), (3, 1, 1)))
    image = np.full((960, 1280, 3), 60, np.uint8)
    Drawing(walking.skeleton, ellipses=True, numbers=False).add(image, camera, pose, scale=4.0)
    joint_px, top_px = (
        4 * camera.project(walking.positions_m[0, 0] + [0.0, 0.0, up_m]) for up_m in (0, 2.4477 * sigma_m)
    )
    assert np.linalg.norm(top_px - joint_px) < 6, "smaller than the dot"
    assert has_white(image, top_px)


def test_the_number_is_above_the_topmost_joint_that_is_observed(squares: SquaresScene) -> None:
    """A predicted joint may be far from the body."""
    camera, walking = squares.rig.cameras[0], trajectory(squares, 2)
    positions_m = walking.positions_m[0].copy()
    positions_m[2] += [0.0, 0.0, 0.5]
    status = np.array([Status.OBSERVED, Status.OBSERVED, Status.PREDICTED])
    points_px = 4 * camera.project(positions_m)
    top_px = points_px[:2][points_px[:2, 1].argmin()]
    with_number, without = (np.full((960, 1280, 3), 60, np.uint8) for _ in range(2))
    for image, numbers in ((with_number, True), (without, False)):
        pose = Pose(7, positions_m, status, None)
        Drawing(walking.skeleton, ellipses=False, numbers=numbers).add(image, camera, pose, scale=4.0)
    drawn_px = np.argwhere((with_number != without).any(axis=-1))[:, ::-1]
    # A digit is 24 pixels high at this size, its outline 3 wide, and begins 10 above the joint.
    np.testing.assert_allclose(drawn_px.mean(axis=0), top_px - [0, 22], atol=8)


def test_people_are_between_the_frames_of_their_trajectory_and_not_in_its_gaps(squares: SquaresScene) -> None:
    walking = trajectory(squares, 20)
    gap = walking.frames(~np.isin(np.arange(20), [8, 9, 10, 11]))
    moments = Moments({3: gap}, np.array([0.025, 0.475, 0.95, 1.2]))
    (pose,) = moments.poses(0)
    assert pose.person == 3
    np.testing.assert_allclose(pose.positions_m, squares.positions_m(0.025)[0], atol=1e-12)
    assert moments.poses(1) == []
    assert len(moments.poses(2)) == 1
    assert moments.poses(3) == []


def test_a_run_draws_its_own_film(
    recorded: list[str],
    squares: SquaresScene,
    squares_network: SquaresNetwork,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the frames and cameras that were estimated; the camera that began late is drawn at its own times."""
    monkeypatch.setenv("FGPOSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("fgpose.monocular.networks.open_network", lambda *arguments, **options: squares_network)
    run = ["run", recorded[2], *recorded[3:], "-o", str(tmp_path / "out"), "--overlay"]
    chosen = ["--frames", "12", "--cameras", "ring_0", "ring_1", "--formats", "parquet"]
    assert main([*run, *chosen]) == 0
    printed = capsys.readouterr()
    path = tmp_path / "out" / "walk_overlay.mp4"
    assert f"wrote {path}" in printed.out
    assert "drawing" in printed.err
    end_s = fgpose.load_trajectory(tmp_path / "out" / "walk.parquet").time_s[-1]
    time_s, images = film(path)
    np.testing.assert_allclose(time_s, np.arange(round(end_s * FPS) + 1) / FPS, atol=1e-4)
    assert images[0].shape[1] == 1920
    # Of each camera 958 of the 320 pixels, side by side with 4 between them.
    for n, (camera, begin_px) in enumerate(zip(squares.rig.cameras[:2], (0.0, 962.0), strict=True)):
        # The last image before the middle of the step, 0.425 s: of the camera that began late, its sixth.
        taken_s = LATE_S + 5 / FPS if n else 8 / FPS
        pelvis_px = 958 / 320 * camera.project(squares.positions_m(taken_s)[0])[0]
        assert is_drawn(images[8], pelvis_px + np.array([begin_px, 0.0])), camera.name

    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr("fgpose.monocular.networks.open_network", None)  # no work is done
    assert main([*run, *chosen]) == 2
    assert capsys.readouterr().err == "fgpose: error: a film needs PyAV: pip install 'fgpose[overlay]'\n"
    monkeypatch.undo()
    assert main([*run, "--formats", "npz"]) == 2
    assert "--overlay is drawn from the parquet file" in capsys.readouterr().err


def test_what_is_missing_is_said_before_any_work(
    recorded: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ["-o", str(tmp_path / "film.mp4")]
    assert main([*recorded[:3], *output]) == 2
    assert "pose.npz does not hold the calibration of its cameras; give it with --rig" in capsys.readouterr().err
    assert main([*recorded, *output, "--from", "7"]) == 2
    assert "ring_0.mp4: no frame is from 7 s on: there are frames from 0 s to 0.95 s" in capsys.readouterr().err
    assert main([*recorded, *output, "--width", "1"]) == 2
    assert "--width must be 2 px at least" in capsys.readouterr().err
    assert main([*recorded, *output, "--width", "3"]) == 2
    said = "a film of 2 cameras side by side is 8 px wide at least (--width), got 3"
    assert f"fgpose: error: {said}\n" in capsys.readouterr().err
    assert main([*recorded, "-o", str(tmp_path / "film.avi")]) == 2
    assert "film.avi: a film is written as .mp4" in capsys.readouterr().err
    assert not list(tmp_path.glob("film.*"))


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("walk/ring_1.mp4", "walk/ring_1.mp4 would replace an input; choose another with --output"),
        ("link.mp4", "link.mp4 would replace an input"),
        ("own.mp4", "own.mp4 is there already, and it does not say what made it: fgpose overlay does not replace it"),
    ],
)
def test_inputs_and_files_of_others_stay(
    output: str, said: str, recorded: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own.mp4").write_bytes((tmp_path / "walk" / "ring_0.mp4").read_bytes())
    (tmp_path / "link.mp4").symlink_to(tmp_path / "walk" / "ring_2.mp4")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert main([*recorded, "-o", str(tmp_path / output)]) == 2
    assert said in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_films_of_each_camera_replace_only_films(
    recorded: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The film of a camera has the name of its video, as of walk/ring.mp4 and the camera 0 that of ring_0.mp4."""
    rig = fgpose.load_rig(tmp_path / "rig.toml")
    fgpose.save_rig(
        CameraRig(tuple(replace(camera, name=camera.name[-1]) for camera in rig.cameras)), tmp_path / "rig.toml"
    )
    before = {path: path.read_bytes() for path in (tmp_path / "walk").iterdir()}
    assert main([*recorded, "--each", "-o", str(tmp_path / "walk" / "ring.mp4")]) == 2
    assert "ring_0.mp4 would replace an input" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in (tmp_path / "walk").iterdir()} == before
    for _ in range(2):
        assert main([*recorded, "--each", "-o", str(tmp_path / "film.mp4"), "--to", "0.2"]) == 0
    assert made_by(tmp_path / "film_1.mp4") == "overlay"
