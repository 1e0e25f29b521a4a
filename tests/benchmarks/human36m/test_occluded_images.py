"""The images of Human3.6M-Occluded."""

from __future__ import annotations

import json
import random
from pathlib import Path

import cv2
import numpy as np
import pytest

from fgpose_benchmarks.human36m.cutouts import read_image
from fgpose_benchmarks.human36m.occluded_images import OccludedView, generate, protocol_frames
from tests.benchmarks.human36m.human36m_files import sequence

GREY = 90


def opaque(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 4), 255, np.uint8)


CUTOUTS = {"wide": opaque(8, 4), "tall": opaque(3, 9), "square": opaque(5, 5)}
BOX_PX = np.array([60.0, 40.0, 50.0, 120.0])


def views(folder: Path, n_frames: int, n_views: int = 4) -> list[list[OccludedView]]:
    frames = []
    for frame in range(n_frames):
        names = [f"{view}/img_{frame + 1:06d}.png" for view in range(n_views)]
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / name), np.full((200, 180, 3), GREY, np.uint8))
        frames.append([OccludedView(folder / name, BOX_PX, name) for name in names])
    return frames


def authors_draws(n_frames: int, seed: int) -> list[dict[int, list[tuple[str, float, tuple[float, float]]]]]:
    """The draws of gen_occluded_h36m.py and its aug_utils.py, in their words."""
    random.seed(seed)
    names, drawn = list(CUTOUTS), []
    for _ in range(n_frames):
        of_frame = {}
        for i in random.sample(range(0, 4), 3):
            of_frame[i] = []
            for _ in range(2):
                occluder = random.choice(names)
                random_scale_factor = random.uniform(0.5, 1.0)
                x, y, width, height = BOX_PX.tolist()
                center = (random.uniform(x, x + width), random.uniform(y, y + height))
                of_frame[i].append((occluder, random_scale_factor, center))
        drawn.append(of_frame)
    return drawn


def test_the_draws_are_those_of_the_authors_generator(tmp_path: Path):
    path = generate(views(tmp_path / "in", 20), CUTOUTS, tmp_path / "out", seed=42)
    described = json.loads(path.read_text())
    assert described["seed"] == 42
    for frame, expected in zip(described["frames"], authors_draws(20, 42), strict=True):
        placed = {number: view["occluders"] for number, view in enumerate(frame) if view["occluders"]}
        assert placed.keys() == expected.keys()
        for number, occluders in placed.items():
            for occluder, (name, scale, centre_px) in zip(occluders, expected[number], strict=True):
                assert occluder["cutout"] == name
                assert occluder["scale"] == pytest.approx(scale)
                assert occluder["centre_px"] == pytest.approx(centre_px)


def test_occluders_lie_where_the_description_says(tmp_path: Path):
    frames = views(tmp_path / "in", 6)
    described = json.loads(generate(frames, CUTOUTS, tmp_path / "out").read_text())["frames"]
    for of_frame in described:
        for view in of_frame:
            image = read_image(tmp_path / "out" / view["image"])
            covered = np.zeros(image.shape[:2], bool)
            for occluder in view["occluders"]:
                height, width = CUTOUTS[occluder["cutout"]].shape[:2]
                # short side: that share of the box's 50 px
                size_px = occluder["scale"] * 50.0 / min(width, height) * np.array([width, height])
                low_px = np.array(occluder["centre_px"]) - size_px / 2
                rows, columns = np.indices(covered.shape)
                covered |= (abs(columns + 0.5 - low_px[0] - size_px[0] / 2) < size_px[0] / 2 - 2) & (
                    abs(rows + 0.5 - low_px[1] - size_px[1] / 2) < size_px[1] / 2 - 2
                )
            # two pixels in from their rims, which are rounded
            assert (image[covered] == 255).all()
            changed_share = (image != GREY).any(axis=-1).mean()
            assert covered.mean() <= changed_share <= covered.mean() + 0.1


def test_the_fourth_view_is_copied_as_it_is(tmp_path: Path):
    frames = views(tmp_path / "in", 3)
    described = json.loads(generate(frames, CUTOUTS, tmp_path / "out").read_text())["frames"]
    for of_frame, of_views in zip(described, frames, strict=True):
        free = [number for number, view in enumerate(of_frame) if not view["occluders"]]
        assert len(free) == 1
        view = of_views[free[0]]
        assert (tmp_path / "out" / view.name).read_bytes() == view.image.read_bytes()


def test_the_seed_decides(tmp_path: Path):
    frames = views(tmp_path / "in", 3)
    first, again, other = (
        generate(frames, CUTOUTS, tmp_path / name, seed).read_text() for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert first == again != other


def test_progress_is_told_frame_by_frame(tmp_path: Path):
    told: list[tuple[int, int]] = []
    generate(
        views(tmp_path / "in", 3), CUTOUTS, tmp_path / "out", progress=lambda done, total: told.append((done, total))
    )
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_frames_of_the_protocol_and_their_images():
    each = sequence("S9", "Eating-1", np.arange(0, 130))
    each.boxes_px[64, 2] = np.nan
    frames = protocol_frames([each], "processed")
    assert [len(frame) for frame in frames] == [4, 3, 4]
    assert frames[1][0].name == "S9/Eating-1/imageSequence/54138969/img_000065.jpg"
    assert frames[1][0].image == Path("processed") / frames[1][0].name
    np.testing.assert_array_equal(frames[2][1].box_px, each.joint_boxes_px()[128, 1])
    np.testing.assert_array_equal(protocol_frames([each], "processed", "labels")[0][0].box_px, each.boxes_px[0, 0])


def test_what_is_wrong_is_said_before_anything_is_written(tmp_path: Path):
    frames = views(tmp_path / "in", 2)
    output = tmp_path / "out"
    with pytest.raises(ValueError, match="no cut-out to paste"):
        generate(frames, {}, output)
    with pytest.raises(ValueError, match="no image to occlude"):
        generate([], CUTOUTS, output)
    with pytest.raises(ValueError, match="the images themselves are there"):
        generate(frames, CUTOUTS, tmp_path / "in")
    with pytest.raises(ValueError, match="two images have one name"):
        generate([*frames, frames[0]], CUTOUTS, output)
    empty = OccludedView(frames[0][0].image, np.array([0.0, 0.0, 0.0, 5.0]), "other.png")
    with pytest.raises(ValueError, match="the box of the person is empty"):
        generate([[empty]], CUTOUTS, output)
    frames[1][3].image.unlink()
    with pytest.raises(ValueError, match=r"1 of 8 images are missing, the first is .*3/img_000002\.png"):
        generate(frames, CUTOUTS, output)
    assert not output.exists()
