"""How large the errors of visible detections are, told frame by frame."""

from __future__ import annotations

import numpy as np
import pytest

from fgpose.config import Config
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals
from fgpose.estimation.visibility.running_spread import RunningSpread
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, simulate, walking

FPS, N_FRAMES = 30.0, 120
CONFIG = Config()


def residuals(rig: CameraRig, skeleton: Skeleton, sigma_px: float) -> list[DetectionResiduals]:
    """Against the truth, frame by frame."""
    noise = DetectionNoise(sigma_px=sigma_px, correlated_px=0.0, outlier_share=0.0)
    scene = simulate(walking(N_FRAMES, FPS, skeleton), skeleton, rig, FPS, noise, NO_OCCLUSION, seed=0)
    evidence = [gather(frame, rig, CONFIG) for frame in scene.observations]
    poses = zip(scene.truth_m, evidence, strict=True)
    return [DetectionResiduals.of(positions_m[None], each, rig, CONFIG) for positions_m, each in poses]


def then(spread: RunningSpread, frame: int, residuals: DetectionResiduals) -> RunningSpread:
    n_cameras = residuals.seen.shape[1]
    return spread.then(frame / FPS, np.full((n_cameras, 1), 1 / FPS), residuals, np.ones(n_cameras, bool))


def told(frames: list[DetectionResiduals], spread: RunningSpread, first: int) -> list[RunningSpread]:
    spreads = []
    for frame, each in enumerate(frames, first):
        spreads.append(spread := then(spread, frame, each))
    return spreads


def test_it_follows_errors_that_grow_and_shrink_within_half_a_second(rig: CameraRig, skeleton: Skeleton) -> None:
    quiet, loud = (residuals(rig, skeleton, sigma_px) for sigma_px in (2.0, 8.0))
    start = RunningSpread.at_first(CONFIG.visibility.sigma_m, rig.n_cameras)
    before = told(quiet, start, 0)
    during = told(loud[:60], before[-1], N_FRAMES)
    after = told(quiet[:60], during[-1], N_FRAMES + 60)
    usual_m = before[-1].spread_m
    # Four times; of the median of 15 frames x 68 detections 3 %, and of what is believed of it a tenth is left out.
    np.testing.assert_allclose(during[16].spread_m / usual_m, 4.0, rtol=0.25)
    np.testing.assert_allclose(after[16].spread_m / usual_m, 1.0, rtol=0.25)


def test_of_equal_errors_it_is_the_usual_one(rig: CameraRig, skeleton: Skeleton) -> None:
    spreads = told(residuals(rig, skeleton, 4.0), RunningSpread.at_first(CONFIG.visibility.sigma_m, rig.n_cameras), 0)
    of_usual = [spread.spread_m / spread.usual_m.min(axis=0) for spread in spreads[60:]]
    np.testing.assert_allclose(of_usual, 1.0, atol=0.1)


def test_a_frame_that_another_image_joins_counts_once(rig: CameraRig, skeleton: Skeleton) -> None:
    frames = residuals(rig, skeleton, 4.0)
    spread = told(frames[:100], RunningSpread.at_first(CONFIG.visibility.sigma_m, rig.n_cameras), 0)[-1]
    joined = then(spread, 99, frames[99])
    assert joined.lately[-1][1].tolist() == spread.lately[-1][1].tolist()
    assert (len(joined.lately), joined.stretches) == (len(spread.lately), spread.stretches)


def test_frames_that_nothing_is_seen_in_change_nothing(rig: CameraRig, skeleton: Skeleton) -> None:
    frames = residuals(rig, skeleton, 4.0)
    spread = told(frames, RunningSpread.at_first(CONFIG.visibility.sigma_m, rig.n_cameras), 0)[-1]
    nobody = np.zeros(rig.n_cameras, bool)
    later = spread.then(100.0, np.full((rig.n_cameras, 1), 96.0), frames[0], nobody)
    assert later.spread_m == pytest.approx(later.usual_m.min(axis=0))
