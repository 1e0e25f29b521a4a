"""One clock for all images, where cameras began at different moments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fgpose.geometry.camera import CameraRig
from fgpose.people import PeopleObservations
from fgpose.sampling import usual_step_s

# Images whose stamps differ by more frames than this are not taken to be of one moment (match_frames); up to there the
# estimator corrects for the delay by the motion.
_DELAYS_FRAMES = 0.5


def on_common_clock(people: PeopleObservations, rig: CameraRig) -> tuple[PeopleObservations, CameraRig]:
    """The recording by the clock of the rig, if a camera's time offset is more than half a frame; else as it is.

    The estimators correct small offsets by the motion of the joints. Videos that began seconds apart must have the
    right images put together first: the offsets of the rig are added to the times of the images, and are zero then.

    Raises:
        ValueError: the cameras of people and rig differ.
    """
    people.check_cameras(rig.names)
    step_s = min(usual_step_s(people.times_s(name)) for name in rig.names)
    if not is_far_off(rig, step_s):
        return people, rig
    offset_s = dict(zip(rig.names, rig.time_offsets_s.tolist(), strict=True))
    images = tuple(replace(image, time_s=image.time_s + offset_s[image.camera]) for image in people.images)
    # Without given_frames: which images belong together is what was wrong.
    shifted = PeopleObservations(people.skeleton, people.camera_names, images, remarks=people.remarks)
    return shifted, rig.with_time_offsets(np.zeros(rig.n_cameras))


def is_far_off(rig: CameraRig, step_s: float) -> bool:
    """Whether a camera of the rig is late or early by more than half a frame of this length."""
    return bool(np.abs(rig.time_offsets_s).max() > _DELAYS_FRAMES * step_s)
