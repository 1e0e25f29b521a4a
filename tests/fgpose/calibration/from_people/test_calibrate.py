"""The whole chain, from uncalibrated cameras to a rig with a verdict."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
import pytest

import fgpose
from fgpose.assessment import rigs
from fgpose.calibration.from_people.calibrate import Parts, calibrate_from_people
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople, Grade
from fgpose.calibration.from_people.starts.starts import GivenStart
from fgpose.geometry.camera import CameraRig
from fgpose_benchmarks.synthetic import SimulatedClocks, WalkScene, film, find_studio, stature_m, walkers

DURATION_S = 15.0


@cache
def scene(
    behaviour: Literal["walks", "stands"] = "walks",
    max_start_s: float = 0.0,
    focal_guess: float | None = None,
    n_cameras: int = 4,
) -> WalkScene:
    """Of cameras around a walker, with biased detections."""
    studio = find_studio("equal_4" if focal_guess else "ring_4")
    duration_s = DURATION_S if behaviour == "walks" else 6.0
    motion = walkers(studio.floor_m, duration_s + max_start_s, 3, behaviour=behaviour)
    clocks = SimulatedClocks(max_start_s=max_start_s) if max_start_s else None
    rig = studio.rig.subset(studio.rig.names[:n_cameras])
    return film(motion, rig, 3, clocks=clocks, focal_guess=focal_guess)


def calibrated(of: WalkScene, intrinsics: CameraRig | None = None, **options: object) -> CalibratedFromPeople:
    stature = stature_m(of.motion.truth_m[0], of.motion.skeleton)
    given: dict = {"stature_m": stature, "synchronised": True, **options}
    return calibrate_from_people(of.observations, intrinsics or of.intrinsics, **given)


@cache
def of_known_lenses() -> tuple[CalibratedFromPeople, list[tuple[int, int]]]:
    """And the progress that was told."""
    progress = list[tuple[int, int]]()
    return calibrated(scene(), progress=lambda done, of_all: progress.append((done, of_all))), progress


@pytest.mark.slow
def test_synchronised_cameras_of_known_lenses() -> None:
    of, (found, progress) = scene(), of_known_lenses()
    assert found.grade is Grade.GOOD
    # Half a minute of a walker gives 5 to 20 mm and 0.1 to 0.5 degrees; this is half of that.
    assert rigs.position_errors_m(found.rig, of.rig).max() < 0.06
    assert max(rigs.rotation_errors_deg(found.rig, of.rig)) < 1.5
    assert abs(rigs.scale_error(found.rig, of.rig)) < 0.03
    assert rigs.vertical_error_deg(found.rig, of.rig) < 1.5
    assert found.scale_from.startswith("stature")
    first = found.rig.cameras[0]
    np.testing.assert_allclose(first.position_m[:2], 0.0, atol=1e-9)
    assert first.world_T_camera[0, 2] > 0
    assert abs(first.world_T_camera[1, 2]) < 1e-9
    assert np.nanmin(found.joints_m[..., 2]) == pytest.approx(0.0, abs=0.15)  # feet are on the floor
    assert progress == [(n, 7) for n in range(1, 8)]


@pytest.mark.slow
def test_videos_that_begin_seconds_apart() -> None:
    of = scene(max_start_s=5.0, n_cameras=3)
    found = calibrated(of, synchronised=False)
    assert found.grade is not Grade.FAILED
    # A third of an image at 30 Hz; the starts are seconds apart.
    assert np.abs(of.rig.time_offsets_s).max() > 0.5
    assert np.abs(rigs.start_errors_s(found.rig, of.rig)).max() < 0.011
    assert rigs.position_errors_m(found.rig, of.rig).max() < 0.06


@pytest.mark.slow
def test_starts_that_were_heard_are_made_exact() -> None:
    of = scene(max_start_s=5.0, n_cameras=3)
    heard_s = of.rig.time_offsets_s + np.array([0.0, 0.012, -0.008])
    starts = {name: GivenStart(float(start_s), 0.01) for name, start_s in zip(of.rig.names, heard_s, strict=True)}
    found = calibrated(of, synchronised=False, starts=starts)
    assert np.abs(rigs.start_errors_s(found.rig, of.rig)).max() < 0.006
    assert rigs.position_errors_m(found.rig, of.rig).max() < 0.06


@pytest.mark.slow
def test_one_unknown_focal_length() -> None:
    of = scene(focal_guess=1.3)
    found = calibrated(of, focal="shared")
    assert found.grade is not Grade.FAILED
    assert np.abs(rigs.focal_errors(found.rig, of.rig)).max() < 0.03  # from 30 % off
    assert (found.sigmas.focal > 0).all()


@pytest.mark.slow
def test_a_k_of_another_resolution_is_named() -> None:
    of = scene()
    wrong = of.intrinsics.cameras[1].K.copy()
    wrong[:2, :2] *= 0.5
    cameras = list(of.intrinsics.cameras)
    cameras[1] = replace(cameras[1], K=wrong)
    found = calibrated(of, CameraRig(tuple(cameras)))
    assert found.grade is not Grade.GOOD
    assert cameras[1].name in {finding.camera for finding in found.findings}


@pytest.mark.slow
def test_somebody_who_stands_still_does_not_make_a_good_calibration() -> None:
    found = calibrated(scene("stands", n_cameras=3))
    assert found.grade is not Grade.GOOD
    assert any("one place" in finding.reason for finding in found.findings)


@pytest.mark.slow
def test_parts_can_be_left_out() -> None:
    of = scene()
    (whole, _), without = of_known_lenses(), calibrated(of, parts=Parts(bias=False, referee=False))
    assert not np.allclose(whole.rig.projection_matrices, without.rig.projection_matrices)
    assert rigs.position_errors_m(without.rig, of.rig).max() < 0.1


def test_one_camera_is_refused() -> None:
    of = scene()
    name = of.rig.names[0]
    with pytest.raises(ValueError, match="at least two cameras"):
        calibrate_from_people(of.observations.subset([name]), of.intrinsics.subset([name]))


def test_cameras_must_be_those_of_the_intrinsics() -> None:
    of = scene()
    with pytest.raises(ValueError, match="camera"):
        fgpose.calibration.calibrate_from_people(of.observations, of.intrinsics.subset(of.rig.names[:2]))
