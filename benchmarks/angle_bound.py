"""How small the error of knee flexion can be on the recordings of the benchmark.

    python benchmarks/angle_bound.py               # an estimator that is told much; a minute
    python benchmarks/angle_bound.py --smoother    # the batch smoother on changed recordings; two minutes

The estimator that is told much knows the rig, which detections are hidden or outliers, the true covariance of the
errors of the others (white, and correlated over 0.15 s), the lengths of thigh and shank, and how much hip, knee and
ankle accelerate around each frame: all from the truth. From that it makes the best linear estimate of the leg. Its
error is not that of one draw of the detections' errors but the expectation over all of them: what the motion prior
smooths away, and what the detections do. What is known of human motion beyond its accelerations is not in it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d
from scipy.spatial.distance import cdist

import fgpose
from fgpose.io.skeletons import load_skeleton
from fgpose.kinematics import joint_angles
from fgpose.kinematics.definitions import angles_of
from fgpose.trajectory import Status, Trajectory
from fgpose_benchmarks.accuracy.families import Variant, find_variant
from fgpose_benchmarks.accuracy.variants import MAX_FRAMES, TEST_CLIPS, TUNING_CLIPS, record
from fgpose_benchmarks.comparison.recording import BenchmarkRecording
from fgpose_benchmarks.synthetic import DetectionNoise, Occlusion, embedded_motion, ring_rig, simulate
from fgpose_factors import projection_residual

_LEG, _BONES = ("hip", "knee", "ankle"), ((0, 1), (1, 2))
_SIDES = ("left", "right")
Told = Literal["power", "covariance"]
_TOLD: tuple[Told, ...] = ("power", "covariance")
_NEARBY_S = 0.4  # accelerations are averaged over so much time around each frame
_BONE_SIGMA_M = 1e-3  # less makes no difference
_LEAST_POWER = 0.03  # (m/s^2)^2; of a foot on the floor
# An acceleration that is correlated from frame to frame, as that of a body is, is less rough than a white one of the
# same power. The best of these factors on its precision is taken.
_PRECISIONS = (0.2, 0.4, 0.8)
_OUTLIER_SIGMAS = 4.5
_STEP_M = 1e-5  # of the central differences
_DRAWS = 4


@dataclass(frozen=True, eq=False)
class Leg:
    """Hip, knee and ankle of one side in a recording."""

    side: str
    fps: float
    noise: DetectionNoise
    truth_m: Float[np.ndarray, "frame 3 3"]
    jacobian: Float[np.ndarray, "camera frame 3 2 3"]
    """Of the detections, px/m."""
    seen: Bool[np.ndarray, "camera frame 3"]

    @staticmethod
    def of(recording: BenchmarkRecording, variant: Variant, side: str) -> Leg:
        """Raises ValueError: nobody knows what is hidden in the recording."""
        observations, rig = recording.oracle_observations, recording.true_rig
        if observations is None or recording.sigma_px is None:
            raise ValueError(f"nobody knows what is occluded in {recording.clip} ({recording.variant})")
        joints = [observations.skeleton.index(f"{side}_{name}") for name in _LEG]
        truth_m, points_px = recording.truth_m[:, joints], rig.undistort(observations.points2d_px)[:, :, joints]
        seen, jacobians = [], []
        for index, camera in enumerate(rig.cameras):
            args = truth_m, camera.camera_T_world, camera.K, points_px[:, index]
            error_px, (jacobian,) = projection_residual(*args)
            seen.append((np.abs(error_px) < _OUTLIER_SIGMAS * recording.sigma_px).all(axis=-1))
            jacobians.append(jacobian)
        return Leg(side, recording.fps, variant.noise, truth_m, np.stack(jacobians), np.stack(seen))

    def information(self) -> Float[np.ndarray, "unknown unknown"]:
        """Of all detections on all positions, errors of a detection correlated over time."""
        n_frames = len(self.truth_m)
        information = np.zeros((3, n_frames, 3, 3, n_frames, 3))
        for seen, jacobian in zip(self.seen, self.jacobian, strict=True):
            for joint in range(3):
                weight = self._weight(seen[:, joint])
                of_joint = np.einsum("tia,ts,sib->tasb", jacobian[:, joint], weight, jacobian[:, joint], optimize=True)
                information[joint, :, :, joint] += of_joint
        return information.reshape(9 * n_frames, -1)

    def _weight(self, seen: Bool[np.ndarray, " frame"]) -> Float[np.ndarray, "frame frame"]:
        """Inverse covariance of a coordinate of a joint's detections in one camera, 1/px^2."""
        time_s = np.arange(len(seen))[:, None] / self.fps
        covariance_px2 = self.noise.correlated_px**2 * np.exp(-cdist(time_s, time_s) / self.noise.correlation_s)
        covariance_px2 += self.noise.sigma_px**2 * np.eye(len(seen))
        weight, known = np.zeros_like(covariance_px2), np.ix_(seen, seen)
        weight[known] = np.linalg.inv(covariance_px2[known])
        return weight

    def acceleration_mps2(self) -> tuple[Float[np.ndarray, "step frame"], Float[np.ndarray, "step 3 3"]]:
        """Second differences, and what they are of the truth."""
        difference = np.diff(np.eye(len(self.truth_m)), 2, axis=0) * self.fps**2
        return difference, np.einsum("kt,tja->kja", difference, self.truth_m)

    def motion(self, told: Told) -> Float[np.ndarray, "unknown unknown"]:
        """Information of the motion prior.

        Args:
            told: "power" of each joint's acceleration, or "covariance" of the accelerations of all joints along all
                axes, which tells in which direction the leg swings.
        """
        difference, acceleration = self.acceleration_mps2()
        flat = acceleration.reshape(-1, 9)
        width = max(round(_NEARBY_S * self.fps), 1)
        covariance = uniform_filter1d(np.einsum("ka,kb->kab", flat, flat), width, axis=0)
        power = np.einsum("kjaja->kj", covariance.reshape(-1, 3, 3, 3, 3)) / 3
        of_joints = (power + _LEAST_POWER)[:, :, None] * np.ones(3)
        if told == "power":
            precision = np.eye(9) / of_joints.reshape(-1, 1, 9)
        else:
            # The few frames nearby do not span nine directions: a twentieth is as if all were alike.
            isotropic = np.eye(9) * of_joints.reshape(-1, 1, 9)
            precision = np.linalg.inv(0.95 * covariance + 0.05 * isotropic)
        size = flat.shape[1] * len(self.truth_m)
        by_joint = precision.reshape(-1, 3, 3, 3, 3)
        return np.einsum("kt,kjaib,ks->jtaisb", difference, by_joint, difference, optimize=True).reshape(size, size)

    def bones(self) -> Float[np.ndarray, "unknown unknown"]:
        """Information of the known lengths of thigh and shank."""
        frames = np.arange(len(self.truth_m))
        information = np.zeros((3, len(frames), 3, 3, len(frames), 3))
        for start, end in _BONES:
            bone_m = self.truth_m[:, end] - self.truth_m[:, start]
            along = bone_m / np.linalg.norm(bone_m, axis=-1, keepdims=True)
            outer = np.einsum("ta,tb->tab", along, along) / _BONE_SIGMA_M**2
            for i, j, sign in ((start, start, 1), (end, end, 1), (start, end, -1), (end, start, -1)):
                information[i, frames, :, j, frames] += sign * outer
        return information.reshape(9 * len(frames), -1)

    def gradient_deg(self) -> Float[np.ndarray, "joint frame 3"]:
        """Of knee flexion by the positions, degrees per metre."""
        gradient = np.zeros((3, len(self.truth_m), 3))
        for joint in range(3):
            for axis in range(3):
                step_m = np.zeros((3, 3))
                step_m[joint, axis] = _STEP_M
                ends = (self._flexion_deg(self.truth_m + sign * step_m) for sign in (1, -1))
                gradient[joint, :, axis] = np.subtract(*ends) / (2 * _STEP_M)
        return gradient

    def _flexion_deg(self, positions_m: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, " frame"]:
        points = {f"{self.side}_{name}": positions_m[:, joint] for joint, name in enumerate(_LEG)}
        return np.rad2deg(angles_of(points)[f"{self.side}_knee_flexion"][0])

    def mean_square_deg2(self, told: Told) -> Float[np.ndarray, " precision"]:
        """Expected square error of knee flexion, mean over the frames, for each of _PRECISIONS."""
        detections, motion, bones = self.information(), self.motion(told), self.bones()
        gradient_deg, truth_m = self.gradient_deg(), self.truth_m.transpose(1, 0, 2).ravel()
        n_frames = len(self.truth_m)
        rows = np.zeros((n_frames, 3, n_frames, 3))
        frames = np.arange(n_frames)
        rows[frames, :, frames] = gradient_deg.transpose(1, 0, 2)
        by_unknown = rows.reshape(n_frames, -1)
        found = []
        for precision in _PRECISIONS:
            gain = np.linalg.solve(detections + precision * motion + bones, by_unknown.T)
            smoothed_away_deg = gain.T @ (precision * motion @ truth_m)
            variance_deg2 = np.einsum("ut,ut->t", gain, detections @ gain)
            found.append(np.mean(smoothed_away_deg**2 + variance_deg2))
        return np.array(found)


