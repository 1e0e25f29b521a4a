"""Following people back from where they were first found, to where one camera alone sees them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from fgpose.association.moment import Moment, follow
from fgpose.association.pose_filter import PoseFilters
from fgpose.people_observations import NOBODY
from fgpose.skeleton import Skeleton

# Who is not detected for so long is not followed farther back: one camera alone does not tell the distance, and what it
# shows after a gap may be somebody else.
_GAP_S = 0.2


def look_back(
    moments: Iterator[tuple[int, Moment]],
    first: Mapping[int, tuple[int, PoseFilters]],
    skeleton: Skeleton,
) -> Iterator[tuple[int, int, int, np.ndarray, np.ndarray]]:
    """Give people detections that are nobody's, from where they were first found backwards in time.

    Args:
        moments: frames in reversed order, with their detections that are nobody's.
        first: of each track the frame in which it begins, and the pose then.
        skeleton: the joints.

    Yields:
        Track, frame, number of the camera in the moment, and for every joint the number of the detection (or NOBODY)
        and that of its joint.
    """
    mirror = skeleton.mirror
    poses: dict[int, PoseFilters] = {}
    seen_s: dict[int, float] = {}
    for frame, moment in moments:
        now_s = -float(moment.times_s.min())
        poses = {track: pose for track, pose in poses.items() if now_s - seen_s[track] <= _GAP_S}
        if poses:
            backwards = replace(moment, times_s=-moment.times_s)
            tracks, equal = list(poses), np.zeros(len(poses), dtype=int)
            people, matches = follow(PoseFilters.stacked(list(poses.values())), equal, backwards, mirror)
            poses = {track: people[k : k + 1] for k, track in enumerate(tracks)}
            for c, k in np.argwhere((matches.detection != NOBODY).any(axis=-1)).tolist():
                seen_s[tracks[k]] = now_s
                yield tracks[k], frame, c, matches.detection[c, k], matches.joint[c, k]
        begun = {track: pose.reversed for track, (at, pose) in first.items() if at == frame}
        poses, seen_s = poses | begun, seen_s | dict.fromkeys(begun, now_s)
