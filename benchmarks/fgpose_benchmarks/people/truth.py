"""Who is who in a simulated crowd, as if association were solved, and whom the cameras see."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from fgpose.association.recording import Association
from fgpose.correspondences import NO_IMAGE, NOBODY, Seen
from fgpose_benchmarks.people.recording import PeopleRecording


def true_association(recording: PeopleRecording) -> Association:
    """Each person has their detections, those whose left and right are interchanged turned round.

    A joint that shows somebody else is left out; one that is hallucinated stays, for association cannot know. Of
    doubled detections the first is taken.
    """
    scene, rig, frames = recording.scene, recording.rig, recording.frames
    n_joints = scene.observations.skeleton.n_joints
    people = [Seen.nothing(len(frames.image), rig.n_cameras, n_joints) for _ in range(scene.motion.n_people)]
    number = {(image.camera, image.time_s): n for n, image in enumerate(scene.observations.images)}
    for c, name in enumerate(rig.names):
        images = scene.observations.by_camera[name]
        for t in np.flatnonzero(frames.image[:, c] != NO_IMAGE).tolist():
            n = number[name, images[frames.image[t, c]].time_s]
            # The last is the first of the image.
            for detection in reversed(range(len(scene.who[n]))):
                if (person := int(scene.who[n][detection])) >= 0:
                    _give(people[person], t, c, detection, recording, n)
    there = {person: seen for person, seen in enumerate(people) if (seen.detection != NOBODY).any()}
    return Association(scene.observations, rig, {person: _cut(seen) for person, seen in there.items()}, ())


def seen_by(n_cameras: int, recording: PeopleRecording) -> dict[int, Bool[np.ndarray, " frame"]]:
    """By true person, whether so many cameras or more detect the person in each frame of the recording."""
    scene, rig, frames = recording.scene, recording.rig, recording.frames
    who = {(image.camera, image.time_s): who for image, who in zip(scene.observations.images, scene.who, strict=True)}
    n_seeing = np.zeros((scene.motion.n_people, len(frames.image)), dtype=int)
    for c, name in enumerate(rig.names):
        images = scene.observations.by_camera[name]
        for t in np.flatnonzero(frames.image[:, c] != NO_IMAGE).tolist():
            shown = who[name, images[frames.image[t, c]].time_s]
            n_seeing[np.unique(shown[shown >= 0]), t] += 1
    return dict(enumerate(n_seeing >= n_cameras))


def _give(seen: Seen, t: int, c: int, detection: int, recording: PeopleRecording, n: int) -> None:
    """Note in place that a detection of image n shows somebody."""
    scene = recording.scene
    person, n_joints = scene.who[n][detection], scene.observations.skeleton.n_joints
    label = scene.observations.skeleton.mirror if scene.flipped[n][detection] else np.arange(n_joints)
    shows = scene.joint_of[n][detection][label]
    known = scene.observations.images[n].confidence[detection][label] > 0
    seen.detection[t, c] = np.where(known & ((shows == person) | (shows < 0)), detection, NOBODY)
    seen.joint[t, c] = label


def _cut(seen: Seen) -> Seen:
    """From the first to the last frame that shows them."""
    frames = np.flatnonzero((seen.detection != NOBODY).any(axis=(1, 2)))
    inside = slice(int(frames[0]), int(frames[-1]) + 1)
    return Seen(inside.start, seen.detection[inside], seen.joint[inside])
