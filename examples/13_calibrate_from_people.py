"""Calibrate cameras from nothing but the person in their videos, and compare the result with the true calibration.

What one learns: throwing a calibration away, calibrating from people, reading the verdict with its reasons and
remedies and the standard deviations, and keeping the rig in fgpose's format and in that of another program.

    python examples/13_calibrate_from_people.py --stature-m 1.80
    python examples/13_calibrate_from_people.py --focal shared      # the focal lengths are thrown away, too
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

import fgpose
from fgpose.calibration import CalibratedFromPeople, Grade, calibrate_from_people
from fgpose.calibration.moved_views import moved_with_cameras
from fgpose.geometry.intrinsics import without_pose
from fgpose.pipeline.calibration import write_calibration


def angle_deg(a: fgpose.Camera, b: fgpose.Camera) -> float:
    """By how much two cameras are turned against each other."""
    between = a.world_T_camera[:3, :3].T @ b.world_T_camera[:3, :3]
    return float(np.rad2deg(np.arccos(np.clip((np.trace(between) - 1) / 2, -1, 1))))


def distance_m(a: fgpose.Camera, b: fgpose.Camera) -> float:
    return float(np.linalg.norm(a.position_m - b.position_m))


def print_comparison(found: fgpose.CameraRig, true: fgpose.CameraRig) -> None:
    """Distances and angles between cameras: they do not depend on where the world has its origin."""
    print(f"{'cameras':20} {'distance [m]':>20} {'angle [deg]':>20}")
    for a, b in combinations(range(true.n_cameras), 2):
        pairs = [(rig.cameras[a], rig.cameras[b]) for rig in (found, true)]
        (distance, true_distance), (angle, true_angle) = zip(
            *((distance_m(*p), angle_deg(*p)) for p in pairs), strict=True
        )
        print(
            f"{true.names[a] + ' ' + true.names[b]:20} {distance:7.2f}, true {true_distance:5.2f} "
            f"{angle:9.1f}, true {true_angle:5.1f}"
        )


def print_verdict(result: CalibratedFromPeople) -> None:
    """Why it is good, coarse or failed, and what would help."""
    print(f"verdict: {result.grade.value}; scale from {result.scale_from}, +/- {100 * result.sigmas.scale:.1f} %")
    for finding in result.findings:
        print(f"  {finding.camera or 'all'}: {finding.reason}; {finding.remedy}")
    for name, sigma_m, sigma_deg in zip(
        result.rig.names, result.sigmas.position_m, result.sigmas.direction_deg, strict=True
    ):
        print(f"  {name}: place +/- {1000 * sigma_m:.0f} mm, direction +/- {sigma_deg:.1f} deg")


def main(
    focal: Literal["known", "shared", "each"] = "known",
    stature_m: float | None = None,
    output: Path = Path("out/calibrated"),
) -> None:
    """Calibrate the four cameras of a real recording. The man in it stays in one place: a hard case.

    Args:
        focal: whether the focal lengths are taken from the true calibration, or estimated.
        stature_m: of the person; without it the scale is that of the network's 3D, which is off by some per cent.
        output: folder for the rig and the scene for the viewer.
    """
    true, observations = fgpose.files.load_recording("balance_blazepose")
    if focal == "known":
        intrinsics = fgpose.CameraRig(tuple(without_pose(camera) for camera in true.cameras))
    else:
        intrinsics = fgpose.calibration.guessed_intrinsics(true.names, [camera.size_px for camera in true.cameras])
    # What uncalibrated cameras see: the network's 3D is in the frame of each camera, not in a common world.
    people = fgpose.people.PeopleObservations.of_one(moved_with_cameras(observations, true, intrinsics))

    result = calibrate_from_people(people, intrinsics, focal=focal, stature_m=stature_m, synchronised=True)
    print_verdict(result)
    print_comparison(result.rig, true)
    for path in write_calibration(result, output / "rig.toml", rrd=output / "rig.rrd"):
        print(f"wrote {path}")
    if result.grade is not Grade.FAILED:
        fgpose.save_rig(result.rig, output / "calibration.toml", "aniposelib")
        print(f"wrote {output / 'calibration.toml'} for anipose")


if __name__ == "__main__":
    tyro.cli(main)
