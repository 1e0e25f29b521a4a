"""One segment of a recording as one GTSAM factor graph: build, linearise, read back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float, Int

from fgpose.estimation import frame_factors
from fgpose.estimation.frame_factors import FrameTime
from fgpose.estimation.keys import length_key, position_key, velocity_key
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_problem import GraphProblem
from fgpose_factors import bone_length_and_direction


@dataclass(frozen=True)
class BoneLengths:
    """Many shared-length factors, linearised at once.

    The same factor as shared_bone_length_factor, for a batch solver that linearises from Python: one numpy expression
    instead of one callback per bone and frame.
    """

    start_keys: Sequence[int]
    end_keys: Sequence[int]
    length_keys: Sequence[int]
    sigma_m: float
    """Standard deviation of each residual, metres."""

    def residuals_m(self, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray) -> np.ndarray:
        """(N,) residuals of all factors."""
        return np.linalg.norm(ends_m - starts_m, axis=1) - lengths_m

    def error(self, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray) -> float:
        """Half the sum of the squared whitened residuals, as NonlinearFactorGraph.error counts it."""
        return 0.5 * float(np.sum((self.residuals_m(starts_m, ends_m, lengths_m) / self.sigma_m) ** 2))

    def linearize_into(
        self, linear: gtsam.GaussianFactorGraph, starts_m: np.ndarray, ends_m: np.ndarray, lengths_m: np.ndarray
    ) -> None:
        """Append every factor, linearised at these (N, 3), (N, 3) and (N,) values."""
        distances_m, directions = bone_length_and_direction(starts_m, ends_m)
        right_hand_sides = (lengths_m - distances_m)[:, None]
        minus_one = -np.ones((1, 1))
        noise = gtsam.noiseModel.Isotropic.Sigma(1, self.sigma_m)
        rows = zip(
            self.start_keys,
            -directions[:, None],
            self.end_keys,
            directions[:, None],
            self.length_keys,
            right_hand_sides,
            strict=True,
        )
        for start, to_start, end, to_end, length, right_hand_side in rows:
            linear.add(gtsam.JacobianFactor(start, to_start, end, to_end, length, minus_one, right_hand_side, noise))


class GtsamBatch(GraphProblem):
    """The optimisation problem of a segment of frames."""

    def __init__(self, segment: Segment) -> None:
        super().__init__(gtsam.NonlinearFactorGraph(), segment.config.solver.step_tolerance_m)
        self._stretch = segment
        self._rows = np.full(segment.active.shape, -1)
        self._rows[segment.active] = np.arange(segment.active.sum())
        for factor in self._factors():
            self.graph.add(factor)
        self.bones: BoneLengths | None = None
        self._bone_rows: Int[np.ndarray, "bone 3"] = np.zeros((0, 3), dtype=int)
        self._lengths_m = np.full(segment.skeleton.n_lengths, np.nan)
        self._add_bones()

    def _factors(self) -> Iterator[gtsam.NonlinearFactor]:
        segment = self._stretch
        rig, skeleton, data, config = segment.rig, segment.skeleton, segment.evidence, segment.config
        kept = segment.kept
        before = FrameTime(-1, float(data.time_s[0]))
        for frame, time_s in enumerate(data.time_s.tolist()):
            active = segment.active[frame]
            after = FrameTime(frame, time_s)
            yield from frame_factors.projection_factors(
                rig, frame, data.undistorted_px[frame], data.weights[frame], active, config.projection
            )
            anchored = active & data.anchored[frame]
            yield from frame_factors.anchor_factors(frame, anchored, data.guess_m[frame], config.fusion)
            yield from frame_factors.depth_factors(
                frame,
                time_s - before.time_s if frame else np.inf,
                active,
                data.views_m[frame],
                data.rays[frame],
                data.depth_sigma_m[frame],
                config.depth,
            )
            if config.symmetry.form == "frame":
                yield from frame_factors.symmetry_factors(skeleton, frame, active, config.symmetry)
            joints, density = np.flatnonzero(kept[frame]).tolist(), segment.process_density[frame]
            yield from frame_factors.motion_factors(before, after, joints, density, config.motion)
            if frame:
                step_s = time_s - before.time_s
                yield from frame_factors.fading_factors(
                    skeleton, frame, step_s, active, data.seen[frame], density, config.motion
                )
            entering = np.flatnonzero(active & ~kept[frame]).tolist()
            yield from frame_factors.prior_factors(
                frame, entering, data.guess_m[frame], config.prior, with_velocity=segment.with_velocity
            )
            before = after

    def _add_bones(self) -> None:
        segment = self._stretch
        bones = [
            (frame, start, end, length)
            for start, end, length in segment.bones_with_length()
            for frame in np.flatnonzero(segment.present(start, end)).tolist()
        ]
        if not bones:
            return
        frame, start, end, length = np.array(bones).T
        self._bone_rows = np.stack([self._rows[frame, start], self._rows[frame, end], length], axis=1)
        self._lengths_m[np.unique(length)] = segment.lengths_m[np.unique(length)]
        self.bones = BoneLengths(
            [position_key(s, f) for f, s in zip(frame.tolist(), start.tolist(), strict=True)],
            [position_key(e, f) for f, e in zip(frame.tolist(), end.tolist(), strict=True)],
            [length_key(number) for number in length.tolist()],
            segment.config.symmetry.sigma_m,
        )
        for factor in frame_factors.length_prior_factors(self._lengths_m, segment.length_sigma_m):
            self.graph.add(factor)

    def initial(self) -> gtsam.Values:
        """The first guess as Values; velocities start at zero, the solution does not depend on them."""
        values, segment = gtsam.Values(), self._stretch
        zero = np.zeros(3)
        for frame, joint in np.argwhere(segment.active).tolist():
            values.insert(position_key(joint, frame), segment.evidence.guess_m[frame, joint])
            if segment.with_velocity:
                values.insert(velocity_key(joint, frame), zero)
        for length in np.flatnonzero(np.isfinite(self._lengths_m)).tolist():
            values.insert(length_key(length), float(self._lengths_m[length]))
        return values

    def _active_positions(self, values: gtsam.Values) -> Float[np.ndarray, "variable 3"]:
        # Keys sort by symbol: velocities come before positions.
        points = gtsam.utilities.extractPoint3(values)
        return points[len(points) - int(self._stretch.active.sum()) :]

    def _bone_arguments(self, values: gtsam.Values) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        points = self._active_positions(values)
        start, end, length = self._bone_rows.T
        return points[start], points[end], self.lengths_m(values)[length]

    def error(self, state: gtsam.Values) -> float:
        error = super().error(state)
        return error if self.bones is None else error + self.bones.error(*self._bone_arguments(state))

    def gaussian(self, state: gtsam.Values) -> gtsam.GaussianFactorGraph:
        linear = super().gaussian(state)
        if self.bones is not None:
            self.bones.linearize_into(linear, *self._bone_arguments(state))
        return linear

    def moves_m(self, step: gtsam.VectorValues) -> Float[np.ndarray, "variable 3"]:
        vector = step.vector()
        return vector[len(vector) - 3 * int(self._stretch.active.sum()) :].reshape(-1, 3)

    def positions_m(self, state: gtsam.Values) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        positions_m = np.full((*self._stretch.active.shape, 3), np.nan)
        positions_m[self._stretch.active] = self._active_positions(state)
        return positions_m

    def lengths_m(self, state: gtsam.Values) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none is in the graph."""
        lengths_m = np.full(self._lengths_m.shape, np.nan)
        for length in np.flatnonzero(np.isfinite(self._lengths_m)).tolist():
            lengths_m[length] = state.atDouble(length_key(length))
        return lengths_m
