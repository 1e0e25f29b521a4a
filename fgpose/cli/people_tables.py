"""Several people in a few short tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from fgpose.association.recording import Association
from fgpose.association.successive import Succession
from fgpose.cli.tables import latency_table, new_table
from fgpose.pipeline import PeopleResult
from fgpose.sampling import frames_per_second
from fgpose.trajectory import Status, Trajectory

# More would hide the rest of the report; all are in the .rrd file.
_MAX_EVENTS = 10


def print_people(console: Console, result: PeopleResult, written: tuple[Path, ...]) -> None:
    """The motion of everybody, and the files that it is in."""
    print_association(console, result.association, result.source.succession)
    of_people = dict(sorted(result.main.items()))
    table = new_table("", *(f"person {person}" for person in of_people))
    trajectories = of_people.values()
    table.add_row("reprojection error [px]", *(f"{_median_px(each):.1f}" for each in trajectories))
    for status in (Status.OBSERVED, Status.PREDICTED):
        shares = [f"{100 * each.status_share(status):.1f}" for each in trajectories]
        table.add_row(f"joints {status.name.lower()} [%]", *shares)
    if any(each.absent.any() for each in trajectories):
        table.add_row("frames away [%]", *(f"{100 * each.absent.mean():.1f}" for each in trajectories))
    console.print(table)
    if result.update_ms is not None:
        console.print(latency_table(result.update_ms))
    late = [
        person
        for person, each in result.main.items()
        if each.convergence is not None and not each.convergence.converged
    ]
    if late:
        names = ", ".join(map(str, late))
        console.print(f"Not converged: person {names}. Raise --solver.max-iterations, or look at fgpose info.")
    for path in written:
        console.print(f"wrote {path}", soft_wrap=True)


def print_association(console: Console, association: Association, succession: Succession | None = None) -> None:
    """Who is there and when, what no person was found for, and what has happened to whom."""
    people, frames = association.observations, association.frames
    time_s = frames.frame_time_s
    fps = frames_per_second(time_s)
    rate = "" if np.isnan(fps) else f" at {fps:.4g} Hz"
    console.print(
        f"{len(time_s)} frames{rate}, {len(people.camera_names)} cameras, {people.skeleton.n_joints} joints "
        f"({people.skeleton.name}), up to {people.n_most} people in an image"
    )
    table = new_table("", "from [s]", "to [s]", *(f"seen by {name} [%]" for name in people.camera_names))
    for person, seen in sorted(association.people.items()):
        own_s, in_image = time_s[seen.frames], (seen.detection >= 0).any(axis=-1)
        shares = [f"{100 * share:.0f}" for share in in_image.mean(axis=0)]
        table.add_row(f"person {person}", f"{own_s[0]:.2f}", f"{own_s[-1]:.2f}", *shares)
    console.print(table)
    for change in succession.changes if succession else ():
        console.print(f"No image shows more than one person, but {change}.", soft_wrap=True)
    n_detections = sum(image.n_people for image in people.images)
    console.print(f"{association.n_unused} of {n_detections} detections belong to nobody")
    for event in association.events[:_MAX_EVENTS]:
        console.print(f"{event.time_s:8.2f} s  person {event.person} {event.what}: {event.reason}", soft_wrap=True)
    if len(association.events) > _MAX_EVENTS:
        console.print(f"and {len(association.events) - _MAX_EVENTS} more changes")


def _median_px(trajectory: Trajectory) -> float:
    residual_px = trajectory.residual_px
    if residual_px is None or not np.isfinite(residual_px).any():
        return float("nan")
    return float(np.nanmedian(residual_px))
