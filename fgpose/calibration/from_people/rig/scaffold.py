"""A first rig: two cameras by their relative pose, the others by what the two see, for every pair; the best one counts.

The error of the essential matrix of a pair does not show whether it is twisted. A third camera does: joints that were
triangulated with a wrong pose fit no pose of it. So every pair is tried, in large rigs many of them, and the rig whose
worst camera fits best wins. Two cameras have no third: there the views' 3D tells, or else that bones do not change
their length.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from fgpose.assessment.rigs import angle_deg
from fgpose.calibration.from_people.body_size import INLIER_SHARE
from fgpose.calibration.from_people.rig.evidence import (
    Evidence,
    body_joints,
    body_radius_px,
    evidence_of,
    frames_of,
)
from fgpose.calibration.from_people.rig.procrustes import procrustes_pose
from fgpose.calibration.from_people.rig.relative_pose import LEAST_POINTS, RelativePose, relative_poses
from fgpose.calibration.from_people.rig.resection import resect
from fgpose.calibration.from_people.rig.unit import unit_of
from fgpose.calibration.from_people.walk import Walk
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.sampling import spread_evenly

_MAX_FRAMES = 150  # five seconds a frame in a walk of minutes: twice as many change no choice on the tuning scenes
_MAX_PAIRS = 66  # all of 12 cameras; bounds the time, which grows with pairs times what all cameras triangulate
# Errors of a network are 20 to 40 mm, and a body has a radius (RMS) of about 0.45 m.
_TOLERANCE_SHARE = 0.05
_REFEREE_DEG = 30.0  # a pose that is further from the views' 3D is twisted; the 3D itself is 5 to 15 degrees off
_RIVALS = 1.5  # a scaffold whose residual is so many times the best one is as good as far as can be known


@dataclass(frozen=True, eq=False)
class Scaffold:
    """A first rig, and how far it can be trusted."""

    rig: CameraRig
    """First camera at the identity; the unit is that of the views' 3D, or the median torso is 0.5."""
    pair: tuple[str, str]
    """The cameras that it began with."""
    residual: Float[np.ndarray, " camera"]
    """Median reprojection error, as a share of the body's radius in the image, of what the others triangulate: of each
    camera but those of the pair, theirs is that of the joints triangulated with all."""
    score: float
    """The lower, the better: the worst residual, and how much bones change their length."""
    cross_check_deg: Float[np.ndarray, "camera camera"]
    """Between the relative rotation of two cameras and that of their views' 3D; NaN without."""
    n_joints: tuple[int, ...]
    """How many joints of each camera have been used."""
    rival_deg: float = 0.0
    """Largest angle between relative rotations here and in another scaffold that is about as good: a few degrees where
    the recording tells the rig. With guessed focal lengths it is tens of degrees, which the adjustment mends."""


def scaffold(walk: Walk, intrinsics: CameraRig, seed: int = 0) -> Scaffold:
    """The best first rig.

    Args:
        walk: what the cameras saw.
        intrinsics: K and distortion, known or guessed; its poses are not used.
        seed: of the robust estimators.

    Raises:
        ValueError: there is one camera, or a camera shares too little with the others.
    """
    return scaffolds(walk, intrinsics, seed)[0]


def scaffolds(walk: Walk, intrinsics: CameraRig, seed: int = 0) -> list[Scaffold]:
    """All of them, the best one first.

    Raises:
        ValueError: as scaffold does.
    """
    if intrinsics.n_cameras < 2:
        raise ValueError("cameras are calibrated relative to each other: at least two are needed")
    views, rng = _Views.of(walk, intrinsics), np.random.default_rng(seed)
    grown = views.all_grown(views.begun_with, rng) or views.all_grown(views.other_pairs, rng)
    if not grown:
        raise ValueError(f"the cameras cannot be placed: {views.least_shared()}")
    ranked = sorted(grown, key=lambda made: made.score)
    as_good = sum(made.score <= _RIVALS * ranked[0].score for made in ranked)
    rivals_deg = largest_differences_deg([made.rig for made in ranked], [made.rig for made in ranked[:as_good]])
    return [replace(made, rival_deg=rival_deg) for made, rival_deg in zip(ranked, rivals_deg.tolist(), strict=True)]


