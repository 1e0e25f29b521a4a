"""Errors of real detections, for the family "real" of the open benchmark.

    .venv/bin/python benchmarks/real_residuals.py [OUTPUT.npz]    # about two minutes

Writes data/detection_errors/errors.npz from recordings of one man with four cameras: OpenPose and BlazePose as they
come with fgpose, BlazePose on the demonstration videos (fetched once), and on these videos with cut-outs pasted
over the man by the rule of benchmarks/occluders.py, which stay for 1 to 2 s.

The error of a detection is its distance from the projected result of fgpose.smooth on the *other* cameras, which never
see an occluder. As the calibration that comes with the videos is off by up to 60 mm, the cameras are calibrated first,
with their clocks, on the detections without occluders of the same detector. Pixels become metres at the joint's depth:
times depth over focal length. Frames in which the result is not known to 30 mm (SD along the worst axis) for every
joint, or in which fewer than two of the other cameras see it, are left out; stretches shorter than a second too.

What remains in these errors and is none: that of the other cameras' result, about 10 mm.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

import fgpose
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.calibration.self_calibration import self_calibrate
from fgpose.estimation.evidence.image_checks.flips import correct_flips
from fgpose.io.arrays import write_arrays
from fgpose.io.recordings import load_recording
from fgpose.monocular.detection import detect
from fgpose.monocular.downloads.cache import cache_folder
from fgpose.monocular.networks import open_network
from fgpose.trajectory import Status
from fgpose_benchmarks.synthetic.real_errors import Block
from occluders import load_cutouts, occluded
from scenario import demo_sources

_OUTPUT = Path(__file__).parent / "fgpose_benchmarks" / "data" / "detection_errors" / "errors.npz"
_NETWORKS = ("blazepose-full", "blazepose-heavy")
_SEEDS = (42, 43, 44)
_MAX_SIGMA_M = 0.03
_MIN_S = 1.0
# Of h36m_17 and where the detector has no such joint: what is nearest. The middle of two is the mean of their errors.
_INSTEAD = {
    "pelvis": ("left_hip", "right_hip"),
    "spine": ("left_hip", "right_hip"),
    "thorax": ("left_shoulder", "right_shoulder"),
    "neck_base": ("left_shoulder", "right_shoulder"),
    "head": ("nose",),
}


def main(output: Path) -> None:
    blocks = list(_all_blocks())
    output.parent.mkdir(parents=True, exist_ok=True)
    write_arrays(
        output,
        {
            # Half precision: a thousandth of the error.
            "error_m": np.concatenate([block.error_m for block in blocks]).astype(np.float16),
            "confidence": np.concatenate([block.confidence for block in blocks]).astype(np.float16),
            "n_frames": np.array([len(block.error_m) for block in blocks]),
            "sources": np.array([block.source for block in blocks]),
            "cameras": np.array([block.camera for block in blocks]),
            "joint_names": np.array(fgpose.load_skeleton("h36m_17").joints),
            "fps": np.array(60.0),
        },
    )
    _print_summary(blocks)


def _all_blocks() -> Iterator[Block]:
    rig, observations = load_recording("balance_openpose")
    calibrated = self_calibrate(observations, rig)
    yield from _blocks("openpose", calibrated.observations, calibrated.observations, calibrated.rig)
    sources, cutouts = demo_sources(), load_cutouts()
    for model in _NETWORKS:
        network, name = open_network(model), model.replace("-", "_")
        clean = detect(sources, network, cache=cache_folder() / "detections")
        calibrated = self_calibrate(correct_flips(clean.observations(), clean.rig)[0], clean.rig)
        # Flips are errors of the detector: they are put right in the reference only.
        seen = moved_with_cameras(clean.observations(), clean.rig, calibrated.rig)
        yield from _blocks(name, seen, calibrated.observations, calibrated.rig)
        for seed in _SEEDS:
            hidden = detect(occluded(clean, seed, cutouts), network).observations()
            seen = moved_with_cameras(hidden, clean.rig, calibrated.rig)
            yield from _blocks(f"{name}_occluded", seen, calibrated.observations, calibrated.rig)


def _blocks(
    source: str, seen: fgpose.Observations, reference: fgpose.Observations, rig: fgpose.CameraRig
) -> Iterator[Block]:
    """Of every camera: what it has seen against the other cameras of the reference."""
    for index, camera in enumerate(rig.cameras):
        others = tuple(name for name in rig.names if name != camera.name)
        result = fgpose.smooth(reference.subset(others), rig.subset(others))
        at_camera_m = _at_m(result, camera.time_offset_s)
        off_px = camera.undistort(seen.points2d_px[:, index]) - camera.project(at_camera_m)
        depth_m = camera.to_camera_frame(at_camera_m)[..., 2:]
        error_m, confidence = _as_h36m(off_px * depth_m / np.diag(camera.K)[:2], seen.confidence[:, index], seen)
        for start, end in _long_stretches(_known(result), round(_MIN_S * 60.0)):
            yield Block(source, camera.name, error_m[start:end], confidence[start:end])


def _at_m(result: fgpose.Trajectory, offset_s: float) -> Float[np.ndarray, "frame joint 3"]:
    """The result when the camera took its images. Joints that are nowhere known stay NaN."""
    velocity_mps = np.gradient(result.positions_m, result.time_s, axis=0)
    return result.positions_m + offset_s * velocity_mps


def _used_joints(skeleton: fgpose.Skeleton) -> list[tuple[int, ...]]:
    """For each joint of h36m_17, the joints of a detector that stand for it."""
    names = [
        (joint,) if joint in skeleton.joints else _INSTEAD[joint] for joint in fgpose.load_skeleton("h36m_17").joints
    ]
    return [tuple(skeleton.index(name) for name in each) for each in names]


def _as_h36m(
    error_m: Float[np.ndarray, "frame joint 2"],
    confidence: Float[np.ndarray, "frame joint"],
    seen: fgpose.Observations,
) -> tuple[Float[np.ndarray, "frame h36m 2"], Float[np.ndarray, "frame h36m"]]:
    """Missing where one of the joints that are averaged is."""
    used = _used_joints(seen.skeleton)
    return (
        np.stack([error_m[:, list(joints)].mean(axis=1) for joints in used], axis=1),
        np.stack([confidence[:, list(joints)].min(axis=1) for joints in used], axis=1),
    )


def _known(result: fgpose.Trajectory) -> Bool[np.ndarray, " frame"]:
    """Frames in which the other cameras know every joint."""
    assert result.covariance_m2 is not None
    joints = sorted({joint for joints in _used_joints(result.skeleton) for joint in joints})
    # What is not known has a variance beyond every limit.
    covariance_m2 = np.nan_to_num(result.covariance_m2[:, joints], nan=1.0)
    largest_m2 = np.linalg.eigvalsh(covariance_m2)[..., -1]
    is_seen = np.isin(result.status[:, joints], [Status.OBSERVED])
    return np.all((largest_m2 <= _MAX_SIGMA_M**2) & is_seen, axis=1)


def _long_stretches(chosen: Bool[np.ndarray, " frame"], shortest: int) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(chosen.astype(int), prepend=0, append=0)).tolist()
    return [(start, end) for start, end in list(pairwise(edges))[::2] if end - start >= shortest]


def _print_summary(blocks: list[Block]) -> None:
    print("| source | blocks | s | median, mm | 95 %, mm | > 0.1 m, % | missing, % | mean confidence |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for source in dict.fromkeys(block.source for block in blocks):
        of_source = [block for block in blocks if block.source == source]
        size_mm = 1000 * np.linalg.norm(np.concatenate([block.error_m for block in of_source]), axis=-1)
        confidence = np.concatenate([block.confidence for block in of_source])
        numbers = [
            f"{len(of_source)}",
            f"{len(size_mm) / 60:.1f}",
            *(f"{np.nanpercentile(size_mm, percent):.0f}" for percent in (50, 95)),
            f"{100 * np.mean(size_mm > 100):.1f}",
            f"{100 * np.mean(np.isnan(size_mm)):.1f}",
            f"{confidence.mean():.2f}",
        ]
        print(f"| {source} | {' | '.join(numbers)} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else _OUTPUT)
