"""Showing the images of videos in a recording, each in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from fgpose.cli.console import progress_bar
from fgpose.correspondences import NO_IMAGE
from fgpose.sampling import nearest

if TYPE_CHECKING:
    from fgpose.monocular.clips import Clip
    from fgpose.monocular.detected import Detected
    from fgpose.monocular.sources import Sources
    from fgpose.pipeline import SeenWalk
    from fgpose.viewer import CalibrationRecording
    from fgpose.viewer.recording import Session

# An image belongs to a frame of the walk if it is the nearest and no further away than this share of the usual step.
_REACH = 0.6


def show_images(detected: Detected, time_s: Float[np.ndarray, " frame"], recording: Session) -> None:
    """Show the images of every camera, each in its frame; the videos are decoded again."""
    show_matched_images(detected.sources, detected.frames.image[: len(time_s)], time_s, recording)


def show_matched_images(
    sources: Sources,
    image: Int[np.ndarray, "frame camera"],
    time_s: Float[np.ndarray, " frame"],
    recording: Session,
) -> None:
    """Show the images that belong to each frame, NO_IMAGE where there is none."""
    if not any(recording.wants_image(name, 0) for name in sources.rig.names):
        return
    with progress_bar("adding images", "images") as progress:
        for c, (name, clip) in enumerate(zip(sources.rig.names, sources.clips, strict=True)):
            frame_of = {number: frame for frame, number in enumerate(image[:, c].tolist()) if number != NO_IMAGE}
            for picture in islice(clip.pictures(), max(frame_of, default=-1) + 1):
                frame = frame_of.get(picture.number)
                if frame is not None and recording.wants_image(name, frame):
                    recording.log_image(name, frame, float(time_s[frame]), picture.image)
                progress(c * len(image) + (frame or 0), image.size)
        progress(image.size, image.size)


def show_walk_images(detected: Detected, seen: SeenWalk, recording: CalibrationRecording) -> None:
    """Show a calibration, and under the joints of each frame the images that are nearest to it by the clock that was
    found."""
    from fgpose.pipeline import show_walk

    show_walk(seen, recording)
    taken_s = [detected.people.times_s(camera.name) + camera.time_offset_s for camera in seen.rig.cameras]
    sources = detected.recalibrated(seen.rig).sources
    show_matched_images(sources, _nearest_images(taken_s, seen.walk.time_s), seen.walk.time_s, recording)


def show_board_images(
    clips: Sequence[Clip], start_s: Float[np.ndarray, " camera"] | None, seen: SeenWalk, recording: CalibrationRecording
) -> None:
    """The same of a calibration with a board; start_s: when each camera began, None: all at once."""
    from fgpose.monocular.sources import Sources
    from fgpose.pipeline import show_walk

    show_walk(seen, recording)
    begins_s = np.zeros(len(clips)) if start_s is None else start_s
    taken_s = [clip.taken_s() + begin_s for clip, begin_s in zip(clips, begins_s, strict=True)]
    image = _nearest_images(taken_s, seen.walk.time_s)
    show_matched_images(Sources(seen.rig, tuple(clips)), image, seen.walk.time_s, recording)


def _nearest_images(
    taken_s: Sequence[Float[np.ndarray, " _"]], time_s: Float[np.ndarray, " frame"]
) -> Int[np.ndarray, "frame camera"]:
    """Of each camera the image that is nearest to each frame; NO_IMAGE: none is near."""
    image = np.full((len(time_s), len(taken_s)), NO_IMAGE)
    for c, own_s in enumerate(taken_s):
        number = nearest(time_s, own_s)
        is_near = np.abs(own_s[number] - time_s) <= _REACH * float(np.median(np.diff(own_s)))
        image[is_near, c] = number[is_near]
    return image
