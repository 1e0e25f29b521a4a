"""Errors that joints share because bones join them.

A bone keeps its length, so the errors of both its ends along it are the same; across it they are independent. The
shoulders hang on the thorax from both sides: where one is too far to the right, the other is so too, and the middle of
both, on which the lateral bending of the trunk depends, has twice the variance that independent errors would leave it.

A trajectory states the covariance of each joint, S_j S_j with a symmetric root S_j. With errors S_j w_j, a bone of
unit direction u measures u . (S_k w_k - S_j w_j) = 0. How well it does, the trajectory shows: as far as its bones
differ from their constant lengths, and these are uncertain. So the w are those of independent joints, conditioned on
the bones. Each joint is to have its stated covariance afterwards: that which it has without bones is larger, and is
found by scaling (iterative proportional fitting).

The same network also errs alike in both hips, say. As far as the views of a recording show that, it was tried in place
of independent joints, and did not make angles of recordings with errors of real networks more honest.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fgpose.kinematics.errors.propagation import symmetric_root
from fgpose.skeleton import Skeleton
from fgpose.trajectory import Trajectory

_ROUNDS = 4  # of the scaling
_LEAST_M = 1e-6  # no bone is better known, and rounding is less


@dataclass(frozen=True, eq=False)
class SharedErrors:
    """Of the joints of a trajectory from which something is computed, and of those that join them."""

    joints: Int[np.ndarray, " joint"]
    ends: Int[np.ndarray, "end bone"]
    """Of the bones whose lengths were estimated, as indices of joints."""
    sigma_m: Float[np.ndarray, " bone"]
    """How far the length of each may be from the true one in a frame: root mean square."""

    @staticmethod
    def of(trajectory: Trajectory, joints: Collection[int]) -> SharedErrors:
        """As all frames tell."""
        bones, sigma_m = _rigid(trajectory, joints)
        ends = trajectory.skeleton.bone_ends[:, bones]
        own = np.union1d(list(joints), ends).astype(int)
        return SharedErrors(own, np.searchsorted(own, ends), sigma_m)

    def correlation(
        self,
        positions_m: Float[np.ndarray, "frame all_joints 3"],
        covariance_m2: Float[np.ndarray, "frame all_joints 3 3"],
    ) -> Float[np.ndarray, "frame error error"]:
        """Of the errors in some frames: three of each of self.joints, in units of the root of its covariance."""
        measured = self._measured(positions_m[:, self.joints], covariance_m2[:, self.joints])
        by_joint, own = (len(measured), *2 * (len(self.joints), 3)), np.arange(len(self.joints))
        found = alone = np.tile(np.eye(3 * len(self.joints)), (len(measured), 1, 1))
        for _ in range(_ROUNDS if len(self.sigma_m) else 0):
            seen = measured @ alone
            total_m2 = seen @ measured.swapaxes(-1, -2) + np.diag(self.sigma_m**2)
            found = alone - seen.swapaxes(-1, -2) @ np.linalg.solve(total_m2, seen)
            _, to_unit = symmetric_root(found.reshape(by_joint)[:, own, :, own].swapaxes(0, 1))
            scaled = "tjab,tjbkc,tkcd->tjakd", to_unit
            found, alone = (
                np.einsum(*scaled, each.reshape(by_joint), to_unit, optimize=True).reshape(each.shape)
                for each in (found, alone)
            )
        return found

    def _measured(
        self, positions_m: Float[np.ndarray, "frame joint 3"], covariance_m2: Float[np.ndarray, "frame joint 3 3"]
    ) -> Float[np.ndarray, "frame bone error"]:
        """What each bone measures, by the errors of each joint; 0 where a bone is not known."""
        known = np.asarray(np.isfinite(covariance_m2).all(axis=(-1, -2)))
        root_m, _ = symmetric_root(np.where(known[..., None, None], covariance_m2, 0.0))
        starts, ends = self.ends
        bones_m = positions_m[:, ends] - positions_m[:, starts]
        length_m = np.linalg.norm(bones_m, axis=-1, keepdims=True)
        whole = known[:, starts] & known[:, ends] & (length_m[..., 0] > 0)
        along = np.divide(bones_m, length_m, out=np.zeros_like(bones_m), where=whole[..., None])
        measured, number = np.zeros((*along.shape[:2], len(self.joints), 3)), np.arange(len(starts))
        measured[:, number, ends] = np.einsum("tbac,tbc->tba", root_m[:, ends], along)
        measured[:, number, starts] = -np.einsum("tbac,tbc->tba", root_m[:, starts], along)
        return measured.reshape(*along.shape[:2], 3 * len(self.joints))


def _rigid(
    trajectory: Trajectory, joints: Collection[int]
) -> tuple[Int[np.ndarray, " bone"], Float[np.ndarray, " bone"]]:
    """The bones between joints whose lengths the trajectory has estimated, and how well it keeps them."""
    skeleton, lengths_m, length_sigma_m = trajectory.skeleton, trajectory.bone_lengths_m, trajectory.bone_length_sigma_m
    if lengths_m is None or length_sigma_m is None:
        return np.zeros(0, dtype=int), np.zeros(0)
    bones = _between(skeleton, joints)
    length = np.array(skeleton.length_of_bone, dtype=int)[bones]
    difference_m = skeleton.bone_lengths(trajectory.positions_m)[:, bones] - lengths_m[length]
    known = np.isfinite(difference_m)
    squared_m2 = np.sum(difference_m**2, axis=0, where=known) / np.maximum(known.sum(axis=0), 1)
    sigma_m = np.maximum(np.sqrt(squared_m2 + length_sigma_m[length] ** 2), _LEAST_M)
    told = known.any(axis=0) & np.isfinite(sigma_m)
    return bones[told], sigma_m[told]


def _between(skeleton: Skeleton, joints: Collection[int]) -> Int[np.ndarray, " bone"]:
    """The bones through which these joints hang together: without fingers, if they are not among them."""
    ends = skeleton.bone_ends.T
    kept = np.ones(len(ends), dtype=bool)
    while True:
        n_bones = np.bincount(ends[kept].ravel(), minlength=skeleton.n_joints)
        n_bones[list(joints)] = 2
        fewer = kept & (n_bones[ends] > 1).all(axis=1)
        if (fewer == kept).all():
            return np.flatnonzero(kept)
        kept = fewer
