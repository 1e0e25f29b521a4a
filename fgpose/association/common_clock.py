"""One clock for all images, where cameras began at different moments, and one pose for each camera."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.changing_rig import held_by, in_pieces, is_changing, later_s, pieces_of
from fgpose.observations import Observations
from fgpose.people import Detections, PeopleObservations
from fgpose.sampling import usual_step_s

# Images whose stamps differ by more frames than this are not taken to be of one moment (match_frames); up to there the
# estimator corrects for the delay by the motion.
_DELAYS_FRAMES = 0.5

Recording = TypeVar("Recording", Observations, PeopleObservations)


def on_common_clock(people: Recording, rig: CameraRig) -> tuple[Recording, CameraRig]:
    """The recording by the clock of the rig, if a camera's time offset is more than half a frame, if a clock or a pose
    changes or if no frame has images of two cameras; else as it is.

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
        return _together(people, rig) if is_changing(rig) or is_far_off(rig, step_s) else (people, rig)
    is_far = is_far_off(rig, usual_step_s(people.frame_time_s))
    if not is_changing(rig) and not is_far and not are_single_images(people):
        return people, rig
    together, on_clock = _together(PeopleObservations.of_one(replace(people, camera_names=rig.names)), rig)
    return together.of_person(together.only()), on_clock


def _together(people: PeopleObservations, rig: CameraRig) -> tuple[PeopleObservations, CameraRig]:
    by_name = dict(zip(rig.names, rig.cameras, strict=True))
    images = tuple(_on_clock(image, by_name[image.camera]) for image in people.images)
    # Without given_frames: which images belong together is what was wrong.
    on_clock = in_pieces(rig)
    shown = _without_doubles(images)
    return PeopleObservations(people.skeleton, on_clock.names, shown, remarks=people.remarks), on_clock


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


def _without_doubles(images: tuple[Detections, ...]) -> tuple[Detections, ...]:
    """Where a clock jumps back, images before and after have the same time: the later ones count."""
    return tuple({(image.camera, round(image.time_s, 9)): image for image in images}.values())


def are_single_images(observations: Observations) -> bool:
    """Whether each of several cameras has frames of its own: images that come one by one."""
    time_s = observations.time_s
    return time_s.ndim == 2 and time_s.shape[1] > 1 and bool((np.isfinite(time_s).sum(axis=1) <= 1).all())


def is_far_off(rig: CameraRig, step_s: float) -> bool:
    """Whether a camera of the rig is late or early by more than half a frame of this length."""
    return bool(np.abs(rig.time_offsets_s).max() > _DELAYS_FRAMES * step_s)
