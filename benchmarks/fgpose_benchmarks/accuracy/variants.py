"""The open benchmark: real motion seen by simulated cameras, with each thing that can go wrong, alone and together.

The clips are motion capture that comes with this package; rig, noise and occluders are those of
fgpose_benchmarks.synthetic. Every draw depends on the clip's name only, so that the variants of a clip differ in what
they are named after and in nothing else.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.observations import Observations
from fgpose_benchmarks.accuracy.families import VARIANTS as VARIANTS
from fgpose_benchmarks.accuracy.families import Layout, Variant
from fgpose_benchmarks.accuracy.families import find_variant as find_variant
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import RealErrors, Scene, embedded_motion, real_errors, ring_rig, simulate
from fgpose_benchmarks.synthetic.answering_network import as_read

VERSION = 2
"""Results of one version can be compared. Whatever changes a recording is a new version."""

TUNING_CLIPS = ("cmu_01_04_a", "cmu_02_01_short", "cmu_02_05", "cmu_03_03_b")
"""Defaults may be chosen on these: climbing, walking, punching, over obstacles."""
TEST_CLIPS = ("cmu_01_01_a", "cmu_02_07_a", "cmu_02_10", "cmu_03_03_a", "cmu_02_03_short")
"""Results are stated on these: jumping, swordplay, washing, over obstacles, running."""
MAX_FRAMES = 250  # 5 s; with more, all methods take longer than the 25 minutes that are promised

_OFFSETS_FRAMES = (-2, -1, 1, 2)  # the paper, eq. 6
# How much goes wrong, chosen and not fitted; a change is a new VERSION. See the fields of Variant.
_MAX_SUBFRAME = 0.5
_BUMP_RAD = np.deg2rad(1.0)
_BUMP_M = 0.02
_LOST_S = 2.0
_MAX_LOST_SHARE = 1 / 3
_DISTANCE_M = 4.0
_TILT_RAD = np.deg2rad(40.0)
_TARGET_HEIGHT_M = 1.0
_MEDIAN_OVER_SIGMA = 0.6745  # of the absolute value of a normal distribution


def recordings(
    variants: Iterable[Variant] = VARIANTS, clips: Iterable[str] = TEST_CLIPS, max_frames: int = MAX_FRAMES
) -> Iterator[BenchmarkRecording]:
    """The recordings of the benchmark, one after the other; the same at each call.

    Args:
        variants: what goes wrong.
        clips: names of motions, of TUNING_CLIPS or TEST_CLIPS.
        max_frames: of each clip, at its own 50 Hz; of one that is played faster, the frames of as much time.

    Raises:
        ValueError: a clip is unknown.
    """
    clips = tuple(clips)
    for variant in variants:
        for clip in clips:
            yield record(variant, clip, max_frames)


def record(variant: Variant, clip: str, max_frames: int = MAX_FRAMES) -> BenchmarkRecording:
    """One recording; as recordings()."""
    truth_m, fps = _motion(clip, max_frames, variant.fps, variant.speed)
    rig = _rig(variant.layout)
    bumped, lost = _rng(clip, "cameras").permutation(rig.n_cameras)[:2].tolist()
    true_rig = _with_bump(rig, bumped, _rng(clip, "bump")) if variant.bumped else rig
    offsets_s = _offsets_s(variant, clip, rig.n_cameras, fps)
    skeleton = load_skeleton("h36m_17")
    real = _real_errors(variant, clip, len(truth_m), rig.n_cameras, fps) if variant.real else None

    def seen(offsets_s: Float[np.ndarray, " camera"]) -> Scene:
        seed = _seed(clip, "scene")
        return simulate(truth_m, skeleton, true_rig, fps, variant.noise, variant.occlusion, seed, offsets_s, real)

    away = np.zeros((len(truth_m), rig.n_cameras), dtype=bool)
    if variant.lost:
        away[_lost_frames(len(truth_m), fps, _rng(clip, "lost")), lost] = True
    kept = rig.names[: variant.n_cameras]
    scene, on_time = seen(offsets_s), seen(np.zeros(rig.n_cameras))
    hidden = on_time.occluded | away[..., None]
    known = on_time.observations.without(hidden)
    if variant.network is not None:
        read = as_read(scene.observations, true_rig, variant.network, _seed(clip, "stature"))
        scene = replace(scene, observations=read)
    delivered = moved_with_cameras(scene.observations, true_rig, rig).without(away[..., None] | np.zeros_like(hidden))
    return BenchmarkRecording(
        clip=clip,
        variant=variant.name,
        observations=delivered.subset(kept),
        rig=rig.subset(kept),
        fps=fps,
        truth_m=truth_m,
        occluded=scene.occluded[:, : variant.n_cameras],
        true_rig=true_rig.subset(kept),
        true_offsets_s=offsets_s[: variant.n_cameras],
        oracle_observations=known.subset(kept),
        sigma_px=_sigma_px(variant, known, true_rig, truth_m),
    )


def _real_errors(variant: Variant, clip: str, n_frames: int, n_cameras: int, fps: float) -> RealErrors:
    skeleton, rng = load_skeleton("h36m_17"), _rng(clip, "real errors")
    return real_errors(rng, n_frames, n_cameras, skeleton, fps, variant.real)


def _sigma_px(
    variant: Variant, known: Observations, rig: CameraRig, truth_m: Float[np.ndarray, "frame joint 3"]
) -> float:
    """Standard deviation of each pixel coordinate of a detection that is neither hidden nor an outlier. Of real errors
    and of biased ones it is measured."""
    if not variant.real and variant.noise.max_bias_m == 0:
        return float(np.hypot(variant.noise.sigma_px, variant.noise.correlated_px))
    error_px = rig.undistort(known.points2d_px) - rig.project(truth_m)
    return float(np.nanmedian(np.abs(error_px)) / _MEDIAN_OVER_SIGMA)


def _seed(clip: str, what: str) -> int:
    # hash() of a string differs from process to process.
    return zlib.crc32(f"{clip}/{what}".encode())


def _rng(clip: str, what: str) -> np.random.Generator:
    return np.random.default_rng(_seed(clip, what))


def _motion(
    clip: str, max_frames: int, fps: float | None, speed: float
) -> tuple[Float[np.ndarray, "frame joint 3"], float]:
    if clip not in TUNING_CLIPS + TEST_CLIPS:
        raise ValueError(f"no clip {clip!r}; there is {', '.join(TUNING_CLIPS + TEST_CLIPS)}")
    clip_m, clip_fps = embedded_motion(clip)
    truth_m, played_fps = clip_m[: round(speed * max_frames)], speed * clip_fps
    return (truth_m, played_fps) if fps is None else (_resampled_m(truth_m, played_fps, fps), fps)


def _resampled_m(
    motion_m: Float[np.ndarray, "frame joint 3"], fps: float, new_fps: float
) -> Float[np.ndarray, "new_frame joint 3"]:
    from scipy.interpolate import CubicSpline

    n_frames = int((len(motion_m) - 1) / fps * new_fps) + 1
    return np.asarray(CubicSpline(np.arange(len(motion_m)) / fps, motion_m)(np.arange(n_frames) / new_fps))


def _rig(layout: Layout) -> CameraRig:
    if layout == "ring":
        return ring_rig()
    radius_m = float(_DISTANCE_M * np.cos(_TILT_RAD))
    height_m = float(_TARGET_HEIGHT_M + _DISTANCE_M * np.sin(_TILT_RAD))
    return ring_rig(radius_m=radius_m, height_m=height_m, target_m=(0.0, 0.0, _TARGET_HEIGHT_M))


def _offsets_s(variant: Variant, clip: str, n_cameras: int, fps: float) -> Float[np.ndarray, " camera"]:
    """The offsets of fewer shifted cameras are among those of more."""
    rng = _rng(clip, "offsets")
    shifted = 1 + rng.permutation(n_cameras - 1)[: variant.n_shifted]
    whole = rng.choice(_OFFSETS_FRAMES, n_cameras)
    part = rng.uniform(-_MAX_SUBFRAME, _MAX_SUBFRAME, n_cameras)
    offsets = np.zeros(n_cameras)
    if variant.offsets != "none":
        offsets[shifted] = (whole if variant.offsets == "frames" else part)[shifted]
    return offsets / fps


def _with_bump(rig: CameraRig, index: int, rng: np.random.Generator) -> CameraRig:
    """The rig with one camera turned about its own centre and moved, both in random directions."""
    cameras = list(rig.cameras)
    cameras[index] = _bumped(cameras[index], rng)
    return CameraRig(tuple(cameras))


def _bumped(camera: Camera, rng: np.random.Generator) -> Camera:
    from scipy.spatial.transform import Rotation

    axis, direction = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
    world_T_camera = camera.world_T_camera.copy()
    world_T_camera[:3, :3] = Rotation.from_rotvec(_BUMP_RAD * axis).as_matrix() @ world_T_camera[:3, :3]
    world_T_camera[:3, 3] += _BUMP_M * direction
    return replace(camera, world_T_camera=world_T_camera)


def _lost_frames(n_frames: int, fps: float, rng: np.random.Generator) -> slice:
    count = round(min(_LOST_S * fps, _MAX_LOST_SHARE * n_frames))
    start = int(rng.integers(n_frames - count + 1))
    return slice(start, start + count)
