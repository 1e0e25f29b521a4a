"""Greedy triangulation frame by frame, and the nearest pose of the frame before: the simplest that can work.

The two detections whose rays meet best are somebody; every other camera gives the detection that fits best to where
they meet; what is left is treated likewise. Thresholds are the defaults of Pose2Sim (Config.toml, [personAssociation]
and [triangulation]; Pagnon et al., Pose2Sim: An End-to-End Workflow for 3D Markerless Sports Kinematics, 2021-2024).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.triangulation import triangulate_robust
from fgpose_benchmarks.people.baselines.frame import Frame, NearestInTime
from fgpose_benchmarks.people.recording import PeopleRecording, Poses

# reconstruction_error_threshold 0.1 m times 1 - min_affinity 0.2: mean distance of the rays of two detections.
_RAYS_M = 0.08
# reproj_error_threshold_association and reproj_error_threshold_triangulation.
_FITS_PX, _INLIER_PX = 20.0, 15.0
# Ours: Pose2Sim has no lower limit, but from two or three joints everything meets something.
_MIN_JOINTS = 5
# Poses of successive frames farther apart than 1 m are of two people; after a second anybody may stand there.
_REACH_M, _FORGET_S = 1.0, 1.0


def greedy(recording: PeopleRecording) -> list[Poses]:
    """Everybody in every frame of a recording."""
    identity = NearestInTime(_REACH_M, 0.0, _FORGET_S)
    return [
        identity.identified(time_s, people_m(Frame.of(images, recording.rig))) for time_s, images in recording.images()
    ]


def people_m(frame: Frame) -> list[Float[np.ndarray, "joint 3"]]:
    """The poses in one frame, those whose views agree best first; joints on which no two views agree are NaN."""
    pairs = frame.pairs()
    if not len(pairs):
        return []
    joints_m, rays_m = frame.meetings(pairs)
    n_known = np.isfinite(rays_m).sum(axis=1)
    cost_m = np.where(np.isfinite(rays_m), rays_m, 0.0).sum(axis=1) / np.maximum(n_known, 1)
    possible = np.flatnonzero((n_known >= _MIN_JOINTS) & (cost_m < _RAYS_M))
    free = np.asarray(frame.known.any(axis=-1))
    people = []
    for pair in possible[np.argsort(cost_m[possible], kind="stable")].tolist():
        (a, of_a), (b, of_b) = pairs[pair].tolist()
        if not (free[a, of_a] and free[b, of_b]):
            continue
        chosen = {a: of_a, b: of_b} | _others(frame, free, joints_m[pair], without={a, b})
        pose_m = _pose_m(frame, chosen)
        if np.isfinite(pose_m).all(axis=-1).sum() < _MIN_JOINTS:
            continue
        for camera, detection in chosen.items():
            free[camera, detection] = False
        people.append(pose_m)
    return people


def _others(
    frame: Frame, free: Bool[np.ndarray, "camera detection"], joints_m: Float[np.ndarray, "joint 3"], without: set[int]
) -> dict[int, int]:
    """Of each other camera the free detection that fits best to these joints, if one does."""
    error_px = np.linalg.norm(frame.points_px - frame.cameras.project(joints_m)[:, None], axis=-1)
    n_known = np.isfinite(error_px).sum(axis=-1)
    mean_px = np.where(np.isfinite(error_px), error_px, 0.0).sum(axis=-1) / np.maximum(n_known, 1)
    mean_px = np.where(free & (n_known >= _MIN_JOINTS), mean_px, np.inf)
    return {
        camera: int(np.argmin(own_px))
        for camera, own_px in enumerate(mean_px)
        if camera not in without and own_px.min() < _FITS_PX
    }


def _pose_m(frame: Frame, chosen: dict[int, int]) -> Float[np.ndarray, "joint 3"]:
    camera, detection = list(chosen), list(chosen.values())
    cameras = frame.cameras.subset([frame.cameras.names[c] for c in camera])
    points_px, confidence = frame.points_px[camera, detection], frame.confidence[camera, detection]
    return triangulate_robust(points_px, confidence, cameras, _INLIER_PX).positions_m
