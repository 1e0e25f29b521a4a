from __future__ import annotations

import threading
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from fgpose.association.chosen_person import PersonRegion
from fgpose.monocular.detected import Detected
from fgpose.monocular.detection import detect
from fgpose.monocular.sources import Sources, open_sources
from fgpose.observations import Observations

if TYPE_CHECKING:
    from tests.fgpose.conftest import SquaresNetwork, SquaresScene

FPS = 20.0
# Squares are drawn on whole pixels, and the codec blurs their edges: half a pixel and a bit.
FOUND_PX = 1.5


def truth_px(squares: SquaresScene, time_s: float, person: int = 0) -> np.ndarray:
    """(C, J, 2) where a person is in every camera."""
    return squares.rig.project(squares.positions_m(time_s, 2)[person])


def assert_follows(observations: Observations, squares: SquaresScene, person: int = 0) -> None:
    """Every known joint is where this person was at the time of its image."""
    assert observations.seen.any()
    for t in range(observations.n_frames):
        time_s = np.broadcast_to(observations.time_s[t], (observations.n_cameras,))
        for c in np.flatnonzero(observations.seen[t].any(axis=-1)):
            expected_px = truth_px(squares, float(time_s[c]), person)[c]
            np.testing.assert_allclose(observations.points2d_px[t, c], expected_px, atol=FOUND_PX)


def region_around(squares: SquaresScene, camera: int, person: int) -> PersonRegion:
    points_px = truth_px(squares, 0.0, person)[camera]
    x, y = points_px.min(axis=0) - 8
    width, height = np.ptp(points_px, axis=0) + 16
    return PersonRegion(squares.rig.names[camera], float(x), float(y), float(width), float(height))


