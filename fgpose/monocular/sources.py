"""Videos or image folders of calibrated cameras, found and checked before any work is done."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fgpose.association.common_clock import is_far_off
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import later_s
from fgpose.geometry.fitted_camera import fitted_camera
from fgpose.io.names import match_cameras, named_cameras, visible
from fgpose.monocular.clips import VIDEO_SUFFIXES, Clip, open_clip
from fgpose.monocular.image_files import image_files
from fgpose.plain_files import naming

# Numbers of images that go up by more than this in all cameras may be times.
_USUAL_FRAMES_PER_IMAGE = 5
_MILLISECONDS_HZ = 1000.0
# Cameras that are stopped one after the other end within a few frames.
_EARLY_S = 0.1


@dataclass(frozen=True, eq=False)
class Sources:
    """What the cameras of a rig recorded."""

    rig: CameraRig
    """With the intrinsics of the images, see fitted_camera."""
    clips: tuple[Clip, ...]
    """In the order of the rig."""

    @property
    def fps(self) -> float:
        """Of the fastest camera."""
        return max(clip.fps for clip in self.clips)

    def taken_s(self) -> list[np.ndarray]:
        """When the images of each camera, (image,), were taken, by the clock of the rig. Raises ValueError as
        Clip.stamps_s."""
        stamps_s = [clip.times_s(clip.stamps_s()) for clip in self.clips]
        return [own_s + later_s(camera, own_s) for camera, own_s in zip(self.rig.cameras, stamps_s, strict=True)]

    def on_common_clock(self) -> Sources:
        """The same by the clock of the rig, if a camera's time offset is more than half a frame: the clips begin then,
        and the offsets of the rig are zero. See fgpose.association.common_clock."""
        if not is_far_off(self.rig, 1 / self.fps):
            return self
        begins_s = self.rig.time_offsets_s.tolist()
        clips = (
            replace(clip, begin_s=clip.begin_s + late_s) for clip, late_s in zip(self.clips, begins_s, strict=True)
        )
        return Sources(self.rig.with_time_offsets(np.zeros(len(begins_s))), tuple(clips))


def has_videos(path: str | Path) -> bool:
    """Whether there are videos or folders of images of cameras; a single file by its extension. Raises OSError."""
    path = Path(path)
    if path.is_dir():
        return any(_clip_in(entry) is not None for entry in visible(path))
    return path.suffix.lower() in VIDEO_SUFFIXES


def find_clips(
    path: str | Path,
    *,
    fps: float | None = None,
    cameras: tuple[str, ...] = (),
    fps_of_images: float | None = None,
) -> tuple[Clip, ...]:
    """The videos of cameras that are not calibrated yet, by their own names, each probed.

    Args:
        path: as of open_sources.
        fps: as there.
        cameras: use only these, in this order.
        fps_of_images: of folders of images, where fps is not given: their times are their numbers divided by this.

    Warns:
        UserWarning: numbers of images may be milliseconds.

    Raises:
        ValueError: as open_sources; a camera has no video.
        OSError: a file cannot be opened.
    """
    path = Path(path)
    found = _find(path)
    with naming(path):
        names = named_cameras(cameras or found, found)
    each = [(name, found[own]) for name, own in names.items()]
    clips = tuple(open_clip(name, own, fps or (fps_of_images if own.is_dir() else None)) for name, own in each)
    if fps is not None:
        _warn_of_milliseconds(path, clips, fps)
    return clips


def open_sources(
    path: str | Path, rig: CameraRig, *, fps: float | None = None, cameras: tuple[str, ...] = ()
) -> Sources:
    """Find the videos of a rig and probe each: size, number and rate of its images.

    Videos that began at different moments are put together by the time offsets of the rig (Sources.on_common_clock).

    Args:
        path: a folder with one video per camera (``cam01.mp4``) or one folder per camera, which holds its images in
            natural order or a single video. Names are compared as match_cameras does.
        rig: the cameras.
        fps: frames per second; needed for images, overrides what videos say.
        cameras: use only these, in this order. Calibration and videos may then have cameras that the other lacks.

    Warns:
        UserWarning: the size of a video differs from that of its calibration, it ends early, or the numbers of images
            may be milliseconds.

    Raises:
        ValueError: there are no videos, they do not match the calibration, one is damaged or empty, an image cannot be
            read, the size of a video does not fit the calibration, fps is missing; the message names the file.
        OSError: a file cannot be opened.
    """
    path = Path(path)
    found = _find(path)
    matched, rig = _matched(path, found, rig, cameras)
    clips = tuple(open_clip(name, found[matched[name]], fps) for name in rig.names)
    if fps is not None:
        _warn_of_milliseconds(path, clips, fps)
    fitted = CameraRig(
        tuple(fitted_camera(camera, clip.size_px, clip.path) for camera, clip in zip(rig.cameras, clips, strict=True))
    )
    given = Sources(fitted, clips)
    sources = given.on_common_clock()
    # Cameras that begin at different moments also end at different ones.
    if sources is given:
        _warn_of_early_ends(clips)
    return sources


def _find(path: Path) -> dict[str, Path]:
    """Videos and folders of images by their names, in natural order; a folder of nothing but the images of one camera
    by its own name."""
    if path.is_file():
        return {path.stem: path}
    found: dict[str, Path] = {}
    for entry in visible(path):
        clip = _clip_in(entry)
        name = entry.name if entry.is_dir() else entry.stem
        if clip is not None and name in found:
            raise ValueError(
                f"{clip}: camera {name} has {found[name].name} beside it; one video per camera is needed: rename or "
                "move one of the two"
            )
        if clip is not None:
            found[name] = clip
    if not found and image_files(path):
        return {path.absolute().name: path}
    if not found:
        raise ValueError(
            f"{path}: no videos; expected one video per camera (cam01.mp4), or one folder per camera with its images"
        )
    return found


def _clip_in(entry: Path) -> Path | None:
    """The video or the folder of images that an entry of the folder stands for."""
    if not entry.is_dir():
        return entry if entry.suffix.lower() in VIDEO_SUFFIXES else None
    videos = [file for file in visible(entry) if file.suffix.lower() in VIDEO_SUFFIXES and file.is_file()]
    if len(videos) == 1:
        return videos[0]
    return entry if image_files(entry) else None


def _matched(
    path: Path, found: dict[str, Path], rig: CameraRig, cameras: tuple[str, ...]
) -> tuple[dict[str, str], CameraRig]:
    """The name of the video of each camera, and the cameras that are wanted."""
    wanted = rig.subset(cameras) if cameras else rig
    for candidate in dict.fromkeys((rig, wanted)):
        try:
            return match_cameras(found, candidate.names, ignore_others=bool(cameras)), wanted
        except ValueError:
            continue
    raise ValueError(
        f"{path}: its videos ({', '.join(found)}) and the cameras of the calibration ({', '.join(wanted.names)}) "
        "do not have the same names, each once; name the cameras to be used (cameras, --cameras) or rename the videos"
    )


def _warn_of_early_ends(clips: tuple[Clip, ...]) -> None:
    end_s = max(clip.end_s for clip in clips)
    for clip in clips:
        if clip.end_s < end_s - _EARLY_S:
            warnings.warn(
                f"{clip.path}: ends after {clip.end_s:.2f} s, {end_s - clip.end_s:.2f} s before the others; "
                "from there the camera sees nothing",
                stacklevel=3,
            )


def _warn_of_milliseconds(path: Path, clips: tuple[Clip, ...], fps: float) -> None:
    steps = [fps / clip.fps for clip in clips]
    if fps != _MILLISECONDS_HZ and min(steps) > _USUAL_FRAMES_PER_IMAGE:
        warnings.warn(
            f"{path}: the numbers of the images go up by {steps[0]:g}: taken as {clips[0].fps:.3g} images a second; "
            f"if they are milliseconds, give --fps {_MILLISECONDS_HZ:g}",
            stacklevel=3,
        )
