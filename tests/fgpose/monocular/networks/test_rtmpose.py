from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import topdown_networks as tiny
from topdown_networks import JOINT_COLOURS, PERSON_COLOURS, Boxes

from fgpose.monocular.network import Network, People, Tracker
from fgpose.monocular.networks.rtmpose import RTMPose
from fgpose.monocular.networks.topdown import follow, suppress

CAMERA = tiny.camera()
WIDTH, HEIGHT = CAMERA.size_px
# Pixels of the image per pixel of the crop of a person 200 wide and 400 high.
SCALE = 1.25 * 400 / 256
# Bins are half a pixel of the crop apart, and the middle of a disc is found to another quarter.
TOLERANCE_PX = 0.5 * SCALE


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rtmpose")
    return tiny.simcc(folder / "rtmpose.onnx"), tiny.yolox(folder / "yolox.onnx")


def joints(left: float, top: float, n: int = 17, seed: int = 0) -> np.ndarray:
    """On a grid over a person 200 wide and 400 high, each a little beside its place."""
    grid = np.array([(25 + 50 * column, 30 + 55 * row) for row in range(7) for column in range(4)], dtype=float)[:n]
    return grid + np.random.default_rng(seed).uniform(-8, 8, (n, 2)) + (left, top)


def draw(image: np.ndarray, left: int, top: int, colour: np.ndarray, points_px: np.ndarray) -> None:
    """A person: a rectangle with a disc for every joint, but for its edges."""
    image[max(top, 0) : top + 400, max(left, 0) : left + 200] = colour
    tiny.discs(image, points_px, JOINT_COLOURS[: len(points_px)], 5 * SCALE)


def empty() -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), 20, dtype=np.uint8)


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    image, left, right = empty(), joints(100, 150), joints(600, 200, seed=1)
    draw(image, 100, 150, PERSON_COLOURS[0], left)
    draw(image, 600, 200, PERSON_COLOURS[1], right)
    return image, left, right


def test_finds_the_joints_of_two_people_the_surer_one_first(files: tuple[Path, Path]):
    network = RTMPose(*files)
    tracker = network.tracker(CAMERA)
    assert isinstance(network, Network)
    assert isinstance(tracker, Tracker)
    assert network.skeleton.name == "coco_17"
    image, left, right = scene()
    people = tracker.detect(image)
    np.testing.assert_allclose(people.boxes, [(600, 200, 200, 400, 0.9), (100, 150, 200, 400, 0.8)], atol=1.5)
    np.testing.assert_allclose(people.points2d_px, [right, left], atol=TOLERANCE_PX)
    np.testing.assert_allclose(people.confidence, 0.9, atol=2e-3)  # the bell's top lies up to half a bin beside one
    assert people.points3d_m.shape == (2, 17, 3)
    assert people.covariance_m2.shape == (2, 17, 3, 3)
    assert np.isnan(people.points3d_m).all()
    assert np.isnan(people.covariance_m2).all()


def test_halpe_and_other_numbers_of_keypoints(tmp_path: Path):
    body_and_feet = RTMPose(tiny.simcc(tmp_path / "halpe.onnx", n_keypoints=26), Boxes([(100, 150, 200, 400, 0.9)]))
    assert body_and_feet.skeleton.name == "halpe_26"
    image, points_px = empty(), joints(100, 150, n=26)
    draw(image, 100, 150, PERSON_COLOURS[0], points_px)
    people = body_and_feet.tracker(CAMERA).detect(image)
    np.testing.assert_allclose(people.points2d_px[0], points_px, atol=TOLERANCE_PX)
    with pytest.raises(ValueError, match=r"hand\.onnx gives 21 keypoints; known are 17 \(coco_17\) or 26 \(halpe_26\)"):
        RTMPose(tiny.simcc(tmp_path / "hand.onnx", n_keypoints=21), Boxes([]))


def test_nobody(files: tuple[Path, Path]):
    people = RTMPose(*files).tracker(CAMERA).detect(empty())
    assert people.n_people == 0
    assert people.points2d_px.shape == (0, 17, 2)
    assert people.covariance_m2.shape == (0, 17, 3, 3)


