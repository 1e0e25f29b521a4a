"""Errors of real detections, in blocks, to be put on other motion. data/detection_errors tells where from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from jaxtyping import Bool, Float

from fgpose.io.arrays import checked, read_arrays, texts
from fgpose.skeleton import Skeleton

HIDDEN_M = 0.1
"""A larger error counts as that of a hidden joint. Five times the median error without occluders; 25 px at 4.5 m."""


@dataclass(frozen=True, eq=False)
class Block:
    """What one camera detected for a while, all joints of h36m_17 together."""

    source: str
    """Detector and condition, as blazepose_full or blazepose_full_occluded."""
    camera: str
    error_m: Float[np.ndarray, "frame joint 2"]
    """Along the axes of the image (right, down), metres at the joint's depth; NaN where nothing was detected."""
    confidence: Float[np.ndarray, "frame joint"]


@dataclass(frozen=True, eq=False)
class RealErrors:
    """Of every detection of a recording."""

    error_m: Float[np.ndarray, "frame camera joint 2"]
    """As of a Block."""
    confidence: Float[np.ndarray, "frame camera joint"]
    hidden: Bool[np.ndarray, "frame camera joint"]
    """Missing, or off by more than HIDDEN_M: the detector cannot have seen the joint."""


@cache
def real_blocks() -> tuple[tuple[Block, ...], tuple[str, ...], float]:
    """All blocks that come with fgpose, the joints they have, and their frame rate."""
    with resources.as_file(
        resources.files("fgpose_benchmarks").joinpath("data", "detection_errors", "errors.npz")
    ) as path:
        arrays = read_arrays(path)
    joints = texts(arrays, "joint_names")
    ends = np.cumsum(checked(arrays, "n_frames", "whole numbers", None)).tolist()
    error_m = checked(arrays, "error_m", "numbers", ends[-1], len(joints), 2).astype(float)
    confidence = checked(arrays, "confidence", "numbers", ends[-1], len(joints)).astype(float)
    parts = zip(texts(arrays, "sources"), texts(arrays, "cameras"), [0, *ends[:-1]], ends, strict=True)
    blocks = (Block(source, camera, error_m[a:b], confidence[a:b]) for source, camera, a, b in parts)
    return tuple(blocks), joints, float(checked(arrays, "fps", "numbers"))


def real_errors(
    rng: np.random.Generator, n_frames: int, n_cameras: int, skeleton: Skeleton, fps: float, sources: Sequence[str]
) -> RealErrors:
    """Errors for a recording: blocks of one source, drawn at random, one after the other in every view.

    Each block is played forwards or backwards, as it is or mirrored (left joints for right ones). All views have the
    same order of blocks, but each starts with another one, somewhere in it.

    Raises:
        ValueError: there is no block of a source, or the blocks have other joints than the skeleton.
    """
    every, joints, block_fps = real_blocks()
    if joints != skeleton.joints:
        raise ValueError(f"real errors are those of {', '.join(joints)}; {skeleton.name} has other joints")
    source = sources[int(rng.integers(len(sources)))]
    blocks = [block for block in every if block.source == source]
    if not blocks:
        raise ValueError(f"no real errors of {source!r}; there are {', '.join(sorted({b.source for b in every}))}")
    order = rng.permutation(len(blocks))
    duration_s = n_frames / fps
    views = []
    for camera in range(n_cameras):
        chain = _chain(rng, [blocks[index] for index in np.roll(order, -camera)], skeleton, block_fps * duration_s)
        views.append(_resampled(*chain, block_fps, n_frames, fps))
    error_m, confidence = (np.stack(arrays, axis=1) for arrays in zip(*views, strict=True))
    return RealErrors(error_m, confidence, ~(np.linalg.norm(error_m, axis=-1) <= HIDDEN_M))


def _chain(
    rng: np.random.Generator, blocks: Sequence[Block], skeleton: Skeleton, n_frames: float
) -> tuple[Float[np.ndarray, "frame joint 2"], Float[np.ndarray, "frame joint"]]:
    """Blocks in turn until there are enough frames, at the rate of the blocks."""
    errors_m, confidences, total = [], [], 0
    skipped = int(rng.integers(len(blocks[0].error_m)))
    for block in _endless(blocks):
        error_m, confidence = block.error_m, block.confidence
        if rng.random() < 0.5:
            error_m, confidence = error_m[::-1], confidence[::-1]
        if rng.random() < 0.5:
            error_m, confidence = _mirrored(error_m, confidence, skeleton)
        errors_m.append(error_m[skipped:])
        confidences.append(confidence[skipped:])
        total += len(errors_m[-1])
        skipped = 0
        if total > n_frames + 1:
            break
    return np.concatenate(errors_m), np.concatenate(confidences)


def _endless(blocks: Sequence[Block]) -> Iterator[Block]:
    while True:
        yield from blocks


def _mirrored(
    error_m: Float[np.ndarray, "frame joint 2"], confidence: Float[np.ndarray, "frame joint"], skeleton: Skeleton
) -> tuple[Float[np.ndarray, "frame joint 2"], Float[np.ndarray, "frame joint"]]:
    """As of the mirrored image of the mirrored person."""
    other = [skeleton.mirrored((joint, joint))[0] for joint in range(skeleton.n_joints)]
    return error_m[:, other] * np.array([-1.0, 1.0]), confidence[:, other]


def _resampled(
    error_m: Float[np.ndarray, "frame joint 2"],
    confidence: Float[np.ndarray, "frame joint"],
    fps: float,
    n_frames: int,
    new_fps: float,
) -> tuple[Float[np.ndarray, "new_frame joint 2"], Float[np.ndarray, "new_frame joint"]]:
    """At another rate: each frame takes the nearest of the blocks, so that sizes and jumps stay what they are."""
    nearest = np.minimum(np.round(np.arange(n_frames) / new_fps * fps).astype(int), len(error_m) - 1)
    return error_m[nearest], confidence[nearest]
