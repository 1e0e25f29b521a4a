"""The lens of one camera in a table of names and numbers, whatever program wrote it.

Names are compared without case, underscores, hyphens and blanks, and tables inside of it (``intrinsics``) count as
its own. What looks like a distortion and is not read is an error: a lens that is taken to have none bends everything.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.geometry.lens import LensModel
from fgpose.io.calibration.calibrated_view import Intrinsics, numbers

_INSIDE = ("intrinsics", "intrinsic", "intrinsicparameters", "extrinsics", "extrinsic", "extrinsicparameters")
# The more telling first.
_MATRIX = ("cameramatrix", "intrinsicmatrix", "intrinsicmat", "intrinsics", "intrinsic", "matrix", "mtx", "k")
_FOCAL_AND_CENTRE = ("fx", "fy", "cx", "cy")
_DISTORTION = (
    *("distortioncoefficients", "distortioncoeffs", "distortioncoeff", "distortioncoefs", "distortioncoef"),
    *("distcoeffs", "distcoeff", "distcoefs", "distcoef", "distcoefficients", "distortionparams"),
    *("distortionparameters", "distortionvector", "lensdistortion", "distortions", "distortion", "dist", "kc", "d"),
)
_NAMED = re.compile(r"[kp]\d")
_COEFFICIENTS = {"pinhole": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), "fisheye": ("k1", "k2", "k3", "k4")}
_LOOKS_LIKE_DISTORTION = re.compile(r"dist(?!ance|ortionmodel)|coef|radial|tangential")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_SIZE = ("imagesize", "imgsize", "size", "resolution")
_LENS_MODEL = ("distortionmodel", "lensmodel")
# Where others write which device it is; a name of no lens says nothing there.
_PERHAPS_MODEL = ("cameramodel", "model", "lens", "type", "cameratype", "projection")
_FLAGS = ("isfisheye", "fisheye", "fisheyemodel")
_PROJECTIONS = ("", "none", "pinhole", "perspective", "rectilinear")  # with any distortion
_PINHOLE = (
    *("plumbbob", "radtan", "radialtangential", "rationalpolynomial", "rational", "opencv", "fullopencv"),
    *("brown", "brownconrady", "standard"),
)
_FISHEYE = re.compile(r"(opencv)?fisheye|equidistant|equi|kb[48]?|kannalabrandt\d*")
_OTHER_MODEL = re.compile(
    r"fish|omni|mei$|eucm|^ds$|doublesphere|division|prism|scaramuzza|ocam|conrady|equi|stereograph|orthograph|spheri"
)
_YES_OR_NO = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False, "none": False}


@dataclass(frozen=True)
class CameraTable:
    """What a file says of one camera."""

    name: str
    values: Mapping[str, Any]
    """By plain names, without what is null."""
    spelled: Mapping[str, str]
    """Plain names, as in the file."""

    @classmethod
    def of(cls, name: str, table: Mapping[str, Any]) -> CameraTable:
        """Raises ValueError where something is in it twice."""
        values, spelled = dict[str, Any](), dict[str, str]()
        for key, value in table.items():
            own = plain(key)
            if own in _INSIDE and isinstance(value, Mapping) and "data" not in value:
                inside = cls.of(name, value)
                new, names = inside.values, inside.spelled
            else:
                new, names = ({} if value is None else {own: value}), {own: str(key)}
            # Names of cameras may look alike.
            if (own in _INSIDE or not isinstance(value, Mapping)) and (twice := values.keys() & new.keys()):
                raise ValueError(f"camera {name}: {names[min(twice)]} is given twice")
            values |= new
            spelled |= names
        return cls(name, values, spelled)

    def first(self, names: tuple[str, ...]) -> Any:
        """Of the plain names the first that is there; None if none is."""
        return next((self.values[name] for name in names if name in self.values), None)

    @property
    def has_lens(self) -> bool:
        return self.first(_MATRIX) is not None or all(name in self.values for name in _FOCAL_AND_CENTRE)

    @property
    def states_distortion(self) -> bool:
        """Whether it says something of it, be it that there is none."""
        return self.first((*_DISTORTION, "k1")) is not None or plain(self.first(_LENS_MODEL) or "") == "none"


def plain(name: Any) -> str:
    """Without case, underscores, hyphens and blanks."""
    return re.sub(r"[_\-\s]", "", str(name)).casefold()


def lens_of(table: CameraTable) -> Intrinsics:
    """The intrinsics of a camera. Raises ValueError, which names the camera and what is wrong."""
    lens = _model(table)
    return Intrinsics(table.name, _matrix(table), _distortion(table, lens), _size_px(table), lens)


def _matrix(table: CameraTable) -> Float[np.ndarray, "3 3"]:
    value = table.first(_MATRIX)
    if value is None:
        missing = [name for name in _FOCAL_AND_CENTRE if name not in table.values]
        if missing:
            raise ValueError(f"camera {table.name}: the camera matrix (K, or fx, fy, cx and cy) is missing")
        value = [table.values[name] for name in _FOCAL_AND_CENTRE]
    values = numbers(table.name, "the camera matrix", as_numbers(value, table.name))
    if values.shape == (4,):
        fx, fy, cx, cy = values
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return numbers(table.name, "the camera matrix", values, 3, 3)


def _distortion(table: CameraTable, lens: LensModel) -> Float[np.ndarray, " coefficients"]:
    stated = [key for key in _DISTORTION if key in table.values]
    named = {key: value for key, value in table.values.items() if _NAMED.fullmatch(key)}
    if len(stated) + bool(named) > 1:
        keys = " and ".join(table.spelled[key] for key in (*stated, *sorted(named)))
        raise ValueError(f"camera {table.name}: {keys} are more than one distortion; leave one")
    if named:
        return _of_names(table, named, lens)
    if not stated:
        _refuse_unread(table)
        return np.zeros(0)
    value = table.values[stated[0]]
    if isinstance(value, Mapping) and "data" not in value:
        return _of_names(table, {plain(key): each for key, each in value.items()}, lens)
    return numbers(table.name, "the distortion", as_numbers(value, table.name)).ravel()


def _of_names(table: CameraTable, named: Mapping[str, Any], lens: LensModel) -> Float[np.ndarray, " coefficients"]:
    """In the order of OpenCV; those that are not named are zero."""
    order = _COEFFICIENTS[lens]
    if unknown := [key for key in named if key not in order]:
        wrong, known = ", ".join(unknown), ", ".join(order)
        raise ValueError(f"camera {table.name}: {wrong} is no coefficient of a {lens} lens, which has {known}")
    if not named:
        return np.zeros(0)
    n = len(order) if {"k4", "k5", "k6"} & named.keys() or lens == "fisheye" else 5
    values = [as_numbers(named.get(key, 0.0), table.name) for key in order[:n]]
    return numbers(table.name, "the distortion", values, n)


def _refuse_unread(table: CameraTable) -> None:
    for key in table.values:
        if _LOOKS_LIKE_DISTORTION.search(key):
            raise ValueError(
                f"camera {table.name}: {table.spelled[key]} looks like a distortion of the lens, and is not read; call "
                'it "dist": [k1, k2, p1, p2, k3] as OpenCV does, or "dist": [] if there is none'
            )


def _model(table: CameraTable) -> LensModel:
    """Pinhole unless it is said otherwise."""
    found = dict[bool, str]()
    for key in (*_LENS_MODEL, *_PERHAPS_MODEL, *_FLAGS):
        if key in table.values and (is_fisheye := _is_fisheye(table, key)) is not None:
            found.setdefault(is_fisheye, f"{table.spelled[key]} {table.values[key]}")
    if len(found) > 1:
        raise ValueError(f"camera {table.name}: {found[True]} and {found[False]} contradict each other")
    return "fisheye" if True in found else "pinhole"


def _is_fisheye(table: CameraTable, key: str) -> bool | None:
    """None: it does not say."""
    value = table.values[key]
    text = plain(value).rpartition(".")[2]
    if key in _FLAGS and text in _YES_OR_NO:
        return _YES_OR_NO[text]
    if text in _PROJECTIONS:
        return None
    if text in _PINHOLE or _FISHEYE.fullmatch(text):
        return text not in _PINHOLE
    if key in _PERHAPS_MODEL and not _OTHER_MODEL.search(text):
        return None
    raise ValueError(
        f"camera {table.name}: {table.spelled[key]} {reprlib.repr(value)} is no lens that is known: pinhole "
        "(plumb_bob, radtan, rational_polynomial, opencv, brown_conrady) or fisheye (equidistant, kannala_brandt)"
    )


def _size_px(table: CameraTable) -> tuple[int, int] | None:
    size = table.first(_SIZE)
    if size is None:
        sides = table.first(_WIDTH), table.first(_HEIGHT)
        size = None if None in sides else list(sides)
    if size is None:
        return None
    width, height = numbers(table.name, "the image size", as_numbers(size, table.name), 2)
    return round(width), round(height)


def as_numbers(value: Any, name: str) -> Any:
    """Lists of numbers, from lists, arrays, texts or OpenCV's matrices. Raises ValueError, which names the camera."""
    if isinstance(value, Mapping):
        if "data" not in value:
            raise ValueError(f"camera {name}: {reprlib.repr(dict(value))} has no numbers under a name that is read")
        return as_numbers(value["data"], name)
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list):
        return [as_numbers(each, name) for each in value]
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"camera {name}: {reprlib.repr(value)} is not a number") from None