@dataclass(frozen=True, eq=False)
class _Views:
    """What the cameras saw in the frames that are used."""

    walk: Walk
    intrinsics: CameraRig
    evidence: Evidence
    radius_px: float
    referees: dict[tuple[int, int], Float[np.ndarray, "4 4"] | None]

    @staticmethod
    def of(walk: Walk, intrinsics: CameraRig) -> _Views:
        evidence = evidence_of(walk, intrinsics, _MAX_FRAMES)
        used, measured_px = frames_of(walk, evidence.frames), evidence.sightings.measured_px
        radii_px = [body_radius_px(measured_px[:, c]) for c in range(intrinsics.n_cameras)]
        pairs = list(combinations(range(intrinsics.n_cameras), 2))
        return _Views(
            used, intrinsics, evidence, float(np.nanmedian(radii_px)), {pair: _referee(used, *pair) for pair in pairs}
        )

    @cached_property
    def shared(self) -> Int[np.ndarray, "camera camera"]:
        """How many joints two cameras see at the same time."""
        seen = (self.evidence.sightings.weights > 0).astype(int)
        return np.einsum("tcj,tdj->cd", seen, seen, optimize=True)

    @property
    def begun_with(self) -> list[tuple[int, int]]:
        """Pairs of cameras that see enough together; of a large rig _MAX_PAIRS of them, spread evenly."""
        pairs = [pair for pair in self.referees if self.shared[pair] >= LEAST_POINTS]
        return [pairs[n] for n in spread_evenly(len(pairs), _MAX_PAIRS)] if pairs else []

    @property
    def other_pairs(self) -> list[tuple[int, int]]:
        """For rigs that none of the former tell."""
        begun_with = set(self.begun_with)
        return [pair for pair in self.referees if pair not in begun_with]

    def all_grown(self, pairs: Sequence[tuple[int, int]], rng: np.random.Generator) -> list[Scaffold]:
        """From every relative pose of these pairs."""
        made = (self.grown(*begun) for begun in self.relative_poses(pairs, rng))
        return [each for each in made if each is not None]

    def relative_poses(
        self, pairs: Sequence[tuple[int, int]], rng: np.random.Generator
    ) -> Iterator[tuple[int, int, RelativePose]]:
        """All that the views' 3D does not rule out."""
        for a, b in pairs:
            referee = self.referees[a, b]
            found = relative_poses(self._at_unit(a), self._at_unit(b), self._tolerance(a, b), referee, rng)
            agreeing = [relative for relative in found if not relative.cross_check_deg > _REFEREE_DEG]
            for relative in agreeing or found:
                yield a, b, relative

    def grown(self, first: int, second: int, relative: RelativePose) -> Scaffold | None:
        """With all cameras, each placed by the joints that those before it triangulate; None where one cannot be."""
        poses = {first: np.eye(4), second: relative.first_T_second}
        residual = np.full(self.intrinsics.n_cameras, np.nan)
        while len(poses) < self.intrinsics.n_cameras:
            joints = self._joints(poses)
            waiting = [c for c in range(self.intrinsics.n_cameras) if c not in poses]
            placed = {c: pose for c in waiting if (pose := self._placed(c, joints)) is not None}
            if not placed:
                return None
            for c, pose in placed.items():
                residual[c] = self._residual(c, pose, joints)
            poses |= placed
        joints = self._joints(poses)
        for c in (first, second):
            residual[c] = self._residual(c, poses[c], joints)
        rig = self._rig(poses, joints)
        return Scaffold(
            rig=rig,
            pair=(self.intrinsics.names[first], self.intrinsics.names[second]),
            residual=residual,
            score=float(np.max(residual)) + self._bone_spread(joints),
            cross_check_deg=self._referee_deg(rig),
            n_joints=tuple((self.evidence.sightings.weights > 0).sum(axis=(0, 2)).tolist()),
        )

    def least_shared(self) -> str:
        """Which cameras see nobody together with the others, in words; or, if all do, that no poses explain it."""
        from scipy.sparse.csgraph import connected_components

        n_groups, group_of = connected_components(self.shared >= LEAST_POINTS, directed=False)
        if n_groups == 1:
            return (
                "no poses of the cameras explain what they saw; walk through the whole view of each, in several "
                "directions, and see that every video is of another camera and that K is of its resolution"
            )
        names = np.array(self.intrinsics.names)
        groups = [", ".join(names[group_of == group].tolist()) for group in range(n_groups)]
        return (
            f"{groups[0]} on one side and {'; '.join(groups[1:])} on the other never see the same person at the same "
            "time; walk where cameras of both see you"
        )

    def _joints(self, poses: dict[int, np.ndarray]) -> Float[np.ndarray, "frame joint 3"]:
        """What the cameras that have a pose triangulate; NaN = not known."""
        cameras, rig = list(poses), CameraRig(tuple(self._camera(c, pose) for c, pose in poses.items()))
        sightings = self.evidence.sightings
        measured_px, weights = sightings.measured_px[:, cameras], sightings.weights[:, cameras]
        return triangulate_robust(measured_px, weights, rig, INLIER_SHARE * self.radius_px).positions_m

    def _camera(self, c: int, world_T_camera: Float[np.ndarray, "4 4"]) -> Camera:
        return replace(self.intrinsics.cameras[c], world_T_camera=world_T_camera)

    def _placed(self, c: int, joints: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "4 4"] | None:
        """world_T_camera of a camera that sees joints whose place is known."""
        points_px = self.evidence.sightings.measured_px[:, c]
        known = np.isfinite(joints).all(axis=-1) & np.isfinite(points_px).all(axis=-1)
        K = self.intrinsics.cameras[c].K
        return resect(joints[known], points_px[known], K, INLIER_SHARE * self.radius_px, LEAST_POINTS)

    def _residual(self, c: int, pose: np.ndarray, joints: Float[np.ndarray, "frame joint 3"]) -> float:
        """Median reprojection error as a share of the body's radius; infinite where half the joints are behind."""
        camera = self._camera(c, pose)
        points_px = self.evidence.sightings.measured_px[:, c]
        known = np.isfinite(joints).all(axis=-1) & np.isfinite(points_px).all(axis=-1)
        if not known.any():
            return np.inf
        errors_px = np.linalg.norm(camera.project(joints[known]) - points_px[known], axis=-1)
        radius_px = body_radius_px(points_px)
        return float(np.median(np.where(np.isfinite(errors_px), errors_px, np.inf))) / radius_px

    def _bone_spread(self, joints: Float[np.ndarray, "frame joint 3"]) -> float:
        """By which share bones differ from their usual length: the median over bones of their median deviation."""
        lengths = self.walk.skeleton.bone_lengths(self.evidence.of_skeleton(joints, self.walk.skeleton))
        lengths = lengths[:, np.isfinite(lengths).any(axis=0)]
        if not lengths.size:
            return 0.0
        usual = np.nanmedian(lengths, axis=0)
        return float(np.median(np.nanmedian(np.abs(lengths / usual - 1), axis=0)))

    def _rig(self, poses: dict[int, np.ndarray], joints: Float[np.ndarray, "frame joint 3"]) -> CameraRig:
        """All cameras in the frame of the first."""
        views_m = None if self.walk.points3d_m is None else self.walk.points3d_m[:, :, self.evidence.joints]
        unit = unit_of(joints, views_m, self.walk.skeleton, self.evidence.joints)
        first_T_world = np.linalg.inv(poses[0])
        cameras = []
        for c in sorted(poses):
            pose = first_T_world @ poses[c]
            pose[:3, 3] *= unit
            cameras.append(self._camera(c, pose))
        return CameraRig(tuple(cameras))

    def _referee_deg(self, rig: CameraRig) -> Float[np.ndarray, "camera camera"]:
        degrees = np.full((rig.n_cameras, rig.n_cameras), np.nan)
        for (a, b), referee in self.referees.items():
            if referee is not None:
                degrees[a, b] = degrees[b, a] = angle_deg(_relative_rotation(rig, a, b), referee[:3, :3])
        return degrees

    def _at_unit(self, c: int) -> Float[np.ndarray, "frame joint 2"]:
        K = self.intrinsics.cameras[c].K
        return (self.evidence.sightings.measured_px[:, c] - K[:2, 2]) / np.diag(K)[:2]

    def _tolerance(self, a: int, b: int) -> float:
        """Of both cameras, at unit focal length."""
        radii = [
            body_radius_px(self.evidence.sightings.measured_px[:, c]) / self.intrinsics.cameras[c].K[0, 0]
            for c in (a, b)
        ]
        return _TOLERANCE_SHARE * float(np.mean(radii))


