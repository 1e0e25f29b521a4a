"""Batch smoothing of everybody in a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fgpose.association.common_clock import on_common_clock
from fgpose.association.recording import Association, Progress, associate
from fgpose.config import Config
from fgpose.estimation.evidence.gathered import gather_long
from fgpose.estimation.evidence.image_checks.left_out import with_left_out
from fgpose.estimation.evidence.inputs import check_inputs
from fgpose.estimation.smoother import smooth_evidence
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.sampling import nearest
from fgpose.shown import Shown
from fgpose.trajectory import Trajectory


@dataclass(frozen=True, eq=False, repr=False)
class SmoothedPeople(Shown):
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
    unfinished: Path | None = None,
) -> SmoothedPeople:
    """Tell everybody apart, then smooth each as fgpose.smooth does one person.

    Args:
        observations: everybody in all images.
        rig: the cameras; those without images are left out.
        config: see fgpose.config; the section [tracking] says how people are told apart.
        progress: told after every frame of the association and of each person; of how many in all changes once it is
            known how many people there are.
        association: who is who in these observations, where that is known; by default see associate, of the
            observations by the clock of the rig (on_common_clock).
        unfinished: see fgpose.smooth.

    Raises:
        ValueError: a camera of the observations is not in the rig.
        TypeError: the observations are of one person, or the arguments are exchanged.

    Warns:
        UserWarning: as fgpose.smooth.
    """
    check_inputs("smooth_people", observations, rig, PeopleObservations)
    config = config or Config()
    if association is None:
        on_time = on_common_clock(observations, rig.subset(observations.camera_names))
        association = associate(*on_time, config.tracking, progress)
    n_done = n_frames = len(association.frames.image)
    n_frames += sum(len(seen.detection) for seen in association.people.values())
    frame_time_s = association.observations.frame_time_s + association.rig.common_offset_s
    trajectories: dict[int, Trajectory] = {}
    for person in association.people:
        own = association.of(person)
        before = n_done

        def told(done: int, _: int, before: int = before) -> None:
            if progress:
                progress(before + done, n_frames)

        # In the frames of the association, even where cameras see this person in turns.
        evidence = gather_long(own, association.rig, config)
        smoothed = smooth_evidence(evidence, own.skeleton, association.rig, config, told, unfinished)
        numbers = nearest(smoothed.time_s, frame_time_s)
        smoothed = with_left_out(smoothed, own, association.rig, evidence.sides_exchanged)
        trajectories[person] = replace(smoothed, frame_numbers=numbers)
        n_done += own.n_frames
        if progress:
            progress(n_done, n_frames)
    return SmoothedPeople(trajectories, association)
