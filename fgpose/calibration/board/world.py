"""Where the world of a calibration with boards is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fgpose.calibration.board.sightings import BoardSightings
from fgpose.geometry.rigid import inverse, pose_of

OriginKind = Literal["board", "camera", "level", "people"]
_MOST_APART_S = 0.5  # a board that lies on the floor lies there for longer
_FORMS = "board, board@SECONDS, camera, level or people"


@dataclass(frozen=True)
class WorldOrigin:
    """What is asked for."""

    kind: OriginKind = "board"
    at_s: float | None = None
    """board: when it lies on the floor; None: at the first moment at which it is used."""


def parse_origin(text: str) -> WorldOrigin:
    """From board, board@12.5, camera, level or people. Raises ValueError for anything else."""
    kind, _, at = text.partition("@")
    if kind not in ("board", "camera", "level", "people") or (at and kind != "board") or text.endswith("@"):
        raise ValueError(f"the origin is {_FORMS}, got {text!r}")
    try:
        return WorldOrigin(kind, float(at) if at else None)
    except ValueError:
        raise ValueError(f"the origin is {_FORMS}, got {text!r}") from None


def world_T_first(
    origin: WorldOrigin,
    first_T_camera: Float[np.ndarray, "camera 4 4"],
    first_T_board: Float[np.ndarray, "moment 4 4"],
    sightings: BoardSightings,
) -> tuple[Float[np.ndarray, "4 4"], str]:
    """The world and, in a sentence, where it is.

    - board: z out of the board, x along its rows, the origin at its first corner.
    - camera: the frame of the first camera, z forward.
    - level: z up as the cameras have it that stand level, the origin at the first camera, which looks along x.
    - people: as level, until somebody was followed in it (level_from_walker).

    Raises:
        ValueError: the board is not used at the moment that is asked for.
    """
    if origin.kind == "camera":
        return np.eye(4), "The world is the frame of the first camera: x right, y down, z forward."
    if origin.kind in ("level", "people"):
        return _level(first_T_camera), (
            "The world is at the first camera, z up as far as the cameras stand level, x where the first one looks."
        )
    t = 0 if origin.at_s is None else _nearest(sightings, origin.at_s)
    # The board's z goes into it.
    world = inverse(first_T_board[t] @ np.diag([1.0, -1.0, -1.0, 1.0]))
    when = sightings.when(float(sightings.time_s[t]))
    said = f"The world is the board {when}: z = 0 on it, z up out of it, x along its rows."
    heights_m = (world @ first_T_camera)[:, 2, 3]
    if (heights_m < 0).any():
        said += " A camera is below it: if it did not lie on the floor then, say when it did (--origin board@SECONDS)."
    return world, said


def _nearest(sightings: BoardSightings, at_s: float) -> int:
    apart_s = np.abs(sightings.time_s - at_s)
    t = int(np.argmin(apart_s))
    if apart_s[t] > _MOST_APART_S:
        when = sightings.when(float(sightings.time_s[t]))
        raise ValueError(f"the origin is board@{at_s:g}, where no view of the board is used; one is {when}")
    return t


def _level(first_T_camera: Float[np.ndarray, "camera 4 4"]) -> Float[np.ndarray, "4 4"]:
    """Up is at right angles to the horizontal axes of all images, as nearly as it can be."""
    axes = first_T_camera[:, :3, 0]
    usual_up = -first_T_camera[:, :3, 1].mean(axis=0)
    # A single axis, or parallel ones, leave a turn around them: there the images' own up decides.
    _, vectors = np.linalg.eigh(axes.T @ axes / len(axes) - 1e-3 * np.outer(usual_up, usual_up))
    up = vectors[:, 0] * np.sign(vectors[:, 0] @ usual_up)
    forward = first_T_camera[0, :3, 2]
    ahead = forward - (forward @ up) * up
    ahead /= np.linalg.norm(ahead)
    R = np.stack([ahead, np.cross(up, ahead), up])
    return pose_of(R, -R @ first_T_camera[0, :3, 3])