def _referee(walk: Walk, a: int, b: int) -> Float[np.ndarray, "4 4"] | None:
    if walk.points3d_m is None:
        return None
    joints = body_joints(walk.skeleton)
    return procrustes_pose(walk.points3d_m[:, a][:, joints], walk.points3d_m[:, b][:, joints])


def _relative_rotation(rig: CameraRig, a: int, b: int) -> Float[np.ndarray, "3 3"]:
    return rig.cameras[a].world_T_camera[:3, :3].T @ rig.cameras[b].world_T_camera[:3, :3]


def largest_differences_deg(rigs: list[CameraRig], others: list[CameraRig]) -> Float[np.ndarray, " rig"]:
    """Largest angle between the relative rotation of two cameras in each rig and that in any of the others."""
    own = relative_quaternions(rigs)
    return np.max([angles_deg(own, other).max(axis=1) for other in relative_quaternions(others)], axis=0)


def relative_quaternions(rigs: list[CameraRig]) -> Float[np.ndarray, "rig pair 4"]:
    """Of the rotation between each two cameras."""
    from scipy.spatial.transform import Rotation

    turned = np.array([[camera.world_T_camera[:3, :3] for camera in rig.cameras] for rig in rigs])
    first, second = np.triu_indices(turned.shape[1], k=1)
    relative = turned[:, first].swapaxes(-1, -2) @ turned[:, second]
    return Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_quat().reshape(*relative.shape[:2], 4)


def angles_deg(one: Float[np.ndarray, "*#of 4"], other: Float[np.ndarray, "*#of 4"]) -> Float[np.ndarray, "*of"]:
    """Between rotations; exact for small angles, unlike the arccosine of the product."""
    apart, opposite = np.linalg.norm(one - other, axis=-1), np.linalg.norm(one + other, axis=-1)
    return np.rad2deg(4 * np.arctan2(np.minimum(apart, opposite), np.maximum(apart, opposite)))
