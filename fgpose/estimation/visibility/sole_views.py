"""Joints that one camera alone sees: their distances from it, as depths of its view.

See fgpose.estimation.visibility.single_view for how distances follow from bone lengths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.noise import CORRELATION_S, correlated_frames
from fgpose.estimation.visibility.posture import Posture, bone_directions
from fgpose.estimation.visibility.single_view import DistanceFilter, Sight, smoothed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import usual_step_s
from fgpose.skeleton import Skeleton

# Frames before and after, which tell the speed; frames apart by less belong together.
_LEAD_S = 0.3
# Online a joint is predicted until its second image has come; that is too short to lose its depth.
_SOON_S = 0.1
_SPEED_SIGMA_MPS = 0.15  # of the body, as the newest velocities of its joints tell it
# Online, how somebody usually holds himself is learned so often; after a pause, or alone, one frame tells no more.
_POSTURE_S, _LONGEST_FRAME_S = 0.1, 0.5


def with_distances(
    evidence: Evidence,
    positions_m: Float[np.ndarray, "frame joint 3"],
    lengths_m: Float[np.ndarray, " length"],
    rig: CameraRig,
    skeleton: Skeleton,
) -> Evidence:
    """The evidence of a recording with the distances of all joints that one camera alone sees, smoothed over time.

    Args:
        evidence: with the visibility of its detections.
        positions_m: as estimated so far; NaN where a joint is not estimated.
        lengths_m: shared bone lengths; NaN where one is not known.
        rig, skeleton: of the evidence.
    """
    wanted = np.isfinite(positions_m).all(axis=-1) & ~evidence.has_measured_depth
    alone = evidence.sole_view & wanted[:, None]
    if not alone.any() or not skeleton.bones:
        return evidence
    views = _Views.of(evidence, positions_m, rig)
    step_s = min(usual_step_s(evidence.time_s), _LONGEST_FRAME_S)
    posture = Posture.of(views.determined_m, step_s, skeleton)
    distance_m, variance_m2 = np.full(alone.shape, np.nan), np.full(alone.shape, np.nan)
    for camera in np.flatnonzero(alone.any(axis=(0, 2))).tolist():
        of_camera = alone[:, camera]
        for frames in _stretches(np.asarray(of_camera.any(axis=1)), evidence.time_s):
            # From where more is known.
            known = np.isfinite(views.distance_m[frames, camera]).sum(axis=1)
            order = frames if known[0] >= known[-1] else frames[::-1]
            last = _nearest_directions(views.determined_m, order, skeleton)
            single = DistanceFilter(skeleton, lengths_m, posture, last)
            told = _smoothed_distances(single, views, order, camera)
            distance_m[order, camera], variance_m2[order, camera] = told
    # Of garbage the filter may lose its last digits.
    told = alone & (variance_m2 > 0)
    distance_m[~told], variance_m2[~told] = np.nan, np.nan
    return evidence.with_distances(_on_rays(distance_m, views.rays, rig), np.sqrt(variance_m2), rig)


class RunningSoleViews:
    """The same online: filtered over time.

    Args:
        skeleton: of the person.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._posture, self._posture_s = Posture.none(skeleton), -np.inf
        self._last = np.full((len(skeleton.bones), 3), np.nan)
        self._determined_s = np.full(skeleton.n_joints, -np.inf)
        self._before: FrameState | None = None
        self._filters: dict[int, _Running] = {}

    def learn(self, state: FrameState, lengths_m: Float[np.ndarray, " length"], rig: CameraRig) -> None:
        """Take the newest frame, when all of its images are there that will be used.

        Args:
            state: of the frame.
            lengths_m: shared bone lengths as learned so far.
            rig: the cameras.
        """
        time_s, evidence = state.at.time_s, state.evidence
        alone = evidence.sole_view[0] & state.active & ~evidence.has_measured_depth[0]
        for camera in np.flatnonzero(alone.any(axis=1)).tolist():
            if camera not in self._filters and self._before is not None:
                self._filters[camera] = self._begun(camera, lengths_m, self._before, rig)
            if camera in self._filters:
                self._filters[camera].needed_s = time_s
        self._filters = {c: each for c, each in self._filters.items() if each.needed_s >= time_s - _LEAD_S}
        if self._filters:
            views = _Views.of(evidence, state.positions_m[None], rig)
            for camera, running in self._filters.items():
                running.take(views, camera)
        self._determined_s[evidence.observed[0] & state.active] = time_s
        if time_s >= self._posture_s + _POSTURE_S:
            self._learn_posture(state, time_s - self._posture_s)
        self._before = state

    def _learn_posture(self, state: FrameState, step_s: float) -> None:
        self._posture_s = state.at.time_s
        determined_m = np.where(state.evidence.observed[0, :, None], state.positions_m, np.nan)
        shown = Posture.of(determined_m[None], min(step_s, _LONGEST_FRAME_S), self._skeleton)
        self._posture = self._posture.plus(shown)
        direction, length_m = bone_directions(determined_m, self._skeleton)
        self._last = np.where(np.isfinite(length_m)[:, None], direction, self._last)

    def with_distances(
        self,
        gathered: Evidence,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> tuple[Evidence, Evidence]:
        """The evidence of the next frame, as gathered and as judged, with the distances of the joints that one camera
        alone has seen for some time.

        Args:
            gathered, evidence: of the frame.
            positions_m: predicted; NaN where a joint is not estimated.
            rig: the cameras.
        """
        is_late = evidence.time_s[0] - self._determined_s > _SOON_S
        wanted = np.isfinite(positions_m).all(axis=-1) & is_late & ~evidence.has_measured_depth[0]
        alone = evidence.sole_view[0] & wanted
        if not self._filters or not alone.any():
            return gathered, evidence
        located = evidence.observed[0] & np.isfinite(evidence.guess_m[0]).all(axis=-1)
        views = _Views.of(evidence, np.where(located[:, None], evidence.guess_m[0], positions_m)[None], rig)
        distance_m, variance_m2 = np.full(alone.shape, np.nan), np.full(alone.shape, np.nan)
        for camera, running in self._filters.items():
            distance_m[camera], variance_m2[camera] = running.distances(views, camera)
        distance_m[~alone] = np.nan
        told = _on_rays(distance_m[None], views.rays, rig), np.sqrt(variance_m2)[None], rig
        return gathered.with_distances(*told), evidence.with_distances(*told)

    def _begun(
        self, camera: int, lengths_m: Float[np.ndarray, " length"], before: FrameState, rig: CameraRig
    ) -> _Running:
        views = _Views.of(before.evidence, before.positions_m[None], rig)
        single, body = DistanceFilter(self._skeleton, lengths_m, self._posture, self._last), views.bodies[0, camera]
        known = np.isfinite(views.distance_m[0, camera])
        speed = (float(np.mean(before.velocities_mps[known] @ body)), _SPEED_SIGMA_MPS) if known.any() else ()
        single.begin(views.sight(0, camera), body, float(views.about_m[0, camera]), *speed)
        return _Running(single, before.at.time_s)


class _Running:
    """A filter and its time."""

    def __init__(self, single: DistanceFilter, time_s: float) -> None:
        self._single, self._time_s = single, time_s
        self.needed_s = time_s

    def take(self, views: _Views, camera: int) -> None:
        """The next frame."""
        self._step(views, camera)
        self._time_s = float(views.time_s[0])

    def distances(self, views: _Views, camera: int) -> tuple[Float[np.ndarray, " joint"], Float[np.ndarray, " joint"]]:
        """Of a frame that is not complete yet, and variances; of one that was taken already, as it was then."""
        before = self._single.belief
        if views.time_s[0] == self._time_s:
            return self._single.distances(before)
        self._step(views, camera)
        told, self._single.belief = self._single.distances(self._single.belief), before
        return told

    def _step(self, views: _Views, camera: int) -> None:
        step_s = float(views.time_s[0]) - self._time_s
        self._single.step(step_s, views.sight(0, camera), views.bodies[0, camera])


@dataclass(frozen=True, eq=False)
class _Views:
    """What the filter needs of some frames."""

    time_s: Float[np.ndarray, " frame"]
    rays: Float[np.ndarray, "frame camera joint 3"]
    """Of the detections that are probably of their joints; NaN for the others."""
    sigma_m: Float[np.ndarray, "frame camera joint"]
    """Of these detections, at the joint."""
    bodies: Float[np.ndarray, "frame camera 3"]
    """Directions to the middle of the body."""
    about_m: Float[np.ndarray, "frame camera"]
    """Distance of the middle of the body."""
    distance_m: Float[np.ndarray, "frame camera joint"]
    """Of the joints that several cameras determine; NaN for the others."""
    distance_sigma_m: Float[np.ndarray, "frame camera joint"]
    determined_m: Float[np.ndarray, "frame joint 3"]
    """Positions of these joints; NaN for the others."""

    @staticmethod
    def of(evidence: Evidence, positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig) -> _Views:
        rays = [camera.ray(evidence.undistorted_px[:, number]) for number, camera in enumerate(rig.cameras)]
        px_per_m = rig.px_per_m(positions_m)
        rays = np.where((evidence.believed & np.isfinite(px_per_m))[..., None], np.stack(rays, axis=1), np.nan)
        sigma_m = evidence.detection_sigma_px / px_per_m
        offsets_m = positions_m[:, None] - rig.positions_m[:, None]
        determined, distance_m = evidence.observed[:, None], norm(offsets_m)
        known = np.isfinite(positions_m).all(axis=-1).sum(axis=1)[:, None, None]
        middle_m = np.nansum(offsets_m, axis=2) / np.maximum(known, 1)
        about_m = norm(middle_m)
        bodies = np.divide(middle_m, about_m[..., None], out=np.zeros_like(middle_m), where=about_m[..., None] > 0)
        return _Views(
            time_s=evidence.time_s,
            rays=rays,
            sigma_m=sigma_m,
            bodies=bodies,
            about_m=about_m,
            distance_m=np.where(determined, distance_m, np.nan),
            distance_sigma_m=_distance_sigma_m(offsets_m, np.where(np.isnan(rays[..., 0]), np.inf, sigma_m), evidence),
            determined_m=np.where(evidence.observed[..., None], positions_m, np.nan),
        )

    def sight(self, frame: int, camera: int) -> Sight:
        """Of one camera in one frame."""
        values = self.rays, self.sigma_m, self.distance_m, self.distance_sigma_m
        return Sight(*(value[frame, camera] for value in values))


def _distance_sigma_m(
    offsets_m: Float[np.ndarray, "frame camera joint 3"],
    sigma_m: Float[np.ndarray, "frame camera joint"],
    evidence: Evidence,
) -> Float[np.ndarray, "frame camera joint"]:
    """Standard deviation of the distance of joints from each camera as all cameras tell it: the more they see it from
    the side. Errors that are correlated in time are made up for."""
    directions = offsets_m / norm(offsets_m)[..., None]
    directions = np.where(np.isnan(directions), 0.0, directions)
    cosine = np.einsum("tcji,tdji->tcdj", directions, directions)
    information = np.einsum("tdj,tcdj->tcj", sigma_m**-2, np.maximum(1 - cosine**2, 0.0))
    correlated = correlated_frames(usual_step_s(evidence.time_s), CORRELATION_S)
    return np.sqrt(correlated / np.maximum(information, 1e-9))


def _stretches(which: Bool[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> Iterator[np.ndarray]:
    """Frames that belong together, with those around them."""
    frames = np.flatnonzero(which)
    for part in np.split(frames, np.flatnonzero(np.diff(time_s[frames]) > 2 * _LEAD_S) + 1):
        yield np.flatnonzero((time_s >= time_s[part[0]] - _LEAD_S) & (time_s <= time_s[part[-1]] + _LEAD_S))


def _smoothed_distances(
    single: DistanceFilter, views: _Views, order: Int[np.ndarray, " stretch"], camera: int
) -> tuple[Float[np.ndarray, "stretch joint"], Float[np.ndarray, "stretch joint"]]:
    """Distance and its variance, of every joint in every frame of a stretch."""
    first, *others = order.tolist()
    about_m = float(views.about_m[first, camera])
    steps = [single.begin(views.sight(first, camera), views.bodies[first, camera], about_m)]
    for step_s, frame in zip(np.abs(np.diff(views.time_s[order])).tolist(), others, strict=True):
        steps.append(single.step(step_s, views.sight(frame, camera), views.bodies[frame, camera]))
    distance_m, variance_m2 = zip(*(single.distances(belief) for belief in smoothed(steps)), strict=True)
    return np.stack(distance_m), np.stack(variance_m2)


def _nearest_directions(
    determined_m: Float[np.ndarray, "frame joint 3"], order: Int[np.ndarray, " stretch"], skeleton: Skeleton
) -> Float[np.ndarray, "bone 3"]:
    """Of each bone, where it was seen last before a stretch begins, or next; NaN if it never was."""
    direction, length_m = bone_directions(determined_m, skeleton)
    nearest = np.full(direction.shape[1:], np.nan)
    for bone in range(len(nearest)):
        known = np.flatnonzero(np.isfinite(length_m[:, bone]))
        if known.size:
            nearest[bone] = direction[known[np.argmin(np.abs(known - order[0]))], bone]
    return nearest


def _on_rays(
    distance_m: Float[np.ndarray, "frame camera joint"], rays: Float[np.ndarray, "frame camera joint 3"], rig: CameraRig
) -> Float[np.ndarray, "frame camera joint 3"]:
    """Points at these distances from the cameras; NaN where one is not positive."""
    distance_m = np.where(distance_m > 0, distance_m, np.nan)
    origins_m = rig.positions_m[:, None]
    return origins_m + distance_m[..., None] * rays
