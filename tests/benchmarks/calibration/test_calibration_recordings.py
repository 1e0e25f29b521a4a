"""The recordings of the benchmark of calibration from people, and what its baselines make of exact ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fgpose.assessment import rigs
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.calibration import real
from fgpose_benchmarks.calibration.baselines import five_point, procrustes
from fgpose_benchmarks.calibration.real import REAL, WEBCAM, record_real
from fgpose_benchmarks.calibration.recording import KnownRigRecording
from fgpose_benchmarks.calibration.variants import TEST_CLIPS, VARIANTS, find_variant, record, recordings
from fgpose_benchmarks.synthetic import NO_CROWD_ERRORS, NO_NOISE, STUDIOS, SimulatedClocks, SimulatedNetwork

EXACT = SimulatedNetwork(
    noise=NO_NOISE,
    min_bias_m=0.0,
    max_bias_m=0.0,
    scale_sigma=0.0,
    depth_bias_scale=0.0,
    tilt_sigma_deg=0.0,
    mistakes=NO_CROWD_ERRORS,
)
VARIANT = replace(find_variant("walk_ring_4"), duration_s=2.0, network=EXACT)


@pytest.fixture(scope="module")
def exact() -> KnownRigRecording:
    return record(VARIANT, "test_1")


@pytest.fixture(scope="module")
def apart() -> KnownRigRecording:
    clocks = SimulatedClocks(fps=(30.0, 50.0), max_start_s=1.0, min_drift_ppm=43.0, max_drift_ppm=145.0)
    return record(replace(VARIANT, clocks=clocks), "test_1")


@pytest.mark.parametrize("clocks", ["exact", "apart"])
def test_what_baselines_are_told_is_the_walker(clocks: str, request: pytest.FixtureRequest):
    recording: KnownRigRecording = request.getfixturevalue(clocks)
    walk, scene = recording.told, recording.scene
    assert scene is not None
    for c, camera in enumerate(recording.rig.cameras):
        known = np.isfinite(recording.on_time_s[:, c])
        assert known.mean() > 0.95
        # The nearest image: within half a period of the camera, but for the last.
        assert np.abs(recording.on_time_s[known, c] - walk.time_s[known]).max() < 0.6 / 30
        true_m = scene.joints_m(recording.on_time_s[known, c])
        off_px = walk.points2d_px[known, c] - camera.distort(camera.project(true_m))
        assert np.nanmax(np.abs(off_px)) < 1e-5
    np.testing.assert_allclose(scene.joints_m(walk.time_s), recording.joints_m)


def test_times_of_a_camera_are_by_its_own_clock(apart: KnownRigRecording):
    assert not apart.given.synchronised
    offsets_s = apart.on_time_s - apart.image_s
    # Constant but for the drift: at most 290 ppm of 3 s.
    assert np.nanmax(np.nanstd(offsets_s, axis=0)) < 1e-3
    np.testing.assert_allclose(np.nanmean(offsets_s, axis=0), apart.rig.time_offsets_s, atol=1e-3)


@pytest.mark.parametrize(("solve", "position_m", "rotation_deg"), [(procrustes, 1e-4, 1e-3), (five_point, 1e-3, 1e-2)])
def test_baselines_find_the_rig_of_an_exact_recording(
    solve: Callable[[Walk, CameraRig], CameraRig],
    position_m: float,
    rotation_deg: float,
    exact: KnownRigRecording,
):
    # Procrustes is exact but for the undistortion; RANSAC ends at the best of its samples, not at an optimum.
    rig = solve(exact.told, exact.intrinsics)
    assert rigs.position_errors_m(rig, exact.rig).max() < position_m
    assert rigs.rotation_errors_deg(rig, exact.rig).max() < rotation_deg
    np.testing.assert_allclose(rig.cameras[0].world_T_camera, np.eye(4), atol=1e-12)


def test_baselines_say_what_they_lack(exact: KnownRigRecording):
    with pytest.raises(ValueError, match="Procrustes needs per-view 3D joints"):
        procrustes(replace(exact.told, points3d_m=None), exact.intrinsics)
    nothing = replace(exact.told, points2d_px=np.full_like(exact.told.points2d_px, np.nan))
    with pytest.raises(ValueError, match="no two cameras share enough joints"):
        five_point(nothing, exact.intrinsics)


def test_a_variant_gives_what_its_name_says():
    shared = record(replace(find_variant("shared_equal_4"), duration_s=1.0), "test_1")
    assert shared.given.focal == "shared"
    guess = shared.intrinsics.focal_px / shared.rig.focal_px
    assert np.ptp(guess) < 1e-9
    assert 0.2 <= abs(guess[0] - 1.0) <= 0.4
    distance = record(replace(find_variant("distance_ring_4"), duration_s=1.0), "test_1").given
    assert distance.stature_m is None
    ((first, far, length_m),) = distance.distances
    # Opposite cameras of a ring with a radius of 4.5 m.
    assert (first, far, round(length_m, 6)) == ("cam_1", "cam_3", 9.0)


def test_variants_differ_in_what_they_are_named_after():
    names = [variant.name for variant in VARIANTS]
    assert len(set(names)) == len(names)
    studios = {studio.name for studio in STUDIOS}
    assert {variant.studio for variant in VARIANTS if variant.group != "real"} <= studios
    assert {variant.studio for variant in VARIANTS if variant.group == "real"} == set(REAL)
    # The same walk where only the errors differ.
    plain, no_3d = (
        record(replace(find_variant(name), duration_s=1.0), "test_2") for name in ("walk_ring_4", "2d_ring_4")
    )
    np.testing.assert_array_equal(plain.joints_m, no_3d.joints_m)
    assert no_3d.told.points3d_m is None
    with pytest.raises(ValueError, match="no variant 'none'"):
        find_variant("none")
    with pytest.raises(ValueError, match="no clip 'test_9'"):
        record(VARIANT, "test_9")


def test_a_real_recording_comes_once_and_without_its_calibration():
    (balance,) = recordings([find_variant("balance_blazepose")], TEST_CLIPS)
    assert (balance.clip, balance.variant) == ("real", "balance_blazepose")
    for given, true in zip(balance.intrinsics.cameras, balance.rig.cameras, strict=True):
        np.testing.assert_array_equal(given.world_T_camera, np.eye(4))
        np.testing.assert_array_equal(given.K, true.K)
    # In the frames of the cameras, the man is some metres ahead of each, and on the rays of his landmarks.
    assert balance.told.points3d_m is not None
    depth_m = np.nanmedian(balance.told.points3d_m[..., 2], axis=(0, 2))
    assert ((depth_m > 2.0) & (depth_m < 6.0)).all()
    camera, points3d_m = balance.intrinsics.cameras[0], balance.told.points3d_m[:, 0]
    off_px = camera.distort(camera.project(points3d_m)) - balance.told.points2d_px[:, 0]
    assert np.nanmedian(np.abs(off_px)) < 0.1
    assert np.isfinite(balance.joints_m).all(axis=-1).mean() > 0.9


@pytest.mark.skipif(not WEBCAM.is_dir(), reason="it is read from the folder of the source code")
def test_the_webcams_have_clocks_of_their_own(monkeypatch: pytest.MonkeyPatch):
    # Its joints take ten seconds, and tell nothing of the clocks.
    unknown = SimpleNamespace(positions_m=np.full((267, 33, 3), np.nan))
    monkeypatch.setattr(real, "smooth", lambda *_: unknown)
    webcam = record_real("webcam_mediapipe")
    assert webcam.told.points3d_m is None
    assert webcam.image_s.shape == (267, 4)
    # Images of one group are up to 20 ms apart.
    spread_s = np.nanmax(webcam.image_s, axis=1) - np.nanmin(webcam.image_s, axis=1)
    assert 0.001 < np.median(spread_s) < 0.02
    with pytest.raises(ValueError, match="no recording 'none' here; there is balance_blazepose, balance_openpose"):
        record_real("none")
