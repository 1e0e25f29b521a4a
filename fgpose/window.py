"""One stretch of a recording as one GTSAM factor graph: build, linearise, read back."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose import graph
from fgpose.camera import CameraRig
from fgpose.config import Config
from fgpose.evidence import Evidence, ray_directions
from fgpose.graph import FrameTime
from fgpose.graph_problem import GraphProblem
from fgpose.keys import length_key, position_key, velocity_key
from fgpose.skeleton import Skeleton
from fgpose.tracks import kept_joints
from fgpose_factors import BoneLengths


class Window(GraphProblem):
    """The optimisation problem of a stretch of frames.

    Args:
        evidence: of these frames; its first guess must be finite wherever a joint is active.
        active: which joints take part in which frame.
        lengths_m: first guess of every shared bone length; NaN where a bone has none.
        length_sigma_m: how well it is known.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        evidence: Evidence,
        active: Bool[np.ndarray, "frame joint"],
        lengths_m: Float[np.ndarray, " length"],
        length_sigma_m: float,
    ) -> None:
        super().__init__(gtsam.NonlinearFactorGraph(), config.solver.step_tolerance_m)
        self.evidence, self.active, self.config = evidence, active, config
        self.with_velocity = config.motion.model == "constant_velocity"
        self._rows = np.full(active.shape, -1)
        self._rows[active] = np.arange(active.sum())
        for factor in self._factors(rig, skeleton):
            self.graph.add(factor)
        self.bones: BoneLengths | None = None
        self._bone_rows: Int[np.ndarray, "bone 3"] = np.zeros((0, 3), dtype=int)
        self._lengths_m = np.full(skeleton.n_lengths, np.nan)
        if config.symmetry.form == "shared_length":
            self._add_bones(skeleton, lengths_m, length_sigma_m)

    def _factors(self, rig: CameraRig, skeleton: Skeleton) -> Iterator[gtsam.NonlinearFactor]:
        data, config = self.evidence, self.config
        kept = kept_joints(self.active, config.motion)
        directions = ray_directions(data.views_m, rig)
        before = FrameTime(-1, float(data.time_s[0]))
        for frame, time_s in enumerate(data.time_s.tolist()):
            active = self.active[frame]
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
                directions[frame],
                data.depth_sigma_m[frame],
                config.depth,
            )
            if config.symmetry.form == "frame":
                yield from graph.symmetry_factors(skeleton, frame, active, config.symmetry)
            yield from graph.motion_factors(before, after, np.flatnonzero(kept[frame]).tolist(), config.motion)
            if frame:
                step_s = time_s - before.time_s
                yield from graph.fading_factors(skeleton, frame, step_s, active, data.seen[frame], config.motion)
            entering = np.flatnonzero(active & ~kept[frame]).tolist()
            yield from graph.prior_factors(
                frame, entering, data.guess_m[frame], config.prior, with_velocity=self.with_velocity
            )
            before = after

    def _add_bones(self, skeleton: Skeleton, lengths_m: np.ndarray, length_sigma_m: float) -> None:
        bones = [
            (frame, start, end, length)
            for (start, end), length in zip(skeleton.bones, skeleton.length_of_bone, strict=True)
            if np.isfinite(lengths_m[length])
            for frame in np.flatnonzero(self.active[:, start] & self.active[:, end]).tolist()
        ]
        if not bones:
            return
        frame, start, end, length = np.array(bones).T
        self._bone_rows = np.stack([self._rows[frame, start], self._rows[frame, end], length], axis=1)
        self._lengths_m[np.unique(length)] = lengths_m[np.unique(length)]
        self.bones = BoneLengths(
            [position_key(s, f) for f, s in zip(frame.tolist(), start.tolist(), strict=True)],
            [position_key(e, f) for f, e in zip(frame.tolist(), end.tolist(), strict=True)],
            [length_key(number) for number in length.tolist()],
            self.config.symmetry.sigma_m,
        )
        for factor in graph.length_prior_factors(self._lengths_m, length_sigma_m):
            self.graph.add(factor)

    def initial(self) -> gtsam.Values:
        """The first guess as Values; velocities start at zero, the solution does not depend on them."""
        values = gtsam.Values()
        zero = np.zeros(3)
        for frame, joint in np.argwhere(self.active).tolist():
            values.insert(position_key(joint, frame), self.evidence.guess_m[frame, joint])
            if self.with_velocity:
                values.insert(velocity_key(joint, frame), zero)
        for length in np.flatnonzero(np.isfinite(self._lengths_m)).tolist():
            values.insert(length_key(length), float(self._lengths_m[length]))
        return values

    def _active_positions(self, values: gtsam.Values) -> Float[np.ndarray, "variable 3"]:
        # Keys sort by symbol: velocities come before positions.
        points = gtsam.utilities.extractPoint3(values)
        return points[len(points) - int(self.active.sum()) :]

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
        return vector[len(vector) - 3 * int(self.active.sum()) :].reshape(-1, 3)

    def positions_m(self, state: gtsam.Values) -> Float[np.ndarray, "frame joint 3"]:
        """Positions of the active joints; NaN elsewhere."""
        positions_m = np.full((*self.active.shape, 3), np.nan)
        positions_m[self.active] = self._active_positions(state)
        return positions_m

    def lengths_m(self, state: gtsam.Values) -> Float[np.ndarray, " length"]:
        """Shared bone lengths; NaN where none is in the graph."""
        lengths_m = np.full(self._lengths_m.shape, np.nan)
        for length in np.flatnonzero(np.isfinite(self._lengths_m)).tolist():
            lengths_m[length] = state.atDouble(length_key(length))
        return lengths_m
