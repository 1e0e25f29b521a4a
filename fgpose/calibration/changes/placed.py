"""A change that was chosen by seconds, as one by the stamps of its camera: to the image, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
from jaxtyping import Float

from fgpose.calibration.changes.candidate import Candidate
from fgpose.calibration.changes.change import Change, Kind
from fgpose.calibration.changes.clock_changes import ClockFit, constant_lag, score
from fgpose.calibration.changes.comparison import Comparison
from fgpose.calibration.changes.credible import JUMP_FRAMES, NOTICEABLE_FRAMES, WHOLE_FRAMES
from fgpose.calibration.changes.lag_costs import PER_STEP, Blocks
from fgpose.calibration.changes.poses.pose_changes import PoseFit, pose_fit
from fgpose.calibration.changes.turning_point import turning_point_s

_ROUNDS = 5
_SETTLED, _SETTLED_M = np.deg2rad(0.1), 0.005


def placed(candidate: Candidate, compared: Comparison) -> list[Change]:
    """As changes by the stamps of the camera."""
    rays, blocks = compared.rays, compared.blocks
    fit, change = candidate.fit, replace(candidate.change, reliability=score(candidate.fit.gain))
    if isinstance(fit, ClockFit):
        lag_step_s = rays.step_s / PER_STEP
        lag_s = fit.lag * lag_step_s
        adds_up, free = (float(np.ptp(lag) if fit.kind is Kind.RATE else lag[0]) for lag in (fit.lag, fit.free_lag))
        change = replace(change, sigma=fit.change_sigma(adds_up, free) * lag_step_s)
        if fit.kind is Kind.OFFSET:
            return [_offset(replace(change, offset_s=float(lag_s[0])), compared)]
        if fit.kind is Kind.RATE:
            return [_rate(change, lag_s, blocks)]
        return _jump(change, fit, lag_s, compared)
    moved = _move(change, fit, compared)
    if fit.kind is Kind.MOVED:
        return [moved]
    held = np.flatnonzero(fit.held)
    before, after = list(compared.changes), [*compared.changes, moved]
    if not fit.held[0]:
        moved = replace(moved, at_s=_turning_point_s(before, after, change.camera, int(held[0]), compared))
        moved = replace(moved, between_s=_between_s(fit.edges, moved.at_s, blocks))
    if not fit.held[-1]:
        moved = replace(moved, until_s=_turning_point_s(after, before, change.camera, int(held[-1]) + 1, compared))
    if fit.held[0]:
        moved = replace(moved, between_s=_between_s(fit.edges, moved.until_s, blocks))
    return [moved]


def _turning_point_s(
    before: Sequence[Change], after: Sequence[Change], c: int, first: int, compared: Comparison
) -> float:
    """When these changes take the place of those, within two blocks of one."""
    blocks = compared.blocks
    near_s = float(blocks.time_s[min(first, blocks.n_blocks - 1)]) - blocks.length_s / 2
    people, rig, step_s = compared.people, compared.rig, compared.rays.step_s
    return turning_point_s(people, rig, before, after, c, step_s, near_s, 2 * blocks.length_s)


def _between_s(edges: tuple[int, int], at_s: float, blocks: Blocks) -> tuple[float, float]:
    """A block to either side: where in a block it changes is not told by blocks."""
    begin_s, end_s = (float(blocks.time_s[min(edge, blocks.n_blocks - 1)]) for edge in edges)
    return min(begin_s - 1.5 * blocks.length_s, at_s), max(end_s + 0.5 * blocks.length_s, at_s)


def _move(change: Change, fit: PoseFit, compared: Comparison) -> Change:
    """Until nothing is left of it: a large one makes the angles so wide that some of them look like usual ones."""
    c = change.camera
    given = compared.rig.cameras[c].world_T_camera
    for each in compared.changes:
        if each.camera == c and each.kind is Kind.MOVED:
            given = each.moved_pose(given)
    pose = np.array(given)
    for _ in range(_ROUNDS):
        pose[:3, 3] += fit.translation_m
        pose[:3, :3] = gtsam.Rot3.Expmap(fit.rotation).matrix() @ pose[:3, :3]
        relative = np.linalg.inv(given) @ pose
        change = replace(
            change,
            rotation=gtsam.Rot3.Logmap(gtsam.Rot3(relative[:3, :3])),
            translation_m=relative[:3, 3],
            sigma=fit.sigma_rotation,
            translation_sigma_m=fit.sigma_translation_m,
        )
        if np.linalg.norm(fit.rotation) < _SETTLED and np.linalg.norm(fit.translation_m) < _SETTLED_M:
            break
        moved = compared.beside(change)
        fit = pose_fit(moved.rays, moved.costs(c), c, fit.kind, fit.held)
    return change


def _offset(change: Change, compared: Comparison) -> Change:
    """Until nothing is left of it: at a long lag less is seen by both, and at each something else."""
    for _ in range(_ROUNDS):
        costs = compared.beside(change).costs(change.camera)
        left, sigma = (costs.step_s * each for each in constant_lag(costs, change.camera))
        change = replace(change, offset_s=change.offset_s + left, sigma=sigma)
        if abs(left) < costs.step_s:
            break
    return change


def _rate(change: Change, lag_s: Float[np.ndarray, " block"], blocks: Blocks) -> Change:
    """A lag that grows by s per second of common time t is s / (1 - s) per second of stamps t - lag."""
    duration_s = float(blocks.time_s[-1] - blocks.time_s[0])
    slope = float(lag_s[-1] - lag_s[0]) / duration_s
    rate = slope / (1 - slope)
    return replace(change, rate=rate, offset_s=(float(lag_s[0]) - slope * float(blocks.time_s[0])) / (1 - slope))


def _jump(change: Change, fit: ClockFit, lag_s: Float[np.ndarray, " block"], compared: Comparison) -> list[Change]:
    blocks, step_s, lag_step_s = compared.blocks, compared.step_s, compared.rays.step_s / PER_STEP
    found: list[Change] = []
    if abs(lag_s[0]) > NOTICEABLE_FRAMES * step_s:
        offset_s = float(lag_s[0])
        found.append(
            Change(Kind.OFFSET, change.camera, offset_s=offset_s, sigma=change.sigma, reliability=change.reliability)
        )
    for first, edges in zip(fit.firsts, fit.edges, strict=True):
        by_s = float(lag_s[first] - lag_s[first - 1])
        free = float(fit.free_lag[first] - fit.free_lag[first - 1])
        frames = by_s / step_s
        if abs(frames - round(frames)) < WHOLE_FRAMES:
            by_s = round(frames) * step_s
        if abs(by_s) < JUMP_FRAMES * step_s:
            continue
        jump = replace(change, offset_s=by_s, sigma=fit.change_sigma(by_s / lag_step_s, free) * lag_step_s)
        before = [*compared.changes, *found]
        at_s = _turning_point_s(before, [*before, jump], change.camera, first, compared)
        found.append(replace(jump, at_s=at_s, between_s=_between_s(edges, at_s, blocks)))
    return found