def told_much(variant: Variant) -> str:
    """One line per what is told."""
    legs = [(clip, Leg.of(record(variant, clip), variant, side)) for clip in TEST_CLIPS for side in _SIDES]
    frames = np.array([len(leg.truth_m) for _, leg in legs])
    lines = []
    for told in _TOLD:
        squares_deg2 = np.stack([leg.mean_square_deg2(told) for _, leg in legs])
        best_deg = np.sqrt(np.average(squares_deg2, axis=0, weights=frames).min())
        lines.append(f"{variant.name}, told the {told} of accelerations: {best_deg:.2f} deg rms")
    return "\n".join(lines)


@dataclass(frozen=True)
class Scenes:
    """The occluded recordings with something changed."""

    name: str
    clips: tuple[str, ...] = TEST_CLIPS
    n_cameras: int = 4
    distance_m: float = 4.5
    noise: float = 1.0
    """Times the errors of visible detections."""

    def rms_deg(self, draw: int) -> float:
        """Error of knee flexion of the batch smoother in a draw of errors and occluders."""
        usual, skeleton = DetectionNoise(), load_skeleton("h36m_17")
        noise = replace(usual, sigma_px=self.noise * usual.sigma_px, correlated_px=self.noise * usual.correlated_px)
        rig = ring_rig(self.n_cameras, radius_m=self.distance_m)
        occlusion = Occlusion(n_views=self.n_cameras * 3 // 4)
        squares_deg2 = []
        for index, clip in enumerate(self.clips):
            clip_m, fps = embedded_motion(clip)
            scene = simulate(clip_m[:MAX_FRAMES], skeleton, rig, fps, noise, occlusion, seed=100 * draw + index)
            trajectory = fgpose.smooth(scene.observations, rig, fgpose.Config(solver={"covariance": False}))
            everywhere = np.full(trajectory.status.shape, int(Status.OBSERVED))
            truth = Trajectory(skeleton, trajectory.time_s, scene.truth_m.copy(), everywhere)
            found, true = joint_angles(trajectory), joint_angles(truth)
            squares_deg2 += [(found[name] - true[name]) ** 2 for name in (f"{side}_knee_flexion" for side in _SIDES)]
        return float(np.sqrt(np.nanmean(np.concatenate(squares_deg2))))


_SCENES = (
    Scenes("test clips"),
    Scenes("tuning clips", TUNING_CLIPS),
    Scenes("errors of detections x 0.8", noise=0.8),
    Scenes("cameras 3.6 m away", distance_m=3.6),
    Scenes("eight cameras, six occluded", n_cameras=8),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smoother", action="store_true", help="the batch smoother instead, on changed recordings")
    options = parser.parse_args()
    if options.smoother:
        for scenes in _SCENES:
            rms_deg = [scenes.rms_deg(draw) for draw in range(_DRAWS)]
            between = f"{min(rms_deg):.2f} to {max(rms_deg):.2f}"
            sys.stdout.write(f"{scenes.name}: {np.mean(rms_deg):.2f} deg rms, {_DRAWS} draws from {between}\n")
        return
    for name in ("clean", "occluded"):
        sys.stdout.write(told_much(find_variant(name)) + "\n")


if __name__ == "__main__":
    main()
