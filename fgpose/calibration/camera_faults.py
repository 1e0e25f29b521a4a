"""Which cameras seem to be late, or to have been moved since they were calibrated: a quick self-calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fgpose.association.recording import Association
from fgpose.calibration.changes.credible import NOTICEABLE_FRAMES
from fgpose.calibration.everybody import each_person
from fgpose.calibration.rig_refinement import SIGNIFICANT_SIGMAS, has_moved, moves
from fgpose.calibration.search import Found, search
from fgpose.calibration.used_parts import seen_by_two
from fgpose.config import Config
from fgpose.estimation.noise import TELLING_HZ
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import fair_limits, usual_step_s
from fgpose.skeleton import Skeleton

# They bound the time that it takes, as calibration.max_frames does. More would make the offsets a little more precise.
_MAX_DURATION_S = 20.0
_MAX_ITERATIONS = 15


@dataclass(frozen=True)
class CameraFault:
    """The faults of one camera, estimated on a part of the recording."""

    name: str
    offset_s: float
    """Additional time offset, beyond time stamps and calibration, relative to the camera whose clock is nearest to
    those of all others; positive: its images are taken later."""
    offset_sigma_s: float
    """Standard deviation; zero for that camera."""
    offset_frames: float
    """The offset in frames of the recording."""
    rotation_deg: float
    """By how much it would have to be turned and moved to agree with the others."""
    translation_m: float
    late: bool
    """Whether the offset is more than chance, and enough to matter."""
    moved: bool
    """Whether it would have to be moved further than the calibration can be wrong."""


def camera_faults(
    observations: Observations | Association, rig: CameraRig, config: Config | None = None
) -> tuple[CameraFault, ...]:
    """Self-calibration (see self_calibrate) on the limbs in at most 20 s from the middle of the recording.

    Args:
        observations: of one person, or of everybody who was told apart; then the 20 s are shared out among them, each
            in the middle of the time in which they are there.
        rig: the cameras.
        config: the parameters.

    Returns:
        One for each camera; none with fewer than three cameras, a single frame, or no joint seen by two that agree.

    Raises:
        ValueError: the cameras of the observations and of the rig differ.
    """
    config = (config or Config()).replace(solver={"max_iterations": _MAX_ITERATIONS})
    if isinstance(observations, Observations):
        observations.check_cameras(rig.names)
        everybody = [observations]
    else:
        observations.observations.check_cameras(rig.names)
        everybody = each_person(observations.observations, observations)
    people = [own for own in seen_by_two(everybody) if own.n_frames >= 2]
    if rig.n_cameras < 3 or not people:
        return ()
    step_s = min(usual_step_s(own.frame_time_s) for own in people)
    parts = [_limbs_only(part) for part in _thinned(people, step_s, config.calibration.max_frames)]
    try:
        found = search(parts, rig, config, poses=True, clocks=True)
    except ValueError:  # no joint is seen by two cameras that agree: RecordingInfo reports that
        return ()
    return _faults(found, rig, config, step_s)


def _faults(found: Found, rig: CameraRig, config: Config, step_s: float) -> tuple[CameraFault, ...]:
    late_s = found.rig.time_offsets_s - rig.time_offsets_s
    offsets_s, sigma_s = _relative_to_nearest(late_s, found.offset_sigma_s)
    rotation_deg, translation_m = moves(rig, found.rig)
    late = np.abs(offsets_s) > np.maximum(SIGNIFICANT_SIGMAS * sigma_s, NOTICEABLE_FRAMES * step_s)
    moved = has_moved(rotation_deg, translation_m, config)
    numbers = offsets_s, sigma_s, offsets_s / step_s, rotation_deg, translation_m, late, moved
    return tuple(CameraFault(name, *row) for name, *row in zip(rig.names, *(n.tolist() for n in numbers), strict=True))


def _relative_to_nearest(
    offsets_s: Float[np.ndarray, " camera"], sigma_s: Float[np.ndarray, " camera"]
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """Offsets against the camera that is nearest to all: were the first one late, all others would seem early."""
    nearest = int(np.argmin(np.abs(offsets_s[:, None] - offsets_s).sum(axis=1)))
    both_s = np.hypot(sigma_s, sigma_s[nearest])
    both_s[nearest] = 0.0
    return offsets_s - offsets_s[nearest], both_s


def _thinned(people: list[Observations], step_s: float, max_frames: int) -> list[Observations]:
    """The middle of what was seen of each, at about 25 frames a second."""
    stride = max(1, round(1 / (TELLING_HZ * step_s)))
    at_most = min(int(_MAX_DURATION_S / step_s), max_frames * stride)
    limits = fair_limits([own.n_frames for own in people], at_most)
    return [_middle(own, int(limit), stride) for own, limit in zip(people, limits, strict=True)]


def _middle(observations: Observations, at_most: int, stride: int) -> Observations:
    n_frames = min(observations.n_frames, at_most)
    first = (observations.n_frames - n_frames) // 2
    return observations.frames(slice(first, first + max(n_frames, 1), stride))


def _limbs_only(observations: Observations) -> Observations:
    """The joints of arms and legs, for which a recording of 33 joints takes a fifth of the time."""
    skeleton = observations.skeleton
    bones = tuple(bone for pair in skeleton.limb_pairs for bone in pair)
    if not bones:
        return replace(observations, points3d_m=None, covariance3d_m2=None)
    kept = sorted({joint for bone in bones for joint in bone})
    number = {joint: n for n, joint in enumerate(kept)}

    def renumbered(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((number[a], number[b]) for a, b in pairs if a in number and b in number)

    limbs = Skeleton(
        name=skeleton.name,
        joints=tuple(skeleton.joints[joint] for joint in kept),
        bones=renumbered(bones),
        root=(0,),
        left_right=renumbered(skeleton.left_right),
        limbs=renumbered(skeleton.limbs),
    )
    return replace(
        observations,
        skeleton=limbs,
        points2d_px=observations.points2d_px[:, :, kept],
        confidence=observations.confidence[:, :, kept],
        points3d_m=None,
        covariance3d_m2=None,
    )
