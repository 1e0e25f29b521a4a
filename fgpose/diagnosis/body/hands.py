"""Hands that hang on the other arm: their lists were exchanged when the keypoints were written."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fgpose.calibration.from_people.body_size import mean_joint
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import spread_evenly
from fgpose.skeleton import BodyPart, Skeleton

_FRAMES, _FEWEST = 500, 10
_MOSTLY = 0.5


def exchanged_hands(examined: Examined) -> list[Finding]:
    """Cameras in whose images hands are mostly at the wrist of the other arm."""
    skeleton, seen = examined.main.skeleton, examined.main.frames(spread_evenly(examined.main.n_frames, _FRAMES))
    pairs = list(_pairs(skeleton))
    if not pairs:
        return []
    shares = np.array([[_share(seen.points2d_px[:, c], *pair) for pair in pairs] for c in range(seen.n_cameras)])
    worst = np.nan_to_num(shares).max(axis=1)
    cameras = [name for name, share in zip(seen.camera_names, worst.tolist(), strict=True) if share > _MOSTLY]
    if not cameras:
        return []
    share = float(worst[worst > _MOSTLY].min())
    return [
        Finding(
            Code.EXCHANGED_SIDES,
            Severity.WRONG,
            f"Left and right hand are exchanged in {examined.in_words(cameras)}: they are at the wrists of the other "
            f"arms in {100 * share:.0f} % of the images or more",
            "Exchange the lists of the hands in the keypoints, or see that the order of the joints is that of the "
            "skeleton.",
            1.0,
            camera=cameras[0] if len(cameras) == 1 else "",
            numbers={"share": share},
        )
    ]


def _pairs(skeleton: Skeleton) -> Iterator[tuple[BodyPart, BodyPart]]:
    for one, other in combinations(skeleton.parts, 2):
        holder = one.hangs_on[0]
        if skeleton.mirror[holder] == other.hangs_on[0] != holder:
            yield one, other


def _share(points_px: Float[np.ndarray, "frame joint 2"], one: BodyPart, other: BodyPart) -> float:
    """Of the hands that are at one of two wrists apart; NaN: too few are."""
    wrists_px = points_px[:, [one.hangs_on[0], other.hangs_on[0]]]
    hands_px = np.stack([mean_joint(points_px[:, each.joints]) for each in (one, other)], axis=1)
    away_px = np.linalg.norm(hands_px[:, :, None] - wrists_px[:, None], axis=-1)
    own_px, other_px = away_px[:, [0, 1], [0, 1]], away_px[:, [0, 1], [1, 0]]
    apart_px = np.linalg.norm(wrists_px[:, 0] - wrists_px[:, 1], axis=-1, keepdims=True)
    tells = np.minimum(own_px, other_px) < apart_px / 2
    return float(np.mean(other_px[tells] < own_px[tells])) if tells.sum() >= _FEWEST else np.nan
