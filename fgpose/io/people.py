"""Which of several people in each image is the person: the one that the views and the frames agree on.

The candidates of a frame are gathered into groups, at most one candidate per camera: each candidate in turn is the
seed, the other cameras add whoever agrees with it best along the epipolar lines, and then with the whole group. The
path through the groups of all frames with the most agreement between views, confidence and continuity in the images is
found by dynamic programming, so a frame in which a by-stander fits better does not change the person.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from fgpose.geometry.camera import Camera, CameraRig

NOBODY = -1

# Detections of the same joint lie within about 1 % of the image diagonal of each other's epipolar line.
_EPIPOLAR_SCALE = 0.01
# Share of the largest possible agreement with which a candidate joins a group. Measured on real and simulated scenes:
# 0.45 to 0.95 for the same person, below 0.3 for another.
_MIN_AGREEMENT = 0.35
# A person moves between frames by less than half its own size in the image; from there continuity counts nothing.
_MAX_STEP = 0.5


def choose_person(
    points2d_px: Float[np.ndarray, "frame camera person joint 2"],
    confidence: Float[np.ndarray, "frame camera person joint"],
    rig: CameraRig,
) -> Int[np.ndarray, "frame camera"]:
    """Index of the person in each image, or NOBODY where no candidate agrees with the other views.

    Args:
        points2d_px: all candidates of every image in pixels of the original image; NaN = missing.
        confidence: in [0, 1], 0 = missing.
        rig: the cameras, in the order of the camera axis.

    Returns:
        Indices into the person axis.
    """
    confidence = np.where(np.isfinite(points2d_px).all(axis=-1), confidence, 0.0)
    undistorted_px = np.stack([_undistorted(camera, points2d_px[:, c]) for c, camera in enumerate(rig.cameras)], axis=1)
    agreement, shared = _agreement(undistorted_px, confidence, rig)
    completeness = confidence.mean(axis=-1)
    groups = [_groups(agreement[t], shared[t], completeness[t] > 0) for t in range(len(confidence))]
    # Each of the three terms counts once per camera: pairs are C - 1 times as many.
    scores = [_group_scores(group, agreement[t], completeness[t]) for t, group in enumerate(groups)]
    return _best_path(groups, scores, undistorted_px)


def _undistorted(camera: Camera, points2d_px: np.ndarray) -> np.ndarray:
    return camera.undistort(points2d_px.reshape(-1, 2)).reshape(points2d_px.shape)


def _agreement(undistorted_px: np.ndarray, confidence: np.ndarray, rig: CameraRig) -> tuple[np.ndarray, np.ndarray]:
    """How well two candidates of two cameras fit on each other's epipolar lines, and the most that it could be.

    Both are (frame, camera, person, camera, person), between 0 and 1.
    """
    n_frames, n_cameras, n_people, _ = confidence.shape
    agreement = np.zeros((n_frames, n_cameras, n_people, n_cameras, n_people))
    shared = np.zeros_like(agreement)
    for a, b in combinations(range(n_cameras), 2):
        scale_px = _EPIPOLAR_SCALE * np.hypot(*np.add(rig.cameras[a].size_px, rig.cameras[b].size_px)) / 2
        distance_px = _epipolar_distance_px(undistorted_px[:, a], undistorted_px[:, b], rig.cameras[a], rig.cameras[b])
        weight = np.sqrt(confidence[:, a, :, None] * confidence[:, b, None])
        fit = np.where(weight > 0, weight / (1 + (distance_px / scale_px) ** 2), 0.0)
        agreement[:, a, :, b] = fit.mean(axis=-1)
        shared[:, a, :, b] = weight.mean(axis=-1)
        agreement[:, b, :, a] = agreement[:, a, :, b].swapaxes(1, 2)
        shared[:, b, :, a] = shared[:, a, :, b].swapaxes(1, 2)
    return agreement, shared


def _epipolar_distance_px(
    a_px: Float[np.ndarray, "frame p joint 2"], b_px: Float[np.ndarray, "frame q joint 2"], a: Camera, b: Camera
) -> Float[np.ndarray, "frame p q joint"]:
    """Larger of the two distances of a joint to the epipolar line of the other view; NaN where one is missing."""
    F = _fundamental_matrix(a, b)
    a_h, b_h = (np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) for points in (a_px, b_px))
    lines_b, lines_a = a_h @ F.T, b_h @ F
    residual = np.abs(np.einsum("tpji,tqji->tpqj", lines_b, b_h))
    norms_b, norms_a = (np.linalg.norm(lines[..., :2], axis=-1) for lines in (lines_b, lines_a))
    # Cameras at one place have no epipolar lines: everything fits.
    return residual / np.maximum(np.minimum(norms_b[:, :, None], norms_a[:, None]), 1e-12)


def _fundamental_matrix(a: Camera, b: Camera) -> Float[np.ndarray, "3 3"]:
    """F with x_b^T F x_a = 0 for undistorted homogeneous pixels (Hartley and Zisserman, eq. 9.2)."""
    b_T_a = b.camera_T_world @ a.world_T_camera
    x, y, z = b_T_a[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.linalg.inv(b.K).T @ cross @ b_T_a[:3, :3] @ np.linalg.inv(a.K)


def _groups(agreement: np.ndarray, shared: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Groups of candidates of one frame, (group, camera) indices; at least one, if only of NOBODY."""
    n_cameras = len(present)
    found = set()
    for seed_camera, seed in np.argwhere(present):
        group = np.full(n_cameras, NOBODY)
        group[seed_camera] = seed
        for reference in (group.copy(), None):
            members = group.copy() if reference is None else reference
            for camera in range(n_cameras):
                if camera != seed_camera:
                    group[camera] = _best_member(camera, members, agreement, shared)
        found.add(tuple(group.tolist()))
    return np.array(sorted(found), dtype=int) if found else np.full((1, n_cameras), NOBODY)