@pytest.fixture(scope="module")
def sources(squares: SquaresScene, tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return open_sources(squares.write_all(tmp_path_factory.mktemp("videos"), 20, FPS), squares.rig)


@pytest.fixture(scope="module")
def two_people(squares: SquaresScene, tmp_path_factory: pytest.TempPathFactory) -> Sources:
    return open_sources(squares.write_all(tmp_path_factory.mktemp("two"), 20, FPS, n_people=2), squares.rig)


@pytest.fixture
def both(two_people: Sources, squares_network: SquaresNetwork) -> Detected:
    return detect(two_people, squares_network)


def test_every_image_of_every_camera_is_seen_once_and_in_order(
    sources: Sources, squares: SquaresScene, squares_network: SquaresNetwork
) -> None:
    detected = detect(sources, squares_network, jobs=2)
    assert sorted(squares_network.seen) == sorted(list(squares.rig.names) * 20)
    assert sorted(squares_network.trackers) == sorted(squares.rig.names)
    observations = detected.observations()
    np.testing.assert_allclose(observations.time_s, np.arange(20) / FPS, atol=1e-9)
    assert observations.seen.all()
    assert observations.camera_names == squares.rig.names
    assert_follows(observations, squares)


def test_3d_and_covariance_are_in_the_world_frame(
    sources: Sources, squares: SquaresScene, squares_network: SquaresNetwork
) -> None:
    """The network says 4 m of depth, known twice as badly along the optical axis as across."""
    observations = detect(sources, squares_network, frames=3).observations()
    assert observations.points3d_m is not None
    assert observations.covariance3d_m2 is not None
    for c, camera in enumerate(squares.rig.cameras):
        in_camera_m = camera.to_camera_frame(observations.points3d_m[:, c])
        # Single precision at 4 m.
        np.testing.assert_allclose(in_camera_m[..., 2], 4.0, atol=1e-5)
        reprojected_px = camera.project(observations.points3d_m[:, c])
        np.testing.assert_allclose(reprojected_px, observations.points2d_px[:, c], atol=1e-2)
        axis = camera.world_T_camera[:3, 2]
        sigma_m = np.sqrt(np.einsum("i,tjik,k->tj", axis, observations.covariance3d_m2[:, c], axis))
        np.testing.assert_allclose(sigma_m, 0.1, rtol=1e-5)
        np.testing.assert_allclose(np.linalg.det(observations.covariance3d_m2[:, c]), 0.05**6 * 4, rtol=1e-4)


def test_a_network_without_3d_gives_none(sources: Sources, squares_network: SquaresNetwork) -> None:
    squares_network.depth_m = float("nan")
    observations = detect(sources, squares_network, frames=2).observations()
    assert observations.points3d_m is None
    assert observations.covariance3d_m2 is None


def test_the_threads_work_on_several_cameras_at_once(sources: Sources, squares_network: SquaresNetwork) -> None:
    """Two threads meet in the network; if one waited for the other, the barrier would break."""
    barrier = threading.Barrier(2)
    squares_network.before_image = lambda n_seen: None
    met: list[int] = []

    class Meeting(type(squares_network)):
        def note(self, camera: str) -> None:
            met.append(barrier.wait(timeout=20.0))

    two = Sources(sources.rig.subset(sources.rig.names[:2]), sources.clips[:2])
    detect(two, Meeting(), jobs=2, frames=5)
    assert sorted(met) == [0] * 5 + [1] * 5


def test_one_job_needs_one_thread(sources: Sources, squares_network: SquaresNetwork) -> None:
    detect(sources, squares_network, jobs=1, frames=3)
    assert len(squares_network.threads) == 1


def test_progress_counts_the_images(sources: Sources, squares_network: SquaresNetwork) -> None:
    told: list[tuple[int, int]] = []
    detect(sources, squares_network, progress=lambda done, total: told.append((done, total)))
    assert told[0] == (0, 60)
    assert told[-1] == (60, 60)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_nonsense_is_refused(sources: Sources, squares_network: SquaresNetwork) -> None:
    with pytest.raises(ValueError, match="jobs must be at least 1, got 0"):
        detect(sources, squares_network, jobs=0)
    with pytest.raises(ValueError, match="frames must be at least 1, got 0"):
        detect(sources, squares_network, frames=0)


def test_an_error_in_one_camera_ends_all(sources: Sources, squares_network: SquaresNetwork) -> None:
    def fail(n_seen: int) -> None:
        if n_seen == 8:
            raise ValueError("camera ring_1: what is this?")

    squares_network.before_image = fail
    with pytest.raises(ValueError, match="what is this"):
        detect(sources, squares_network, jobs=2)
    # The other thread may have been at one more image.
    assert len(squares_network.seen) == 8


# --- frames of different cameras ---


def test_cameras_of_different_rates(squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    for camera, (name, fps) in enumerate(zip(squares.rig.names, (30.0, 15.0, 24.0), strict=True)):
        squares.write_video(tmp_path / f"{name}.mp4", camera, int(fps), fps)
    observations = detect(open_sources(tmp_path, squares.rig), squares_network).observations()
    assert observations.n_frames == 30
    seen = np.asarray(observations.seen.all(axis=-1))
    np.testing.assert_array_equal(seen.sum(axis=0), [30, 15, 24])
    np.testing.assert_array_equal(np.flatnonzero(seen[:, 1]), np.arange(0, 30, 2))
    assert observations.time_s.shape == (30, 3)
    assert_follows(observations, squares)


def test_the_first_frames_of_cameras_of_different_rates(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    for camera, (name, fps) in enumerate(zip(squares.rig.names, (30.0, 15.0, 30.0), strict=True)):
        squares.write_video(tmp_path / f"{name}.mp4", camera, int(fps), fps)
    detected = detect(open_sources(tmp_path, squares.rig), squares_network, frames=5)
    assert [view.n_images for view in detected.views] == [5, 3, 5]
    assert detected.observations().n_frames == 5


def test_a_camera_that_ends_early_sees_nothing_from_there(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    squares.write_all(tmp_path, 20, FPS)
    squares.write_video(tmp_path / "ring_1.mp4", 1, 9, FPS)
    with pytest.warns(UserWarning, match="ends after 0.45 s"):
        sources = open_sources(tmp_path, squares.rig)
    observations = detect(sources, squares_network).observations()
    assert observations.n_frames == 20
    np.testing.assert_array_equal(observations.seen[:, 1].all(axis=-1), np.arange(20) < 9)
    assert observations.seen[:, (0, 2)].all()
    assert_follows(observations, squares)


def test_a_video_that_cannot_be_decoded_to_its_end(
    sources: Sources, squares: SquaresScene, squares_network: SquaresNetwork
) -> None:
    """As a truncated file is: it says 40 images and has 20."""
    clips = (replace(sources.clips[0], n_images=40), *sources.clips[1:])
    with pytest.warns(UserWarning, match=r"ring_0\.mp4: only 20 of 40 images can be decoded"):
        detected = detect(Sources(sources.rig, clips), squares_network)
    assert_follows(detected.observations(), squares)


def test_image_folders_begin_when_their_numbers_say(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    """ring_1 began three frames later, and lost frame 6."""
    for c, name in enumerate(squares.rig.names):
        (tmp_path / name).mkdir()
        for n in range(10):
            if c != 1 or (n >= 3 and n != 6):
                image = cv2.cvtColor(squares.image(c, n / FPS), cv2.COLOR_RGB2BGR)
                cv2.imwrite(str(tmp_path / name / f"{name}_{n}.png"), image)
    observations = detect(open_sources(tmp_path, squares.rig, fps=FPS), squares_network).observations()
    assert observations.n_frames == 10
    np.testing.assert_array_equal(
        observations.seen[:, 1].all(axis=-1), [False, False, False, True, True, True, False, True, True, True]
    )
    assert_follows(observations, squares)


def test_the_network_gets_the_camera_that_fits_the_images(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    """A video at half its calibrated size; the tracker checks the size of every image against its camera."""
    squares.write_all(tmp_path, 4, FPS)
    # x' + 1/2 = 2 (x + 1/2).
    doubling = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
    doubled = [replace(view, size_px=(640, 480), K=doubling @ view.K) for view in squares.rig.cameras]
    with pytest.warns(UserWarning, match="resized by 0.5 x 0.5"):
        sources = open_sources(tmp_path, type(squares.rig)(tuple(doubled)))
    for fitted, original in zip(sources.rig.cameras, squares.rig.cameras, strict=True):
        np.testing.assert_allclose(fitted.K, original.K, atol=1e-9)
    assert detect(sources, squares_network).n_images == 12


# --- nobody, somebody, several ---


def test_nobody_anywhere_is_an_error(squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path) -> None:
    squares.write_all(tmp_path, 5, FPS, n_people=0)
    with pytest.raises(ValueError, match="nobody was found in any of the 15 images of ring_0, ring_1, ring_2"):
        detect(open_sources(tmp_path, squares.rig), squares_network)


def test_a_camera_without_anybody_is_announced(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    squares.write_all(tmp_path, 5, FPS)
    squares.write_video(tmp_path / "ring_2.mp4", 2, 5, FPS, n_people=0)
    with pytest.warns(UserWarning, match=r"ring_2\.mp4: nobody was found in its 5 images"):
        observations = detect(open_sources(tmp_path, squares.rig), squares_network).observations()
    assert not observations.seen[:, 2].any()
    assert observations.seen[:, :2].all()


@pytest.mark.parametrize(
    ("person", "camera"),
    [(0, 1), (1, 2)] + [pytest.param(*which, marks=pytest.mark.slow) for which in ((0, 0), (0, 2), (1, 0), (1, 1))],
)
def test_the_person_in_a_region_is_followed_in_all_views(
    camera: int, person: int, both: Detected, squares: SquaresScene
) -> None:
    observations = both.observations(region_around(squares, camera, person))
    assert observations.seen.all()
    assert_follows(observations, squares, person)


def test_people_come_by_how_much_is_seen_of_them(
    squares: SquaresScene, squares_network: SquaresNetwork, tmp_path: Path
) -> None:
    """The first leaves after half of the recording: the second is seen more."""
    replace(squares, first_leaves_s=0.5).write_all(tmp_path, 20, FPS, n_people=2)
    detected = detect(open_sources(tmp_path, squares.rig), squares_network)
    most, less = detected.observations(0), detected.observations(1)
    assert most.seen.all()
    assert_follows(most, squares, 1)
    np.testing.assert_array_equal(less.seen.all(axis=(1, 2)), np.arange(20) < 10)
    assert_follows(less, squares, 0)
    with pytest.raises(ValueError, match="no person 2: 2 were found"):
        detected.observations(2)


def test_a_region_without_anybody_says_who_is_there(both: Detected, squares: SquaresScene) -> None:
    with pytest.raises(ValueError, match=r"region ring_1:0,0,20,20: nobody is there .*people are at X,Y,W,H = \d+,\d+"):
        both.observations(PersonRegion("ring_1", 0.0, 0.0, 20.0, 20.0))
    with pytest.raises(ValueError, match="ring_9"):
        both.observations(PersonRegion("ring_9", 0.0, 0.0, 20.0, 20.0))


def test_with_one_camera_the_person_of_a_region_is_followed_too(
    two_people: Sources, squares: SquaresScene, squares_network: SquaresNetwork
) -> None:
    one = Sources(two_people.rig.subset(["ring_0"]), two_people.clips[:1])
    detected = detect(one, squares_network)
    found = detected.observations()
    person = 0 if abs(found.points2d_px[0, 0] - truth_px(squares, 0.0, 0)[0]).max() < FOUND_PX else 1
    again = detected.observations(region_around(squares, 0, person))
    np.testing.assert_array_equal(again.points2d_px, found.points2d_px)


def test_good_videos_warn_of_nothing(sources: Sources, squares_network: SquaresNetwork) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        detected = detect(sources, squares_network, jobs=3)
    assert detected.n_new_images == detected.n_images == len(squares_network.seen) > 0
