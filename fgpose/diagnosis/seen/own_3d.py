"""The 3D joints that each view alone gives: whether they are in the frame and the unit that they were read in."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from fgpose.diagnosis.body.proportions import rough_stature_m, stature_m
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import Camera
from fgpose.observations import Observations
from fgpose.sampling import spread_evenly
from fgpose.skeleton import Skeleton

_FRAMES = 200  # medians need no more
# Of the size of the body in the image. 3D of a network, projected, is within a tenth of its 2D; in another frame it is
# beside the body or behind the camera.
_ELSEWHERE = 0.5
_THERE = 0.25
# Noise of 3D joints makes limbs longer, children are small, and some networks know no scale: within a factor of three.
_SMALLEST_M, _TALLEST_M = 0.4, 4.0
_USUAL_M = 1.7
_MM_AS_M = (300.0, 3000.0)


class _Mistake(NamedTuple):
    camera: str
    what: str
    """Of the 3D joints, after "are"; in front of numbers that differ from camera to camera."""
    cause: str
    remedy: str
    numbers: dict[str, float]


def foreign_3d(examined: Examined) -> list[Finding]:
    """Cameras whose own 3D is of another unit, or is not where their own 2D is."""
    seen = examined.main
    if seen.points3d_m is None:
        return []
    sampled = seen.frames(spread_evenly(seen.n_frames, _FRAMES))
    of_cameras = [_of_camera(camera, *_own(sampled, c), seen.skeleton) for c, camera in enumerate(examined.rig.cameras)]
    mistakes = [each for each in of_cameras if each is not None]
    by_cause: dict[str, list[_Mistake]] = {}
    for each in mistakes:
        by_cause.setdefault(each.cause, []).append(each)
    return [_finding(examined, same) for same in by_cause.values()]


def _finding(examined: Examined, same: list[_Mistake]) -> Finding:
    first = same[0]
    who = first.camera if len(same) == 1 else examined.in_words([each.camera for each in same])
    example = "" if len(same) == 1 else f" in {first.camera}"
    return Finding(
        Code.PER_VIEW_JOINTS,
        Severity.WRONG,
        f"The 3D joints that {who} alone give{'s' if len(same) == 1 else ''} are {first.what}{example}: {first.cause}",
        first.remedy,
        1.0,
        camera=first.camera if len(same) == 1 else "",
        numbers=first.numbers,
    )


def _own(seen: Observations, c: int) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame joint 2"]]:
    """3D and 2D joints of a camera, where it has both."""
    assert seen.points3d_m is not None
    points_m, points_px = seen.points3d_m[:, c].astype(float), seen.points2d_px[:, c].astype(float)
    both = np.isfinite(points_m).all(axis=-1, keepdims=True) & np.isfinite(points_px).all(axis=-1, keepdims=True)
    return np.where(both, points_m, np.nan), np.where(both, points_px, np.nan)


def _of_camera(
    camera: Camera,
    points_m: Float[np.ndarray, "frame joint 3"],
    points_px: Float[np.ndarray, "frame joint 2"],
    skeleton: Skeleton,
) -> _Mistake | None:
    points_px = camera.undistort(points_px)
    body_px = _size_px(points_px)
    if not body_px > 0:
        return None
    tall_m = stature_m(points_m, skeleton)
    tall_m = rough_stature_m(points_m, skeleton) if np.isnan(tall_m) else tall_m
    if 0 < tall_m < _SMALLEST_M or tall_m > _TALLEST_M:
        return _of_unit(camera.name, tall_m)
    away_px = _away_px(camera, points_m, points_px)
    return _of_frame(camera, points_m, points_px, body_px) if away_px > _ELSEWHERE * body_px else None


def _size_px(points_px: Float[np.ndarray, "frame joint 2"]) -> float:
    """Of the body in the image: the longer side of the box around its joints, median; NaN: it is in none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of images without anybody: NaN
        return float(np.nanmedian((np.nanmax(points_px, axis=1) - np.nanmin(points_px, axis=1)).max(axis=-1)))


def _away_px(
    camera: Camera, points_m: Float[np.ndarray, "frame joint 3"], points_px: Float[np.ndarray, "frame joint 2"]
) -> float:
    """Median distance of the image of the 3D joints from the 2D ones; infinite if most are behind the camera."""
    away_px = np.linalg.norm(camera.project(points_m) - points_px, axis=-1)[np.isfinite(points_px).all(axis=-1)]
    return float(np.median(np.where(np.isfinite(away_px), away_px, np.inf)))


def _of_unit(name: str, tall_m: float) -> _Mistake:
    factor = _USUAL_M / tall_m
    true, read_as = ("m", "mm") if factor > 1 else ("mm", "m")
    cause, remedy = f"they are in {true}, read as {read_as}", f"Give --points3d-unit {true} (points3d_unit in Python)."
    if not _MM_AS_M[0] < max(factor, 1 / factor) < _MM_AS_M[1]:
        cause, remedy = "they are in another unit", f"Multiply them by about {factor:.2g}."
    numbers = {"stature_m": tall_m, "factor": factor}
    return _Mistake(name, f"those of a person {tall_m:.2g} m tall", cause, remedy, numbers)


def _of_frame(
    camera: Camera,
    points_m: Float[np.ndarray, "frame joint 3"],
    points_px: Float[np.ndarray, "frame joint 2"],
    body_px: float,
) -> _Mistake:
    """Of 3D joints that are elsewhere than the 2D ones. A frame is named if the joints fit with it."""

    def fit(placed_m: Float[np.ndarray, "frame joint 3"]) -> bool:
        return _away_px(camera, placed_m, points_px) < _THERE * body_px

    cause = "they are in another frame, or of a camera elsewhere"
    remedy = (
        "Give --points3d-frame (points3d_frame in Python) as they were written, with the calibration that the network "
        "was given; or leave them out."
    )
    if fit(camera.to_camera_frame(points_m)):
        cause = "they are in the frame of the world, read as in that of the camera"
        remedy = "Give --points3d-frame world (points3d_frame in Python)."
    elif fit(camera.to_world_frame(points_m)):
        cause = "they are in the frame of the camera, read as in that of the world"
        remedy = (
            "Give --points3d-frame camera (points3d_frame in Python); observations of your own want them in the world "
            "(Camera.to_world_frame)."
        )
    away_px = _away_px(camera, points_m, points_px)
    away = f"{away_px:.0f} px away from" if np.isfinite(away_px) else "behind it, not at"
    what = f"{away} its own 2D joints (median; the body is {body_px:.0f} px large)"
    return _Mistake(camera.name, what, cause, remedy, {"away_px": away_px, "body_px": body_px})