def _best_member(camera: int, members: np.ndarray, agreement: np.ndarray, shared: np.ndarray) -> int:
    """The candidate of a camera that agrees best with the members in the other cameras."""
    others = [other for other in range(len(members)) if other != camera and members[other] != NOBODY]
    total = agreement[camera][:, others, members[others]].sum(axis=1)
    possible = shared[camera][:, others, members[others]].sum(axis=1)
    best = int(np.argmax(total))
    return best if total[best] > _MIN_AGREEMENT * possible[best] else NOBODY


def _group_scores(groups: np.ndarray, agreement: np.ndarray, completeness: np.ndarray) -> np.ndarray:
    """Agreement between the views of each group plus the confidence of its members, about 0 to 2 per camera."""
    n_cameras = groups.shape[1]
    scores = np.zeros(len(groups))
    for g, group in enumerate(groups):
        members = np.flatnonzero(group != NOBODY)
        scores[g] = completeness[members, group[members]].sum()
        for a, b in combinations(members, 2):
            scores[g] += 2 / (n_cameras - 1) * agreement[a, group[a], b, group[b]]
    return scores


def _best_path(groups: list[np.ndarray], scores: list[np.ndarray], undistorted_px: np.ndarray) -> np.ndarray:
    """The sequence of groups with the largest sum of scores and continuity (Viterbi)."""
    total, came_from = scores[0], []
    for t in range(1, len(groups)):
        through = total[:, None] + _continuity(groups[t - 1], groups[t], undistorted_px[t - 1], undistorted_px[t])
        came_from.append(through.argmax(axis=0))
        total = through.max(axis=0) + scores[t]
    path = [int(np.argmax(total))]
    for previous in reversed(came_from):
        path.append(int(previous[path[-1]]))
    return np.stack([group[g] for group, g in zip(groups, reversed(path), strict=True)])


def _continuity(before: np.ndarray, after: np.ndarray, before_px: np.ndarray, after_px: np.ndarray) -> np.ndarray:
    """For each pair of groups, the sum over the cameras of 1 (has not moved) to 0 (elsewhere, or missing)."""
    total = np.zeros((len(before), len(after)))
    for camera in range(before.shape[1]):
        stay = _nearness(before_px[camera], after_px[camera])
        known = (before[:, camera] != NOBODY)[:, None] & (after[:, camera] != NOBODY)
        total += np.where(known, stay[before[:, camera][:, None], after[:, camera]], 0.0)
    return total


def _nearness(
    before_px: Float[np.ndarray, "p joint 2"], after_px: Float[np.ndarray, "q joint 2"]
) -> Float[np.ndarray, "p q"]:
    """1 for candidates of two successive images at the same place, 0 from _MAX_STEP of their size on."""
    distance_px = np.linalg.norm(before_px[:, None] - after_px, axis=-1)
    common = np.isfinite(distance_px)
    mean_px = np.where(common, distance_px, 0.0).sum(axis=-1) / np.maximum(common.sum(axis=-1), 1)
    size_px = np.array([_size_px(points_px) for points_px in after_px])
    return np.where(common.any(axis=-1), np.clip(1 - mean_px / (_MAX_STEP * size_px), 0, 1), 0.0)


def _size_px(points_px: np.ndarray) -> float:
    """Diagonal of the box around a person's joints."""
    known = points_px[np.isfinite(points_px).all(axis=-1)]
    return max(float(np.linalg.norm(np.ptp(known, axis=0))), 1.0) if len(known) else 1.0
