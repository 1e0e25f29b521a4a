"""The chain from what uncalibrated cameras saw of people to a calibrated rig.

tracks and starts (one walker on one clock) -> scaffold (a first rig) -> adjustment (bundle adjustment, again where
views showed somebody else, and of the two halves of the recording) -> metric (scale, vertical, floor) -> sigmas ->
verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.unknowns import FOCAL, OFFSET, TRANSLATION, Groups
from fgpose.calibration.from_people.calibrated import CalibratedFromPeople
from fgpose.calibration.from_people.rig.evidence import frames_of, reconstructed
from fgpose.calibration.from_people.rig.focal_check import check_focal
from fgpose.calibration.from_people.rig.other_people import other_people
from fgpose.calibration.from_people.rig.scaffold import scaffolds
from fgpose.calibration.from_people.rig.somebody_else import with_the_walker
from fgpose.calibration.from_people.rig.walk_adjustment import AdjustedWalk, AdjustmentConfig, adjust, lens_groups
from fgpose.calibration.from_people.starts.starts import GivenStart, Starts, find_starts
from fgpose.calibration.from_people.starts.together import together
from fgpose.calibration.from_people.starts.walker import main_tracks
from fgpose.calibration.from_people.tracks import find_tracks
from fgpose.calibration.from_people.verdict.alignment import aligned, point_about_centroid
from fgpose.calibration.from_people.verdict.coverage import coverage
from fgpose.calibration.from_people.verdict.inputs import gather
from fgpose.calibration.from_people.verdict.sigmas import RigEstimate, camera_sigmas
from fgpose.calibration.from_people.verdict.verdict import findings, in_one_place
from fgpose.calibration.from_people.walk import SHORT_S, Track, Walk
from fgpose.calibration.from_people.world.metric import Metric, to_metric
from fgpose.calibration.from_people.world.scale import MeasuredDistance, body_sigma, check_stature
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.fitted_camera import BLOCK_PX
from fgpose.people_observations import PeopleObservations
from fgpose.shown.unknown_names import check_names

Focal = Literal["known", "shared", "each"]
"""Focal lengths are those of the intrinsics; are unknown, one for all cameras of a model; or one for each camera."""
Progress = Callable[[int, int], None]
"""Called with the number of steps done and the number of steps in all."""


@dataclass(frozen=True)
class Parts:
    """Parts of the chain that can be turned on and off, to measure what they are worth."""

    referee: bool = True
    """The monocular 3D of the views rules out twisted relative poses."""
    choose_scaffold: bool = True
    """Every pair of cameras is tried as the first; else only the first two."""
    joint_focal: bool = True
    """Unknown focal lengths are estimated; else their guesses are held."""
    bias: bool = True
    """The detections of a view are off by the same in all frames of one direction of the body."""


_ALL = Parts()
_STEPS = 7


def calibrate_from_people(
    people: PeopleObservations,
    intrinsics: CameraRig,
    *,
    focal: Focal = "known",
    stature_m: float | None = None,
    distances: Sequence[tuple[str, str, float]] = (),
    synchronised: bool = False,
    starts: Mapping[str, GivenStart] | None = None,
    progress: Progress | None = None,
    parts: Parts = _ALL,
) -> CalibratedFromPeople:
    """Calibrate cameras from nothing but people who walk through the scene.

    Args:
        people: what the cameras saw, each by its own clock; per-view 3D, if there is any, in the frame of each camera.
        intrinsics: K and lens of each camera (load_intrinsics, guessed_intrinsics); its poses are not used.
        focal: what is known of the focal lengths. Unknown ones are searched for within some tens of per cent.
        stature_m: of the walker, without shoes.
        distances: two cameras, and how far apart they are in metres.
        synchronised: whether all cameras have one clock already.
        starts: of some cameras, what is known of them, as from their sound; their moments are not searched for.
        progress: told after each step.
        parts: which are turned on.

    Returns:
        The rig of the cameras whose starts are known, with sigmas and verdict. If that is failed (grade), it must not
        be used.

    Raises:
        ValueError: there is one camera, fewer than two see the same person at the same time, the cameras cannot be
            placed, or a stature or distance is impossible.
    """
    done = iter(range(1, _STEPS + 1))

    def told() -> None:
        if progress:
            progress(next(done), _STEPS)

    people.check_cameras(intrinsics.names)
    measured = _checked(intrinsics, stature_m, distances)
    everybody = find_tracks(people)
    tracks = main_tracks(everybody, people.skeleton, synchronised=synchronised)
    told()
    known = {name: GivenStart(0.0) for name in intrinsics.names} if synchronised else starts
    found = find_starts(tracks, people.skeleton, intrinsics, known)
    first = together(tracks, found, people.skeleton)
    told()
    placed = _placed(first, intrinsics.subset(first.camera_names), parts)
    told()
    adjusting = _adjusting(placed, focal, parts, clocks=not synchronised)
    walk, adjusted, joints = adjusting.of_walker(first, placed, everybody, found)
    told()
    halves = adjusting.halves(walk, adjusted.rig)
    told()
    metric = _metric(walk, adjusted, joints, halves, stature_m, measured, everybody, found)
    told()
    result = _judged(first, walk, found, adjusted, halves, metric, _unknown_lenses(placed, focal))
    told()
    return result


def unknown_focal(intrinsics: CameraRig) -> Focal:
    """How focal lengths of which nothing is known are estimated: one for all cameras if their images have one size."""
    # Upright and lying images of one camera have the same focal length, and those that an encoder has cut.
    sizes = np.array([sorted(camera.size_px) for camera in intrinsics.cameras])
    return "shared" if np.ptp(sizes, axis=0).max() <= BLOCK_PX else "each"


def _checked(
    intrinsics: CameraRig, stature_m: float | None, distances: Sequence[tuple[str, str, float]]
) -> list[MeasuredDistance]:
    """What gives the scale. Raises ValueError, before any work, for what cannot be."""
    if intrinsics.n_cameras < 2:
        raise ValueError(f"one camera ({intrinsics.names[0]}) cannot be calibrated; at least two cameras are needed")
    if stature_m is not None:
        check_stature(stature_m)
    ends = [name for first, second, _ in distances for name in (first, second)]
    check_names(ends, intrinsics.names, "a distance is given for", "the cameras are")
    return [MeasuredDistance(*distance) for distance in distances]


def _of_rig(measured: Sequence[MeasuredDistance], walk: Walk) -> list[MeasuredDistance]:
    """Those between cameras that could be brought together in time. The verdict names the others, and is failed."""
    return [each for each in measured if {each.first, each.second} <= set(walk.camera_names)]


def _placed(walk: Walk, intrinsics: CameraRig, parts: Parts) -> CameraRig:
    """A first rig."""
    found = scaffolds(walk if parts.referee else replace(walk, points3d_m=None), intrinsics)
    if parts.choose_scaffold:
        return found[0].rig
    return next((first.rig for first in found if first.pair == intrinsics.names[:2]), found[-1].rig)


def _unknown_lenses(rig: CameraRig, focal: Focal) -> Groups:
    if focal == "known":
        return ()
    return lens_groups(rig) if focal == "shared" else tuple((c,) for c in range(rig.n_cameras))


@dataclass(frozen=True)
class _Adjusting:
    """How a walk is adjusted, the whole and its halves alike."""

    unknown_lenses: Groups
    clocks: bool
    config: AdjustmentConfig

    def of(self, walk: Walk, rig: CameraRig) -> AdjustedWalk:
        return adjust(walk, rig, unknown_lenses=self.unknown_lenses, clocks=self.clocks, config=self.config)

    def of_walker(
        self, walk: Walk, rig: CameraRig, everybody: Mapping[str, Sequence[Track]], starts: Starts
    ) -> tuple[Walk, AdjustedWalk, Float[np.ndarray, "frame joint 3"]]:
        """Again where views showed somebody else: the walk, the scene, and the joints of all frames."""
        adjusted = self.of(walk, rig)
        joints = reconstructed(walk, adjusted.rig)
        of_walker = with_the_walker(walk, everybody, starts, adjusted.rig, joints)
        if of_walker is walk:
            return walk, adjusted, joints
        adjusted = self.of(of_walker, adjusted.rig)
        return of_walker, adjusted, reconstructed(of_walker, adjusted.rig)

    def halves(self, walk: Walk, rig: CameraRig) -> tuple[AdjustedWalk, AdjustedWalk] | None:
        """Of each half of the recording; None where one is too short, or shows too little."""
        if walk.time_s[-1] - walk.time_s[0] < 2 * SHORT_S:
            return None
        is_first = walk.time_s < 0.5 * (walk.time_s[0] + walk.time_s[-1])
        try:
            return (
                self.of(frames_of(walk, np.flatnonzero(is_first)), rig),
                self.of(frames_of(walk, np.flatnonzero(~is_first)), rig),
            )
        except ValueError:
            return None


def _adjusting(rig: CameraRig, focal: Focal, parts: Parts, *, clocks: bool) -> _Adjusting:
    config = AdjustmentConfig(n_sectors=AdjustmentConfig.n_sectors if parts.bias else 0)
    return _Adjusting(_unknown_lenses(rig, focal) if parts.joint_focal else (), clocks, config)


def _of_positions(adjusted: AdjustedWalk) -> Float[np.ndarray, "camera 3 camera 3"]:
    """Covariance of the positions of the cameras, in the gauge of the rig."""
    rotations = np.stack([camera.world_T_camera[:3, :3] for camera in adjusted.rig.cameras])
    own = adjusted.covariance[:, TRANSLATION, :, TRANSLATION]
    return np.einsum("cij,cjdk,dlk->cidl", rotations, own, rotations)


def _metric(
    walk: Walk,
    adjusted: AdjustedWalk,
    joints: Float[np.ndarray, "frame joint 3"],
    halves: tuple[AdjustedWalk, AdjustedWalk] | None,
    stature_m: float | None,
    measured: Sequence[MeasuredDistance],
    everybody: Mapping[str, Sequence[Track]],
    starts: Starts,
) -> Metric:
    """In the world, with what the halves of the recording tell of the size of the body."""
    # A distance is nobody's.
    others = [] if measured or stature_m is None else other_people(walk, everybody, starts, adjusted.rig, joints)
    cues = stature_m, _of_rig(measured, walk), _of_positions(adjusted), _body_sigma(joints, adjusted.rig, halves)
    return to_metric(walk, adjusted.rig, joints, *cues, others)


def _body_sigma(
    joints: Float[np.ndarray, "frame joint 3"], rig: CameraRig, halves: tuple[AdjustedWalk, AdjustedWalk] | None
) -> float:
    """See fgpose.calibration.from_people.world.scale.body_sigma; 0 where there are no halves."""
    if halves is None:
        return 0.0
    of_halves = [reconstructed(half.walk, aligned(half.rig, rig)[0].rig(half.rig)) for half in halves]
    lengths = halves[0].walk.skeleton.bone_lengths
    return body_sigma(lengths(joints), [lengths(own) for own in of_halves])


def _estimate(adjusted: AdjustedWalk) -> RigEstimate:
    return RigEstimate.of(adjusted.rig, adjusted.covariance, FOCAL, OFFSET)


def _judged(
    first: Walk,
    walk: Walk,
    starts: Starts,
    adjusted: AdjustedWalk,
    halves: tuple[AdjustedWalk, AdjustedWalk] | None,
    metric: Metric,
    estimated_lenses: Groups,
) -> CalibratedFromPeople:
    """With sigmas and verdict."""
    of_halves = None if halves is None else (_estimate(halves[0]), _estimate(halves[1]))
    whole = _estimate(adjusted).moved(metric.world_T_gauge)
    focal_check = None if estimated_lenses else check_focal(adjusted.problem, adjusted.state)
    of_lenses = None
    if focal_check is not None:
        nothing = np.zeros(adjusted.rig.n_cameras)
        of_lenses = RigEstimate(adjusted.rig, focal_check.covariance, nothing, nothing).moved(metric.world_T_gauge)
    of_world = metric.scale.sigma, metric.vertical.sigma_deg, metric.floor_sigma_m
    one_place = in_one_place(coverage(walk, metric.rig, metric.joints_m))
    sigmas = camera_sigmas(
        whole, of_halves, *of_world, of_lenses, one_place, walker_m=_walker_sigma_m(adjusted, metric)
    )
    doubtful = {finding.camera for finding in starts.findings}
    grounds = gather(
        first,
        walk,
        metric,
        sigmas,
        None if halves is None else (halves[0].rig, halves[1].rig),
        _unused(walk, adjusted),
        estimated_lenses,
        np.array([name not in doubtful for name in metric.rig.names]),
        focal_check,
    )
    undistorted_px = metric.rig.undistort(walk.points2d_px)
    return CalibratedFromPeople(
        rig=_with_starts(metric.rig, starts, walk),
        sigmas=sigmas,
        walk=walk,
        joints_m=metric.joints_m,
        residual_px=np.linalg.norm(metric.rig.project(metric.joints_m) - undistorted_px, axis=-1),
        findings=(*starts.findings, *findings(grounds)),
        scale_from=metric.scale.source,
    )


def _walker_sigma_m(adjusted: AdjustedWalk, metric: Metric) -> float:
    """Standard deviation of how high the walker is against the cameras, by what the adjustment says."""
    problem, state = adjusted.problem, adjusted.state
    middle = state.joints_m[problem.seen_by_two].mean(axis=0)
    covariance = point_about_centroid(problem.covariance_with_middle(state), adjusted.rig, middle)
    up = metric.vertical.up
    return metric.scale.factor * float(np.sqrt(up @ covariance @ up))


def _unused(walk: Walk, adjusted: AdjustedWalk) -> Bool[np.ndarray, " frame"]:
    """Frames that the adjustment did not use."""
    return ~np.isin(walk.time_s, adjusted.walk.time_s)


def _with_starts(rig: CameraRig, starts: Starts, walk: Walk) -> CameraRig:
    """With what turns the clock of each camera into the common one: as it is in the middle of the walk."""
    middle_s = 0.5 * (walk.time_s[0] + walk.time_s[-1])
    return rig.with_starts(starts.offsets_at_s(rig.names, middle_s) + rig.time_offsets_s)
