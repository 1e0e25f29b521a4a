"""Cameras in which none of several people is followed, although they show somebody: what is wrong of them.

What does not fit anybody belongs to nobody, and no other check sees it.
"""

from __future__ import annotations

import numpy as np

from fgpose.association.chosen_person import of_camera_alone
from fgpose.association.recording import Association
from fgpose.correspondences import NO_IMAGE, NOBODY
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.hypotheses.findings import disagreements
from fgpose.finding import Finding

# In so many of its images a camera shows somebody, and in so few of these somebody who is followed.
_SHOWS, _HARDLY_EVER = 0.5, 0.1


def causes_of_unfollowed(examined: Examined) -> list[Finding]:
    """The cause that makes cameras agree, with the one whom each of those cameras sees most taken for the main person;
    none where there is no such cause: they may show somebody else."""
    if examined.association is None:
        return []
    cameras = unfollowed(examined.association)
    if not cameras:
        return []
    association, n_frames = examined.association, len(examined.association.frames.image)
    main = examined.main_person
    seen = association.people[main].in_frames(n_frames)
    for camera in cameras:
        for alone in of_camera_alone(association.observations, examined.rig, camera)[:1]:
            seen.detection[:, camera], seen.joint[:, camera] = alone.detection[:, 0], alone.joint[:, 0]
    with_them = Examined(examined.rig, {main: association.observations.of_person(seen)}, examined.config)
    return disagreements(with_them) if with_them.geometry.explanation is not None else []


def unfollowed(association: Association) -> list[int]:
    """Numbers of the cameras."""
    observations, image = association.observations, association.frames.image
    n_frames, found = len(image), np.zeros(image.shape, dtype=bool)
    for seen in association.people.values():
        found |= (seen.in_frames(n_frames).detection != NOBODY).any(axis=-1)
    shows = image != NO_IMAGE
    for t, c in np.argwhere(shows).tolist():
        shows[t, c] = observations.image(t, c).n_people > 0
    n_shown, n_found = shows.sum(axis=0), found.sum(axis=0)
    return np.flatnonzero((n_shown > _SHOWS * n_frames) & (n_found < _HARDLY_EVER * n_shown)).tolist()
