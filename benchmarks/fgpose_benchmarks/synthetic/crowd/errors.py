"""What a detector makes of several people besides its noise: whom it misses, doubles, invents, turns or mixes up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fgpose.geometry.camera import Camera
from fgpose_benchmarks.synthetic.noise import check_scales


@dataclass(frozen=True)
class CameraTimes:
    """When the cameras take their images.

    Raises:
        ValueError: there is no rate, or one is not positive and finite.
    """

    fps: tuple[float, ...] = (30.0,)
    """Rates, given to the cameras in turn."""
    random_phases: bool = False
    """Whether every camera begins at a random time within its first period; else all begin at 0 s."""

    def __post_init__(self) -> None:
        if not self.fps or not all(0 < rate < np.inf for rate in self.fps):
            raise ValueError(f"CameraTimes.fps must be positive rates, got {self.fps}")

    def of(self, rng: np.random.Generator, camera: int, duration_s: float) -> Float[np.ndarray, " image"]:
        """Times of all images of a camera from 0 s to the duration."""
        period_s = 1.0 / self.fps[camera % len(self.fps)]
        first_s = rng.random() * period_s if self.random_phases else 0.0
        return first_s + period_s * np.arange(int((duration_s - first_s) / period_s + 1e-9) + 1)


@dataclass(frozen=True)
class CrowdErrors:
    """The shares were not measured: they are assumptions about a good detector in a crowded room.

    What goes wrong lasts for a while: a state is drawn anew at random times, which are the given seconds apart on
    average; 0 s: in every image.

    Raises:
        ValueError: a number is negative or not finite, a share lies outside [0, 1], or a lower limit exceeds its upper.
    """

    min_visible_joints: int = 6
    """A person of whom fewer joints are visible is not detected."""
    missed_share: float = 0.02
    """Share of the images in which a person who could be detected is not."""
    missed_s: float = 0.3
    doubled_share: float = 0.01
    """Share of the detected people who are detected twice, with independent noise."""
    doubled_s: float = 0.2
    flipped_share: float = 0.02
    """Share of the detections whose left and right joints are interchanged, all of them."""
    flipped_s: float = 0.2
    grabbed_share: float = 0.3
    """Share of the hidden joints that are taken from the person who hides them, if they are visible on him: of the same
    joint and the mirrored one, the nearer in the image. The other hidden joints are hallucinated or missing."""
    grabbed_s: float = 0.3
    false_people: float = 0.05
    """Mean number of people in each image of a camera who are not there."""
    min_false_s: float = 0.1
    """A false person stays at a place in the image: uniform from min_false_s ..."""
    max_false_s: float = 0.5
    """... to max_false_s."""
    false_confidence: float = 0.4
    """Mean confidence of the joints of a false person."""
    own_body: bool = False
    """Whether joints behind the person's own body count as hidden. Detectors guess these well."""

    def __post_init__(self) -> None:
        shares = ("missed_share", "doubled_share", "flipped_share", "grabbed_share", "false_confidence")
        check_scales(self, shares=shares)
        if self.min_false_s > self.max_false_s or self.max_false_s == 0:
            raise ValueError("CrowdErrors.min_false_s must not exceed max_false_s, which must be positive")


NO_CROWD_ERRORS = CrowdErrors(
    min_visible_joints=1, missed_share=0.0, doubled_share=0.0, flipped_share=0.0, grabbed_share=0.0, false_people=0.0
)
"""Everybody of whom a joint is visible is detected once; hidden joints are hallucinated or missing."""


def spells(
    rng: np.random.Generator, shape: tuple[int, ...], fps: float, share: float, mean_s: float
) -> Bool[np.ndarray, ...]:
    """States (image, ...) that are on for a share of the images and are drawn anew every mean_s on average."""
    anew = rng.random(shape) < (-np.expm1(-1.0 / (fps * mean_s)) if mean_s > 0 else 1.0)
    state = rng.random(shape) < share
    anew[:1] = True
    image = np.arange(shape[0]).reshape(-1, *(1,) * (len(shape) - 1))
    drawn = np.maximum.accumulate(np.where(anew, image, 0), axis=0)
    return np.take_along_axis(state, drawn, axis=0)


@dataclass(frozen=True, eq=False)
class FalsePerson:
    start_s: float
    end_s: float
    points_px: Float[np.ndarray, "joint 2"]
    """Undistorted pixels."""
    confidence: Float[np.ndarray, " joint"]


def false_people(
    rng: np.random.Generator,
    camera: Camera,
    true_px: Float[np.ndarray, "image person joint 2"],
    duration_s: float,
    errors: CrowdErrors,
) -> list[FalsePerson]:
    """Poses of true people, distorted by a tenth of their height and put at a random place in the image."""
    known = np.argwhere(np.isfinite(true_px).all(axis=(2, 3)))
    mean_s = (errors.min_false_s + errors.max_false_s) / 2
    n = rng.poisson(errors.false_people / mean_s * (duration_s + errors.max_false_s)) if len(known) else 0
    size_px = np.array(camera.size_px, dtype=float)
    found = []
    for _ in range(n):
        image, person = known[rng.integers(len(known))]
        shape_px = true_px[image, person] - true_px[image, person].mean(axis=0)
        shape_px = shape_px * rng.uniform(0.6, 1.2) + 0.1 * np.ptp(shape_px[:, 1]) * rng.standard_normal(shape_px.shape)
        shape_px *= min(1.0, 0.9 * float((size_px / np.ptp(shape_px, axis=0)).min()))
        low_px, high_px = -shape_px.min(axis=0), size_px - 1 - shape_px.max(axis=0)
        start_s = rng.uniform(-errors.max_false_s, duration_s)
        end_s = start_s + rng.uniform(errors.min_false_s, errors.max_false_s)
        confidence = np.clip(errors.false_confidence + 0.15 * rng.standard_normal(len(shape_px)), 0.02, 1.0)
        found.append(FalsePerson(start_s, end_s, shape_px + rng.uniform(low_px, high_px), confidence))
    return found
