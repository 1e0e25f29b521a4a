"""Which way is up, by the body and by the cameras."""

from __future__ import annotations

import numpy as np

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.up_axis import nearest_axis, up_vector
from fgpose.kinematics.vertical import find_up
from fgpose.trajectory import Status, Trajectory

# As fgpose.kinematics.vertical: who leans by more than this does not stand.
_UPRIGHT_DEG = 25.0


def wrong_up(examined: Examined) -> list[Finding]:
    """A world in which another axis than z is up, or another than the one that was given."""
    body_m = examined.body_m
    status = np.where(np.isfinite(body_m).all(axis=-1), Status.OBSERVED, Status.UNOBSERVABLE).astype(np.int8)
    body = Trajectory(examined.main.skeleton, np.arange(len(body_m), dtype=float), body_m, status)
    found = find_up([body], examined.rig)
    if not found.remark:
        return []
    if examined.world_up == "auto":
        remedy = (
            "TRC, C3D, BVH, .mot, angles and reports have it up; positions in parquet, npz and Python stay in the "
            "calibration's world. If it is another, give --world-up."
        )
        return [Finding(Code.WORLD_UP, Severity.NOTE, found.remark, remedy, 0.3)]
    away = np.clip(up_vector(found.world_up) @ up_vector(examined.world_up), -1, 1)
    angle_deg = float(np.rad2deg(np.arccos(away)))
    if angle_deg <= _UPRIGHT_DEG:
        return []
    return [
        Finding(
            Code.WORLD_UP,
            Severity.WRONG,
            f"--world-up {examined.world_up} was given, but {found.remark}",
            f"Give --world-up {nearest_axis(found.world_up)}, or auto.",
            0.8,
            numbers={"angle_deg": angle_deg},
        )
    ]
