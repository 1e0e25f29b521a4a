"""The person who is seen most, where several may be."""

from __future__ import annotations

from fgpose.association.recording import Association, associate
from fgpose.frame_matching import NO_IMAGE, MatchedFrames
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people import PeopleObservations, Seen


def main_person(people: PeopleObservations, rig: CameraRig, frames: MatchedFrames | None = None) -> Observations:
    """What the cameras saw of the person who is seen most, in all frames; of nobody if nobody is seen.

    Args:
        people: everybody.
        rig: the cameras.
        frames: which images belong together; by default those of about the same time.
    """
    association = associate_somehow(people, rig, frames)
    if association.people:
        return association.in_all_frames(next(iter(association.people)))
    n_frames, n_cameras = association.frames.image.shape
    return people.of_person(association.frames, Seen.nothing(n_frames, n_cameras, people.skeleton.n_joints))


def associate_somehow(people: PeopleObservations, rig: CameraRig, frames: MatchedFrames | None = None) -> Association:
    """Who is who (see associate), also where no two cameras agree on anybody: because there is one only, or because the
    calibration is wrong.

    Every camera follows those whom it sees for itself then, and the first person is the one whom each of them sees
    most. So what is wrong can be looked at.
    """
    association = associate(people, rig, frames=frames)
    if association.people:
        return association
    frames, rig = association.frames, association.rig
    together: list[Seen] = []
    for c, name in enumerate(rig.names):
        if not (frames.image[:, c] != NO_IMAGE).any():
            continue
        own = MatchedFrames(frames.frame_time_s, frames.image[:, [c]])
        for number, seen in enumerate(associate(people.subset([name]), rig, frames=own).people.values()):
            if number == len(together):
                together.append(Seen.nothing(len(frames.image), rig.n_cameras, people.skeleton.n_joints))
            alone = seen.in_frames(len(frames.image))
            together[number].detection[:, c], together[number].joint[:, c] = alone.detection[:, 0], alone.joint[:, 0]
    return Association(people, rig, frames, dict(enumerate(together)), ())
