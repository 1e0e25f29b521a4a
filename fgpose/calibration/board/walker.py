"""The world of a calibration with boards, level from somebody who walked before the cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.calibration.board.calibrate import CalibratedFromBoards
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade
from fgpose.calibration.from_people.verdict.inputs import camera_tilt_deg
from fgpose.calibration.from_people.verdict.verdict import nobody_upright
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.floor import find_vertical_and_floor
from fgpose.calibration.from_people.world.metric import world_T_gauge
from fgpose.calibration.from_people.world.vertical import Vertical
from fgpose.estimation.smoother import smooth
from fgpose.geometry.rigid import pose_of
from fgpose.monocular.detected import Detected
from fgpose.trajectory import Trajectory

_COARSE_DEG = 2.0  # cameras on tripods are level to one or two


def level_from_people(result: CalibratedFromBoards, detected: Detected) -> CalibratedFromBoards:
    """The same in the world of the person who was seen most, see level_from_walker; where nobody was followed, as it is
    and with a finding that says why.

    Args:
        result: its world is that of level cameras.
        detected: the people in the images of the same cameras, whatever rig they were detected with.
    """
    if result.grade is Grade.FAILED:
        return result
    try:
        own = detected.recalibrated(result.rig.with_time_offsets(result.begins_s))
        return level_from_walker(result, smooth(own.observations(), own.rig))
    except ValueError as error:
        reason = f"the world is level by the cameras alone: {error}"
    remedy = "walk before the cameras, seen from head to feet, or give another --origin"
    return replace(result, findings=(*result.findings, CalibrationFinding("", Grade.COARSE, reason, remedy)))


def level_from_walker(result: CalibratedFromBoards, walker: Trajectory) -> CalibratedFromBoards:
    """The same rig in the world of somebody who walked: z up, z = 0 on the floor, the origin under the first camera,
    whose horizontal viewing direction is x. Lengths stay those of the board.

    Args:
        result: in any world.
        walker: estimated with its rig; joints that fewer than two cameras saw do not count.

    Raises:
        ValueError: the skeleton lacks hips, knees or ankles, or legs and head (or shoulders) were never seen together.
    """
    joints_m = np.where(walker.observed[..., None], walker.positions_m, np.nan)
    anatomy = Anatomy(walker.skeleton)
    stature_m = anatomy.stature_m(joints_m)
    if not np.isfinite(stature_m):
        raise ValueError("vertical and floor need the legs and shoulders of somebody: no two cameras saw them")
    vertical, floor = find_vertical_and_floor(joints_m, walker.time_s, anatomy)
    moved = world_T_gauge(result.rig.cameras[0], vertical.up, floor.height, 1.0)
    rig = moved.rig(result.rig)
    seen_s = float(walker.observed.any(axis=1).mean() * (walker.time_s[-1] - walker.time_s[0]))
    return replace(
        result,
        rig=rig,
        world_T_board=pose_of(moved.R, moved.offset_m) @ result.world_T_board,
        world=(
            f"The world is level as somebody walked who was seen for {seen_s:.0f} s and is {stature_m:.2f} m tall by "
            f"the lengths of the board (± {100 * anatomy.segments[1]:.0f} %): z up, ± {vertical.sigma_deg:.1f} deg; "
            f"z = 0 on the floor, ± {1000 * floor.sigma:.0f} mm; the origin under the first camera, x ahead of it."
        ),
        findings=(*result.findings, *nobody_upright(vertical.upright, camera_tilt_deg(rig)), *_uncertain(vertical)),
    )


def _uncertain(vertical: Vertical) -> list[CalibrationFinding]:
    if vertical.sigma_deg <= _COARSE_DEG:
        return []
    reason = f"the vertical is known to ± {vertical.sigma_deg:.1f} degrees only"
    return [CalibrationFinding("", Grade.COARSE, reason, "walk through the room, in several directions")]
