"""Joints that stand at (0, 0): missing ones, which were not written as missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from fgpose.diagnosis.body.joint_names import in_words
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.observations import Observations, blanked

# Of the detections of a joint in one camera. Where most are at (0, 0), that is where the joint is put; the estimator
# leaves out a few, as it does outliers.
_MOST = 0.5
_FEW = 0.01  # of all detections
_LISTED = 6


def zero_keypoints(examined: Examined) -> list[Finding]:
    """Detections in the corner of the image: to the last digit, no network finds a joint there."""
    zero, seen = (
        np.concatenate([each[person] for person in examined.people])
        for each in (_zero(examined.people), {person: own.seen for person, own in examined.people.items()})
    )
    if not zero.any():
        return []
    share = float(zero.sum() / seen.sum())
    shares = zero.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    names = examined.main.skeleton.joints
    joints = [names[j] for j in np.argsort(-shares.max(axis=0), kind="stable") if shares[:, j].any()]
    listed = in_words(joints) if len(joints) <= _LISTED else f"{len(joints)} of the {len(names)} joints"
    cameras = [name for name, own in zip(examined.rig.names, shares, strict=True) if own.any()]
    where = "all cameras" if len(cameras) == examined.rig.n_cameras else ", ".join(cameras)
    severity = Severity.WRONG if shares.max() > _MOST else Severity.DOUBTFUL if share > _FEW else Severity.NOTE
    return [
        Finding(
            Code.ZERO_KEYPOINTS,
            severity,
            f"{100 * share:.2g} % of the detections stand at exactly (0, 0), with a confidence above 0: missing joints "
            f"that were written as zero. They are of {listed}, in {where}",
            "Write NaN, or confidence 0, for joints that were not found.",
            min(1.0, 2 * share),
            numbers={"share": share},
        )
    ]


def without_zeros(examined: Examined) -> Examined:
    """As if missing joints had been given as missing: what is looked at is what was seen."""
    zero = _zero(examined.people)
    people = {person: _blanked(seen, zero[person]) for person, seen in examined.people.items()}
    return replace(examined, people=people)


def _zero(people: Mapping[int, Observations]) -> dict[int, Bool[np.ndarray, "frame camera joint"]]:
    return {person: np.asarray((seen.points2d_px == 0).all(axis=-1)) for person, seen in people.items()}


def _blanked(seen: Observations, zero: Bool[np.ndarray, "frame camera joint"]) -> Observations:
    if not zero.any():
        return seen
    return replace(seen, **seen.per_detection(lambda array: blanked(array, zero)))
