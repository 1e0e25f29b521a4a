"""Hands whose lists were exchanged when the keypoints were written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fgpose
from fgpose.diagnosis.body.hands import exchanged_hands
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Severity
from fgpose.io.skeletons import load_skeleton
from fgpose_benchmarks.synthetic import DetectionNoise, Scene, motion_from_npz, ring_rig
from fgpose_benchmarks.synthetic.whole_body import simulate_whole_body, whole_body_of
from tests.conftest import MOCAP


@pytest.fixture(scope="module", params=["openpose_137", "coco_wholebody_133", "holistic_75"])
def filmed(request: pytest.FixtureRequest) -> Scene:
    skeleton = load_skeleton(request.param)
    motion_m, fps = motion_from_npz(MOCAP / "cmu_02_05.npz")
    truth_m = whole_body_of(motion_m[:60], fps, skeleton)
    return simulate_whole_body(truth_m, skeleton, ring_rig(), fps, DetectionNoise())


def with_hands_exchanged(seen: fgpose.Observations, cameras: list[int]) -> fgpose.Observations:
    """What is at the left of a pair becomes the right one, of the joints of the hands."""
    order = np.arange(seen.skeleton.n_joints)
    for part in seen.skeleton.parts:
        if "hand" in part.name:
            order[list(part.joints)] = seen.skeleton.mirror[list(part.joints)]
    points2d_px, confidence = seen.points2d_px.copy(), seen.confidence.copy()
    points2d_px[:, cameras] = seen.points2d_px[:, cameras][:, :, order]
    confidence[:, cameras] = seen.confidence[:, cameras][:, :, order]
    return replace(seen, points2d_px=points2d_px, confidence=confidence)


@pytest.mark.parametrize(
    ("cameras", "said"), [([], ""), ([1], "in ring_1:"), ([0, 1, 2, 3], "in all cameras:")], ids=["none", "one", "all"]
)
def test_exchanged_hands_are_named(filmed: Scene, cameras: list[int], said: str) -> None:
    seen = with_hands_exchanged(filmed.observations, cameras)
    found = exchanged_hands(Examined(filmed.rig, {0: seen}))
    assert len(found) == bool(cameras)
    for finding in found:
        assert (finding.code, finding.severity) == (Code.EXCHANGED_SIDES, Severity.WRONG)
        assert f"Left and right hand are exchanged {said}" in finding.text
