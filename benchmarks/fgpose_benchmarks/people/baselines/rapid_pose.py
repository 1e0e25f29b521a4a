"""Pairwise triangulation after RapidPoseTriangulation (Bermuth, Poeppel and Reif, RapidPoseTriangulation: Multi-view
Multi-person Whole-body Human Pose Triangulation in a Millisecond, arXiv 2503.21692, 2025).

All pairs of detections of different views are triangulated, those that do not reproject well are dropped, the others
are clustered in 3D and merged joint by joint. People of the frame before sort out pairs beforehand. The steps are those
of the paper. The constants are those of the authors' code as far as we know them: it was not at hand to check.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.people.baselines.frame import Frame, NearestInTime, mean_distance_m
from fgpose_benchmarks.people.recording import PeopleRecording, Poses

_CORE = tuple(
    f"{side}_{of}" for side in ("left", "right") for of in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)
# Score of a pair at least, and of a detection that is said to be of somebody in the frame before.
_MIN_SCORE, _SAME_SCORE = 0.95, 0.75
# An error counts up to a quarter of the image, and as it would be at this distance; score 1 / (1 + 10 error).
_WORST_SHARE, _REFERENCE_M, _SHARPNESS = 0.25, 3.5, 10.0
# Two pairs are of one person if their middles and, on average, their joints are no farther apart.
_MIDDLES_M, _JOINTS_M = 0.6, 0.3
_MIN_JOINTS = 4
# With many cameras a person is asked to be seen by more than one pair.
_FEW_CAMERAS = 4
# Of a joint, the proposals nearest to their median are averaged: a third of the cameras, but three; none beyond this.
_BEST, _OUTLIER_M = 3, 0.2
# People do not move faster, and are forgotten after two seconds.
_SPEED_MPS, _SLACK_M, _FORGET_S = 3.0, 0.1, 2.0


def rapid_pose(recording: PeopleRecording) -> list[Poses]:
    """Everybody in every frame of a recording."""
    identity = NearestInTime(_SLACK_M, _SPEED_MPS, _FORGET_S)
    triangulator = Triangulator(recording.observations.skeleton)
    return [
        identity.identified(time_s, triangulator.people_m(Frame.of(images, recording.rig)))
        for time_s, images in recording.images()
    ]


@dataclass(eq=False)
class Triangulator:
    """Finds everybody in one frame after the other.

    Raises:
        ValueError: the skeleton lacks one of the core joints: shoulders, elbows, wrists, hips, knees and ankles.
    """

    skeleton: Skeleton
    _before_m: list[Float[np.ndarray, "joint 3"]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._core = np.array([self.skeleton.index(joint) for joint in _CORE])

    def people_m(self, frame: Frame) -> list[Float[np.ndarray, "joint 3"]]:
        """The poses in one frame; joints of which no pair is left are NaN."""
        pairs = frame.pairs()
        pairs = pairs[self._is_possible(frame, pairs)]
        joints_m, _ = frame.meetings(pairs)
        score = _pair_scores(frame, pairs, joints_m, self._core)
        good = np.flatnonzero(score >= _MIN_SCORE)
        best_first = good[np.argsort(-score[good], kind="stable")]
        smallest = 1 if frame.cameras.n_cameras <= _FEW_CAMERAS else 2
        clusters = [each for each in _clusters(joints_m[:, self._core], best_first) if len(each) >= smallest]
        keep = max(_BEST, frame.cameras.n_cameras // 3)
        self._before_m = [_merged_m(joints_m[each], keep) for each in clusters]
        return self._before_m

    def _is_possible(self, frame: Frame, pairs: Int[np.ndarray, "pair 2 2"]) -> Bool[np.ndarray, " pair"]:
        """Not two detections of which only one, or each another, is of somebody in the frame before."""
        if not self._before_m or not len(pairs):
            return np.ones(len(pairs), dtype=bool)
        before_m = np.stack(self._before_m)[:, self._core]
        is_of = np.stack(
            [
                _scores(c, frame.cameras, person_m[None], points_px[:, self._core]) >= _SAME_SCORE
                for c, points_px in enumerate(frame.points_px)
                for person_m in before_m
            ]
        ).reshape(frame.cameras.n_cameras, len(before_m), -1)
        first, second = (is_of[pairs[:, end, 0], :, pairs[:, end, 1]] for end in (0, 1))
        same, newcomer = (first & second).any(axis=1), ~(first | second).any(axis=1)
        return np.asarray(same | newcomer)


def _pair_scores(
    frame: Frame,
    pairs: Int[np.ndarray, "pair 2 2"],
    joints_m: Float[np.ndarray, "pair joint 3"],
    core: Int[np.ndarray, " core"],
) -> Float[np.ndarray, " pair"]:
    """How well the core joints of each pair reproject into its two views: the mean of both; 0 with too few joints."""
    score = np.zeros((len(pairs), 2))
    for end in (0, 1):
        for camera in range(frame.cameras.n_cameras):
            own = np.flatnonzero(pairs[:, end, 0] == camera)
            points_px = frame.points_px[camera, pairs[own, end, 1]][:, core]
            score[own, end] = _scores(camera, frame.cameras, joints_m[own][:, core], points_px)
    enough = np.isfinite(joints_m[:, core]).all(axis=-1).sum(axis=1) >= _MIN_JOINTS
    return np.where(enough, score.mean(axis=1), 0.0)


def _scores(
    camera: int,
    cameras: CameraRig,
    joints_m: Float[np.ndarray, "#pose joint 3"],
    points_px: Float[np.ndarray, "#pose joint 2"],
) -> Float[np.ndarray, " pose"]:
    """How near poses are to detections in the image of a camera: 1 exact, 0 without a common joint."""
    own = cameras.cameras[camera]
    scale_px = float(np.mean(own.size_px))
    error = np.minimum(np.linalg.norm(own.project(joints_m) - points_px, axis=-1) / scale_px, _WORST_SHARE)
    error = error * np.sqrt(np.linalg.norm(joints_m - own.position_m, axis=-1) / _REFERENCE_M)
    known = np.isfinite(error)
    score = np.where(known, 1.0 / (1.0 + _SHARPNESS * np.where(known, error, 0.0)), 0.0)
    return np.asarray(score.sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def _clusters(core_m: Float[np.ndarray, "pair core 3"], best_first: Int[np.ndarray, " good"]) -> list[list[int]]:
    """Pairs of one person: each joins the first cluster whose first pair is near enough."""
    clusters: list[list[int]] = []
    for pair in best_first.tolist():
        for cluster in clusters:
            apart_m = np.nanmean(core_m[cluster[0]], axis=0) - np.nanmean(core_m[pair], axis=0)
            near = np.linalg.norm(apart_m) < _MIDDLES_M
            if near and mean_distance_m(core_m[cluster[0]], core_m[pair]) < _JOINTS_M:
                cluster.append(pair)
                break
        else:
            clusters.append([pair])
    return clusters


def _merged_m(joints_m: Float[np.ndarray, "pair joint 3"], keep: int) -> Float[np.ndarray, "joint 3"]:
    """Joint by joint, the mean of the proposals nearest to their median."""
    known = np.asarray(np.isfinite(joints_m).all(axis=-1))
    seen = np.asarray(known.any(axis=0))
    middle_m = np.full(joints_m.shape[1:], np.nan)
    middle_m[seen] = np.nanmedian(joints_m[:, seen], axis=0)
    distance_m = np.where(known, np.linalg.norm(joints_m - middle_m, axis=-1), np.inf)
    rank = np.argsort(np.argsort(distance_m, axis=0, kind="stable"), axis=0, kind="stable")
    used = (rank < keep) & ((distance_m < _OUTLIER_M) | (rank == 0)) & known
    total_m = np.where(used[..., None], joints_m, 0.0).sum(axis=0)
    return np.where(seen[:, None], total_m / np.maximum(used.sum(axis=0), 1)[:, None], np.nan)
