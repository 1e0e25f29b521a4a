"""Colours of the viewer, on a dark background: colour-blind safe (Okabe and Ito, 2008; viridis)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

Colour = tuple[int, int, int]

# Dark, so that the bright colours of the results stand out; the grid just visible on it.
BACKGROUND: Colour = (18, 20, 26)
GRID: Colour = (70, 76, 88)
# Names stand in boxes whose grey is that of the viewer's theme: near the background where it is dark, in the middle
# where it is light. White alone is read on both, so the colour of what is named is beside its name.
TEXT: Colour = (255, 255, 255)
_CAMERAS: tuple[Colour, ...] = (
    (86, 180, 233),
    (0, 158, 115),
    (204, 121, 167),
    (70, 105, 215),
    (150, 150, 150),
    (130, 220, 215),
    (175, 155, 255),
    (150, 190, 90),
)
# Warm colours and white, which no camera has; the final result stands out most.
_TRAJECTORIES: dict[str, Colour] = {
    "fused": (240, 228, 66),
    "refined": (230, 110, 30),
    "smoothed": (255, 255, 255),
    "online": (120, 225, 190),
    "walk": (255, 255, 255),
}
# Of a calibration: the way that was walked, and the floor with its vertical.
PATH: Colour = (230, 159, 0)
FLOOR: Colour = (150, 160, 178)
# A camera where it was before it was bumped.
BEFORE: Colour = (190, 60, 40)
# Of Okabe and Ito, one for each limb; predicted is orange, unobservable red, as a warning.
LIMBS: tuple[Colour, ...] = ((86, 180, 233), (240, 228, 66), (0, 158, 115), (230, 110, 30))
STATUS: dict[str, Colour] = {"predicted": (230, 159, 0), "unobservable": (190, 60, 40)}
# Of cameras while they run; what cannot be trusted stands out.
CAMERA_STATES: dict[str, Colour] = {
    "ok": (70, 130, 115),
    "late": (230, 159, 0),
    "lost": (190, 60, 40),
    "reconnecting": (204, 121, 167),
    "doubtful": (240, 228, 66),
}
# Of people, again from the beginning if they are more: near those of Okabe and Ito, but brighter, and further from each
# other and from grey (20 in CIELAB at least, however one sees colours).
PEOPLE: tuple[Colour, ...] = (
    (86, 180, 233),
    (231, 152, 0),
    (71, 236, 166),
    (231, 157, 190),
    (248, 232, 68),
    (60, 100, 255),
    (222, 78, 30),
    (255, 255, 255),
)
# Detections that are nobody's, somebody who is away, and what is no person where colours stand for people.
NOBODY: Colour = (112, 112, 112)
AWAY: Colour = (52, 56, 66)
PLAIN: Colour = (130, 142, 162)
# For factors that belong to no camera, again from the beginning if they are more.
_OTHER_FACTORS: tuple[Colour, ...] = ((255, 255, 255), (240, 228, 66), (230, 110, 30), (220, 60, 60))
# Viridis at 0, 1/4, 1/2, 3/4 and 1; linear between them nobody sees a difference.
_VIRIDIS = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=float)
# The darkest quarter of viridis cannot be seen on a dark picture.
_DARKEST = 0.2


def camera_colour(camera: int) -> Colour:
    return _CAMERAS[camera % len(_CAMERAS)]


def person_colour(person: int) -> Colour:
    """The same wherever the person is shown."""
    return PEOPLE[person % len(PEOPLE)]


def trajectory_colour(name: str, index: int) -> Colour:
    """Colour of a result: a fixed one for those of fgpose, else one by its index."""
    return _TRAJECTORIES.get(name, _CAMERAS[-1 - index % len(_CAMERAS)])


def factor_colours(factors: Sequence[str], cameras: Sequence[str]) -> list[Colour]:
    """Colours of the factors: the projection factor of a camera ("projection/cam_01") has that camera's."""
    others = itertools.cycle(_OTHER_FACTORS)
    names = [factor.rpartition("/")[2] for factor in factors]
    return [camera_colour(cameras.index(name)) if name in cameras else next(others) for name in names]


def faded(colour: Colour, share: float = 0.55) -> Colour:
    """The colour, mixed with the background."""
    mixed = (round(a + (b - a) * share) for a, b in zip(colour, BACKGROUND, strict=True))
    red, green, blue = mixed
    return red, green, blue


def weight_colours(weights: Float[np.ndarray, "*points"]) -> UInt8[np.ndarray, "*points 3"]:
    """Viridis: violet for no weight, yellow for 1. NaN counts as 0."""
    position = _DARKEST + (1 - _DARKEST) * np.clip(np.nan_to_num(weights), 0, 1)
    stops = np.linspace(0, 1, len(_VIRIDIS))
    return np.stack([np.interp(position, stops, channel) for channel in _VIRIDIS.T], axis=-1).astype(np.uint8)
