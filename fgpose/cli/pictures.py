"""Showing the images of videos in a recording, each in its frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from fgpose.cli.console import progress_bar
from fgpose.correspondences import NO_IMAGE
from fgpose.geometry.changing_rig import later_s
from fgpose.sampling import TIME_ROUNDING_S, nearest, stretches, usual_step_s

if TYPE_CHECKING:
    from fgpose.geometry.camera import CameraRig
    from fgpose.monocular.clips import Clip
    from fgpose.monocular.detected import Detected
    from fgpose.monocular.sources import Sources
    from fgpose.pipeline import SeenWalk
    from fgpose.viewer import CalibrationRecording
    from fgpose.viewer.recording import Session

# An image belongs to a frame if it is no further away than this share of the usual step between images.
_REACH = 0.6


def show_images(detected: Detected, rig: CameraRig, time_s: Float[np.ndarray, " frame"], recording: Session) -> None:
    """Show the images of every camera, each in its frame; the videos are decoded again.

    Args:
        detected: in the videos.
        rig: as of Origin: with the clocks that were found.
        time_s: of the frames, by these clocks.
        recording: where they are shown.
    """
    taken_s, cameras = [], rig.subset(detected.rig.names).cameras
    for camera, clip, view in zip(cameras, detected.sources.clips, detected.views, strict=True):
        stamp_s = clip.times_s(view.stamps_s) - clip.begin_s
        taken_s.append(stamp_s + later_s(camera, stamp_s))
    show_matched_images(detected.sources, _nearest_images(taken_s, time_s), time_s, recording)


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
            for frame in _gone(image[:, c] != NO_IMAGE, time_s):
                recording.log_no_image(name, frame, float(time_s[frame]))
            frame_of = {number: frame for frame, number in enumerate(image[:, c].tolist()) if number != NO_IMAGE}
            for picture in islice(clip.pictures(), max(frame_of, default=-1) + 1):
                frame = frame_of.get(picture.number)
                if frame is not None and recording.wants_image(name, frame):
                    recording.log_image(name, frame, float(time_s[frame]), picture.image)
                progress(c * len(image) + (frame or 0), image.size)
        progress(image.size, image.size)


def _gone(has_image: Bool[np.ndarray, " frame"], time_s: Float[np.ndarray, " frame"]) -> list[int]:
    """The frames from which on a camera has no image for longer than from one to its next."""
    shown_s = time_s[has_image]
    if len(shown_s) < 2:
        return []
    last = np.maximum.accumulate(np.where(has_image, np.arange(len(time_s)), -1))
    patience_s = usual_step_s(shown_s) + usual_step_s(time_s) - TIME_ROUNDING_S
    is_gone = (last >= 0) & (time_s - time_s[last] >= patience_s)
    return [first for first, _ in stretches(is_gone)]


def show_walk_images(detected: Detected, seen: SeenWalk, recording: CalibrationRecording) -> None:
    """Show a calibration, and under the joints of each frame the images that are nearest to it by the clock that was
    found."""
    from fgpose.pipeline import show_walk

    show_walk(seen, recording)
    taken_s = [detected.people.times_s(camera.name) + camera.time_offset_s for camera in seen.rig.cameras]
    sources = detected.recalibrated(seen.rig).sources
    show_matched_images(sources, _nearest_images(taken_s, seen.walk.time_s), seen.walk.time_s, recording)


def show_board_images(
    clips: Sequence[Clip], begins_s: Float[np.ndarray, " camera"], seen: SeenWalk, recording: CalibrationRecording
) -> None:
    """The same of a calibration with a board; begins_s: when each camera began."""
    from fgpose.monocular.sources import Sources
    from fgpose.pipeline import show_walk

    show_walk(seen, recording)
    taken_s = [clip.taken_s() + begin_s for clip, begin_s in zip(clips, begins_s, strict=True)]
    image = _nearest_images(taken_s, seen.walk.time_s)
    show_matched_images(Sources(seen.rig, tuple(clips)), image, seen.walk.time_s, recording)


def _nearest_images(
    taken_s: Sequence[Float[np.ndarray, " _"]], time_s: Float[np.ndarray, " frame"]
) -> Int[np.ndarray, "frame camera"]:
    """Of each camera the image that is nearest to each frame, if no other frame is nearer to it; NO_IMAGE: there is
    none."""
    image, frames = np.full((len(time_s), len(taken_s)), NO_IMAGE), np.arange(len(time_s))
    for c, own_s in enumerate(taken_s):
        number = nearest(time_s, own_s)
        is_near = np.abs(own_s[number] - time_s) <= _REACH * usual_step_s(own_s)
        belongs = is_near & (nearest(own_s, time_s)[number] == frames)
        image[belongs, c] = number[belongs]
    return image
