"""What the solvers need of observations: undistorted points, their weights, and a first guess of every joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.estimation.evidence.delays import image_shift_px
from fgpose.estimation.evidence.detection_bias import Bias
from fgpose.estimation.evidence.presence import present
from fgpose.frozen import changed
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.vectors import norm

# By frame and joint, and by frame, camera and joint; other arrays are of frames as a whole.
_OF_JOINTS = (
    "bias_share",
    "bias_m2",
    "credible",
    "n_views",
    "fused_m",
    "guess_m",
    "off_path_m",
    "anchored",
    "from_bones",
    "held_m",
    "held_information",
)
_OF_VIEWS = (
    "undistorted_px",
    "bias_px",
    "confidence",
    "weights",
    "sigma_px",
    "visibility",
    "views_m",
    "rays",
    "depth_sigma_m",
    "sides_exchanged",
)
_LEAST_SHARE = 1e-6  # keeps standard deviations finite
FARTHEST_M = 1e8
"""What is farther away than anything on Earth: rays that are parallel but for rounding meet anywhere."""
PROBABLE = 0.5
"""A detection with a larger visibility is probably of its joint."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The observations of some frames in the form that the factor graph needs."""

    time_s: Float[np.ndarray, " frame"]
    undistorted_px: Float[np.ndarray, "frame camera joint 2"]
    """Detections, less what is known of their errors: that of the time of their image, and their bias."""
    bias_px: Float[np.ndarray, "frame camera joint 2"]
    """Bias that was taken from undistorted_px; see fgpose.estimation.evidence.detection_bias."""
    bias_share: Float[np.ndarray, "frame joint"]
    """How much of the constant errors of all cameras is left in each joint after that; see Bias.common_share."""
    bias_m2: Float[np.ndarray, "frame joint 3 3"]
    """Covariance of what it does to each joint; see Bias.covariance_m2."""
    confidence: Float[np.ndarray, "frame camera joint"]
    """Of each detection, as its detector states it; see fgpose.estimation.visibility.stated_confidence."""
    weights: Float[np.ndarray, "frame camera joint"]
    """Weight in (0, 1] of each detection; see fgpose.estimation.evidence.weights and visibility."""
    sigma_px: Float[np.ndarray, "frame camera joint"]
    """Standard deviation of each detection, if it is of its joint."""
    visibility: Float[np.ndarray, "frame camera joint"]
    """Probability that each detection is of its joint: 1 until more is known; see fgpose.estimation.visibility."""
    credible: Float[np.ndarray, "frame joint"]
    """Probability that any camera sees the joint, as far as stated confidences tell; see
    fgpose.estimation.evidence.credibility."""
    n_views: Int[np.ndarray, "frame joint"]
    """How many cameras detected the joint."""
    fused_m: Float[np.ndarray, "frame joint 3"]
    """The fused pose (eq. 1-2); see fgpose.estimation.evidence.fusion."""
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
    from_bones: Bool[np.ndarray, "frame joint"]
    """Whether the depth of a joint, which one camera alone sees, follows from bone lengths; see
    fgpose.estimation.visibility.sole_views."""
    delay_s: Float[np.ndarray, "frame camera"]
    """How much later than its frame each image was taken."""
    sides_exchanged: Bool[np.ndarray, "frame camera joint"]
    """The detections that were exchanged with those of the other side, and are as they should be here."""
    implausible: Bool[np.ndarray, " frame"]
    """Whether the detections of a frame make no body: joints tens of metres apart. They are left out."""
    held_m: Float[np.ndarray, "frame joint 3"]
    """Where a joint is by an estimate of another part of the body; NaN where there is none."""
    held_information: Float[np.ndarray, "frame joint 3 3"]
    """Inverse covariance of held_m, 1/m^2; zero where there is none."""

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Its fields by name."""
        return {name: getattr(self, name) for name in Evidence.__dataclass_fields__}

    @cached_property
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

    @cached_property
    def observed(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether the detections of at least two cameras are probably of the joint: one ray alone does not determine a
        position."""
        return np.sum(self.detection_visibility > PROBABLE, axis=1) >= 2

    @cached_property
    def believed(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Where a detection is probably of its joint."""
        return self.detected & (self.visibility > PROBABLE)

    @property
    def sole_view(self) -> Bool[np.ndarray, "frame camera joint"]:
        """Where a detection is probably of its joint, but no other of this joint is."""
        believed = self.believed
        return believed & (believed.sum(axis=1, keepdims=True) == 1)

    @property
    def has_measured_depth(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether some view's own 3D tells the depth of the joint."""
        return np.isfinite(self.depth_sigma_m).any(axis=1) & ~self.from_bones

    @property
    def located(self) -> Bool[np.ndarray, "frame joint"]:
        """Whether there is a guess that is probably of the joint: two cameras see it, or the only one that detects it
        tells its depth. It may be a guess of all of them."""
        agreed = self.believed.sum(axis=1) >= 2
        return np.isfinite(self.guess_m).all(axis=-1) & np.where(self.n_views >= 2, agreed, self.seen)

    @property
    def implausible_frames(self) -> tuple[int, ...]:
        return tuple(np.flatnonzero(self.implausible).tolist())

    def present(self, coast_s: float) -> Bool[np.ndarray, " frame"]:
        """The frames in which the person is there, see fgpose.estimation.evidence.presence."""
        seen, located = (np.asarray(each.any(axis=1)) for each in (self.seen, self.located))
        return present(seen, located, self.time_s, coast_s)

    @property
    def detection_sigma_px(self) -> Float[np.ndarray, "frame camera joint"]:
        """Standard deviation of each detection in the graph."""
        return self.sigma_px / np.sqrt(self.weights)

    @property
    def total_weight(self) -> Float[np.ndarray, "frame joint"]:
        """Weights of the detections of a joint, summed over the cameras."""
        return np.where(self.detected, self.weights, 0.0).sum(axis=1)

    @cached_property
    def unseen(self) -> Float[np.ndarray, "frame joint"]:
        """Probability that no camera sees the joint: it has no detection, or all of them are hallucinated."""
        return np.prod(np.where(self.detected, 1 - self.visibility, 1.0), axis=1)

    @cached_property
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
        return changed(self, weights=self.weights * share, depth_sigma_m=self.depth_sigma_m / np.sqrt(of_depths))

    def on_time(
        self,
        positions_m: Float[np.ndarray, "frame joint 3"],
        moved_m: Float[np.ndarray, "frame camera joint 3"],
        rig: CameraRig,
    ) -> Evidence:
        """As if all cameras were synchronous, if joints at these positions move so far until each image is taken; see
        fgpose.estimation.evidence.delays."""
        moved_px, of_views_m = image_shift_px(positions_m, moved_m, rig), moved_m[:, : self.views_m.shape[1]]
        return changed(self, undistorted_px=self.undistorted_px - moved_px, views_m=self.views_m - of_views_m)

    def less_bias(
        self,
        positions_m: Float[np.ndarray, "frame joint 3"],
        bias: Bias,
        rig: CameraRig,
    ) -> Evidence:
        """Without this bias of the detections of joints at these positions."""
        px_per_m = rig.px_per_m(positions_m)
        bias_px = np.where(np.isnan(px_per_m), 0.0, px_per_m)[..., None] * bias.bias_m
        return changed(
            self,
            undistorted_px=self.measured_px - bias_px,
            bias_px=bias_px,
            bias_share=np.broadcast_to(bias.common_share, self.bias_share.shape),
            bias_m2=np.broadcast_to(bias.covariance_m2, self.bias_m2.shape),
        )

    def with_distances(
        self,
        points_m: Float[np.ndarray, "frame camera joint 3"],
        sigma_m: Float[np.ndarray, "frame camera joint"],
        rig: CameraRig,
    ) -> Evidence:
        """With the distances of joints from cameras that alone see them, as depths of these views.

        Args:
            points_m: on the rays of detections; NaN where a distance is not known.
            sigma_m: standard deviation of these distances.
            rig: the cameras.
        """
        known = np.asarray(np.isfinite(points_m).all(axis=-1))
        if not known.any():
            return self
        own = self if self.views_m.shape[1] else self._with_views(rig.n_cameras)
        rays = points_m - rig.positions_m[:, None]
        rays /= norm(rays)[..., None]
        return changed(
            own,
            views_m=np.where(known[..., None], points_m, own.views_m),
            rays=np.where(known[..., None], rays, own.rays),
            depth_sigma_m=np.where(known, sigma_m, own.depth_sigma_m),
            from_bones=np.asarray(known.any(axis=1)),
        )

    def _with_views(self, n_views: int) -> Evidence:
        """With so many views without depth, instead of none."""
        frames, _, joints = self.depth_sigma_m.shape
        nothing = np.full((frames, n_views, joints), np.nan)
        nowhere = nothing[..., None].repeat(3, axis=-1)
        return changed(self, views_m=nowhere, rays=nowhere, depth_sigma_m=nothing)

    def held(
        self,
        joint: int,
        at_m: Float[np.ndarray, "frame 3"],
        covariance_m2: Float[np.ndarray, "frame 3 3"],
        *,
        instead: bool = False,
    ) -> Evidence:
        """With an estimate of one joint from elsewhere, which is its guess where the detections give none.

        Args:
            joint: its index.
            at_m: NaN where there is none.
            covariance_m2: of its errors; those of different frames are taken for independent.
            instead: of the detections of the joint, which that estimate has used.
        """
        if instead:
            return self._unseen(joint).held(joint, at_m, covariance_m2)
        known = np.isfinite(at_m).all(axis=-1) & np.isfinite(covariance_m2).all(axis=(-1, -2))
        held_m, information, guess_m = self.held_m.copy(), self.held_information.copy(), self.guess_m.copy()
        held_m[known, joint] = at_m[known]
        information[known, joint] = np.linalg.inv(covariance_m2[known])
        guess_m[known, joint] = np.where(np.isnan(guess_m[known, joint]), at_m[known], guess_m[known, joint])
        return changed(self, held_m=held_m, held_information=information, guess_m=guess_m)

    def _unseen(self, joint: int) -> Evidence:
        """As if no camera had detected one joint."""
        nothing = {}
        for name in ("undistorted_px", "fused_m", "guess_m", "views_m", "rays", "depth_sigma_m"):
            nothing[name] = getattr(self, name).copy()
            axis = 2 if name in _OF_VIEWS else 1
            nothing[name][(slice(None),) * axis + (joint,)] = np.nan
        n_views, anchored = self.n_views.copy(), self.anchored.copy()
        n_views[:, joint], anchored[:, joint] = 0, False
        return changed(self, **nothing, n_views=n_views, anchored=anchored)

    def joints(self, joints: Sequence[int]) -> Evidence:
        """Of some of the joints alone, in this order."""
        chosen = list(joints)
        cut = {name: getattr(self, name)[:, chosen] for name in _OF_JOINTS}
        return changed(self, **cut, **{name: getattr(self, name)[:, :, chosen] for name in _OF_VIEWS})

    def frames(self, frames: slice | np.ndarray) -> Evidence:
        """Some of the frames."""
        n_frames = len(self.time_s[frames])
        return Evidence(
            **{
                name: np.broadcast_to(array[0], (n_frames, *array.shape[1:]))
                if is_same_in_all_frames(array)
                else array[frames]
                for name, array in self.arrays.items()
            }
        )


def is_same_in_all_frames(array: np.ndarray) -> bool:
    """Whether one frame is kept in place of all, which takes no memory."""
    return array.strides[0] == 0 and len(array) > 1


def _is_same(array: np.ndarray, one: np.ndarray) -> bool:
    return is_same_in_all_frames(array) and np.array_equal(array[0], one[0], equal_nan=True)


def concatenated(parts: Sequence[Evidence]) -> Evidence:
    """Of parts that follow each other; some may have depths and others none."""
    if len(parts) == 1:
        return parts[0]
    most = max(part.depth_sigma_m.shape[1] for part in parts)
    parts = [part if part.depth_sigma_m.shape[1] == most else part._with_views(most) for part in parts]
    arrays = [vars(part) for part in parts]
    return Evidence(
        **{name: _one_after_another([own[name] for own in arrays]) for name in Evidence.__dataclass_fields__}
    )


def _one_after_another(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """As numpy.concatenate; what is the same in all frames stays so, which is more than half of what is gathered."""
    one = arrays[0]
    if is_same_in_all_frames(one) and all(_is_same(own, one) for own in arrays):
        return np.broadcast_to(one[0], (sum(map(len, arrays)), *one.shape[1:]))
    return np.concatenate(arrays)
