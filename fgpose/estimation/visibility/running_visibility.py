"""Which detections are hallucinated, online: what visibility.judged tells of a recording, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from fgpose.config import Config
from fgpose.estimation.evidence.detection_bias import Bias, RunningBias
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.frame_state import FrameState
from fgpose.estimation.noise import CORRELATION_S, LEARNED_EVERY_S
from fgpose.estimation.visibility.agreement import Agreement, is_doubtful
from fgpose.estimation.visibility.detection_residuals import DetectionResiduals, lengths_m
from fgpose.estimation.visibility.running_spread import RunningSpread
from fgpose.estimation.visibility.stated_confidence import StatedConfidence
from fgpose.estimation.visibility.visibility import (
    independent,
    log_odds_of_frames,
    residual_sums,
    with_visibility,
    within_timing_m,
)
from fgpose.estimation.visibility.visibility_chain import Chain, Stays
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm
from fgpose.sampling import TIME_ROUNDING_S
from fgpose.skeleton import Skeleton

# Logarithm of the odds from which online a place off the predicted path is believed on which three views agree: nothing
# later takes it back. At 0 the mean error of the newest pose on the tuning clips of the benchmark, occluded, is 3 %
# larger.
_SURE_ONLINE = 4.0


@dataclass(frozen=True, eq=False)
class _Known:
    """What the images of each camera tell."""

    probability: Float[np.ndarray, "camera joint"]
    """That each joint is visible in the last."""
    last_s: Float[np.ndarray, "camera 1"]
    """When that was taken."""
    spread: RunningSpread
    """How large their errors are."""

    def since_s(self, evidence: Evidence) -> Float[np.ndarray, "camera 1"]:
        """Time from the last image of each camera to a frame; one that is there twice at one time tells nothing new."""
        return np.maximum(evidence.time_s[0] - self.last_s, TIME_ROUNDING_S)


class Filtered(NamedTuple):
    """What a frame and those before it tell."""

    time_s: float
    """Of the frame."""
    probability: Float[np.ndarray, "camera joint"]
    """That each joint is visible to each camera."""


class RunningVisibility:
    """Filtered over time: forward for the newest frame, forward and backward for the window, the spread of each camera
    from the last seconds.

    What a pose tells about its frame is known after the solver has run. So it weights the detections of the next frame,
    and those of the window when that is judged again.
    """

    def __init__(self, n_cameras: int, skeleton: Skeleton, config: Config) -> None:
        self._skeleton, self._config = skeleton, config
        self._stays, self._chain = Stays(), Chain(config.visibility)
        self._stated = StatedConfidence.unknown(skeleton.n_joints)
        self._on = config.visibility.model == "markov"
        self._probability = np.full((n_cameras, skeleton.n_joints), self._chain.usual if self._on else 1.0)
        self._last_s = np.full((n_cameras, 1), -np.inf)
        self._spread = RunningSpread.at_first(config.visibility.sigma_m, n_cameras)
        self._newest_s, self._before_newest = -np.inf, self._known_of_images()
        self._bias = RunningBias(n_cameras, skeleton.n_joints)
        self._oldest: Evidence | None = None
        self.at_first = Filtered(-np.inf, self._probability)
        """Before there is any frame."""

    @property
    def probability(self) -> Float[np.ndarray, "camera joint"]:
        """That each joint is visible to each camera, when that last took an image."""
        return self._probability

    @property
    def bias(self) -> Bias:
        """Learned so far."""
        return self._bias.bias

    def _known_of_images(self) -> _Known:
        """As they are; no array of them changes."""
        return _Known(self._probability, self._last_s, self._spread)

    @property
    def _spread_m(self) -> Float[np.ndarray, " camera"]:
        return self._spread.spread_m

    def _known_before(self, evidence: Evidence) -> _Known:
        """What the images before those of a frame tell, which is the newest or a new one."""
        return self._before_newest if evidence.time_s[0] == self._newest_s else self._known_of_images()

    def add(
        self,
        positions_m: Float[np.ndarray, "joint 3"],
        velocities_mps: Float[np.ndarray, "joint 3"],
        evidence: Evidence,
        rig: CameraRig,
        has_image: Bool[np.ndarray, " camera"],
    ) -> None:
        """Take the pose of the newest frame and its detections, or take it again where another image has joined it:
        the first image of a frame is judged when there is another to compare it with."""
        if not self._on:
            return
        before = self._known_before(evidence)
        self._newest_s, self._before_newest = float(evidence.time_s[0]), before
        self._spread = before.spread
        residuals = DetectionResiduals.of(positions_m[None], evidence, rig, self._config)
        since_s = before.since_s(evidence)
        odds = self._log_odds(evidence, residuals, velocities_mps[None], rig, since_s)[0]
        updated = self._chain.updated(self._chain.predicted(before.probability, since_s), odds)
        self._probability = np.where(has_image[:, None], updated, before.probability)
        self._last_s = np.where(has_image[:, None], evidence.time_s[0], before.last_s)
        self._spread = before.spread.then(self._newest_s, since_s, residuals, has_image)

    def judged(
        self,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "frame joint 3"],
        velocities_mps: Float[np.ndarray, "frame joint 3"],
        rig: CameraRig,
        before: Filtered,
    ) -> tuple[Evidence, Float[np.ndarray, "frame camera joint"]]:
        """The evidence of the newest frames, with what their poses tell about it (see the function of this name), and
        the filtered probabilities; before is of the frame before them."""
        if not self._on:
            return evidence, evidence.visibility
        residuals = DetectionResiduals.of(positions_m, evidence, rig, self._config)
        step_s = np.diff(evidence.time_s, prepend=before.time_s)
        odds = self._log_odds(evidence, residuals, velocities_mps, rig, step_s[:, None, None])
        filtered = self._chain.filtered(odds, step_s, before.probability)
        probability = self._chain.smoothed(filtered, odds, step_s)
        seen, priors = residuals.of_seen, self._config.visibility
        return with_visibility(evidence, *seen, self._spread_m, probability, step_s[:, None, None], priors), filtered

    def marginalise(self, state: FrameState, rig: CameraRig) -> None:
        """The oldest frame leaves the window. Take the next one, as it was judged last, with its weights as gathered:
        biases, how long joints stay visible or hidden, and what confidences say of it are learned from it, if it tells
        anything new."""
        before = self._oldest
        if not self._on or (before is not None and state.at.time_s - before.time_s[0] < LEARNED_EVERY_S):
            return
        self._oldest = oldest = state.as_gathered
        if before is None:
            return
        step_s, detected = oldest.time_s - before.time_s, np.concatenate([before.detected, oldest.detected])
        visibility = np.concatenate([before.visibility, oldest.visibility])
        stays = Stays.of(visibility, np.append(np.inf, step_s), detected)
        self._stays = self._stays.then(stays, float(step_s[0]))
        stated = StatedConfidence.of(oldest, oldest.visibility, independent(step_s, CORRELATION_S)[:, None, None])
        self._stated = self._stated.then(stated, float(step_s[0]))
        self._chain = Chain(self._config.visibility, self._stays)
        if self._config.visibility.bias == "constant":
            moved_m = within_timing_m(norm(state.velocities_mps))
            sums = residual_sums(oldest, oldest.visibility, step_s, state.positions_m[None], moved_m[None], rig)
            self._bias.add(sums, float(step_s[0]), self._spread_m)

    def _log_odds(
        self,
        evidence: Evidence,
        residuals: DetectionResiduals,
        velocities_mps: Float[np.ndarray, "frame joint 3"],
        rig: CameraRig,
        step_s: Float[np.ndarray, "*#steps"],
    ) -> Float[np.ndarray, "frame camera joint"]:
        moved_m, stated = within_timing_m(norm(velocities_mps)), self._stated.log_odds(evidence)
        spread_m = np.hypot(self._spread_m[:, None], moved_m[:, None])
        said = np.where(residuals.several, self._said(residuals, stated, spread_m, rig).log_odds, 0.0)
        return log_odds_of_frames(said, stated, step_s)

    def _said(
        self,
        residuals: DetectionResiduals,
        stated: Float[np.ndarray, "frame camera joint"],
        visible_m: Float[np.ndarray, "#frame camera #joint"],
        rig: CameraRig,
    ) -> Agreement:
        usual, priors = self._chain.updated(self._chain.usual, stated), self._config.visibility
        return Agreement.of(residuals, visible_m, self._spread_m, usual, _SURE_ONLINE, rig, self._skeleton, priors)

    def with_image(
        self,
        is_own: Bool[np.ndarray, " camera"],
        filtered: Filtered,
        before: Filtered,
        judged: Evidence,
        evidence: Evidence,
        positions_m: Float[np.ndarray, "joint 3"],
        rig: CameraRig,
    ) -> Evidence:
        """The evidence of an older frame that another image joins; what was known of its other detections stays.

        Args:
            is_own: whose image it is.
            filtered, before: of this frame, and of the one before it.
            judged: without the image, as it is in the graph.
            evidence: with the image, as gathered.
            positions_m: the pose.
            rig: the cameras.
        """
        if not self._on:
            return evidence
        since_s = np.full((len(is_own), 1), max(filtered.time_s - before.time_s, TIME_ROUNDING_S))
        own = self._given_stated(filtered.probability, self._stated.log_odds(evidence), since_s)
        probability = np.where(is_own[:, None], own, judged.visibility[0])
        return self._with_probability(probability, evidence, *lengths_m(evidence, positions_m, rig), since_s)

    def predicted(self, evidence: Evidence, positions_m: Float[np.ndarray, "joint 3"], rig: CameraRig) -> Evidence:
        """The evidence of the next frame, or of the newest that another image joins, with what is known of it before
        it is solved.

        Args:
            evidence: of the frame.
            positions_m: the predicted pose.
            rig: the cameras.
        """
        if not self._on:
            return evidence
        before = self._known_before(evidence)
        since_s, stated = before.since_s(evidence), self._stated.log_odds(evidence)
        probability = self._given_stated(self._chain.predicted(before.probability, since_s), stated, since_s)
        length_m, px_per_m = lengths_m(evidence, positions_m, rig)
        if is_doubtful(length_m, self._spread_m):
            residuals = DetectionResiduals.of(positions_m[None], evidence, rig, self._config)
            said = self._said(residuals, stated, self._spread_m[None, :, None], rig)
            is_off = np.isfinite(said.off_path_m[0]).all(axis=-1)
            probability = np.where(is_off, self._chain.updated(probability, said.log_odds[0]), probability)
            evidence = changed(evidence, off_path_m=said.off_path_m)
        return self._with_probability(probability, evidence, length_m, px_per_m, since_s)

    def _given_stated(
        self,
        probability: Float[np.ndarray, "camera joint"],
        stated: Float[np.ndarray, "1 camera joint"],
        since_s: Float[np.ndarray, "camera 1"],
    ) -> Float[np.ndarray, "camera joint"]:
        """With what the confidences of a frame say, of which no residual is known yet."""
        return self._chain.updated(probability, stated[0] * independent(since_s, CORRELATION_S))

    def _with_probability(
        self,
        probability: Float[np.ndarray, "camera joint"],
        evidence: Evidence,
        length_m: Float[np.ndarray, "camera joint"],
        px_per_m: Float[np.ndarray, "camera joint"],
        since_s: Float[np.ndarray, "camera 1"],
    ) -> Evidence:
        of_frame, priors = (length_m[None], px_per_m[None]), self._config.visibility
        return with_visibility(evidence, *of_frame, self._spread_m, probability[None], since_s, priors)
