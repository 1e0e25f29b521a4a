"""Whether a triangulated point or the predicted one is the better first guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.images import fits_better
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_NOISE, NO_OCCLUSION, simulate, walking

CONFIG = Config()
AWAY_M = np.array([0.4, 0.0, 0.1])


def seen_at(points_m: np.ndarray, rig: CameraRig, skeleton: Skeleton, weights: list[float]) -> Evidence:
    """Exact detections of these joints, all of a camera with one weight."""
    scene = simulate(points_m[None], skeleton, rig, 50.0, NO_NOISE, NO_OCCLUSION, seed=0)
    evidence = gather(scene.observations, rig, CONFIG)
    return replace(evidence, weights=np.broadcast_to(np.array(weights)[:, None], evidence.weights.shape).copy())


def test_where_all_cameras_agree_the_joint_has_moved(rig: CameraRig, skeleton: Skeleton) -> None:
    predicted_m = walking(1, 50.0, skeleton)[0]
    for moved_m in (0.03 * AWAY_M, AWAY_M):
        evidence = seen_at(predicted_m + moved_m, rig, skeleton, [1.0] * 4)
        assert fits_better(predicted_m + moved_m, predicted_m, evidence, rig, CONFIG.projection).all()


def test_detections_that_are_hardly_trusted_do_not_move_it_far(rig: CameraRig, skeleton: Skeleton) -> None:
    predicted_m = walking(1, 50.0, skeleton)[0]
    evidence = seen_at(predicted_m + AWAY_M, rig, skeleton, [0.4, 0.4, 0.05, 0.05])
    assert not fits_better(predicted_m + AWAY_M, predicted_m, evidence, rig, CONFIG.projection).any()


def test_an_unknown_point_fits_never_and_any_point_better_than_it(rig: CameraRig, skeleton: Skeleton) -> None:
    known_m = walking(1, 50.0, skeleton)[0]
    evidence, unknown_m = seen_at(known_m, rig, skeleton, [1.0] * 4), np.full(known_m.shape, np.nan)
    assert fits_better(known_m, unknown_m, evidence, rig, CONFIG.projection).all()
    assert not fits_better(unknown_m, known_m, evidence, rig, CONFIG.projection).any()
