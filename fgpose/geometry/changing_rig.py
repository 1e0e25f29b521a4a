"""Cameras whose clock or pose changes while a recording lasts.

A camera that was bumped is two cameras, one before and one after, each of which sees its part: so nothing that
estimates needs to know of it. The second has the name of the camera and the time: ``cam2@18.0s``.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import Camera, CameraRig

# The motion of a fast limb over such a time is known to centimetres, and what is taken for motion then feeds itself:
# somebody who works, four cameras of which one is late, errors (95 %) of 36 mm at 0.07 s and 400 mm at 0.1 s. With up
# to 0.08 s, those of somebody who walks are a quarter larger than with synchronous cameras.
TOGETHER_S = 0.085


def is_changing(rig: CameraRig) -> bool:
    """Whether a clock drifts or jumps, or a camera was moved in between."""
    return any(camera.clock_drift or camera.clock_jumps or camera.moves for camera in rig.cameras)


def refuse_changing(rig: CameraRig) -> None:
    """Raise ValueError if a clock or a pose changes: the images are to be put on the common clock first."""
    for camera in rig.cameras:
        if camera.clock_drift or camera.clock_jumps or camera.moves:
            raise ValueError(
                f"camera {camera.name}: its clock or pose changes while the recording lasts; take "
                "observations, rig = fgpose.calibration.on_common_clock(observations, rig) first"
            )


def warn_far_apart(rig: CameraRig, name: object = "the rig") -> None:
    """Say it where images that come together were taken so far apart that the motion between them is not known.

    Args:
        rig: whose time offsets tell it.
        name: what the rig is called.

    Warns:
        UserWarning: they were.
    """
    late_s = rig.time_offsets_s
    first, last = int(np.argmin(late_s)), int(np.argmax(late_s))
    apart_s = float(late_s[last] - late_s[first])
    if apart_s > TOGETHER_S:
        warnings.warn(
            f"by the time offsets of {name}, {rig.names[last]} takes images {apart_s:.3g} s later than "
            f"{rig.names[first]} with equal time stamps: what is estimated of them as they come is far off, by more "
            "than it claims, or nobody is seen. Give together what was taken together, and a rig without offsets; "
            "fgpose.calibration.on_common_clock does that with a recording. Offsets that say when videos began are of "
            "no use live: they are start_s",
            stacklevel=3,  # past who has called this
        )


def later_s(camera: Camera, stamp_s: Float[np.ndarray, " image"]) -> Float[np.ndarray, " image"]:
    """How much later than its time stamp says each image of a camera was taken."""
    late_s = camera.time_offset_s + camera.clock_drift * stamp_s
    for since_s, by_s in camera.clock_jumps:
        late_s = late_s + np.where(stamp_s >= since_s, by_s, 0.0)
    return late_s


def with_later_clock(
    camera: Camera, offset_s: float = 0.0, drift: float = 0.0, jumps: Sequence[tuple[float, float]] = ()
) -> Camera:
    """The camera whose images are later still than its clock says so far: by an offset, by a drift and jumps that are
    given by that clock."""
    stretched = tuple((since_s, (1 + drift) * by_s) for since_s, by_s in camera.clock_jumps)
    later = ((_stamp_s(camera, since_s), by_s) for since_s, by_s in jumps)
    return replace(
        camera,
        time_offset_s=camera.time_offset_s + offset_s + drift * camera.time_offset_s,
        clock_drift=camera.clock_drift + drift + camera.clock_drift * drift,
        clock_jumps=tuple(sorted((*stretched, *later))),
    )


def _stamp_s(camera: Camera, taken_s: float) -> float:
    """The time stamp of an image that was taken at this time."""
    stamp_s = taken_s
    for _ in range(20):  # a contraction, as drifts are small: each round has the error of the last times the drift
        stamp_s = taken_s - float(later_s(camera, np.array([stamp_s]))[0])
    return stamp_s


def pieces_of(camera: Camera) -> tuple[Camera, ...]:
    """One camera for each pose, with an even clock that is not off."""
    still = camera.unchanging()
    moved = (replace(still, name=_name(camera, n), world_T_camera=pose) for n, (_, pose) in enumerate(camera.moves))
    return (still, *moved)


def _name(camera: Camera, number: int) -> str:
    return f"{camera.name}@{camera.moves[number][0]:.1f}s"


def of_whole_cameras(names: Sequence[str], shares: Sequence[float]) -> dict[str, float]:
    """What the pieces of each camera have of something together, as each sees its part of the time only."""
    whole: dict[str, float] = {}
    for name, share in zip(names, shares, strict=True):
        first = name.rpartition("@")[0]
        whole[first if first in names else name] = whole.get(first, 0.0) + share
    return whole


def in_pieces(rig: CameraRig) -> CameraRig:
    """The rig of the common clock: pieces_of all cameras."""
    return CameraRig(tuple(piece for camera in rig.cameras for piece in pieces_of(camera)))


def held_by(camera: Camera, stamp_s: Float[np.ndarray, " image"]) -> Bool[np.ndarray, "piece image"]:
    """Which of pieces_of a camera took each image."""
    edges_s = np.array([-np.inf, *(since_s for since_s, _ in camera.moves), np.inf])
    return (stamp_s >= edges_s[:-1, None]) & (stamp_s < edges_s[1:, None])


def put_together(given: CameraRig, found: CameraRig, begun: CameraRig) -> CameraRig:
    """The rig of the files, with what was found of its cameras by the common clock.

    Args:
        given: as the files have it.
        found: after it was in_pieces, with the poses and the time offsets that were found.
        begun: the same before.
    """
    by_name, before = (
        dict(zip(found.names, found.cameras, strict=True)),
        dict(zip(begun.names, begun.cameras, strict=True)),
    )
    cameras = []
    for camera in given.cameras:
        pieces = [by_name[piece.name] for piece in pieces_of(camera)]
        extra_s = [piece.time_offset_s - before[piece.name].time_offset_s for piece in pieces]
        moves = tuple(
            (since_s, piece.world_T_camera) for (since_s, _), piece in zip(camera.moves, pieces[1:], strict=True)
        )
        later = with_later_clock(camera, float(np.mean(extra_s)))
        cameras.append(replace(later, world_T_camera=pieces[0].world_T_camera, moves=moves))
    return CameraRig(tuple(cameras))


def after(given: CameraRig, found: CameraRig) -> CameraRig:
    """The rig of the files, with what was found after its clocks and moves were accounted for (in_pieces).

    Args:
        given: as the files have it.
        found: the pieces of its cameras, by the common clock, with clocks that still change and further moves.
    """
    by_name = dict(zip(found.names, found.cameras, strict=True))
    cameras = []
    for camera in given.cameras:
        parts = [by_name[piece.name] for piece in pieces_of(camera)]
        since_s = [-np.inf, *(since_s for since_s, _ in camera.moves)]
        poses = [
            (begin_s if n == 0 else _stamp_s(camera, part.moves[n - 1][0]), pose)
            for begin_s, part in zip(since_s, parts, strict=True)
            for n, pose in enumerate((part.world_T_camera, *(pose for _, pose in part.moves)))
        ]
        offset_s = float(np.mean([part.time_offset_s for part in parts]))
        later = with_later_clock(camera, offset_s, parts[0].clock_drift, parts[0].clock_jumps)
        cameras.append(replace(later, world_T_camera=poses[0][1], moves=tuple(sorted(poses[1:], key=lambda m: m[0]))))
    return CameraRig(tuple(cameras))
