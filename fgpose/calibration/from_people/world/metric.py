"""From a rig in an arbitrary gauge to the world: metres, z up, the floor at z = 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.assessment.rig_alignment import Similarity
from fgpose.calibration.from_people.rig.other_people import OtherPerson
from fgpose.calibration.from_people.walk import Walk
from fgpose.calibration.from_people.world.anatomy import Anatomy
from fgpose.calibration.from_people.world.floor import Floor, find_vertical_and_floor
from fgpose.calibration.from_people.world.scale import (
    MeasuredDistance,
    Scale,
    adult_cue,
    assumed,
    body_uncertain,
    distance_cue,
    fuse,
    network_cue,
    stature_cues,
)
from fgpose.calibration.from_people.world.vertical import Vertical, is_upright
from fgpose.calibration.from_people.world.whose_stature import Beside, whose_stature
from fgpose.geometry.camera import Camera, CameraRig

# Statures per second: 0.4 m/s, half of a slow walk.
_WALKS = 0.24
_SPEED_S = 0.5  # over a step, within which hips go up and down and faster and slower
_LEAST_WALKING_S = 2.0


@dataclass(frozen=True, eq=False)
class Metric:
    """A rig and its walker in the world: z up, floor z = 0, origin under the first camera, whose horizontal viewing
    direction is x; metres."""

    rig: CameraRig
    joints_m: Float[np.ndarray, "frame joint 3"]
    world_T_gauge: Similarity
    """Takes points of the gauge to the world."""
    scale: Scale
    vertical: Vertical
    """In the gauge."""
    floor: Floor
    """In the gauge and its unit."""
    body_sigma: float = 0.0
    """Standard deviation of the size of the body in the gauge, as a share of it."""

    @property
    def floor_sigma_m(self) -> float:
        """Of the height of the cameras above it, which the size of the body tells."""
        high_m = float(np.median(self.rig.positions_m[:, 2]))
        return float(np.hypot(self.scale.factor * self.floor.sigma, self.body_sigma * high_m))


def to_metric(
    walk: Walk,
    rig: CameraRig,
    joints_m: Float[np.ndarray, "frame joint 3"],
    stature_m: float | None = None,
    distances: Sequence[MeasuredDistance] = (),
    covariance: Float[np.ndarray, "camera 3 camera 3"] | None = None,
    body_sigma: float = 0.0,
    others: Sequence[OtherPerson] = (),
) -> Metric:
    """Find scale, vertical and floor, and take rig and joints to the world.

    Args:
        walk: whose per-view 3D tells the scale where nothing else does.
        rig: in any gauge and unit.
        joints_m: of the walk, in the same gauge; NaN = not determined.
        stature_m: of the walker, without shoes; None: unknown.
        distances: measured between cameras.
        covariance: of the positions of the cameras, in the gauge; for the sigma of a distance.
        body_sigma: of the size of the body in the gauge, as a share of it; see scale.body_sigma.
        others: who was there beside the walker: the stature may be theirs.

    Raises:
        ValueError: the skeleton lacks legs, no frame shows them all, a distance names an unknown camera, or the stature
            is none of a person.
    """
    anatomy = Anatomy(walk.skeleton)
    if not np.isfinite(anatomy.stature_m(joints_m)):
        raise ValueError(
            "scale, vertical and floor need the legs (and shoulders) of the walker: none was reconstructed"
        )
    vertical, floor = find_vertical_and_floor(joints_m, walk.time_s, anatomy)
    cues = [distance_cue(distance, rig, covariance) for distance in distances]
    if stature_m is not None:
        heads = _heads(joints_m, walk.time_s, vertical, floor, anatomy)
        cues += [each.of_body(body_sigma) for each in stature_cues(stature_m, joints_m, heads, anatomy)]
    found = None if walk.points3d_m is None else network_cue(walk.points3d_m, joints_m, anatomy)
    network = None if found is None else found.of_body(body_sigma)
    scale = fuse(cues, network) if cues else fuse([network or adult_cue(joints_m, anatomy).of_body(body_sigma)])
    if not cues:
        scale = replace(scale, findings=(*scale.findings, assumed(scale)))
    if stature_m is not None and not distances:
        beside = [
            Beside(other.seen, _times_as_tall(other, scale, stature_m, vertical, floor, anatomy)) for other in others
        ]
        scale = whose_stature(scale, cues[0].sigma, walk, beside)
    if not distances:
        scale = replace(scale, findings=(*scale.findings, *body_uncertain(body_sigma)))
    similarity = world_T_gauge(rig.cameras[0], vertical.up, floor.height, scale.factor)
    return Metric(similarity.rig(rig), similarity.of(joints_m), similarity, scale, vertical, floor, body_sigma)


def _times_as_tall(
    other: OtherPerson, scale: Scale, stature_m: float, vertical: Vertical, floor: Floor, anatomy: Anatomy
) -> float:
    """Somebody as the walker, by what the unit would be if the stature were theirs; NaN: not known."""
    if not np.isfinite(anatomy.stature_m(other.joints_m)):
        return np.nan
    heads = _heads(other.joints_m, other.seen.time_s, vertical, floor, anatomy)
    # The segments, of who sits or stoops.
    return scale.factor / stature_cues(stature_m, other.joints_m, heads, anatomy)[-1].factor


def _heads(
    joints_m: Float[np.ndarray, "frame joint 3"],
    time_s: Float[np.ndarray, " frame"],
    vertical: Vertical,
    floor: Floor,
    anatomy: Anatomy,
) -> Float[np.ndarray, " walking"]:
    """Heights of the head above the floor in the frames in which the person walks upright; where he hardly walks, in
    all in which he is upright."""
    if anatomy.head is None:
        return np.empty(0)
    heights = anatomy.mean_m(joints_m, anatomy.head.joints) @ vertical.up - floor.height
    usable = is_upright(joints_m, vertical.up, anatomy) & np.isfinite(heights)
    walks = usable & (_speed(anatomy.hips_m(joints_m), time_s) > _WALKS * anatomy.stature_m(joints_m))
    frame_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return heights[walks if walks.sum() * frame_s >= _LEAST_WALKING_S else usable]


def _speed(hips_m: Float[np.ndarray, "frame 3"], time_s: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Of the hips over half a second; NaN where they are not known at both ends."""
    after = np.clip(np.searchsorted(time_s, time_s + _SPEED_S / 2, side="right") - 1, 0, len(time_s) - 1)
    before = np.clip(np.searchsorted(time_s, time_s - _SPEED_S / 2), 0, len(time_s) - 1)
    step_s = np.where(after > before, time_s[after] - time_s[before], np.nan)
    return np.linalg.norm(hips_m[after] - hips_m[before], axis=-1) / step_s


def world_T_gauge(first: Camera, up: Float[np.ndarray, " 3"], floor: float, scale: float) -> Similarity:
    """The world whose origin is on the floor under the first camera, x where that looks.

    Args:
        first: the camera, in the gauge.
        up: unit vector in the gauge.
        floor: its height along up, in the unit of the gauge.
        scale: metres for each unit.
    """
    # A camera that looks straight up or down has no horizontal viewing direction: there, what is up in its image.
    R_camera = first.world_T_camera[:3, :3]
    directions = (R_camera[:, 2], -R_camera[:, 1])
    flat = [direction - (direction @ up) * up for direction in directions]
    x = flat[0] if np.linalg.norm(flat[0]) > np.sin(np.deg2rad(1.0)) else flat[1]
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    origin = first.position_m - (first.position_m @ up - floor) * up
    return Similarity(scale, R, -scale * R @ origin)
