"""Bundle adjustment of a walk: poses, clocks and lenses of the cameras, with the joints of all frames that are used.

One objective (fgpose.calibration.from_people.scene_problem), minimised several times: robustly at first, then with the
noise that the residuals show and with biases of the views. Of an unknown lens, focal length, radial distortion and
principal point are free, around what is usual: what the recording does not determine stays there, and its uncertainty
is that of the poses too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from fgpose.calibration.from_people.evidence import Evidence, body_radius_px, evidence_of, frames_of
from fgpose.calibration.from_people.scene import SceneState
from fgpose.calibration.from_people.scene_problem import SceneNoise, SceneProblem
from fgpose.calibration.from_people.sectors import N_SECTORS, SeenFrom
from fgpose.calibration.from_people.unit import scaled, unit_of
from fgpose.calibration.from_people.unknowns import Groups, Unknowns
from fgpose.calibration.from_people.walk import Walk
from fgpose.config import ProjectionConfig
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust

# Median length of two independent normal coordinates, in standard deviations.
_RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))
# Detections are off by tens of millimetres, and a body is half a metre from its centre to its joints (RMS).
_LEAST_SIGMA_SHARE, _MOST_SIGMA_SHARE = 0.004, 0.1
_ROUGH_SIGMA_SHARE = 0.1
_INLIER_SHARE = 0.4  # of that radius: cameras that are off by several degrees at first still count

_HELD_M, _FREE_M = 1e-6, 1e3  # standard deviations of what is held or not used


@dataclass(frozen=True)
class AdjustmentConfig:
    """Settings of the adjustment."""

    max_frames: int = 300
    """Frames that are used, spread evenly. Raising it takes longer, and tells hardly more."""
    max_iterations: int = 60
    """Of each minimisation."""
    n_sectors: int = N_SECTORS
    """Directions from which the biases of a view are told apart."""
    bias_m: float = 0.02
    """Standard deviation of each coordinate of a bias. Raising it trusts a view less, whatever its number of frames."""
    in_common: bool = True
    """Whether a bias depends on the direction alone, as that of one network does, or on the camera too."""
    bone_m: float = 1e3
    """Standard deviation of the length of a bone in a frame, metres; so large: bones are not used. Noise makes bones
    longer, the more the farther away, and the cameras give way: on simulated walks this costs accuracy (two cameras 4.7
    instead of 2.2 degrees, focal lengths 1.3 instead of 0.7 %), on a person in one place it gains a little."""
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
class Adjusted:
    """The most probable scene."""

    rig: CameraRig
    """First camera where it was; time_offset_s corrected."""
    walk: Walk
    """The frames that were used."""
    joints_m: Float[np.ndarray, "frame joint 3"]
    """Of the whole skeleton; NaN = not determined."""
    residual_px: Float[np.ndarray, "frame camera joint"]
    """Length of the reprojection errors, biases taken out; NaN = missing or not used."""
    covariance: Float[np.ndarray, "camera 11 camera 11"]
    """Of rotation vector (radians) and translation in the frame of each camera, log of its focal length, k1, principal
    point (projection.CENTRE) and time offset (seconds), joints and biases marginalised; zero for what is held: the
    first camera, and its distance to the farthest."""
    sigma_px: float
    """Of a good detection, as the residuals show it."""
    problem: SceneProblem
    """What was minimised, ..."""
    state: SceneState
    """... and where its minimum is."""
    objective: float
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
) -> Adjusted:
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
    return task.result(task.finely(task.finely(task.roughly())))


@dataclass(frozen=True, eq=False)
class _Solved:
    """A scene that was adjusted."""

    problem: SceneProblem
    state: SceneState
    evidence: Evidence
    """Without joints that are not known."""
    sigma_px: float
    objective: float
    converged: bool


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
        noise = self._noise(_ROUGH_SIGMA_SHARE * self._radius_px, bias_m=_HELD_M, bone_m=_FREE_M)
        unknowns = Unknowns.of(self.rig.n_cameras, self.evidence.n_lengths, self.unknown_lenses)
        known, joints_m = self._triangulated(self.rig)
        state = SceneState.of(self.rig, joints_m, self.evidence, 1)
        anywhere = SeenFrom.anywhere(len(self.evidence.frames), self.rig.n_cameras)
        return self._solved(state, self.evidence.only(known), anywhere, unknowns, noise)

    def finely(self, before: _Solved) -> _Solved:
        """With the errors that the detections have, bones, clocks and biases."""
        config, rig = self.config, before.state.rig(self.rig)
        noise = self._noise(self._shown_sigma_px(before), bias_m=config.bias_m, bone_m=config.bone_m)
        known, joints_m = self._triangulated(rig)
        unit = self._unit(joints_m)
        rig, joints_m = scaled(rig, unit), unit * joints_m
        state = SceneState.of(rig, joints_m, self.evidence, config.n_sectors, in_common=config.in_common)
        state = state.with_lenses_and_clocks_of(before.state)
        every_m = self._of_skeleton(joints_m)
        seen_from = SeenFrom.of(every_m, self.walk.skeleton, state.world_T_camera, config.n_sectors)
        return self._solved(state, self.evidence.only(known), seen_from, self._unknowns, noise)

    def result(self, solved: _Solved) -> Adjusted:
        """For the whole skeleton: joints that were not adjusted are triangulated."""
        rig = solved.state.rig(self.rig)
        covariance = solved.problem.camera_covariance(solved.state)
        walk = frames_of(self.walk, self.evidence.frames)
        joints_m, residual_px = _triangulated_walk(walk, rig, _INLIER_SHARE * self._radius_px)
        known = np.asarray((solved.evidence.weights > 0).any(axis=1))
        ours = self.evidence.joints
        joints_m[:, ours] = np.where(known[..., None], solved.state.joints_m, np.nan)
        residual_px[:, :, ours] = solved.problem.residual_px(solved.state)
        return Adjusted(
            rig=rig,
            walk=walk,
            joints_m=joints_m,
            residual_px=residual_px,
            covariance=covariance,
            sigma_px=solved.sigma_px,
            problem=solved.problem,
            state=solved.state,
            objective=solved.objective,
            converged=solved.converged,
        )

    def _solved(
        self,
        state: SceneState,
        evidence: Evidence,
        seen_from: SeenFrom,
        unknowns: Unknowns,
        noise: SceneNoise,
    ) -> _Solved:
        problem = SceneProblem(self.rig, evidence, seen_from, unknowns, noise, state)
        solution = levenberg_marquardt(problem, state, self.config.max_iterations)
        return _Solved(
            problem,
            solution.state,
            evidence,
            noise.sigma_px,
            problem.error(solution.state),
            solution.convergence.converged,
        )

    @cached_property
    def _unknowns(self) -> Unknowns:
        """Of the fine adjustment."""
        radial = [group for group in self.unknown_lenses if not self._distorts(group)]
        centres = [c for group in self.unknown_lenses for c in group]
        n_cameras, n_lengths = self.rig.n_cameras, self.evidence.n_lengths
        return Unknowns.of(n_cameras, n_lengths, self.unknown_lenses, radial, centres, clocks=self.clocks)

    def _noise(self, sigma_px: float, *, bias_m: float, bone_m: float) -> SceneNoise:
        kernel, config = ProjectionConfig(), self.config
        return SceneNoise(
            sigma_px,
            kernel.kernel,
            kernel.kernel_scale,
            bias_m,
            bone_m,
            config.focal,
            config.k1,
            config.centre,
            config.offset_s,
        )

    def _shown_sigma_px(self, solved: _Solved) -> float:
        """Standard deviation of the detections, from the median of their residuals: of two coordinates each, less three
        of each joint."""
        residual_px = solved.problem.residual_px(solved.state)
        seen = np.isfinite(residual_px)
        n_detections, n_joints = int(seen.sum()), int(seen.any(axis=1).sum())
        left = max(2 * n_detections - 3 * n_joints, 1) / max(2 * n_detections, 1)
        sigma_px = float(np.nanmedian(residual_px)) / (_RAYLEIGH_MEDIAN * np.sqrt(left)) if n_detections else np.inf
        return float(np.clip(sigma_px, *self._radius_px * np.array([_LEAST_SIGMA_SHARE, _MOST_SIGMA_SHARE])))

    def _triangulated(
        self, rig: CameraRig
    ) -> tuple[Bool[np.ndarray, "frame joint"], Float[np.ndarray, "frame joint 3"]]:
        """Which of our joints can be triangulated, and where they are."""
        measured_px, weights = self.evidence.measured_px, self.evidence.weights
        found = triangulate_robust(measured_px, weights, rig, _INLIER_SHARE * self._radius_px)
        return np.asarray(np.isfinite(found.positions_m).all(axis=-1)), found.positions_m

    def _unit(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> float:
        """What the scene is to be multiplied by: a focal length that was wrong has changed its size."""
        views_m, joints = self.walk.points3d_m, self.evidence.joints
        views_m = None if views_m is None else views_m[self.evidence.frames][:, :, joints]
        return unit_of(joints_m, views_m, self.walk.skeleton, joints)

    def _of_skeleton(self, joints_m: Float[np.ndarray, "frame joint 3"]) -> Float[np.ndarray, "frame all 3"]:
        every_m = np.full((len(joints_m), self.walk.skeleton.n_joints, 3), np.nan)
        every_m[:, self.evidence.joints] = joints_m
        return every_m

    def _distorts(self, group: Sequence[int]) -> bool:
        return any(self.rig.cameras[c].distortion.any() for c in group)

    @cached_property
    def _radius_px(self) -> float:
        measured_px = self.evidence.measured_px
        return float(np.nanmedian([body_radius_px(measured_px[:, c]) for c in range(self.rig.n_cameras)]))


def _triangulated_walk(
    walk: Walk, rig: CameraRig, inlier_px: float
) -> tuple[Float[np.ndarray, "frame joint 3"], Float[np.ndarray, "frame camera joint"]]:
    """All joints of the skeleton, and the lengths of their reprojection errors."""
    undistorted_px = rig.undistort(walk.points2d_px)
    joints_m = triangulate_robust(undistorted_px, walk.confidence, rig, inlier_px).positions_m
    return joints_m, np.linalg.norm(rig.project(joints_m) - undistorted_px, axis=-1)


def _check_lenses(rig: CameraRig, unknown_lenses: Groups) -> None:
    for c in (c for group in unknown_lenses for c in group):
        if rig.cameras[c].lens == "fisheye":
            raise ValueError(
                f"camera {rig.cameras[c].name}: the lens of a fisheye camera must be given, people cannot tell it"
            )
