"""A rig that was right until somebody bumped a camera: what moved, by how much, and a rig that is right again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.disagreement import NEGLIGIBLE_MRAD, allowed_mrad
from fgpose.calibration.from_people.calibrated import CalibrationFinding, Grade, worst_grade
from fgpose.calibration.moved_views import Recording, moved_with_cameras
from fgpose.calibration.rig_refinement import has_moved, moves, refine_rig
from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.shown import Shown

# A move by chance is so nearly along the viewing axis once in thirty times; the turn is a bump's smallest.
_ALONG, _HARDLY_TURNED_DEG = np.cos(np.deg2rad(15.0)), 1.0


@dataclass(frozen=True, eq=False, repr=False)
class BumpedRig(Shown, Generic[Recording]):
    """A rig of which the cameras that had been moved have new poses, and the others the ones they had."""

    rig: CameraRig
    observations: Recording
    """The observations, their per-view 3D moved with the cameras that saw it."""
    moved: Bool[np.ndarray, " camera"]
    """Which cameras were moved: further than their calibration can be wrong."""
    rotation_deg: Float[np.ndarray, " camera"]
    """By how much each camera was turned; zero for those that were not moved."""
    translation_m: Float[np.ndarray, " camera"]
    residual_before_px: Float[np.ndarray, " camera"]
    """Median reprojection error, with the rig as it was and as it is now; NaN for a camera that sees nothing."""
    residual_after_px: Float[np.ndarray, " camera"]
    findings: tuple[CalibrationFinding, ...]

    @property
    def grade(self) -> Grade:
        """The worst of the findings."""
        return worst_grade(self.findings)


def refine_bumped(observations: Recording, rig: CameraRig, config: Config | None = None) -> BumpedRig[Recording]:
    """Find the cameras that were moved since the rig was calibrated, and their new poses.

    The first refinement (refine_rig) of all cameras tells who was moved: further than three standard deviations of an
    untouched camera. The others get back their poses; a second refinement starts from there, so that what they shared
    of the move in the first goes to whom it belongs. Clocks are those of the rig.

    Args:
        observations: of one person or of everybody, on the clock of the rig (on_common_clock).
        rig: as it was calibrated.
        config: see refine_rig.

    Raises:
        ValueError: the cameras of observations and rig differ, or no joint is seen by two cameras that agree.
    """
    config = config or Config()
    first = refine_rig(observations, rig, config)
    moved = np.asarray(has_moved(first.rotation_deg, first.translation_m, config))
    if not moved.any():
        nowhere, error_px = np.zeros(rig.n_cameras), first.residual_before_px
        findings = _findings(rig, rig, moved, error_px)
        return BumpedRig(rig, observations, moved, nowhere, nowhere, error_px, error_px, findings)
    start = _with_moved(rig, first.rig, moved)
    second = refine_rig(moved_with_cameras(observations, rig, start), start, config)
    found = _with_moved(rig, second.rig, moved)
    return BumpedRig(
        found,
        moved_with_cameras(observations, rig, found),
        moved,
        *moves(rig, found),
        first.residual_before_px,
        second.residual_after_px,
        _findings(rig, found, moved, second.residual_after_px),
    )


def _with_moved(given: CameraRig, refined: CameraRig, moved: Bool[np.ndarray, " camera"]) -> CameraRig:
    triples = zip(given.cameras, refined.cameras, moved.tolist(), strict=True)
    return CameraRig(tuple(new if is_moved else old for old, new, is_moved in triples))


def _perhaps_zoomed(
    rig: CameraRig, found: CameraRig, moved: Bool[np.ndarray, " camera"], remedy: str
) -> list[CalibrationFinding]:
    """Cameras that moved along their viewing axis and hardly turned: at one distance a zoom looks the same."""
    turned_deg, moved_m = moves(rig, found)
    axes = np.stack([camera.world_T_camera[:3, 2] for camera in rig.cameras])
    along_m = np.abs(np.sum(axes * (found.positions_m - rig.positions_m), axis=1))
    zoomed = moved & (along_m > _ALONG * moved_m) & (turned_deg < _HARDLY_TURNED_DEG)
    reason = "it was moved by {0:.0f} mm along its viewing axis and hardly turned, or zoomed"
    return [
        CalibrationFinding(rig.names[c], Grade.COARSE, reason.format(1e3 * moved_m[c]), f"if it was zoomed, {remedy}")
        for c in np.flatnonzero(zoomed).tolist()
    ]


def _findings(
    rig: CameraRig, found: CameraRig, moved: Bool[np.ndarray, " camera"], error_px: Float[np.ndarray, " camera"]
) -> tuple[CalibrationFinding, ...]:
    """What is wrong with the result."""
    from_nothing = "calibrate from nothing: leave out --from"
    findings = [
        CalibrationFinding(name, Grade.COARSE, "it saw nothing that another camera saw", "walk where both see you")
        for name in np.array(rig.names)[np.isnan(error_px)].tolist()
    ]
    if moved.any() and 2 * moved.sum() >= rig.n_cameras:
        reason = f"{moved.sum()} of {rig.n_cameras} cameras seem to have moved, so it is not certain which did"
        findings.append(CalibrationFinding("", Grade.COARSE, reason, from_nothing))
    findings += _perhaps_zoomed(rig, found, moved, from_nothing)
    error_mrad = 1000 * error_px / rig.focal_px
    for c in np.flatnonzero(error_mrad > allowed_mrad(float(np.nanmedian(error_mrad)), NEGLIGIBLE_MRAD)).tolist():
        reason = f"it still disagrees with the others by {error_px[c]:.0f} px ({error_mrad[c]:.0f} mrad)"
        findings.append(CalibrationFinding(rig.names[c], Grade.FAILED, reason, from_nothing))
    return tuple(findings)
