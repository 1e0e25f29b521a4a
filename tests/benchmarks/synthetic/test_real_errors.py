"""Errors of real detections: what is shipped, and how blocks become recordings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, DetectionNoise, real_errors, simulate, walking
from fgpose_benchmarks.synthetic.real_errors import HIDDEN_M, real_blocks
from tests.conftest import MOCAP

DATA = MOCAP.parent / "detection_errors"
SOURCES = ("openpose", "blazepose_full", "blazepose_heavy", "blazepose_full_occluded", "blazepose_heavy_occluded")


def test_the_blocks_are_those_of_the_readme() -> None:
    blocks, joints, fps = real_blocks()
    assert (joints, fps) == (load_skeleton("h36m_17").joints, 60.0)
    assert {block.source for block in blocks} == set(SOURCES)
    readme = (DATA / "README.md").read_text(encoding="utf-8")
    for source in SOURCES:
        of_source = [block for block in blocks if block.source == source]
        size_mm = 1000 * np.linalg.norm(np.concatenate([block.error_m for block in of_source]), axis=-1)
        numbers = (
            f"{len(of_source)} | {len(size_mm) / fps:.1f} | {np.nanmedian(size_mm):.0f} | "
            f"{np.nanpercentile(size_mm, 95):.0f} | {100 * np.mean(size_mm > 100):.1f}"
        )
        assert f"| {source} | {numbers} |" in readme
    # As promised: a block is a second or longer, and missing is NaN with confidence 0.
    assert min(len(block.error_m) for block in blocks) >= fps
    for block in blocks:
        np.testing.assert_array_equal(np.isfinite(block.error_m).all(axis=-1), block.confidence > 0)
    assert (DATA / "errors.npz").stat().st_size < 500_000


def test_the_confidence_of_a_real_detector_tells_something() -> None:
    """Rows of errors and of confidence belong together."""
    for source in SOURCES[3:]:
        blocks = [block for block in real_blocks()[0] if block.source == source]
        size_m = np.linalg.norm(np.concatenate([block.error_m for block in blocks]), axis=-1)
        confidence = np.concatenate([block.confidence for block in blocks])
        # Of the detections that are off by more than 0.1 m it is clearly lower on average.
        assert confidence[size_m < HIDDEN_M].mean() > confidence[size_m > HIDDEN_M].mean() + 0.1


def test_every_view_begins_with_another_block(skeleton: Skeleton) -> None:
    blocks = [block for block in real_blocks()[0] if block.source == "openpose"]
    mirror = [skeleton.mirrored((joint, joint))[0] for joint in range(skeleton.n_joints)]

    def number(row_m: np.ndarray, confidence: np.ndarray) -> int:
        for index, block in enumerate(blocks):
            for joints, sign in ((slice(None), 1), (mirror, (-1, 1))):
                same = np.isclose(block.error_m[:, joints] * sign, row_m, rtol=0, atol=0, equal_nan=True)
                rows = np.flatnonzero(same.all(axis=(1, 2)))
                if rows.size:
                    np.testing.assert_array_equal(block.confidence[rows[0], joints], confidence)
                    return index
        raise AssertionError("not of a block")

    drawn = real_errors(np.random.default_rng(0), 200, 4, skeleton, 60.0, ("openpose",))
    numbers = [
        [number(*pair) for pair in zip(drawn.error_m[:, camera], drawn.confidence[:, camera], strict=True)]
        for camera in range(4)
    ]
    assert sorted(of_camera[0] for of_camera in numbers) == [0, 1, 2, 3]
    # 200 frames are two blocks or three.
    assert all(len(set(of_camera)) >= 2 for of_camera in numbers)
    np.testing.assert_array_equal(drawn.hidden, ~(np.linalg.norm(drawn.error_m, axis=-1) <= HIDDEN_M))


def test_at_a_quarter_of_the_rate_every_fourth_frame_is_left(skeleton: Skeleton) -> None:
    fast, slow = (
        real_errors(np.random.default_rng(1), n_frames, 2, skeleton, fps, SOURCES[:1])
        for n_frames, fps in ((80, 60.0), (20, 15.0))
    )
    np.testing.assert_array_equal(fast.error_m[::4], slow.error_m)
    np.testing.assert_array_equal(fast.confidence[::4], slow.confidence)


def test_unknown_sources_and_joints_are_refused(skeleton: Skeleton) -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="no real errors of 'mine'; there are blazepose_full, "):
        real_errors(rng, 10, 1, skeleton, 50.0, ("mine",))
    with pytest.raises(ValueError, match="coco_17 has other joints"):
        real_errors(rng, 10, 1, load_skeleton("coco_17"), 50.0, SOURCES)


def test_a_bias_has_two_ends_and_a_misled_joint_a_name(skeleton: Skeleton, rig: CameraRig) -> None:
    with pytest.raises(ValueError, match="min_bias_m must not exceed max_bias_m"):
        DetectionNoise(min_bias_m=0.03, max_bias_m=0.02)
    noise = dataclasses.replace(NO_NOISE, misled_joint="tail")
    with pytest.raises(ValueError, match="has no joint 'tail'"):
        simulate(walking(2, 50.0, skeleton), skeleton, rig, 50.0, noise, NO_OCCLUSION, seed=0)
