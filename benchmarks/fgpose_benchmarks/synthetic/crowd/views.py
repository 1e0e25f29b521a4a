"""What one camera detects of several people: bodies hide joints, and the detector makes mistakes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.geometry.camera import Camera
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic.crowd.bodies import VISIBLE
from fgpose_benchmarks.synthetic.crowd.errors import CrowdErrors, spells
from fgpose_benchmarks.synthetic.noise import DetectionNoise, bias_m, detection_error, stated_confidence
from fgpose_benchmarks.synthetic.occlusion import Occlusion, hallucination


@dataclass(frozen=True, eq=False)
class TrueView:
    """The truth as one camera sees it."""

    camera: Camera
    skeleton: Skeleton
    fps: float
    seen_m: Float[np.ndarray, "image person joint 3"]
    """At the time of each image, world frame; NaN where a person is not there."""
    hider: Int[np.ndarray, "image person joint"]
    """Who hides the joint; see hidden_by."""

    @property
    def true_px(self) -> Float[np.ndarray, "image person joint 2"]:
        """Undistorted."""
        return self.camera.project(self.seen_m)

    def shows(self, undistorted_px: Float[np.ndarray, "*points 2"]) -> Bool[np.ndarray, "*points"]:
        """Whether points are inside the image."""
        original_px = self.camera.distort(undistorted_px)
        return np.asarray(np.all((original_px >= 0) & (original_px < self.camera.size_px), axis=-1))

    def twice(self) -> TrueView:
        """With a double of everybody, behind all the people."""
        seen_m, hider = (np.concatenate([array, array], axis=1) for array in (self.seen_m, self.hider))
        return TrueView(self.camera, self.skeleton, self.fps, seen_m, hider)


@dataclass(frozen=True, eq=False)
class SimulatedDetections:
    """Everybody in all images of a camera."""

    is_there: Bool[np.ndarray, "image person"]
    points_px: Float[np.ndarray, "image person joint 2"]
    """Undistorted; NaN where missing."""
    confidence: Float[np.ndarray, "image person joint"]
    joint_of: Int[np.ndarray, "image person joint"]
    """True person whose joint is really seen, -1: missing or hallucinated."""
    hidden: Bool[np.ndarray, "image person joint"]
    is_flipped: Bool[np.ndarray, "image person"]


def detect(
    rng: np.random.Generator, view: TrueView, noise: DetectionNoise, occlusion: Occlusion, errors: CrowdErrors
) -> SimulatedDetections:
    """Everybody, and behind them a double of everybody; false people not yet."""
    *joint_rngs, missed_rng, doubled_rng, flip_rng = rng.spawn(7)
    n_people = view.hider.shape[1]
    in_view = np.sum((view.hider == VISIBLE) & view.shows(view.true_px), axis=-1)
    missed = spells(missed_rng, in_view.shape, view.fps, errors.missed_share, errors.missed_s)
    doubled = spells(doubled_rng, in_view.shape, view.fps, errors.doubled_share, errors.doubled_s)
    is_there = (in_view >= max(errors.min_visible_joints, 1)) & ~missed
    points_px, confidence, joint_of = _joints(joint_rngs, view.twice(), n_people, noise, occlusion, errors)
    is_there = np.concatenate([is_there, is_there & doubled], axis=1) & np.isfinite(points_px).all(axis=-1).any(axis=-1)
    is_flipped = spells(flip_rng, is_there.shape, view.fps, errors.flipped_share, errors.flipped_s)
    hidden = np.tile(view.hider != VISIBLE, (1, 2, 1))
    flip = np.where(is_flipped[..., None], view.skeleton.mirror, np.arange(view.skeleton.n_joints))
    points_px = np.take_along_axis(points_px, flip[..., None], axis=2)
    confidence, joint_of, hidden = (np.take_along_axis(a, flip, axis=2) for a in (confidence, joint_of, hidden))
    return SimulatedDetections(is_there, points_px, confidence, joint_of, hidden, is_flipped)


def _joints(
    rngs: list[np.random.Generator],
    view: TrueView,
    n_people: int,
    noise: DetectionNoise,
    occlusion: Occlusion,
    errors: CrowdErrors,
) -> tuple[
    Float[np.ndarray, "image slot joint 2"], Float[np.ndarray, "image slot joint"], Int[np.ndarray, "image slot joint"]
]:
    """Points in undistorted pixels, their confidence, and whose joint each shows."""
    noise_rng, hidden_rng, grab_rng, bias_rng = rngs
    shape, true_px = view.hider.shape, view.true_px
    error = detection_error(noise_rng, shape, view.skeleton, view.fps, noise)
    hidden = hallucination(hidden_rng, shape, view.fps, occlusion)
    tempted = spells(grab_rng, shape, view.fps, errors.grabbed_share, errors.grabbed_s)
    source_px, source = _hiders_joint_px(view, true_px, n_people)
    grabbed = tempted & (source >= 0)
    hallucinated = (view.hider != VISIBLE) & ~grabbed
    pixel_px = error.pixel_px + np.where(hallucinated[..., None], hidden.pixel_px, 0.0)
    if noise.max_bias_m > 0:
        pixel_px = pixel_px + _bias_px(bias_rng, view, noise)
    level = np.where(hallucinated, occlusion.confidence, np.where(grabbed, occlusion.snap_confidence, noise.confidence))
    confidence = stated_confidence(level, pixel_px, error.confidence, view.skeleton, noise)
    points_px = np.where(grabbed[..., None], source_px, true_px) + pixel_px
    found = view.shows(true_px) & view.shows(points_px) & ~(hallucinated & hidden.missing)
    person = np.arange(shape[1])[:, None] % n_people
    joint_of = np.where(grabbed, source, np.where(found & ~hallucinated, person, -1))
    return (
        np.where(found[..., None], points_px, np.nan),
        np.where(found, confidence, 0.0),
        np.where(found, joint_of, -1),
    )


def _hiders_joint_px(
    view: TrueView, true_px: Float[np.ndarray, "image slot joint 2"], n_people: int
) -> tuple[Float[np.ndarray, "image slot joint 2"], Int[np.ndarray, "image slot joint"]]:
    """Of whoever hides a joint, the same joint or the mirrored one, the nearer that is visible; and who that is.

    -1 where nobody else hides the joint, or both are hidden or outside the image.
    """
    visible = (view.hider == VISIBLE) & view.shows(true_px)
    image, slot, joint = np.nonzero(
        (view.hider >= 0) & (view.hider != np.arange(view.hider.shape[1])[:, None] % n_people)
    )
    other = view.hider[image, slot, joint]
    candidates = np.stack([joint, view.skeleton.mirror[joint]], axis=-1)
    at_px = true_px[image[:, None], other[:, None], candidates]
    apart_px = np.linalg.norm(at_px - true_px[image, slot, joint][:, None], axis=-1)
    apart_px = np.where(visible[image[:, None], other[:, None], candidates], apart_px, np.inf)
    nearer = np.argmin(apart_px, axis=-1)
    usable = np.isfinite(apart_px.min(axis=-1))
    source_px, source = np.full(true_px.shape, np.nan), np.full(view.hider.shape, -1)
    source_px[image, slot, joint] = at_px[np.arange(len(image)), nearer]
    source[image, slot, joint] = np.where(usable, other, -1)
    return source_px, source


def _bias_px(
    rng: np.random.Generator, view: TrueView, noise: DetectionNoise
) -> Float[np.ndarray, "image person joint 2"]:
    depth_m = view.camera.to_camera_frame(view.seen_m)[..., 2:]
    n_people, n_joints = view.hider.shape[1:]
    return bias_m(rng, (n_people, n_joints), noise) * np.diag(view.camera.K)[:2] / depth_m
