"""One stretch of a recording as one GTSAM factor graph: build, linearise, read back."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
from jaxtyping import Float, Int

from fgpose import graph
from fgpose.graph import FrameTime
from fgpose.graph_problem import GraphProblem
from fgpose.keys import length_key, position_key, velocity_key
from fgpose.stretch import Stretch
from fgpose_factors import BoneLengths


class Window(GraphProblem):
    """The optimisation problem of a stretch of frames."""

    def __init__(self, stretch: Stretch) -> None:
        super().__init__(gtsam.NonlinearFactorGraph(), stretch.config.solver.step_tolerance_m)
        self._stretch = stretch
        self._rows = np.full(stretch.active.shape, -1)
        self._rows[stretch.active] = np.arange(stretch.active.sum())
        for factor in self._factors():
            self.graph.add(factor)
        self.bones: BoneLengths | None = None
        self._bone_rows: Int[np.ndarray, "bone 3"] = np.zeros((0, 3), dtype=int)
        self._lengths_m = np.full(stretch.skeleton.n_lengths, np.nan)
        self._add_bones()

    def _factors(self) -> Iterator[gtsam.NonlinearFactor]:
        stretch = self._stretch
        rig, skeleton, data, config = stretch.rig, stretch.skeleton, stretch.evidence, stretch.config
        kept = stretch.kept
        before = FrameTime(-1, float(data.time_s[0]))
        for frame, time_s in enumerate(data.time_s.tolist()):
            active = stretch.active[frame]
            after = FrameTime(frame, time_s)
            yield from graph.projection_factors(
                rig, frame, data.undistorted_px[frame], data.weights[frame], active, config.projection
            )
            anchored = active & data.anchored[frame]
            yield from graph.anchor_factors(frame, anchored, data.guess_m[frame], config.fusion)
            yield from graph.depth_factors(
                frame,
                time_s - before.time_s if frame else np.inf,
                active,
                data.views_m[frame],
                data.rays[frame],
                data.depth_sigma_m[frame],
                config.depth,
            )
            if config.symmetry.form == "frame":
                yield from graph.symmetry_factors(skeleton, frame, active, config.symmetry)
            joints, density = np.flatnonzero(kept[frame]).tolist(), stretch.process_density[frame]
            yield from graph.motion_factors(before, after, joints, density, config.motion)
            if frame:
                step_s = time_s - before.time_s
                yield from graph.fading_factors(
                    skeleton, frame, step_s, active, data.seen[frame], density, config.motion
                )
            entering = np.flatnonzero(active & ~kept[frame]).tolist()
            yield from graph.prior_factors(
                frame, entering, data.guess_m[frame], config.prior, with_velocity=stretch.with_velocity
            )
            before = after

    def _add_bones(self) -> None:
        stretch = self._stretch
        bones = [
            (frame, start, end, length)
            for start, end, length in stretch.bones_with_length()
            for frame in np.flatnonzero(stretch.present(start, end)).tolist()
        ]
        if not bones:
            return
        frame, start, end, length = np.array(bones).T
        self._bone_rows = np.stack([self._rows[frame, start], self._rows[frame, end], length], axis=1)
        self._lengths_m[np.unique(length)] = stretch.lengths_m[np.unique(length)]
        self.bones = BoneLengths(
            [position_key(s, f) for f, s in zip(frame.tolist(), start.tolist(), strict=True)],
            [position_key(e, f) for f, e in zip(frame.tolist(), end.tolist(), strict=True)],
            [length_key(number) for number in length.tolist()],
            stretch.config.symmetry.sigma_m,
        )
        for factor in graph.length_prior_factors(self._lengths_m, stretch.length_sigma_m):
            self.graph.add(factor)

    def initial(self) -> gtsam.Values:
        """The first guess as Values; velocities start at zero, the solution does not depend on them."""
        values, stretch = gtsam.Values(), self._stretch
        zero = np.zeros(3)
        for frame, joint in np.argwhere(stretch.active).tolist():
            values.insert(position_key(joint, frame), stretch.evidence.guess_m[frame, joint])
            if stretch.with_velocity:
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
