"""Batch smoothing of everybody in a recording."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from fgpose.association.recording import Association, Progress, associate
from fgpose.config import Config
from fgpose.estimation.smoother import smooth
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.people import PeopleObservations
from fgpose.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class SmoothedPeople:
    """The motion of everybody."""

    trajectories: Mapping[int, Trajectory]
    """By the number of the person, those seen most first; each from the first to the last frame that shows them. Where
    no camera detects them for longer than tracking.coast_s they are away: nothing is known of them then."""
    association: Association
    """Who is who in the images, and every change in the life of a track."""


def smooth_people(
    observations: PeopleObservations,
    rig: CameraRig,
    config: Config | None = None,
    progress: Progress | None = None,
    association: Association | None = None,
) -> SmoothedPeople:
    """Tell everybody apart, then smooth each as fgpose.smooth does one person.

    Args:
        observations: everybody in all images.
        rig: the cameras; those without images are left out.
        config: see fgpose.config; the section [tracking] says how people are told apart.
        progress: told after every frame of the association and of each person; of how many in all changes once it is
            known how many people there are.
        association: who is who in these observations, where that is known; by default see associate.

    Raises:
        ValueError: a camera of the observations is not in the rig.

    Warns:
        UserWarning: as fgpose.smooth.
    """
    config = config or Config()
    association = association or associate(observations, rig, config.tracking, progress)
    n_done = n_frames = len(association.frames.image)
    n_frames += sum(len(seen.detection) for seen in association.people.values())
    trajectories: dict[int, Trajectory] = {}
    for person in association.people:
        own = association.of(person)
        here = present(own, config.tracking.coast_s)
        before = n_done

        def told(done: int, _: int, before: int = before) -> None:
            if progress:
                progress(before + done, n_frames)

        smoothed = smooth(own.frames(here), association.rig, config, told)
        trajectories[person] = smoothed.in_frames(own.frame_time_s, np.flatnonzero(here))
        n_done += own.n_frames
        if progress:
            progress(n_done, n_frames)
    return SmoothedPeople(trajectories, association)


def present(observations: Observations, coast_s: float) -> Bool[np.ndarray, " frame"]:
    """The frames in which a person is there: all but those between detections that are farther apart than coast_s."""
    seen = np.flatnonzero(observations.seen.any(axis=(1, 2)))
    here = np.ones(observations.n_frames, dtype=bool)
    for before, after in itertools.pairwise(seen.tolist()):
        if observations.frame_time_s[after] - observations.frame_time_s[before] > coast_s:
            here[before + 1 : after] = False
    return here
