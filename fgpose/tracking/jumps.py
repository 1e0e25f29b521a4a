"""Images that are far later than all before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fgpose.people_observations import Detections

# Nobody who was followed is still there, and no camera is so slow.
_FAR_S = 60.0
# Where the other cameras give no images, so many of one are believed.
_ENOUGH_OF_ONE = 10


class Jumps:
    """Images wait here that are far later than all before: all others would be too old for one wrong stamp. They are
    used when an image of another camera is of about their time, and dropped when one of the former time comes."""

    def __init__(self) -> None:
        self._waiting: tuple[Detections, ...] = ()

    def taken(self, images: Sequence[Detections], newest_s: Mapping[str, float]) -> tuple[list[Detections], Jumps]:
        """Those that are to be used now, and what waits then; these stay as they are.

        Args:
            images: the newest.
            newest_s: of each camera that has given images, when it took the last that was used.
        """
        far_s = max(newest_s.values(), default=float("inf")) + _FAR_S
        used = [image for image in images if image.time_s <= far_s]
        ahead = [image for image in images if image.time_s > far_s]
        waiting = [*self._waiting, *ahead]
        after = Jumps()
        for image in ahead:
            near = [each for each in waiting if abs(each.time_s - image.time_s) <= _FAR_S]
            if len({each.camera for each in near}) >= min(2, len(newest_s)) or len(near) >= _ENOUGH_OF_ONE:
                return [*used, *near], after
        if not used:
            after._waiting = tuple(waiting[-_ENOUGH_OF_ONE * len(newest_s) :])
        return used, after
