"""Bundle adjustment of a walk: poses, clocks and lenses of the cameras, with the joints of all frames that are used.

One objective (fgpose.calibration.adjustment.problem), minimised several times: robustly at first, then with the noise
that the residuals show and with biases of the views. Of an unknown lens, focal length, radial distortion and
principal point are free, around what is usual: what the recording does not determine stays there, and its uncertainty
is that of the poses too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.adjustment.cameras import adjusted_rig
from fgpose.calibration.adjustment.noise import Noise
from fgpose.calibration.adjustment.problem import Bundle, BundleProblem
from fgpose.calibration.adjustment.unknowns import N_OF_CAMERA, POSE, Groups, Unknowns
from fgpose.calibration.from_people.rig.evidence import Evidence, body_radius_px, evidence_of, frames_of
from fgpose.calibration.from_people.rig.sectors import N_SECTORS, seen_from
from fgpose.calibration.from_people.rig.unit import scaled, unit_of
from fgpose.calibration.from_people.walk import Walk
from fgpose.config import ProjectionConfig
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose_factors.robust_statistics import MEDIAN_LENGTH

# Detections are off by tens of millimetres, and a body is half a metre from its centre to its joints (RMS).
_LEAST_SIGMA_SHARE, _MOST_SIGMA_SHARE = 0.004, 0.1
_ROUGH_SIGMA_SHARE = 0.1
_INLIER_SHARE = 0.4  # of that radius: cameras that are off by several degrees at first still count


@dataclass(frozen=True)
class AdjustmentConfig:
    """Settings of the adjustment."""

    max_frames: int = 300
    """Frames that are used, spread evenly. Raising it takes longer, and tells hardly more."""
    n_sectors: int = N_SECTORS
    """Directions from which the biases of a view are told apart; 0: there are none."""
    bias_m: float = 0.02
    """Standard deviation of each coordinate of a bias. Raising it trusts a view less, whatever its number of frames."""
    focal: float = 0.25
    """Of the guess of an unknown focal length, as a share of it."""
    k1: float = 0.2
    """Of the radial distortion of an unknown lens around none (RMS of the lenses in fgpose/data: 0.19)."""
    centre: float = 0.01
    """Of the principal point of an unknown lens around the middle of the image, each coordinate, as a share of the
    diagonal: so far off are calibrated cameras of phones, webcams and studios (RMS of the lenses in fgpose/data)."""
    offset_s: float = 0.05
    """Of the clocks as they are given."""


@dataclass(frozen=True, eq=False)
class AdjustedWalk:
    """The most probable scene."""

    rig: CameraRig
    """First camera where it was; time_offset_s corrected."""
    walk: Walk
    """The frames that were used."""
    covariance: Float[np.ndarray, "camera 11 camera 11"]
    """Of small changes of each camera in its own frame (unknowns.N_OF_CAMERA), joints and biases marginalised; zero for
    what is held: the first camera, and its distance to the farthest."""
    problem: BundleProblem
    """What was minimised, ..."""
    state: Bundle
    """... and where its minimum is."""
    converged: bool


def lens_groups(intrinsics: CameraRig) -> tuple[tuple[int, ...], ...]:
    """Cameras that are of one model as far as can be known: equal images and equal guesses of the intrinsics."""
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for c, camera in enumerate(intrinsics.cameras):
        groups[camera.size_px, *camera.K.round(6).ravel().tolist(), *camera.distortion.tolist()].append(c)
    return tuple(tuple(group) for group in groups.values())


def adjust(
    walk: Walk,
    rig: CameraRig,
    *,
    unknown_lenses: Groups = (),
    clocks: bool = True,
    config: AdjustmentConfig | None = None,
) -> AdjustedWalk:
    """The scene that explains a walk best, near a rig that is roughly right (scaffold).

    Args:
        walk: what the cameras saw.
        rig: to start from.
        unknown_lenses: groups of cameras (lens_groups) that share a lens whose focal length is a guess.
        clocks: whether time offsets are unknown, within a fraction of a frame.
        config: settings.

    Raises:
        ValueError: no joint is seen by two cameras at a time, or the lens of a fisheye camera is unknown.
    """
    config = config or AdjustmentConfig()
    _check_lenses(rig, unknown_lenses)
    task = _Task(walk, rig, evidence_of(walk, rig, config.max_frames), config, unknown_lenses, clocks)
    solved = task.finely(task.finely(task.roughly()))
    return AdjustedWalk(
        rig=solved.rig,
        walk=frames_of(walk, task.evidence.frames),
        covariance=solved.problem.covariance(solved.state),
        problem=solved.problem,
        state=solved.state,
        converged=solved.converged,
    )


@dataclass(frozen=True, eq=False)
class _Solved:
    """A scene that was adjusted."""

    problem: BundleProblem
    state: Bundle
    converged: bool

    @staticmethod
    def of(problem: BundleProblem, start: Bundle) -> _Solved:
        solution = problem.solve(start)
        return _Solved(problem, solution.state, solution.convergence.converged)

    @property
    def rig(self) -> CameraRig:
        return adjusted_rig(self.problem.rig, self.state.changes)


@dataclass(frozen=True, eq=False)
class _Task:
    """What stays the same from one minimisation to the next."""

    walk: Walk
    rig: CameraRig
    evidence: Evidence
    config: AdjustmentConfig
    unknown_lenses: Groups
    clocks: bool

    def roughly(self) -> _Solved:
        """Poses and focal lengths alone, with large errors of the detections."""
        known, joints_m = self._triangulated(self.rig)
        state = Bundle.of(np.zeros((self.rig.n_cameras, N_OF_CAMERA)), joints_m)
        unknowns = Unknowns.of(self.rig.n_cameras, self._others, self.unknown_lenses)
        noise = self._noise(_ROUGH_SIGMA_SHARE * self._radius_px)
        return _Solved.of(BundleProblem(self.rig, self.evidence.sightings.only(known), unknowns, noise), state)

    def finely(self, before: _Solved) -> _Solved:
        """With the errors that the detections have, clocks and biases."""
        noise, rig = self._noise(self._shown_sigma_px(before)), before.rig
        known, joints_m = self._triangulated(rig)
        unit = self._unit(joints_m)
        rig, joints_m = scaled(rig, unit), unit * joints_m
        given = _posed(self.rig, rig)
        changes = before.state.changes.copy()
        changes[:, POSE] = 0.0
        world_T_camera = np.stack([camera.world_T_camera for camera in rig.cameras])
        skeleton, n_sectors = self.walk.skeleton, self.config.n_sectors
        sides = seen_from(self.evidence.of_skeleton(joints_m, skeleton), skeleton, world_T_camera, n_sectors)
        problem = BundleProblem(given, self.evidence.sightings.only(known), self._unknowns, noise, sides)
        return _Solved.of(problem, Bundle.of(changes, joints_m, n_sectors))

    @property
    def _others(self) -> range:
        """The first camera is where the world is."""
        return range(1, self.rig.n_cameras)

    @cached_property
    def _unknowns(self) -> Unknowns:
        """Of the fine adjustment."""
        radial = [group for group in self.unknown_lenses if not self._distorts(group)]
        centres = [c for group in self.unknown_lenses for c in group]
        lenses = self.unknown_lenses, radial, centres
        return Unknowns.of(self.rig.n_cameras, self._others, *lenses, clocks=self.clocks)

    def _noise(self, sigma_px: float) -> Noise:
        kernel, config = ProjectionConfig(), self.config
        return Noise(
            sigma_px=np.full(self.rig.n_cameras, sigma_px),
            kernel=kernel.kernel,
            kernel_scale=kernel.kernel_scale,
            bias_m=config.bias_m,
            focal=config.focal,
            k1=config.k1,
            centre=config.centre,
            offset_s=config.offset_s,
        )

    def _shown_sigma_px(self, solved: _Solved) -> float:
        """Standard deviation of the detections, from the median of their residuals: of two coordinates each, less three
        of each joint."""
        residual_px = solved.problem.residual_px(solved.state)
        seen = np.isfinite(residual_px)
        n_detections, n_joints = int(seen.sum()), int(seen.any(axis=1).sum())
        left = max(2 * n_detections - 3 * n_joints, 1) / max(2 * n_detections, 1)
        sigma_px = float(np.nanmedian(residual_px)) / (MEDIAN_LENGTH * np.sqrt(left)) if n_detections else np.inf
        return float(np.clip(sigma_px, *self._radius_px * np.array([_LEAST_SIGMA_SHARE, _MOST_SIGMA_SHARE])))

    def _triangulated(
        self, rig: CameraRig
    ) -> tuple[Bool[np.ndarray, "frame joint"], Float[np.ndarray, "frame joint 3"]]:
        """Which of our joints can be triangulated, and where they are."""
        sightings = self.evidence.sightings
        found = triangulate_robust(sightings.measured_px, sightings.weights, rig, _INLIER_SHARE * self._radius_px)
        return np.asarray(np.isfinite(found.positions_m).all(axis=-1)), found.positions_m

    def _unit(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> float:
        """What the scene is to be multiplied by: a focal length that was wrong has changed its size."""
        views_m, joints = self.walk.points3d_m, self.evidence.joints
        views_m = None if views_m is None else views_m[self.evidence.frames][:, :, joints]
        return unit_of(joints_m, views_m, self.walk.skeleton, joints)

    def _distorts(self, group: Sequence[int]) -> bool:
        return any(self.rig.cameras[c].distortion.any() for c in group)

    @cached_property
    def _radius_px(self) -> float:
        measured_px = self.evidence.sightings.measured_px
        return float(np.nanmedian([body_radius_px(measured_px[:, c]) for c in range(self.rig.n_cameras)]))


def _posed(rig: CameraRig, poses_of: CameraRig) -> CameraRig:
    """The cameras of a rig in the poses of another."""
    pairs = zip(rig.cameras, poses_of.cameras, strict=True)
    return CameraRig(tuple(replace(camera, world_T_camera=posed.world_T_camera) for camera, posed in pairs))


def _check_lenses(rig: CameraRig, unknown_lenses: Groups) -> None:
    for c in (c for group in unknown_lenses for c in group):
        if rig.cameras[c].lens == "fisheye":
            raise ValueError(
                f"camera {rig.cameras[c].name}: the lens of a fisheye camera must be given, people cannot tell it"
            )
