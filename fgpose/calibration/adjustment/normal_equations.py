"""The normal equations of the adjustment, from its steps to its covariance."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.estimation.solvers.elimination import ReducedSystem


class Factorized:
    """Gauss-Newton's equations of shared unknowns and biases, the joints eliminated, and factorised.

    Args:
        reduced: of all rows of the cameras, and of the biases.
        columns: Unknowns.columns.
        of_shared: what priors and damping add for the shared unknowns.
        of_biases: the same for each bias.

    Raises:
        LinAlgError: they are not positive definite.
    """

    def __init__(
        self,
        reduced: ReducedSystem,
        columns: Float[np.ndarray, "row shared"],
        of_shared: Float[np.ndarray, "shared shared"],
        of_biases: float,
    ) -> None:
        from scipy.linalg import LinAlgError, block_diag, cho_factor

        n_biases = len(reduced.gradient) - len(columns)
        self._reduced, self._n_shared = reduced, columns.shape[1]
        self._columns = block_diag(columns, np.eye(n_biases))
        system = self._columns.T @ reduced.information @ self._columns
        system += block_diag(of_shared, of_biases * np.eye(n_biases))
        self._factor = cho_factor(system, lower=True, overwrite_a=True, check_finite=False)
        if not np.isfinite(self._factor[0]).all():
            raise LinAlgError("the normal equations are not finite")

    def solve(self, right_hand_side: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " unknown"]:
        """Of everything: shared unknowns, biases, joints, one after the other."""
        from scipy.linalg import cho_solve

        outer, of_joints = np.split(right_hand_side, [len(self._factor[0])])
        of_joints = of_joints.reshape(*self._reduced.by_step.shape[:2], 3)
        outer = outer - self._columns.T @ self._reduced.eliminated(of_joints)
        outer = cho_solve(self._factor, outer, check_finite=False)
        return np.append(outer, self._reduced.joint_steps_m(self._columns @ outer, of_joints))

    def covariance(
        self, of_scores: Float[np.ndarray, "shared shared"] | None = None
    ) -> Float[np.ndarray, "shared shared"]:
        """Marginal, of the shared unknowns: biases and joints are unknown too.

        Args:
            of_scores: covariance of the gradient by the shared unknowns at the truth, the joints eliminated; of a
                problem without biases. None: that which the weights and the priors stand for.
        """
        from scipy.linalg import cho_solve

        unit = np.eye(len(self._factor[0]), self._n_shared)
        inverse = np.asarray(cho_solve(self._factor, unit, check_finite=False))[: self._n_shared]
        return inverse if of_scores is None else inverse @ of_scores @ inverse

    @property
    def joints_by_shared(self) -> Float[np.ndarray, "frame joint shared 3"]:
        """How far the joints that suit the detections best move with the shared unknowns, but for the sign."""
        by_rows = self._reduced.by_step[:, :, : self._reduced.n_of_cameras]
        columns = self._columns[: self._reduced.n_of_cameras, : self._n_shared]
        return np.einsum("tjra,ru->tjua", by_rows, columns)

    def covariance_with_middle(self, seen: Bool[np.ndarray, "frame joint"]) -> Float[np.ndarray, "row row"]:
        """Of the shared unknowns and the mean of the positions of these joints, by what is not known of cameras and
        biases."""
        from scipy.linalg import cho_solve

        n_rows, count = self._reduced.n_of_cameras, max(int(seen.sum()), 1)
        of_joint = -np.sum(self._reduced.by_step * seen[..., None, None], axis=0) / count
        of_rows = np.concatenate([of_joint[:, :n_rows].sum(axis=0), of_joint[:, n_rows:].reshape(-1, 3)])
        both = np.hstack([np.eye(len(self._factor[0]), self._n_shared), self._columns.T @ of_rows])
        return both.T @ np.asarray(cho_solve(self._factor, both, check_finite=False))
