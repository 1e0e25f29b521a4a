"""Scenes that many tests share: a ring of four cameras around a person whose motion is known."""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from tests.shape_checks import pytest_runtest_setup  # noqa: F401

# isort: split
from fgpose.geometry.camera import CameraRig
from fgpose.io.skeletons import load_skeleton
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import (
    NO_OCCLUSION,
    DetectionNoise,
    Occlusion,
    Scene,
    motion_from_npz,
    ring_rig,
    simulate,
    walking,
)

MOCAP = Path(__file__).parents[1] / "benchmarks" / "fgpose_benchmarks" / "data" / "mocap_cmu"


def pytest_collection_finish() -> None:
    """What was imported and collected lives until the end: garbage is not looked for in it, nor after 700 objects."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


@pytest.fixture(scope="session")
def rig() -> CameraRig:
    """Four cameras like those of Human3.6M, world z up."""
    return ring_rig()


@pytest.fixture(scope="session")
def skeleton() -> Skeleton:
    return load_skeleton("h36m_17")


@pytest.fixture(scope="session")
def walking_scene(rig: CameraRig, skeleton: Skeleton) -> Scene:
    """Two seconds of walking at 30 frames a second, noisy, nothing occluded."""
    return simulate(walking(60, 30.0, skeleton), skeleton, rig, 30.0, DetectionNoise(), NO_OCCLUSION, seed=0)


@pytest.fixture(scope="session")
def mocap_scene(rig: CameraRig, skeleton: Skeleton) -> Scene:
    """Three seconds of a real walk (motion capture) at 50 frames a second; three of the four views are occluded."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    return simulate(truth_m[:150], skeleton, rig, fps, DetectionNoise(), Occlusion(), seed=0)


@pytest.fixture(scope="session")
def demo_videos() -> Path:
    """Folder of the demonstration videos, with the weights of BlazePose beside them in the user's cache.

    Skips the test where the registries do not answer and the cache is empty.
    """
    from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
    from fgpose.monocular.downloads.models import MODELS
    from fgpose.monocular.downloads.packages import FetchError

    try:
        for model in MODELS:
            model.pull()
        return fetch_demo_videos()
    except FetchError as error:
        pytest.skip(str(error))
