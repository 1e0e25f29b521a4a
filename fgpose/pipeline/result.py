"""What a run gives, and how it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fgpose.association.recording import Association
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import FRAMES_AT_ONCE
from fgpose.estimation.evidence.gathered import Gathered
from fgpose.estimation.residuals import whitened_residuals
from fgpose.estimation.settling import informed
from fgpose.estimation.windows import cut_windows
from fgpose.freed_memory import hand_back
from fgpose.geometry.camera import CameraRig
from fgpose.io.origin import Origin
from fgpose.observations import Observations
from fgpose.pipeline.source import AnySource, with_findings
from fgpose.sampling import nearest
from fgpose.trajectory import Trajectory
from fgpose.viewer import Recording


@dataclass(frozen=True, eq=False)
class Result:
    """The results of a run: the motion of everybody."""

    source: AnySource
    config: Config
    trajectories: Mapping[str, Mapping[int, Trajectory]]
    """By name ("fused", "refined", "smoothed", "online"), the most important last; of each by the number of the person,
    which is 0 where the source is of one."""
    saved: tuple[str, ...]
    """Names of the trajectories to be written as files of their own; the others are shown in the .rrd. One that the
    run did not give is left out."""
    association: Association | None = None
    """Who is who, where the source is of everybody."""
    update_ms: Float[np.ndarray, " frame"] | None = None
    """How long each update of the online estimators took, milliseconds."""
    n_repairs: int = 0
    """How often GTSAM failed in the online estimators, and their windows were eliminated anew."""
    compared_every: int = 1
    """Results that are not saved have one frame in so many."""
    diagnosis: Diagnosis | None = None
    """What is probably wrong with it (fgpose.pipeline.diagnosed); None: nobody has looked."""

    @property
    def main(self) -> Mapping[int, Trajectory]:
        """The most important trajectories."""
        return list(self.trajectories.values())[-1]

    @property
    def seen(self) -> Observations | Association:
        """What the cameras saw of whom."""
        return self.source.observations if self.association is None else self.association

    @property
    def rig(self) -> CameraRig:
        """The cameras, with the clocks by which everybody was told apart."""
        return self.source.rig if self.association is None else self.association.rig

    @property
    def frame_time_s(self) -> Float[np.ndarray, " frame"]:
        """Of the whole recording, by the mean clock of the cameras, as those of the trajectories."""
        recording = self.source if self.association is None else self.association
        return recording.observations.frame_time_s + self.rig.common_offset_s

    @property
    def origin(self) -> Origin | None:
        """That of the source, with what happened to the tracks and what is probably wrong."""
        origin = with_findings(self.source.origin, self.diagnosis)
        return origin and replace(origin, events=() if self.association is None else self.association.events)

    def first_frame(self, trajectory: Trajectory) -> int:
        """The frame of the recording in which a trajectory begins."""
        return int(nearest(trajectory.time_s[:1], self.frame_time_s)[0])


def show(result: Result, recording: Recording) -> None:
    """Show everything that is known of a result; see fgpose.viewer."""
    if result.association is not None:
        recording.log_association(result.association)
        for person, trajectory in result.main.items():
            recording.log_person(person, trajectory, result.first_frame(trajectory))
    else:
        _show_compared(result, recording)


def _show_compared(result: Result, recording: Recording) -> None:
    """The results of one person side by side, with what each detection and each factor does to the last of them."""
    main, every = result.main[0], result.compared_every
    _show_detections(result, recording)
    for name, people in result.trajectories.items():
        recording.log_trajectory(name, people[0], 1 if name in result.saved else every)
    # The paper's method has other sigmas than the factor graph over time: its residuals are its reprojection errors.
    if "refined" not in result.saved:
        hand_back()
        residuals = _residuals(result)
        recording.log_residuals(main.time_s[::every], residuals, every)
    if result.update_ms is not None:
        recording.log_update_times(result.frame_time_s, result.update_ms)


def _show_detections(result: Result, recording: Recording) -> None:
    source, main, shown = result.source, result.main[0], slice(None, None, result.compared_every)
    observations, evidence = source.observations.frames(shown), source.gathered(result.config)
    weights, undistorted_px = _weighted(observations, source.rig, evidence, np.arange(main.n_frames)[shown])
    if main.visibility is not None:
        weights *= np.nan_to_num(main.visibility[shown])
    recording.log_observations(observations, weights, undistorted_px, result.compared_every)


def _weighted(
    observations: Observations, rig: CameraRig, evidence: Evidence | Gathered, frames: Int[np.ndarray, " frame"]
) -> tuple[Float[np.ndarray, "frame camera joint"], Float[np.ndarray, "frame camera joint 2"]]:
    """The weight and the undistorted place of each detection in some frames, in single precision, as the viewer shows
    them, also of those that are no evidence; of a few frames at a time: all that is gathered of them takes ten times as
    much memory."""
    of_parts = []
    for some in np.array_split(frames, -(-len(frames) // FRAMES_AT_ONCE)):
        part = evidence.frames(some)
        of_parts.append((part.weights.astype(np.float32), part.undistorted_px.astype(np.float32)))
        hand_back()
    weights, undistorted_px = (np.concatenate(each) for each in zip(*of_parts, strict=True))
    not_as_given = np.isnan(undistorted_px[..., 0]) | evidence.sides_exchanged[frames]
    some = np.flatnonzero((observations.seen & not_as_given).any(axis=(1, 2)))
    given_px = rig.undistort(observations.points2d_px[some])
    undistorted_px[some] = np.where(not_as_given[some][..., None], given_px, undistorted_px[some])
    return weights, undistorted_px


def _residuals(result: Result) -> dict[str, Float[np.ndarray, "frame joint"]]:
    """Of the frames that are compared, see whitened_residuals; in the windows of the smoother, so that memory does not
    grow with what is gathered."""
    main, rig, config, parts = result.main[0], result.source.rig, result.config, []
    evidence = result.source.gathered(config)
    for window in cut_windows(main.time_s, config.solver.window_s, config.solver.overlap_s):
        of_window, own = main.frames(window.solved), evidence.frames(window.solved)
        known = informed(own, of_window.positions_m, rig, main.skeleton, config, of_window.visibility)
        residuals = whitened_residuals(of_window, known, rig, config)
        of_solved, every = window.contributed_of_solved, result.compared_every
        shown = slice(of_solved.start + -window.contributed.start % every, of_solved.stop, every)
        # A view would keep the residuals of all frames. The viewer shows two digits.
        parts.append({factor: each[shown].astype(np.float32) for factor, each in residuals.items()})
        hand_back()
    return {factor: np.concatenate([part[factor] for part in parts]) for factor in parts[0]}