def test_a_person_cut_by_the_border(files: tuple[Path, Path]):
    image, points_px = empty(), joints(-90, 400)
    draw(image, -90, 400, PERSON_COLOURS[0], points_px)
    people = RTMPose(*files).tracker(CAMERA).detect(image)
    np.testing.assert_allclose(people.boxes[0, :4], (0, 400, 110, 320), atol=1.5)
    margin_px = 5 * SCALE
    inside = (points_px[:, 0] > margin_px) & (points_px[:, 1] < HEIGHT - margin_px)
    outside = (points_px[:, 0] < -margin_px) | (points_px[:, 1] > HEIGHT + margin_px)
    assert inside.sum() >= 4
    assert outside.sum() >= 4
    np.testing.assert_allclose(people.points2d_px[0, inside], points_px[inside], atol=TOLERANCE_PX)
    assert (people.confidence[0, inside] > 0.8).all()
    assert not people.confidence[0, outside].any()
    assert np.isnan(people.points2d_px[0, outside]).all()


def test_only_the_surest_people_are_looked_at(files: tuple[Path, Path]):
    image, _, right = scene()
    people = RTMPose(*files, max_people=1).tracker(CAMERA).detect(image)
    assert people.n_people == 1
    np.testing.assert_allclose(people.points2d_px[0], right, atol=TOLERANCE_PX)
    with pytest.raises(ValueError, match="max_people"):
        RTMPose(*files, max_people=0)


def test_boxes_without_an_area_in_the_image_are_nobody(files: tuple[Path, Path]):
    nothing = (10, 10, 0, 100, 0.9), (10, 10, np.inf, 100, 0.9), (10, 10, 50, np.nan, 0.9)
    detector = Boxes([*nothing, (-100, 10, 100, 100, 0.9), (10, 720, 100, 100, 0.9)])
    assert RTMPose(files[0], detector).tracker(CAMERA).detect(empty()).n_people == 0


def test_an_image_of_another_kind_is_refused_by_the_name_of_its_camera(files: tuple[Path, Path]):
    tracker = RTMPose(*files).tracker(CAMERA)
    for image in (empty()[:-1], empty()[..., :1], empty()[..., 0], empty().astype(float)):
        with pytest.raises(ValueError, match=r"cam_1: an image must be .*\(720, 960, 3\) uint8"):
            tracker.detect(image)


def test_the_name_tells_whatever_the_joints_depend_on(files: tuple[Path, Path], tmp_path: Path):
    copy = tiny.simcc(tmp_path / "rtmpose.onnx", heights=0.8)
    names = {
        RTMPose(*files).name,
        RTMPose(copy, files[1]).name,
        RTMPose(files[0], Boxes([])).name,
        RTMPose(*files, max_people=2).name,
        RTMPose(*files, detect_every_frame=False).name,
    }
    assert len(names) == 5
    assert RTMPose(*files, threads=2).name in names


def walk(n_images: int, step_px: int) -> tuple[list[np.ndarray], np.ndarray]:
    """A person who walks to the right, and the joints (image, joint, 2)."""
    images, points = [], np.stack([joints(100 + step_px * n, 150) for n in range(n_images)])
    for n in range(n_images):
        image = empty()
        draw(image, 100 + step_px * n, 150, PERSON_COLOURS[0], points[n])
        images.append(image)
    return images, points


def test_follows_the_joints_and_asks_the_detector_now_and_then(files: tuple[Path, Path]):
    images, points_px = walk(21, 20)
    detector = Boxes(*[[(100 + 20 * n, 150, 200, 400, 0.9)] for n in (0, 10, 20)])
    tracker = RTMPose(files[0], detector, detect_every_frame=False).tracker(CAMERA)
    people = [tracker.detect(image) for image in images]
    assert detector.n_asked == 3
    # The crop of a followed person is as large as the joints make it, and they end before the person does.
    found_px = np.concatenate([each.points2d_px for each in people])
    np.testing.assert_allclose(found_px, points_px, atol=TOLERANCE_PX)


def test_every_image_is_detected_unless_told_otherwise(files: tuple[Path, Path]):
    images, points_px = walk(4, 20)
    detector = Boxes(*[[(100 + 20 * n, 150, 200, 400, 0.9)] for n in range(4)])
    tracker = RTMPose(files[0], detector).tracker(CAMERA)
    found_px = np.concatenate([tracker.detect(image).points2d_px for image in images])
    assert detector.n_asked == 4
    np.testing.assert_allclose(found_px, points_px, atol=TOLERANCE_PX)


