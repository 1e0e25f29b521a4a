"""One camera as calibration files give it, and the unit of their lengths."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.lens import LensModel, without_unused
from fgpose.geometry.rigid import inverse, pose_of
from fgpose.plain_files import MAX_CAMERAS

UnitOfFormat = str
"""What a format prescribes, or a file says, a name of UNITS; auto where it is left open."""
Unit = str | float
"""auto, a name of UNITS, or how many metres a unit is, as the side of the squares of a board."""
UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "inch": 0.0254, "in": 0.0254, "ft": 0.3048}
"""Metres per unit, by its name."""
_OTHER_NAMES = {"inches": "inch", "in": "inch", "feet": "ft", "foot": "ft"}
# Rigs stand in rooms and halls: no camera is farther than this from the others or from the origin.
_MAX_PLAUSIBLE_M = 100.0
# Cameras that are all nearer to each other than this cannot triangulate a person.
_MIN_PLAUSIBLE_M = 0.02
# Cameras around a person are further apart than this.
_SMALL_M = 0.5
# Of the width of the image: 136 degrees as a pinhole, 286 as a fisheye.
_LEAST_FOCAL = 0.2
# A file of unknown unit: below the first it can only be metres, above the second only millimetres: cameras around a
# person in centimetres would be less than 1 m apart in these.
_SURELY_METRES = 20.0
_SURELY_MILLIMETRES = 1000.0


@dataclass(frozen=True)
class CalibratedView:
    """One camera of a file: x_camera = R x_world + t, t in the unit of the file."""

    name: str
    size_px: tuple[int, int]
    K: Float[np.ndarray, "3 3"]
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]
    distortion: Float[np.ndarray, " coefficients"]
    lens: LensModel = "pinhole"
    time_offset_s: float = 0.0
    """How much later than its time stamps say the camera takes its images; only our own files know it,
    and what changes in time. See Camera."""
    start_s: float = 0.0
    clock_drift: float = 0.0
    clock_jumps: tuple[tuple[float, float], ...] = ()
    moves: tuple[tuple[float, Float[np.ndarray, "4 4"]], ...] = ()
    """Since when, and world_T_camera from then on."""
    world_T_camera: Float[np.ndarray, "4 4"] | None = None
    """As our own files have it. R and t would give it back to the last bit but one, from which an online estimate may
    go another way."""

    def to_camera(self, metres_per_unit: float) -> Camera:
        check_focal(self.name, self.K, self.size_px)
        pose = inverse(pose_of(self.R, self.t)) if self.world_T_camera is None else self.world_T_camera
        return Camera(
            self.name,
            self.size_px,
            self.K,
            _scaled(pose, metres_per_unit),
            without_unused(self.distortion),
            self.lens,
            time_offset_s=self.time_offset_s,
            start_s=self.start_s,
            clock_drift=self.clock_drift,
            clock_jumps=self.clock_jumps,
            moves=tuple((since_s, _scaled(pose, metres_per_unit)) for since_s, pose in self.moves),
        )


def _scaled(pose: Float[np.ndarray, "4 4"], metres_per_unit: float) -> Float[np.ndarray, "4 4"]:
    return pose_of(pose[:3, :3], metres_per_unit * pose[:3, 3])


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of one camera of a file, whatever its pose is."""

    name: str
    K: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, " coefficients"]
    size_px: tuple[int, int] | None
    """None: the file does not say for which images it is."""
    lens: LensModel = "pinhole"


def check_focal(name: str, K: Float[np.ndarray, "3 3"], size_px: tuple[int, int]) -> None:
    """Raise ValueError, naming the camera, for a focal length that no lens has: it is not in pixels."""
    if 0 < K[0, 0] < _LEAST_FOCAL * size_px[0]:
        raise ValueError(
            f"camera {name}: a focal length of {K[0, 0]:g} for images {size_px[0]} px wide is not in pixels; in "
            "millimetres, multiply it by the width in pixels and divide by that of the sensor"
        )


def metres_per_unit(unit: Unit) -> float | None:
    """None for auto. Raises ValueError unless it is a unit or a positive number of metres."""
    if unit == "auto":
        return None
    try:
        metres = UNITS[unit] if unit in UNITS else float(unit)  # type: ignore[index]
    except (TypeError, ValueError):
        metres = math.nan
    if not 0 < metres < math.inf:
        raise ValueError(
            f"unit must be auto, {', '.join(UNITS)}, or how many metres it is (0.054: squares of 54 mm), got {unit!r}"
        )
    return metres


def unit_named(value: Any) -> str:
    """The name of UNITS that a file means (``Millimetres``). Raises ValueError if it is none."""
    text = str(value).strip().casefold()
    for prefix, short in (("milli", "mm"), ("centi", "cm"), ("deci", "dm"), ("", "m")):
        if text.removesuffix("s") in (f"{prefix}metre", f"{prefix}meter"):
            return short
    text = _OTHER_NAMES.get(text, text)
    if text not in UNITS:
        raise ValueError(f"the unit {reprlib.repr(value)} is none of {', '.join(UNITS)}")
    return text


