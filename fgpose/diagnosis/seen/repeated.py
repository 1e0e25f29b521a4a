"""Images that are given several times: a video of a lower rate, written at a higher one, or a camera that hung."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from fgpose.diagnosis.examined import Examined
from fgpose.finding import Code, Finding, Severity
from fgpose.observations import Observations
from fgpose.sampling import frames_per_second, stretches

_FEWEST_JOINTS = 5
_LONGEST = 7  # frames: what stands still for longer is frozen
_FEWEST = 10  # repetitions
# A recorder that fills in an image now and then does little harm; 25 written as 30 are one of six.
_OFTEN = 0.1
# Of the joints of an image that is new, so few are where they were: numbers are not so coarse that most joints of
# somebody who stands still stay the same.
_FEW_EQUAL = 0.2
_REGULAR = 0.05  # from a whole number of times
_FROZEN_FRAMES, _FROZEN_S = 8, 0.3
_OTHERS_MOVE = 0.5  # in so many of these frames another camera shows something new


def repeats(seen: Observations) -> tuple[Bool[np.ndarray, "frame camera"], Bool[np.ndarray, "frame camera"]]:
    """Whether each image shows exactly what the one before does, and whether both show somebody. Networks give the same
    numbers to the last digit only for the same image."""
    both, equal = _equal(seen)
    judged = both.sum(axis=-1) >= _FEWEST_JOINTS
    return judged & (equal.sum(axis=-1) == both.sum(axis=-1)), judged


def repeated_images(examined: Examined) -> list[Finding]:
    """Every second image, or one of six, is that before it."""
    names, rate_hz = examined.rig.names, frames_per_second(examined.main.frame_time_s)
    if examined.association is None:
        shares = [_share(examined.main.subset([name])) for name in names]
    else:
        same, judged = examined.association.repeated
        shares = [_share_of(*each) for each in zip(same.T, judged.T, strict=True)]
    found = [c for c, share in enumerate(shares) if share > _OFTEN]
    if len(found) == len(names) and np.ptp(shares) < _REGULAR:
        return [_repeated("", float(np.mean(shares)), rate_hz)]
    return [_repeated(names[c], shares[c], rate_hz) for c in found]


def _equal(seen: Observations) -> tuple[Bool[np.ndarray, "frame camera joint"], Bool[np.ndarray, "frame camera joint"]]:
    """Which joints an image and the one before it show, and which of them are at the same place; none of the first."""
    both, equal = np.zeros((2, *seen.seen.shape), dtype=bool)
    both[1:] = seen.seen[1:] & seen.seen[:-1]
    equal[1:] = both[1:] & (seen.points2d_px[1:] == seen.points2d_px[:-1]).all(axis=-1)
    return both, equal


def _share(view: Observations) -> float:
    """Of the images of one camera: how many repeat the one before, if new ones do not show most joints where they
    were."""
    same, judged = (each[:, 0] for each in repeats(view))
    share, new = _share_of(same, judged), judged & ~same
    if not share:
        return 0.0
    both, equal = (each[new, 0].sum() for each in _equal(view))
    return share if equal < _FEW_EQUAL * both else 0.0


def _share_of(same: Bool[np.ndarray, " frame"], judged: Bool[np.ndarray, " frame"]) -> float:
    """Without the times in which they stand still; 0 where there is hardly one."""
    same, judged = same.copy(), judged.copy()
    for first, end in stretches(same):
        if end - first > _LONGEST:
            same[first:end] = judged[first:end] = False
    return float(same.sum() / judged.sum()) if same.sum() >= _FEWEST and (judged & ~same).any() else 0.0


def _repeated(camera: str, share: float, rate_hz: float) -> Finding:
    """Of one camera; empty: of all."""
    times, often = 1 / (1 - share), f"{100 * share:.0f} % of the images are repeated"
    if times > 2 - _REGULAR and abs(times - round(times)) < _REGULAR:
        times = round(times)
        often = f"each image comes {times} times"
    true_hz = rate_hz / times
    who = camera or "all cameras"
    return Finding(
        Code.REPEATED_IMAGES,
        Severity.DOUBTFUL,
        f"Of {who} {often}, with keypoints that are the same to the last digit: {true_hz:.3g} images a second were "
        f"taken, not {rate_hz:.3g}",
        "Detect in the original video: repeated keypoints claim to know where somebody is between its images.",
        0.4,
        camera=camera,
        numbers={"share": share, "true_hz": true_hz},
    )


def frozen_cameras(examined: Examined) -> list[Finding]:
    """The same keypoints to the last digit for long."""
    if examined.association is not None:
        # Of whole images: what comes again is given to nobody.
        names, time_s = examined.rig.names, examined.association.frames.frame_time_s
        return _frozen(names, time_s, *examined.association.repeated)
    found = []
    for person, seen in examined.people.items():
        found += _frozen(seen.camera_names, seen.frame_time_s, *repeats(seen), examined.number(person))
    return found


def _frozen(
    names: Sequence[str],
    time_s: Float[np.ndarray, " frame"],
    same: Bool[np.ndarray, "frame camera"],
    judged: Bool[np.ndarray, "frame camera"],
    person: int | None = None,
) -> list[Finding]:
    found = []
    for c, name in enumerate(names):
        others_new = np.asarray(np.delete(judged & ~same, c, axis=1).any(axis=1))
        runs = _runs(same[:, c], others_new, time_s)
        if runs:
            found.append(_stands_still(name, runs, person))
    return found


def _runs(
    same: Bool[np.ndarray, " frame"], others_new: Bool[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]
) -> list[tuple[float, float]]:
    runs = [(first - 1, last - 1) for first, last in stretches(same)]  # with the image that is repeated
    return [
        (float(time_s[first]), float(time_s[last]))
        for first, last in runs
        if last - first >= _FROZEN_FRAMES
        and time_s[last] - time_s[first] >= _FROZEN_S
        and np.mean(others_new[first + 1 : last + 1]) > _OTHERS_MOVE
    ]


def _stands_still(name: str, runs: list[tuple[float, float]], person: int | None) -> Finding:
    start_s, end_s = max(runs, key=lambda run: run[1] - run[0])
    total_s = sum(b - a for a, b in runs)
    more = f", the longest of {len(runs)} such times" if len(runs) > 1 else ""
    return Finding(
        Code.FROZEN_CAMERA,
        Severity.WRONG,
        f"The image of {name} stands still from {start_s:.2f} to {end_s:.2f} s{more}: its keypoints are the same to "
        "the last digit while other cameras show motion",
        "The camera or its recorder hung. While others move its detections are left out: record again if it is needed.",
        0.7,
        camera=name,
        person=person,
        from_s=start_s,
        to_s=end_s,
        numbers={"total_s": total_s},
    )
