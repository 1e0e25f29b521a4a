"""Occluders, and what a monocular estimator hallucinates behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose_benchmarks.synthetic.noise import check_scales, correlated_normal

# Flesh around the joints: 3 % of a standing person's height is about 5 cm. With it about a quarter of all joints are
# occluded by default.
_BOX_MARGIN = 0.03


@dataclass(frozen=True)
class Occlusion:
    """Occluders of Human3.6M-Occluded, and what the estimator makes of the joints behind them: it hallucinates.

    Raises:
        ValueError: a number is negative or not finite, or a share lies outside [0, 1].
    """

    n_views: int = 3
    """Views with occluders at any one time, drawn at random."""
    n_occluders: int = 2
    """Occluders in each of these views, rectangles and ellipses at random; their centre is uniform in the person's
    box."""
    min_scale: float = 0.5
    """Short side of an occluder over the short side of the person's box: uniform from min_scale ..."""
    max_scale: float = 1.0
    """... to max_scale."""
    max_aspect: float = 1.5
    """Long side of an occluder over its short side: uniform from 1 to this."""
    min_duration_s: float = 1.0
    """Views and occluders are drawn anew after a time uniform from min_duration_s ..."""
    max_duration_s: float = 2.0
    """... to max_duration_s."""
    hallucination_px: float = 45.0
    """SD of each pixel coordinate of an occluded joint, added to the noise of a visible one. Its 3D joint lies on the
    same wrong ray: 45 px are 0.18 m at 4.5 m and 1145 px."""
    hallucination_depth_m: float = 0.15
    """SD of the depth error of an occluded joint, added to that of a visible one, metres."""
    correlation_s: float = 0.3
    """Time constant of the hallucination, seconds."""
    missing_share: float = 0.1
    """Share of the occluded detections that are missing altogether, for a while each."""
    confidence: float = 0.55
    """Mean confidence of an occluded joint that happens to be exact."""
    whole_periods: bool = False
    """A joint that is behind occluders for half of a period or longer is hidden for all of it, any other for none: a
    hallucination lasts as long as the occluders stay, however the person moves."""
    snap_share: float = 0.0
    """Share of the stretches of occlusion in which another joint is taken for the occluded one: the detection follows
    the mirrored joint or, where there is none, the nearest visible joint, with the noise of a visible one."""
    snap_confidence: float = 0.8
    """Mean confidence of a snapped detection that hits the wrong joint exactly; by default as of a visible joint."""

    def __post_init__(self) -> None:
        check_scales(self, shares=("missing_share", "confidence", "snap_share", "snap_confidence"))
        for low, high in (("min_scale", "max_scale"), ("min_duration_s", "max_duration_s")):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"Occlusion.{low} must not exceed {high}")
        if self.min_duration_s == 0 or self.max_aspect < 1:
            raise ValueError("Occlusion.min_duration_s must be positive and max_aspect at least 1")


NO_OCCLUSION = Occlusion(n_views=0)
"""Every camera sees every joint."""


@dataclass(frozen=True)
class Hallucination:
    """Error that an occluded joint has on top of that of a visible one."""

    pixel_px: Float[np.ndarray, "frame camera joint 2"]
    depth_m: Float[np.ndarray, "frame camera joint"]
    missing: Bool[np.ndarray, "frame camera joint"]
    """Whether an occluded joint is not detected at all."""


def hallucination(rng: np.random.Generator, shape: tuple[int, ...], fps: float, occlusion: Occlusion) -> Hallucination:
    """Hallucinations of all joints of shape (frames, cameras, joints), for those that turn out to be occluded."""
    from scipy.special import ndtr

    draws = correlated_normal(rng, (*shape, 4), fps, occlusion.correlation_s)
    return Hallucination(
        occlusion.hallucination_px * draws[..., :2],
        occlusion.hallucination_depth_m * draws[..., 2],
        ndtr(draws[..., 3]) < occlusion.missing_share,
    )


