"""From observations to what the solvers need: undistorted points, their weights, and a first guess of every joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.config import Config, DepthConfig
from fgpose.estimation.credibility import credible, usual_confidence
from fgpose.estimation.delays import delays_s, image_shift_px
from fgpose.estimation.detection_bias import Bias
from fgpose.estimation.fusion import fuse_undistorted
from fgpose.estimation.weights import detection_weights
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.triangulation import triangulate_robust
from fgpose.geometry.view_depth import RELATIVE_SIGMA, ViewDepth
from fgpose.observations import Observations

_FRAMES_AT_ONCE = 1000  # bounds the memory of the triangulation's intermediate arrays to about 100 MB
# Median distance of the joints from their middle: 0.3 m, so 300 "metres" in millimetres. A few wrong
# triangulations do not change the median.
_MAX_BODY_M = 30.0
_LEAST_SHARE = 1e-6  # keeps standard deviations finite
_FEW_VIEWS = 2  # three rays determine a joint even if one is wrong; see depth.use
# So many depths of a view tell their spread: 17 joints for 30 frames. The depths of a body share most of their error,
# which is correlated in time, so fewer would tell the error of that moment.
_ENOUGH_DEPTHS = 500
# Depths that were triangulated themselves fit better than any network's.
_LEAST_RELATIVE_SIGMA = 0.01
FARTHEST_M = 1e8
"""What is farther away than anything on Earth: rays that are parallel but for rounding meet anywhere."""
PROBABLE = 0.5
"""A detection with a larger visibility is probably of its joint."""
_SIGMAS_PER_MEDIAN = 1.4826  # of the absolute value of a normal error


@dataclass(frozen=True, eq=False)
class Evidence:
    """The observations of some frames in the form that the factor graph needs."""

    time_s: Float[np.ndarray, " frame"]
    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    """Detections, less what is known of their errors: that of the time of their image, and their bias."""
    bias_px: Float[np.ndarray, "frame camera joint 2"]
    """Bias that was taken from undistorted_px; see fgpose.estimation.detection_bias."""
    common_bias_m2: Float[np.ndarray, "frame joint 3 3"]
    """Covariance of the error of each joint that comes from bias that all cameras have in common, after that."""
    weights: Float[np.ndarray, "frame camera joint"]
    """Weight in (0, 1] of each detection; see fgpose.estimation.weights and visibility."""
    sigma_px: Float[np.ndarray, "frame camera joint"]
    """Standard deviation of each detection, if it is of its joint."""
    visibility: Float[np.ndarray, "frame camera joint"]
    """Probability that each detection is of its joint: 1 until more is known; see fgpose.estimation.visibility."""
    credible: Float[np.ndarray, "frame joint"]
    """Probability that any camera sees the joint, as far as stated confidences tell; see
    fgpose.estimation.credibility."""
    n_views: Int[np.ndarray, "frame joint"]
    """How many cameras detected the joint."""
    fused_m: Float[np.ndarray, "frame joint 3"]
    """The fused pose (eq. 1-2); see fgpose.estimation.fusion."""
    guess_m: Float[np.ndarray, "frame joint 3"]
    """Robust triangulation or, where the views do not allow it, the fused per-view 3D; NaN where there is neither."""
    off_path_m: Float[np.ndarray, "frame joint 3"]
    """Where the detections of a joint agree, if that is more probable than the path that was estimated; else NaN."""
    anchored: Bool[np.ndarray, "frame joint"]
    """Whether the guess is the fused per-view 3D, and nothing else determines the depth of the joint."""
    views_m: Float[np.ndarray, "frame view joint 3"]
    """The 3D joints of each view alone, where their depth is used; no views when it is not wanted or not known."""
    rays: Float[np.ndarray, "frame view joint 3"]
    """Unit vectors from each camera to views_m."""
    depth_sigma_m: Float[np.ndarray, "frame view joint"]
    """Standard deviation of views_m along the ray; NaN where it is not used."""
    delay_s: Float[np.ndarray, "frame camera"]
    """How much later than its frame each image was taken."""

    @property
    def detected(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Where there is a detection."""
        return np.asarray(np.isfinite(self.undistorted_px).all(axis=-1))

    @property
    def measured_px(self) -> Float[np.ndarray, "frame camera joint 2"]:
        """As undistorted_px, with the bias."""
        return self.undistorted_px + self.bias_px

    @property
    def detection_visibility(self) -> Float[np.ndarray, "frame camera joint"]:
        """As visibility, if any camera sees the joint; NaN where there is no detection."""
        return np.where(self.detected, self.visibility * self.credible[:, None], np.nan)

    @property
    def observed(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether the detections of at least two cameras are probably of the joint: one ray alone does not determine a
        position."""
        return np.sum(self.detection_visibility > PROBABLE, axis=1) >= 2

    @property
    def located(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether there is a guess that is probably of the joint: two cameras see it, or the only one that detects it
        tells its depth. It may be a guess of all of them."""
        agreed = np.sum(self.detected & (self.visibility > PROBABLE), axis=1) >= 2
        return np.isfinite(self.guess_m).all(axis=-1) & np.where(self.n_views >= 2, agreed, self.seen)

    @property
    def detection_sigma_px(self) -> Float[np.ndarray, "frame camera joint"]:
        """Standard deviation of each detection in the graph."""
        return self.sigma_px / np.sqrt(self.weights)

    @property
    def total_weight(self) -> Float[np.ndarray, "frame joint"]:
        """Weights of the detections of a joint, summed over the cameras."""
        return np.where(self.detected, self.weights, 0.0).sum(axis=1)

    @property
    def unseen(self) -> Float[np.ndarray, "frame joint"]:
        """Probability that no camera sees the joint: it has no detection, or all of them are hallucinated."""
        return np.prod(np.where(self.detected, 1 - self.visibility, 1.0), axis=1)

    @property
    def seen(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether some camera probably sees the joint."""
        return self.unseen < PROBABLE

    def information(
        self, positions_m: Float[np.ndarray, "frame joint 3"], rig: CameraRig
    ) -> Float[np.ndarray, "frame joint"]:
        """Of the detections of each frame on each axis of a joint at these positions, 1/m^2, on average: each tells two
        of three coordinates."""
        precision = (rig.px_per_m(positions_m) / self.detection_sigma_px) ** 2
        return 2 / 3 * np.where(self.detected & np.isfinite(precision), precision, 0.0).sum(axis=1)

    def trusted(self, share: Float[np.ndarray, "frame camera joint"]) -> Evidence:
        """With this share of the information of each detection, and of the depth that its view gives."""
        share = np.maximum(share, _LEAST_SHARE)
        of_depths = share[:, : self.depth_sigma_m.shape[1]]  # one for every camera, or none at all
        return replace(self, weights=self.weights * share, depth_sigma_m=self.depth_sigma_m / np.sqrt(of_depths))

    def on_time(
        self,
        positions_m: Float[np.ndarray, "frame joint 3"],
        moved_m: Float[np.ndarray, "frame camera joint 3"],
        rig: CameraRig,
    ) -> Evidence:
        """As if all cameras were synchronous, if joints at these positions move so far until each image is taken; see
        fgpose.estimation.delays."""
        moved_px, of_views_m = image_shift_px(positions_m, moved_m, rig), moved_m[:, : self.views_m.shape[1]]
        return replace(self, undistorted_px=self.undistorted_px - moved_px, views_m=self.views_m - of_views_m)

    def less_bias(
        self,
        positions_m: Float[np.ndarray, "frame joint 3"],
        bias: Bias,
        rig: CameraRig,
    ) -> Evidence:
        """Without this bias of the detections of joints at these positions."""
        bias_px = np.nan_to_num(rig.px_per_m(positions_m))[..., None] * bias.bias_m
        return replace(
            self,
            undistorted_px=self.measured_px - bias_px,
            bias_px=bias_px,
            common_bias_m2=np.broadcast_to(bias.common_m2, (*self.common_bias_m2.shape[:1], *bias.common_m2.shape)),
        )

    def _with_views(self, n_views: int) -> Evidence:
        """With so many views without depth, instead of none."""
        frames, _, joints = self.depth_sigma_m.shape
        nothing = np.full((frames, n_views, joints), np.nan)
        nowhere = nothing[..., None].repeat(3, axis=-1)
        return replace(self, views_m=nowhere, rays=nowhere, depth_sigma_m=nothing)

    def frames(self, frames: slice | np.ndarray) -> Evidence:
        """Some of the frames."""
        return Evidence(**{name: array[frames] for name, array in vars(self).items()})


def gather(observations: Observations, rig: CameraRig, config: Config, usual: float | None = None) -> Evidence:
    """The evidence of all frames.

    Args:
        observations: of one person.
        rig: cameras of the observations, in their order.
        config: the parameters.
        usual: the confidence of most detections; by default that of these.

    Raises:
        ValueError: the cameras of observations and rig differ.
    """
    observations.check_cameras(rig.names)
    usual = usual_confidence(observations.confidence) if usual is None else usual
    starts = range(0, observations.n_frames, _FRAMES_AT_ONCE)
    parts = [
        _gather(observations.frames(slice(start, start + _FRAMES_AT_ONCE)), rig, config, usual) for start in starts
    ]
    evidence = concatenated(parts)
    _refuse_millimetres(evidence.guess_m)
    return evidence


def concatenated(parts: Sequence[Evidence]) -> Evidence:
    """Of parts that follow each other; some may have depths and others none."""
    if len(parts) == 1:
        return parts[0]
    most = max(part.depth_sigma_m.shape[1] for part in parts)
    parts = [part if part.depth_sigma_m.shape[1] == most else part._with_views(most) for part in parts]
    return Evidence(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})


def _refuse_millimetres(positions_m: Float[np.ndarray, "frame joint 3"]) -> None:
    """Raise ValueError when the joints are implausibly far apart: the rig's lengths are millimetres, not metres."""
    known = positions_m[np.asarray(np.isfinite(positions_m).any(axis=(1, 2)))]
    if not len(known) or np.nanmax(known) - np.nanmin(known) < _MAX_BODY_M:  # medians would take ten times as long
        return
    centre_m = np.nanmedian(known, axis=1, keepdims=True)
    size_m = float(np.nanmedian(np.linalg.norm(known - centre_m, axis=-1)))
    if size_m > _MAX_BODY_M:
        raise ValueError(
            f"the joints are {size_m:.0f} m apart: the calibration looks like millimetres; divide its lengths by 1000"
        )


def _gather(observations: Observations, rig: CameraRig, config: Config, usual: float) -> Evidence:
    undistorted_px = rig.undistort(observations.points2d_px)
    triangulated_m = triangulate_robust(
        undistorted_px, observations.confidence, rig, config.fusion.inlier_px
    ).positions_m
    triangulated_m[(np.abs(triangulated_m) > FARTHEST_M).any(axis=-1)] = np.nan
    fusion = fuse_undistorted(observations, triangulated_m, undistorted_px, rig, config.fusion)
    guessed = np.asarray(np.isnan(triangulated_m).any(axis=-1))
    views_m, rays, depth_sigma_m = _depths(observations, rig, triangulated_m, config.depth)
    has_depth = np.isfinite(depth_sigma_m).any(axis=1)
    return Evidence(
        time_s=observations.frame_time_s,
        undistorted_px=undistorted_px,
        bias_px=np.zeros_like(undistorted_px),
        common_bias_m2=np.zeros((*triangulated_m.shape, 3)),
        weights=detection_weights(fusion, observations.confidence, config.projection),
        sigma_px=np.full(observations.confidence.shape, config.projection.sigma_px),
        visibility=np.ones(observations.confidence.shape),
        credible=credible(observations.confidence, usual),
        n_views=observations.seen.sum(axis=1),
        fused_m=fusion.positions_m,
        guess_m=np.where(guessed[..., None], fusion.positions_m, triangulated_m),
        off_path_m=np.full_like(triangulated_m, np.nan),
        anchored=guessed & np.isfinite(fusion.positions_m).all(axis=-1) & ~has_depth,
        views_m=views_m,
        rays=rays,
        depth_sigma_m=depth_sigma_m,
        delay_s=delays_s(observations, rig),
    )


def _depths(
    observations: Observations, rig: CameraRig, triangulated_m: Float[np.ndarray, "frame joint 3"], config: DepthConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence.views_m, rays and depth_sigma_m."""
    views_m = observations.points3d_m
    if config.use == "never" or views_m is None:
        nothing = np.zeros((observations.n_frames, 0, observations.skeleton.n_joints))
        nowhere = nothing[..., None].repeat(3, axis=-1)
        return nowhere, nowhere, nothing
    position_m = np.array([camera.position_m for camera in rig.cameras])[:, None]
    depth = ViewDepth.of(views_m, observations.covariance3d_m2, position_m)
    rays, distance_m, sigma_m = depth.rays, depth.distance_m, depth.sigma_m
    unstated = np.isnan(sigma_m) & np.isfinite(distance_m)
    if unstated.any():
        error_m = np.einsum("tcji,tcji->tcj", rays, views_m - triangulated_m[:, None])
        sigma_m = np.where(unstated, distance_m * _relative_sigma(error_m / distance_m)[:, None], sigma_m)
    if config.use == "few_views":
        few = observations.seen.sum(axis=1, keepdims=True) <= _FEW_VIEWS
        sigma_m = np.where(few, sigma_m, np.nan)
    return views_m, rays, sigma_m


def _relative_sigma(error: Float[np.ndarray, "frame camera joint"]) -> Float[np.ndarray, " camera"]:
    """Standard deviation of the depths of each view that does not state any, relative to the distance.

    From the recording, as far as it is long enough to tell; robust, for triangulated joints may be hallucinated.

    Args:
        error: of the depths against the triangulated joints, relative to the distance; NaN where either is missing.
    """
    sigma = np.full(error.shape[1], RELATIVE_SIGMA)
    for view in range(error.shape[1]):
        known = error[:, view][np.isfinite(error[:, view])]
        if known.size >= _ENOUGH_DEPTHS:
            sigma[view] = max(float(_SIGMAS_PER_MEDIAN * np.median(np.abs(known))), _LEAST_RELATIVE_SIGMA)
    return sigma
