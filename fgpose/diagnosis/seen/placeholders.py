"""Missing joints that were written as a place: (0, 0), (-1, -1), 9999, the middle of the image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.body.joint_names import in_words_by_part
from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.sampling import spread_evenly

# Of the detections of a joint in one camera. Where most are at one place, that is where the joint is put; the estimator
# leaves out a few, as it does outliers.
_MOST = 0.5
_FEW = 0.01  # of all detections
_LISTED = 6
_SAMPLED_FRAMES = 2000
_FEWEST, _LEAST_SHARE = 4, 0.002  # detections of a camera at one place, and of all of its
# Different joints at one place to the last digit: outside of the image two are enough, where no network finds any. In
# it, coarse numbers put neighbours at one place, and let joints pass the same; but not nearly all of a body.
_OUTSIDE_JOINTS, _INSIDE_SHARE = 2, 0.75

Place = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Placeholders:
    """Which detections stand at places that are none."""

    of: Mapping[Place, Mapping[int, Bool[np.ndarray, "frame camera joint"]]]
    """By the place in pixels, of each person."""

    @staticmethod
    def among(examined: Examined) -> Placeholders:
        """In the corner of the image, to the last digit, no network finds a joint; other places are those that many
        joints share."""
        sampled_px = [
            seen.points2d_px[spread_evenly(seen.n_frames, _SAMPLED_FRAMES)] for seen in examined.people.values()
        ]
        together_px = np.concatenate(sampled_px)
        sizes_px = (camera.size_px for camera in examined.rig.cameras)
        places = {(0.0, 0.0)}.union(*(_shared(together_px[:, c], size) for c, size in enumerate(sizes_px)))
        by_place = {
            place: {person: (seen.points2d_px == place).all(axis=-1) for person, seen in examined.people.items()}
            for place in sorted(places)
        }
        return Placeholders({place: own for place, own in by_place.items() if any(each.any() for each in own.values())})

    def as_missing(self, examined: Examined) -> Examined:
        """As if missing joints had been given as missing: what is looked at is what was seen."""
        people = dict(examined.people)
        for of_people in self.of.values():
            people = {person: seen.without(of_people[person]) for person, seen in people.items()}
        return replace(examined, people=people)

    def findings(self, examined: Examined) -> list[Finding]:
        seen = np.concatenate([own.seen for own in examined.people.values()])
        return [
            _finding(place, np.concatenate([own[person] for person in examined.people]), seen, examined)
            for place, own in self.of.items()
        ]


def _shared(points_px: Float[np.ndarray, "frame joint 2"], size_px: tuple[int, int]) -> set[Place]:
    """Places of a camera's detections that too many of its joints share."""
    known = np.isfinite(points_px).all(axis=-1)
    joint, known_px = np.nonzero(known)[1], points_px[known]
    places_px, number, counts = np.unique(known_px, axis=0, return_inverse=True, return_counts=True)
    often = np.flatnonzero(counts >= max(_FEWEST, _LEAST_SHARE * len(known_px)))
    most = _INSIDE_SHARE * len(np.unique(joint))
    shared = set()
    for place in often.tolist():
        x_px, y_px = places_px[place].tolist()
        is_outside = not (0 <= x_px <= size_px[0] and 0 <= y_px <= size_px[1])
        if len(np.unique(joint[number == place])) >= (_OUTSIDE_JOINTS if is_outside else most):
            shared.add((x_px, y_px))
    return shared


def _finding(
    place: Place, there: Bool[np.ndarray, "frame camera joint"], seen: np.ndarray, examined: Examined
) -> Finding:
    share = float(there.sum() / seen.sum())
    shares = there.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    skeleton = examined.main.skeleton
    names = skeleton.joints
    joints = [names[j] for j in np.argsort(-shares.max(axis=0), kind="stable") if shares[:, j].any()]
    listed = (
        in_words_by_part(skeleton, joints) if len(joints) <= _LISTED else f"{len(joints)} of the {len(names)} joints"
    )
    cameras = [name for name, own in zip(examined.rig.names, shares, strict=True) if own.any()]
    where = examined.in_words(cameras)
    is_zero = place == (0.0, 0.0)
    return Finding(
        Code.ZERO_KEYPOINTS if is_zero else Code.PLACEHOLDER_KEYPOINTS,
        Severity.WRONG if shares.max() > _MOST else Severity.DOUBTFUL if share > _FEW else Severity.NOTE,
        f"{100 * share:.2g} % of the detections stand at exactly ({place[0]:g}, {place[1]:g}), with a confidence above "
        f"0: missing joints that were written as {'zero' if is_zero else 'a number'}. They are of {listed}, in {where}",
        "Write NaN, or confidence 0, for joints that were not found.",
        min(1.0, 2 * share),
        numbers={"share": share},
    )