@dataclass(frozen=True)
class _Occluders:
    """Occluders of every frame, in units of the person's box; none in a view that is not drawn."""

    centre: Float[np.ndarray, "frame camera occluder 2"]
    """From the upper left corner, over the size of the box."""
    sides: Float[np.ndarray, "frame camera occluder 2"]
    """Over the short side of the box."""
    is_ellipse: Bool[np.ndarray, "frame camera occluder"]
    drawn: Bool[np.ndarray, "frame camera"]
    period: Int[np.ndarray, " frame"]
    """Ascending number of the period."""


def occluded_joints(
    rng: np.random.Generator, true_px: Float[np.ndarray, "frame camera joint 2"], fps: float, occlusion: Occlusion
) -> Bool[np.ndarray, "frame camera joint"]:
    """Whether an occluder hides each true joint; they stay for a while and move with the person's box."""
    n_frames, n_cameras = true_px.shape[:2]
    occluders = _draw_occluders(rng, np.arange(n_frames) / fps, n_cameras, occlusion)
    low_px, size_px = _person_box(true_px)
    centre_px = low_px[:, :, None] + occluders.centre * size_px[:, :, None]
    half_px = np.maximum(occluders.sides * size_px.min(axis=-1)[..., None, None] / 2, 1e-9)
    # (frame, camera, joint, occluder, 2): distance from the centre of the occluder in its half sides.
    distance = np.abs(true_px[..., None, :] - centre_px[:, :, None]) / half_px[:, :, None]
    in_ellipse, in_rectangle = np.sum(distance**2, axis=-1) <= 1, distance.max(axis=-1) <= 1
    hidden = np.where(occluders.is_ellipse[:, :, None], in_ellipse, in_rectangle).any(axis=-1)
    hidden &= occluders.drawn[..., None]
    return _for_whole_periods(hidden, occluders.period) if occlusion.whole_periods else hidden


def _for_whole_periods(
    hidden: Bool[np.ndarray, "frame camera joint"], period: Int[np.ndarray, " frame"]
) -> Bool[np.ndarray, "frame camera joint"]:
    """Hidden for all of a period where it is for half of it or longer, else for none of it."""
    _, starts, number, counts = np.unique(period, return_index=True, return_inverse=True, return_counts=True)
    share = np.add.reduceat(hidden.astype(float), starts, axis=0) / counts[:, None, None]
    return (share >= 0.5)[number]


def _draw_occluders(
    rng: np.random.Generator, time_s: Float[np.ndarray, " frame"], n_cameras: int, occlusion: Occlusion
) -> _Occluders:
    n_periods = int(np.ceil(time_s[-1] / occlusion.min_duration_s)) + 1
    ends_s = np.cumsum(rng.uniform(occlusion.min_duration_s, occlusion.max_duration_s, n_periods))
    shape = (n_periods, n_cameras, occlusion.n_occluders)
    short_side = rng.uniform(occlusion.min_scale, occlusion.max_scale, shape)
    aspect = rng.uniform(1.0, occlusion.max_aspect, shape)
    is_wide = rng.random(shape) < 0.5
    sides = np.stack([np.where(is_wide, aspect, 1.0), np.where(is_wide, 1.0, aspect)], axis=-1) * short_side[..., None]
    rank = rng.permuted(np.tile(np.arange(n_cameras), (n_periods, 1)), axis=1)
    period = np.searchsorted(ends_s, time_s, side="right")
    return _Occluders(
        rng.random((*shape, 2))[period],
        sides[period],
        (rng.random(shape) < 0.5)[period],
        (rank < occlusion.n_views)[period],
        period,
    )


def _person_box(
    true_px: Float[np.ndarray, "frame camera joint 2"],
) -> tuple[Float[np.ndarray, "frame camera 2"], Float[np.ndarray, "frame camera 2"]]:
    """Upper left corner and size of the person's box; nothing where no joint is in front of the camera."""
    known = np.isfinite(true_px)
    low = np.where(known, true_px, np.inf).min(axis=2)
    high = np.where(known, true_px, -np.inf).max(axis=2)
    empty = low > high
    low, high = np.where(empty, 0.0, low), np.where(empty, 0.0, high)
    margin = _BOX_MARGIN * (high - low).max(axis=-1, keepdims=True)
    return low - margin, high - low + 2 * margin
