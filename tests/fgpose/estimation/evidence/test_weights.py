"""The weights of detections."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fgpose.config import ProjectionConfig
from fgpose.estimation.evidence.fusion import Fusion, fuse
from fgpose.estimation.evidence.weights import LEAST_WEIGHT, detection_weights
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import Scene, ring_rig


def weights_of(scene: Scene, rig: CameraRig, **settings: Any) -> np.ndarray:
    config = replace(ProjectionConfig(), **settings)
    return detection_weights(fuse(scene.observations, rig), scene.observations.confidence, rig, config)


@pytest.mark.parametrize("weighting", ["fusion", "confidence", "uniform"])
def test_weights_are_bounded(weighting: str, mocap_scene: Scene, rig: CameraRig) -> None:
    weights = weights_of(mocap_scene, rig, weighting=weighting)
    assert weights.max() <= 1.0
    assert weights.min() >= LEAST_WEIGHT


def test_confidence_alone_and_none_at_all(mocap_scene: Scene, rig: CameraRig) -> None:
    seen, confidence = mocap_scene.observations.seen, mocap_scene.observations.confidence
    least = LEAST_WEIGHT
    np.testing.assert_allclose(weights_of(mocap_scene, rig, weighting="uniform")[seen], 1.0)
    by_confidence = weights_of(mocap_scene, rig, weighting="confidence")[seen]
    np.testing.assert_allclose(by_confidence, np.maximum(confidence[seen], least))
    # Where the views contradict each other their agreement counts too.
    assert np.median(np.abs(weights_of(mocap_scene, rig, weighting="fusion")[seen] - by_confidence)) > 0.05


def test_occluded_detections_weigh_less(mocap_scene: Scene, rig: CameraRig) -> None:
    weights = weights_of(mocap_scene, rig, weighting="fusion")
    seen, occluded = mocap_scene.observations.seen, mocap_scene.occluded
    assert np.median(weights[seen & occluded]) < 0.5 * np.median(weights[seen & ~occluded])


def test_the_nearest_other_view_decides() -> None:
    """Eq. 2 of the other views, bounded: by hand for three views and one joint."""
    by_view_px2 = np.array([[0.0, 900.0, 100.0], [400.0, 0.0, 2500.0], [3600.0, 900.0, 0.0]])[None, :, :, None]
    blank = np.ones((1, 3, 1))
    fusion = Fusion(np.zeros((1, 1, 3)), blank, blank, by_view_px2)
    config = ProjectionConfig(confirming_px=10.0, agreement_px=30.0)
    weights = detection_weights(fusion, np.full((1, 3, 1), 0.6), ring_rig(3), config)
    nearest_px2 = np.array([400.0, 900.0, 100.0])
    trust = 1 - 0.4 * (1 - 1 / (1 + nearest_px2 / 100.0))
    np.testing.assert_allclose(weights[0, :, 0], trust / (1 + nearest_px2 / 900.0))


def test_what_another_view_confirms_needs_no_confidence() -> None:
    fusion = Fusion(np.zeros((1, 1, 3)), np.ones((1, 3, 1)), np.ones((1, 3, 1)), np.full((1, 3, 3, 1), 1.0))
    confidence = np.array([0.05, 0.5, 1.0])[None, :, None]
    weights = detection_weights(fusion, confidence, ring_rig(3), ProjectionConfig())
    np.testing.assert_allclose(weights, 1.0, atol=4e-3)  # off by 1 px of 20: 1 / 400 is lacking


def test_of_two_views_that_contradict_each_other_neither_is_confirmed() -> None:
    """By hand: two views of a joint keep their confidence however far apart they are; a third one judges all three.

    Three cameras, two joints: all three see the first, only two the second.
    """
    by_view_px2 = np.full((1, 3, 3, 2), 100.0**2)
    by_view_px2[:, 2, :, 1] = by_view_px2[:, :, 2, 1] = np.nan
    confidence = np.full((1, 3, 2), 0.5)
    confidence[0, 2, 1] = 0.0
    fusion = Fusion(np.zeros((1, 2, 3)), np.ones((1, 3, 2)), np.ones((1, 3, 2)), by_view_px2)
    weights = detection_weights(
        fusion, confidence, ring_rig(3), ProjectionConfig(confirming_px=1e-3, agreement_px=100.0)
    )
    np.testing.assert_allclose(weights[0, :, 0], 0.25)  # off by agreement_px: half
    np.testing.assert_allclose(weights[0, :2, 1], 0.5)


def test_a_lone_view_keeps_its_confidence() -> None:
    fusion = Fusion(np.zeros((1, 1, 3)), np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.zeros((1, 1, 1, 1)))
    weights = detection_weights(fusion, np.full((1, 1, 1), 0.8), ring_rig(1), ProjectionConfig())
    np.testing.assert_allclose(weights, 0.8)