def rig_in_metres(views: Sequence[CalibratedView], unit_of_format: UnitOfFormat, unit: Unit) -> CameraRig:
    """The rig of a file's cameras, in metres.

    Args:
        views: the cameras in the unit of the file.
        unit_of_format: what the format prescribes; auto where it leaves the unit open.
        unit: what the caller says; auto to go by the format, or by the size of the rig where that leaves it open.

    Raises:
        ValueError: there are too many, the unit cannot be told, or with it the rig is implausibly large or small.
    """
    if len(views) > MAX_CAMERAS:
        raise ValueError(f"{len(views)} cameras are more than the {MAX_CAMERAS} that a rig may have")
    metres = metres_per_unit(unit)
    if metres is None and unit_of_format != "auto":
        unit, metres = unit_of_format, UNITS[unit_of_format]
    elif metres is None:
        unit = _unit_by_size(_extent([view.to_camera(1.0) for view in views]))
        metres = UNITS[unit]
    rig = CameraRig(tuple(view.to_camera(metres) for view in views))
    _check_plausible(rig, str(unit))
    return rig


def _extent(cameras: Sequence[Camera]) -> float:
    """Largest distance between two cameras, or of one from the origin."""
    centres = np.stack([np.zeros(3)] + [camera.position_m for camera in cameras])
    return float(np.linalg.norm(centres[:, None] - centres, axis=-1).max())


def _unit_by_size(extent: float) -> Literal["m", "mm"]:
    if extent < _SURELY_METRES:
        return "m"
    if extent > _SURELY_MILLIMETRES:
        return "mm"
    raise ValueError(
        f"the file does not say its unit of length, and a rig of {extent:.0f} may be metres, centimetres or "
        'millimetres; give --unit m, cm or mm, in Python unit="mm"; squares of a board as their side in metres, '
        "--unit 0.054"
    )


def _check_plausible(rig: CameraRig, unit: str) -> None:
    extent_m = _extent(rig.cameras)
    if extent_m > _MAX_PLAUSIBLE_M:
        farthest = max(rig.cameras, key=lambda camera: float(np.linalg.norm(camera.position_m)))
        advice = "the translations are wrong" if unit != "m" else _other_units(extent_m)
        raise ValueError(
            f"camera {farthest.name} is {np.linalg.norm(farthest.position_m):.0f} m from the origin, the rig measures "
            f"{extent_m:.0f} m: {advice}"
        )
    centres = rig.positions_m
    spread_m = float(np.linalg.norm(centres - centres[0], axis=-1).max())
    if unit == "mm" and rig.n_cameras > 1 and spread_m < _MIN_PLAUSIBLE_M:
        raise ValueError(
            f"all cameras lie within {1000 * spread_m:.1f} mm of {rig.names[0]}: "
            "the file looks like metres; give --unit m"
        )


def _other_units(extent: float) -> str:
    """What to say of a rig that is too large in metres."""
    fitting = [each for each in ("cm", "mm") if _SMALL_M <= extent * UNITS[each] <= _SURELY_METRES]
    if not fitting:
        return "the unit is another one; give it, or how many metres it is (the side of the squares of a board)"
    sizes = " or ".join(f"--unit {each} (then it measures {extent * UNITS[each]:.1f} m)" for each in fitting)
    return f"these are not metres; give {sizes}, or how many metres a unit is (the side of the squares of a board)"


def rotation_matrix(name: str, rotation: Any) -> Float[np.ndarray, "3 3"]:
    """A rotation from a Rodrigues vector (3 numbers) or a matrix (9). Raises ValueError, naming the camera."""
    from scipy.spatial.transform import Rotation

    array = numbers(name, "rotation", rotation)
    if array.size == 3:
        return Rotation.from_rotvec(array.ravel()).as_matrix()
    if array.size == 9:
        return array.reshape(3, 3)
    raise ValueError(
        f"camera {name}: a rotation has 3 numbers (Rodrigues vector) or 9 (matrix), this one has {array.size}"
    )


def numbers(name: str, what: str, value: Any, *shape: int) -> np.ndarray:
    """An array of finite numbers, of the given shape if there is one. Raises ValueError, naming the camera."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"camera {name}: {what} is not an array of numbers: {reprlib.repr(value)}") from None
    if shape and array.size != np.prod(shape):
        wanted = " x ".join(map(str, shape))
        raise ValueError(f"camera {name}: {what} must have {wanted} numbers, got {array.size}")
    if not np.isfinite(array).all():
        raise ValueError(f"camera {name}: {what} contains a number that is not finite")
    return array.reshape(shape) if shape else array
