"""The newest frame before it is solved: where the person should be, and what of its detections is believed so far."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.evidence.evidence import FARTHEST_M, Evidence
from fgpose.estimation.evidence.images import corrected, fits_better
from fgpose.estimation.evidence.presence import has_left
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.online.bone_lengths import RunningLengths
from fgpose.estimation.process_noise import RunningDensity, is_adaptive
from fgpose.estimation.segment import FrameTime
from fgpose.estimation.visibility.running_visibility import RunningVisibility
from fgpose.estimation.visibility.sole_views import RunningSoleViews
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

_FASTEST_MPS = 1e4  # frames that are microseconds apart hardly tell velocities


class Prediction:
    """From what is known of the person by the frames before.

    Args:
        n_joints: of the person.
        lengths, visibility, sole_views: as they are learned; the lengths of somebody who has left are forgotten.
        config: all parameters.
    """

    def __init__(
        self,
        n_joints: int,
        lengths: RunningLengths,
        visibility: RunningVisibility,
        sole_views: RunningSoleViews,
        config: Config,
    ) -> None:
        self._lengths, self._visibility, self._sole_views, self._config = lengths, visibility, sole_views, config
        self._density = RunningDensity(n_joints, config.motion)
        # When each joint was probably seen last, and triangulated last.
        self._seen_s, self._triangulated_s = np.full(n_joints, -np.inf), np.full(n_joints, -np.inf)

    def note(self, state: FrameState) -> None:
        """Take a frame as it was judged; a joint that enters the graph counts as seen."""
        seen = state.evidence.seen[0] | (state.active & ~state.linked)
        triangulated = np.isfinite(state.evidence.guess_m[0]).all(axis=-1)
        for last_s, which in ((self._seen_s, seen), (self._triangulated_s, triangulated)):
            last_s[which] = np.maximum(last_s[which], state.at.time_s)

    def learn(self, oldest: FrameState, information: Float[np.ndarray, " joint"]) -> None:
        """How rough motion is, from a frame that is one lag old, with the information of its detections."""
        if is_adaptive(self._config.motion):
            velocities_mps = np.where(oldest.active[:, None], oldest.velocities_mps, np.nan)
            self._density.add(oldest.at.time_s, velocities_mps, information)

    def frame(
        self,
        before: FrameState | None,
        observations: Observations,
        gathered: Evidence,
        image_time_s: Float[np.ndarray, " camera"],
        rig: CameraRig,
    ) -> FrameState:
        """First guess of the newest frame: the predicted position or, if its reprojection error is smaller, the
        triangulated point. The joints that are estimated are located now or, with a motion model, were in the graph
        before and not given up."""
        time_s, guess_m = float(gathered.time_s[0]), gathered.guess_m[0]
        kept, step_s = np.zeros(len(guess_m), dtype=bool), np.inf
        positions_m, velocities_mps = guess_m, np.zeros_like(guess_m)
        if before is not None:
            step_s = time_s - before.at.time_s
            moved_m = before.carried_on_m(step_s)
            gathered = corrected(gathered, moved_m, before.velocities_mps, self._visibility.bias, rig)
            kept = self._kept(before, moved_m, guess_m, time_s)
            positions_m = np.where(kept[:, None], moved_m, guess_m)
            velocities_mps = np.where(kept[:, None], before.velocities_mps, 0.0)
        evidence = self._visibility.predicted(gathered, positions_m, rig)
        gathered, evidence = self._sole_views.with_distances(gathered, evidence, positions_m, rig)
        better = fits_better(guess_m, positions_m, evidence, rig, self._config.projection)
        density, off_m = self._density.density(), evidence.off_path_m[0]
        if before is not None:
            # A step of one standard deviation to where the detections agree.
            density = np.fmax(density, np.sum((off_m - positions_m) ** 2, axis=-1) / step_s**3)
        positions_m = np.where(better[:, None], guess_m, positions_m)
        linked = kept & (self._config.motion.model != "none")
        active = linked | evidence.located[0]
        return FrameState(
            at=FrameTime(0 if before is None else before.at.frame + 1, time_s),
            step_s=step_s,
            observations=observations,
            image_time_s=image_time_s,
            gathered=gathered,
            evidence=evidence,
            positions_m=np.where(np.isnan(off_m), positions_m, off_m),
            velocities_mps=velocities_mps,
            lengths_m=self._lengths.learned.lengths_m,
            active=active,
            linked=linked,
            process_density=density,
            filtered=evidence.visibility[0],
            unseen_before_s=time_s - self._seen_s,
        )

    def _kept(
        self,
        before: FrameState,
        moved_m: Float[np.ndarray, "joint 3"],
        guess_m: Float[np.ndarray, "joint 3"],
        time_s: float,
    ) -> Bool[np.ndarray, " joint"]:
        """The joints that are carried on: none of somebody who has left, and who is forgotten."""
        known_m = np.where(before.active[:, None], before.positions_m, np.nan)
        if has_left(known_m, guess_m, time_s - float(self._seen_s.max()), self._config.tracking.coast_s):
            self._lengths.forget()
            return np.zeros(len(moved_m), dtype=bool)
        given_up = np.minimum(self._seen_s, self._triangulated_s) < time_s - self._config.motion.max_unseen_s
        within = (np.abs(moved_m) < FARTHEST_M) & (np.abs(before.velocities_mps) < _FASTEST_MPS)
        return before.active & within.all(axis=-1) & ~given_up
