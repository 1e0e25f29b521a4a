"""Which images are used now, and which of them are of one moment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from fgpose.estimation.online.clock_jumps import ENOUGH_OF_ONE, FAR_S
from fgpose.people_observations import Detections


def believed_of(
    images: Sequence[Detections], waiting: Sequence[Detections], newest_s: Mapping[str, float], n_cameras: int
) -> tuple[list[Detections], list[Detections]]:
    """Those that are to be used now, and those that wait: images that are far later than all before, for all others
    would be too old for one wrong stamp. They are used when an image of another camera is of about their time, and
    dropped when one of the former time comes. Images that are given together may share a wrong stamp: they are used
    when those of a later update are of about that time, or later still.

    Args:
        images: the newest.
        waiting: those that wait so far.
        newest_s: of each camera that has given images, when it took the last that was used.
        n_cameras: of the rig.
    """
    # At first the image in the middle is believed: half of the clocks are right.
    first_s = float(np.quantile([image.time_s for image in images], 0.5, method="lower")) if images else np.inf
    far_s = max(newest_s.values(), default=first_s) + FAR_S
    used = [image for image in images if image.time_s <= far_s]
    ahead = [image for image in images if image.time_s > far_s]
    together, n_agreeing = [*waiting, *ahead], min(2, n_cameras)
    for image in ahead:
        near = [each for each in together if abs(each.time_s - image.time_s) <= FAR_S]
        is_later = any(each.time_s < image.time_s or each.camera != image.camera for each in waiting if each in near)
        if is_later and (len({each.camera for each in near}) >= n_agreeing or len(near) >= ENOUGH_OF_ONE):
            return [*used, *near], []
    earlier = [each for each in waiting if each.time_s < min((image.time_s for image in ahead), default=-np.inf)]
    if min(len({each.camera for each in images}) for images in (earlier, ahead)) >= n_agreeing:
        return [*used, *together], []
    return used, [] if used else together[-ENOUGH_OF_ONE * len(newest_s) :]


def moments_of(images: Sequence[Detections]) -> Iterator[list[Detections]]:
    """In the order of time, parted where a camera comes again."""
    moment: list[Detections] = []
    for image in sorted(images, key=lambda image: image.time_s):
        if any(image.camera == other.camera for other in moment):
            yield moment
            moment = []
        moment.append(image)
    if moment:
        yield moment


def times_s(
    images: Sequence[Detections], camera_names: Sequence[str]
) -> tuple[Float[np.ndarray, " camera"], Float[np.ndarray, " camera"]]:
    """When images of different cameras were taken, as these say, and when they arrived; NaN: it is not known."""
    taken_s, arrived_s = np.full((2, len(camera_names)), np.nan)
    for image in images:
        c = camera_names.index(image.camera)
        taken_s[c], arrived_s[c] = image.time_s, np.nan if image.arrived_s is None else image.arrived_s
    return taken_s, arrived_s
