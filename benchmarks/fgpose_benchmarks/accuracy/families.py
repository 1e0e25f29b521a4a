"""The variants of the open benchmark: families of what can go wrong in a recording."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from fgpose_benchmarks.synthetic import NO_OCCLUSION, AnsweringNetwork, DetectionNoise, Occlusion

Family = Literal["standard", "lasting", "snapping", "real", "confidence", "noise", "fast", "network"]
Layout = Literal["ring", "tilted"]
Offsets = Literal["none", "frames", "subframe"]


@dataclass(frozen=True)
class Variant:
    """What goes wrong in a recording."""

    name: str
    description: str
    family: Family = "standard"
    """Defaults may be chosen on the tuning clips of the standard family only; of the others results are stated."""
    layout: Layout = "ring"
    """ring: as Human3.6M, 4.5 m away and 1.7 m high. tilted: 4 m away, 3.6 m high, looking 40 degrees down."""
    n_cameras: int = 4
    """The first so many of the four cameras; what they see does not depend on how many there are."""
    fps: float | None = None
    """Rate of all cameras; None: that of the clip, 50 Hz."""
    speed: float = 1.0
    """How many times as fast the clip is played."""
    noise: DetectionNoise = field(default_factory=DetectionNoise)
    occlusion: Occlusion = NO_OCCLUSION
    offsets: Offsets = "none"
    """Of the cameras' times, constant: whole frames out of -2, -1, 1, 2, or uniform within half a frame to either side.
    The first camera is always on time."""
    n_shifted: int = 3
    """How many of the other cameras that concerns."""
    bumped: bool = False
    """One camera has been turned by 1 degree and moved by 2 cm since the calibration."""
    lost: bool = False
    """One camera, another than the bumped, sees nothing for 2 s (a third of a shorter clip)."""
    real: tuple[str, ...] = ()
    """Sources of real detection errors (data/detection_errors), of which each clip draws one; none: noise."""
    network: AnsweringNetwork | None = None
    """The joints, with these errors, as a network gives them that always answers; None: of a detector."""


_OCCLUDED = Occlusion()

_STANDARD = (
    Variant("clean", "Four cameras, nothing hidden"),
    Variant("occluded", "Occluders in three of the four views at any time", occlusion=_OCCLUDED),
    Variant(
        "occluded_3_cameras",
        "The same recordings with one camera taken away: two or three of the three views are occluded",
        n_cameras=3,
        occlusion=_OCCLUDED,
    ),
    Variant(
        "occluded_2_cameras",
        "The same recordings with two cameras taken away, 90 degrees apart: one or both views are occluded",
        n_cameras=2,
        occlusion=_OCCLUDED,
    ),
    Variant("desync_1", "One camera is off by one or two frames", offsets="frames", n_shifted=1),
    Variant("desync_2", "Two cameras are off by one or two frames", offsets="frames", n_shifted=2),
    Variant("desync_3", "Three of the four cameras are off by one or two frames", offsets="frames"),
    Variant(
        "desync_3_occluded",
        "Three of the four cameras are off by one or two frames, three of the four views occluded",
        offsets="frames",
        occlusion=_OCCLUDED,
    ),
    Variant("subframe", "Every camera but the first is off by up to half a frame", offsets="subframe"),
    Variant("bumped", "One camera was turned by 1 degree and moved by 2 cm after the calibration", bumped=True),
    Variant("lost", "One camera sees nothing for 2 s", lost=True),
    Variant(
        "industrial",
        "Four strongly tilted cameras 4 m away, 15 Hz, three of the four views occluded, every camera but the first "
        "off by up to half a frame, one camera bumped and another lost for 2 s: all at once",
        layout="tilted",
        fps=15.0,
        occlusion=_OCCLUDED,
        offsets="subframe",
        bumped=True,
        lost=True,
    ),
)


def _with_two_cameras(*variants: Variant) -> tuple[Variant, ...]:
    """Each variant, then the same with two cameras."""
    return tuple(
        each
        for variant in variants
        for each in (
            variant,
            replace(
                variant,
                name=f"{variant.name}_2_cameras",
                description=f"{variant.description}; two cameras taken away",
                n_cameras=2,
            ),
        )
    )


# Its 3D lies on the rays of its 2D, and no joint is missing.
_OF_NETWORK = DetectionNoise(lateral_m=0.0)
_ALWAYS_ANSWERED = Occlusion(missing_share=0.0)

_OTHERS = _with_two_cameras(
    Variant(
        "lasting",
        "As occluded, but occluders stay for 0.5 to 3 s, what they hide is hidden for all of that time, and "
        "hallucinations are correlated over 1.5 s",
        "lasting",
        occlusion=Occlusion(min_duration_s=0.5, max_duration_s=3.0, correlation_s=1.5, whole_periods=True),
    ),
    Variant(
        "snapping",
        "As occluded, but half of the stretches of occlusion show another joint, the mirrored or the nearest visible "
        "one, with the noise and the confidence of a visible joint",
        "snapping",
        occlusion=Occlusion(snap_share=0.5),
    ),
    Variant(
        "real",
        "Errors and confidence of OpenPose or BlazePose on a real recording without occluders",
        "real",
        real=("openpose", "blazepose_full", "blazepose_heavy"),
    ),
    Variant(
        "real_occluded",
        "Errors and confidence of BlazePose on a real recording with cut-outs pasted over the person",
        "real",
        real=("blazepose_full_occluded", "blazepose_heavy_occluded"),
    ),
    Variant(
        "silent_confidence",
        "As occluded, with a confidence that depends neither on the error nor on occlusion",
        "confidence",
        noise=DetectionNoise(confidence_fall_px=0.0),
        occlusion=Occlusion(confidence=DetectionNoise().confidence),
    ),
    Variant(
        "misleading_confidence",
        "As occluded, with the confidence of the right wrist turned round: one minus what it would be",
        "confidence",
        noise=DetectionNoise(misled_joint="right_wrist"),
        occlusion=_OCCLUDED,
    ),
    Variant(
        "precise_120hz",
        "As occluded, at 120 Hz, with noise of 2 px that is not correlated in time",
        "noise",
        fps=120.0,
        noise=DetectionNoise(sigma_px=2.0, correlated_px=0.0, correlation_s=0.0),
        occlusion=_OCCLUDED,
    ),
    Variant(
        "coarse_30hz",
        "As occluded, at 30 Hz, with noise of 12 px that is correlated over 0.4 s",
        "noise",
        fps=30.0,
        noise=DetectionNoise(sigma_px=0.0, correlated_px=12.0, correlation_s=0.4),
        occlusion=_OCCLUDED,
    ),
    Variant(
        "biased_60hz",
        "As occluded, at 60 Hz, with a constant error of 20 to 40 mm of each joint in each view",
        "noise",
        fps=60.0,
        noise=DetectionNoise(min_bias_m=0.02, max_bias_m=0.04),
        occlusion=_OCCLUDED,
    ),
    Variant("fast_2x_25hz", "As clean, with the motion twice as fast, at 25 Hz", "fast", fps=25.0, speed=2.0),
    Variant("fast_3x_60hz", "As clean, with the motion three times as fast, at 60 Hz", "fast", fps=60.0, speed=3.0),
    Variant("fast_4x_30hz", "As clean, with the motion four times as fast, at 30 Hz", "fast", fps=30.0, speed=4.0),
    Variant(
        "fast_4x_30hz_real",
        "As real, with the motion four times as fast, at 30 Hz",
        "fast",
        fps=30.0,
        speed=4.0,
        real=("openpose", "blazepose_full", "blazepose_heavy"),
    ),
    Variant(
        "fast_3x_50hz_occluded",
        "As occluded, with the motion three times as fast, at 50 Hz",
        "fast",
        fps=50.0,
        speed=3.0,
        occlusion=_OCCLUDED,
    ),
    Variant(
        "network",
        "As occluded, from a network that answers for hidden joints too and states no confidence, whose 2D is the "
        "projection of its 3D, and that takes the person for too tall or too small, the same in all views",
        "network",
        noise=_OF_NETWORK,
        occlusion=_ALWAYS_ANSWERED,
        network=AnsweringNetwork(),
    ),
    Variant(
        "network_other_focal",
        "As network, with a focal length that is taken to be a quarter longer than it is",
        "network",
        noise=_OF_NETWORK,
        occlusion=_ALWAYS_ANSWERED,
        network=AnsweringNetwork(focal_ratio=1.25),
    ),
)

VARIANTS = _STANDARD + _OTHERS


def find_variant(name: str) -> Variant:
    """A variant by name. Raises ValueError, which lists them, for an unknown one."""
    for variant in VARIANTS:
        if variant.name == name:
            return variant
    raise ValueError(f"no variant {name!r}; there is {', '.join(variant.name for variant in VARIANTS)}")


def family_of(variant: str) -> Family | None:
    """The family of a variant by name; None for what is not of the open benchmark."""
    return next((known.family for known in VARIANTS if known.name == variant), None)