def test_somebody_lost_or_nobody_makes_it_ask_in_the_next_image(files: tuple[Path, Path]):
    (image,), _ = walk(1, 0)
    known = [(100, 150, 200, 400, 0.9)]
    detector = Boxes(known, known, [], known)
    tracker = RTMPose(files[0], detector, detect_every_frame=False).tracker(CAMERA)
    asked = []
    for shown in (image, image, empty(), image, image, empty(), empty(), image):
        tracker.detect(shown)
        asked.append(detector.n_asked)
    #       found, followed, lost, asked: found, followed, lost, asked: nobody, asked: found
    assert asked == [1, 1, 1, 2, 2, 2, 3, 4]


def test_one_of_two_lost_makes_it_ask_in_the_next_image(files: tuple[Path, Path]):
    both, left, _ = scene()
    alone = empty()
    draw(alone, 100, 150, PERSON_COLOURS[0], left)
    detector = Boxes([(600, 200, 200, 400, 0.9), (100, 150, 200, 400, 0.8)])
    tracker = RTMPose(files[0], detector, detect_every_frame=False).tracker(CAMERA)
    asked = []
    for image in (both, both, alone, alone):
        tracker.detect(image)
        asked.append(detector.n_asked)
    assert asked == [1, 1, 1, 2]


def test_of_a_chain_of_boxes_every_other_one_stays():
    boxes = np.array([(x, 0.0, 100.0, 100.0, 0.9 - x / 1000) for x in (0.0, 30.0, 60.0, 90.0, 300.0)])
    # 30 pixels apart they share 70 of 130, 60 pixels apart 40 of 160.
    np.testing.assert_array_equal(suppress(boxes, 0.5), [True, False, True, False, True])
    np.testing.assert_array_equal(suppress(boxes, 0.54), [True] * 5)
    assert suppress(boxes[:0], 0.5).shape == (0,)


def test_a_followed_box_ends_where_the_image_does():
    points_px = np.full((1, 17, 2), np.nan)
    points_px[0, :10] = np.random.default_rng(0).uniform((-100, 300), (100, 700), (10, 2))
    points_px[0, :2] = (-100, 300), (100, 700)
    confidence = np.where(np.isfinite(points_px[..., 0]), 0.8, 0.0)
    unknown = np.full((1, 17, 3), np.nan)
    people = People(np.array([[0, 0, 1, 1, 0.7]]), points_px, confidence, unknown, np.full((1, 17, 3, 3), np.nan))
    # The joints span (-100, 300) to (100, 700), a quarter more (-125, 250) to (125, 750).
    followed = follow(people, (960, 720))
    assert followed is not None
    np.testing.assert_allclose(followed, [(0, 250, 125, 470, 0.7)])
    assert follow(replace(people, points2d_px=points_px - (200, 0)), (960, 720)) is None
    assert follow(replace(people, confidence=confidence / 4), (960, 720)) is None


def test_two_boxes_that_come_to_one_person_become_one(files: tuple[Path, Path]):
    (image,), points_px = walk(1, 0)
    detector = Boxes([(100, 150, 200, 400, 0.9), (60, 130, 260, 430, 0.8)])
    tracker = RTMPose(files[0], detector, detect_every_frame=False).tracker(CAMERA)
    assert tracker.detect(image).n_people == 2
    people = tracker.detect(image)
    assert people.n_people == 1
    assert people.boxes[0, 4] == 0.9
    np.testing.assert_allclose(people.points2d_px[0], points_px[0], atol=TOLERANCE_PX)


def test_trackers_of_one_network_do_not_share_what_they_remember(files: tuple[Path, Path]):
    (image,), points_px = walk(1, 0)
    detector = Boxes([(100, 150, 200, 400, 0.9)])
    network = RTMPose(files[0], detector, detect_every_frame=False)
    first, second = network.tracker(CAMERA), network.tracker(CAMERA)
    first.detect(image)
    people: People = second.detect(image)
    assert detector.n_asked == 2
    np.testing.assert_allclose(people.points2d_px[0], points_px[0], atol=TOLERANCE_PX)


def test_one_network_serves_several_cameras_at_once(files: tuple[Path, Path]):
    images, _ = walk(8, 20)
    network = RTMPose(*files)

    def joints_px(n_skipped: int) -> np.ndarray:
        tracker = network.tracker(CAMERA)
        return np.concatenate([tracker.detect(image).points2d_px for image in images[n_skipped:]])

    one_by_one = [joints_px(n) for n in range(4)]
    with ThreadPoolExecutor(4) as pool:
        at_once = list(pool.map(joints_px, range(4)))
    for expected, found in zip(one_by_one, at_once, strict=True):
        np.testing.assert_array_equal(found, expected)
