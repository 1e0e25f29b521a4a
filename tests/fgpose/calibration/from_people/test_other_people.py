"""Somebody beside the walker, of another size: whose stature it is changes the scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walks import FPS, SKELETON

from fgpose.calibration.from_people.calibrated import Grade
from fgpose.calibration.from_people.rig.evidence import reconstructed
from fgpose.calibration.from_people.rig.other_people import OtherPerson, other_people
from fgpose.calibration.from_people.starts.starts import GivenStart, Starts, find_starts
from fgpose.calibration.from_people.walk import Track, Walk
from fgpose.calibration.from_people.world.metric import Metric, to_metric
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, ring_rig, simulate, walking

RIG = ring_rig(4)
N_FRAMES = 240
STATURE_M = 1.7


def walk_of(size: float, ahead: int, seed: int) -> Walk:
    """Of somebody so many times as tall as the walker, so many frames ahead on the same circle."""
    truth_m = size * walking(N_FRAMES + ahead, FPS, SKELETON)[ahead:]
    seen = simulate(truth_m, SKELETON, RIG, FPS, DetectionNoise(), NO_OCCLUSION, seed).observations
    return Walk(SKELETON, RIG.names, seen.time_s.copy(), seen.points2d_px.copy(), seen.confidence.copy())


def tracks_of(walk: Walk) -> list[Track]:
    return [
        Track(name, walk.time_s, walk.points2d_px[:, c], walk.confidence[:, c])
        for c, name in enumerate(walk.camera_names)
    ]


WALKER = walk_of(1.0, 0, 1)


@pytest.fixture(scope="module")
def starts() -> Starts:
    return find_starts(tracks_of(WALKER), SKELETON, RIG, {name: GivenStart(0.0) for name in RIG.names})


def others_of(others: list[Walk], starts: Starts, cameras: slice = slice(None)) -> list[OtherPerson]:
    everybody = {name: [track] for name, track in zip(RIG.names, tracks_of(WALKER), strict=True)}
    for other in others:
        for track in tracks_of(other)[cameras]:
            everybody[track.camera].append(track)
    return other_people(WALKER, everybody, starts, RIG, reconstructed(WALKER, RIG))


def metric_of(others: list[OtherPerson], **given: object) -> Metric:
    options: dict = {"stature_m": STATURE_M, **given}
    return to_metric(WALKER, RIG, reconstructed(WALKER, RIG), others=others, **options)


def test_who_is_beside_the_walker_is_told_apart_and_reconstructed(starts: Starts) -> None:
    child, adult = walk_of(0.7, 100, 2), walk_of(1.06, 200, 3)
    found = others_of([child, adult], starts)
    assert len(found) == 2
    for other in found:
        assert np.isfinite(other.joints_m).all(axis=-1).mean() > 0.8  # they pass each other, and the walker


@pytest.mark.parametrize("size", [0.7, 1.06, 0.94])
def test_another_size_makes_the_scale_uncertain_by_as_much(starts: Starts, size: float) -> None:
    scale = metric_of(others_of([walk_of(size, 120, 2)], starts)).scale
    (finding,) = scale.findings
    assert finding.grade is Grade.COARSE
    # Detections with noise: heads are known to a hundredth.
    ratio = float(finding.reason.split(" times as tall")[0].rsplit(" ", 1)[1])
    assert ratio == pytest.approx(size, rel=0.015)
    assert "ring_0 shows at pixel" in finding.reason
    assert "--distance" in finding.remedy
    # If the stature is the other's, the scale is off by the ratio.
    assert abs(np.log(size)) < 1.1 * scale.sigma


def test_one_of_the_same_size_changes_nothing_but_says_whose_it_is(starts: Starts) -> None:
    alone, scale = metric_of([]).scale, metric_of(others_of([walk_of(1.0, 120, 2)], starts)).scale
    assert not scale.findings
    assert scale.sigma == pytest.approx(alone.sigma, abs=0.01)
    assert scale.source.startswith(f"{alone.source} (taken to be of whom ring_")


def test_whom_one_camera_alone_sees_is_named(starts: Starts) -> None:
    found = others_of([walk_of(0.7, 120, 2)], starts, slice(1, 2))
    assert np.isnan(found[0].joints_m).all()
    scale = metric_of(found).scale
    assert not scale.findings
    assert "taken to be of whom ring_1 shows at pixel" in scale.source


def test_who_passes_by_does_not_matter(starts: Starts) -> None:
    passer = walk_of(0.7, 120, 2)
    points2d_px = np.where(np.arange(N_FRAMES)[:, None, None, None] < N_FRAMES // 4, passer.points2d_px, np.nan)
    confidence = np.where(np.isfinite(points2d_px).all(axis=-1), passer.confidence, 0.0)
    found = others_of([replace(passer, points2d_px=points2d_px, confidence=confidence)], starts)
    assert metric_of(found).scale == metric_of([]).scale
