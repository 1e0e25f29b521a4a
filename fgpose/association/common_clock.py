"""One clock for all images, where cameras began at different moments, and one pose for each camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.changing_rig import TOGETHER_S, held_by, in_pieces, is_changing, later_s, pieces_of
from fgpose.observations import Observations
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.sampling import usual_step_s

# Images whose stamps differ by more frames than this are not taken to be of one moment (match_frames); up to there the
# estimator corrects for the delay by the motion.
_DELAYS_FRAMES = 0.5

Recording = TypeVar("Recording", Observations, PeopleObservations)


def on_common_clock(people: Recording, rig: CameraRig) -> tuple[Recording, CameraRig]:
    """The recording by the clock of the rig, if a camera's time offset is more than half a frame, if a clock or a pose
    changes, if most frames hold images of other moments by the times of the cameras (are_far_apart) or if cameras take
    turns so that most frames are one image (single_images_together); else as it is.

    The estimators correct small offsets by the motion of the joints. Videos that began seconds apart must have the
    right images put together first: the clocks of the rig are applied to the times of the images, and its offsets are
    zero then. A camera that was moved while it filmed becomes several, one for each pose; the second is called
    ``cam2@18.0s`` if that was at 18 s.

    Args:
        people: what the cameras saw, of one person or of everybody, by their time stamps.
        rig: as it is in its file.

    Raises:
        ValueError: the cameras of people and rig differ.
    """
    people.check_cameras(rig.names)
    if isinstance(people, PeopleObservations):
        step_s = min(usual_step_s(people.times_s(name)) for name in rig.names)
    else:
        step_s = usual_step_s(people.frame_time_s)
    is_off = is_changing(rig) or is_far_off(rig, step_s) or are_far_apart(people, step_s)
    return _together(people, rig, in_any_case=is_off) or (people, rig)


def single_images_together(people: Recording, rig: CameraRig) -> tuple[Recording, CameraRig] | None:
    """The recording by the clock of the rig, where most frames that show somebody show them in one camera and the
    cameras take turns: then images of different cameras make one frame, and most frames have several. Else None.

    It makes no difference whether a camera whose turn it is not has no image, or one that shows nobody.
    """
    return _together(people, rig, in_any_case=False)


def _together(people: Recording, rig: CameraRig, *, in_any_case: bool) -> tuple[Recording, CameraRig] | None:
    """By the clock of the rig: the images of cameras that take turns, else all or, if that is not the case, None."""
    is_of_single_views = _is_of_single_views(people)
    if not is_of_single_views and not in_any_case:
        return None
    everybody, pieces = _everybody(people, rig), in_pieces(rig)
    by_name = dict(zip(rig.names, rig.cameras, strict=True))
    on_clock = {image: _on_clock(image, by_name[image.camera]) for image in everybody.images}

    def recording(images: Iterable[Detections]) -> PeopleObservations:
        # Without given_frames: which images belong together is what was wrong.
        shown = _without_doubles(on_clock[image] for image in images)
        return PeopleObservations(everybody.skeleton, pieces.names, shown, remarks=everybody.remarks)

    if is_of_single_views:
        turns = recording(_without_empty_images(everybody))
        if not _is_of_single_views(turns):
            return _as_given(people, turns), pieces
    return (_as_given(people, recording(everybody.images)), pieces) if in_any_case else None


def _is_of_single_views(people: Recording) -> bool:
    """Whether most frames that show somebody show them in one of several cameras."""
    n_showing = people.n_showing if isinstance(people, PeopleObservations) else people.seen.any(axis=2).sum(axis=1)
    is_most = 2 * np.count_nonzero(n_showing == 1) > np.count_nonzero(n_showing)
    return len(people.camera_names) > 1 and bool(is_most)


def _everybody(people: Recording, rig: CameraRig) -> PeopleObservations:
    if isinstance(people, PeopleObservations):
        return people
    return PeopleObservations.of_one(replace(people, camera_names=rig.names))


def _as_given(people: Recording, everybody: PeopleObservations) -> Recording:
    """Everybody, or the one person, as the recording was given."""
    if isinstance(people, PeopleObservations):
        return everybody  # pyrefly: ignore[bad-return]
    return everybody.of_person(everybody.only())  # pyrefly: ignore[bad-return]


def _without_empty_images(people: PeopleObservations) -> Iterator[Detections]:
    """The images but those that show nobody, where one camera shows somebody."""
    alone = people.frames.image[people.n_showing == 1]
    for c, name in enumerate(people.camera_names):
        beside = set(alone[:, c].tolist())
        yield from (image for i, image in enumerate(people.by_camera[name]) if image.n_people or i not in beside)


def _on_clock(image: Detections, camera: Camera) -> Detections:
    stamp_s = np.array([image.time_s])
    number = int(np.argmax(held_by(camera, stamp_s)[:, 0]))
    piece = pieces_of(camera)[number] if camera.moves else camera
    time_s = image.time_s + float(later_s(camera, stamp_s)[0])
    if number == 0 or image.points3d_m is None:
        return replace(image, camera=piece.name, time_s=time_s)
    move = piece.world_T_camera @ camera.camera_T_world
    R, covariance_m2 = move[:3, :3], image.covariance3d_m2
    return replace(
        image,
        camera=piece.name,
        time_s=time_s,
        points3d_m=image.points3d_m @ R.T + move[:3, 3],
        covariance3d_m2=None if covariance_m2 is None else R @ covariance_m2 @ R.T,
    )


def _without_doubles(images: Iterable[Detections]) -> tuple[Detections, ...]:
    """Where a clock jumps back, images before and after have the same time: the later ones count."""
    return tuple({(image.camera, round(image.time_s, 9)): image for image in images}.values())


def is_far_off(rig: CameraRig, step_s: float) -> bool:
    """Whether a camera of the rig is late or early by more than half a frame of this length."""
    return bool(np.abs(rig.time_offsets_s).max() > _DELAYS_FRAMES * step_s)


def are_far_apart(people: Recording, step_s: float) -> bool:
    """Whether the images of most frames were taken so far apart that they belong to others, by the times of the
    cameras."""
    time_s = people.frames.time_s if isinstance(people, PeopleObservations) else people.time_s
    if time_s.ndim == 1:
        return False
    several = np.isfinite(time_s).sum(axis=1) > 1
    apart_s = np.nanmax(time_s[several], axis=1) - np.nanmin(time_s[several], axis=1)
    return bool(len(apart_s)) and float(np.median(apart_s)) > max(TOGETHER_S, step_s)
