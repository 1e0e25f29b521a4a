"""What the commands print: results in a few short tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from fgpose.assessment.metrics import jitter_mps3
from fgpose.association.recording import Association
from fgpose.association.successive import Succession
from fgpose.calibration.self_calibration import CameraCalibration
from fgpose.cli.console import new_table, number, print_written
from fgpose.finding import Code
from fgpose.io.trajectories.result_table import numbered
from fgpose.observations import Observations
from fgpose.people_observations import PeopleObservations
from fgpose.pipeline import AnySource, Result
from fgpose.sampling import frames_per_second, parts_of, stretches
from fgpose.trajectory import Status, Trajectory

_MAX_LISTED = 5
# More would hide the rest of the report; all are in the .rrd file.
_MAX_EVENTS = 10
_MEANING = {
    "fused": "fused",
    "refined": "each frame alone",
    "smoothed": "smoothed",
    "online": "online",
}


def print_result(console: Console, result: Result, written: tuple[Path, ...]) -> None:
    """The result of a run, and the files that it is in."""
    if result.association is None:
        print_source(console, result.source)
        console.print(result_table(result))
    else:
        print_association(console, result.association, result.source.succession)
        console.print(people_table(result.main))
    if result.update_ms is not None:
        console.print(latency_table(result.update_ms))
    for line in _notes_of_one(result) if result.association is None else _notes_of_people(result.main):
        console.print(line, soft_wrap=True)
    print_written(console, *written)


def _notes_of_one(result: Result) -> list[str]:
    main = result.main[0]
    is_said = result.diagnosis is not None and result.diagnosis.tells_of(Code.NOBODY)
    notes = [*([] if is_said else absence_lines(main)), *left_out_lines(main)]
    if main.convergence is not None and not main.convergence.converged:
        notes.append("Not converged: raise --solver.max-iterations, or look at the input with fgpose info.")
    return notes


def _notes_of_people(people: Mapping[int, Trajectory]) -> list[str]:
    late = [n for n, each in people.items() if each.convergence is not None and not each.convergence.converged]
    names = ", ".join(map(str, late))
    return [f"Not converged: person {names}. Raise --solver.max-iterations, or look at fgpose info."] if late else []


def print_source(console: Console, source: AnySource) -> None:
    console.print(_size(source.observations))
    print_presence(console, source)


def _size(observations: Observations | PeopleObservations) -> str:
    fps = frames_per_second(observations.frame_time_s)
    rate = "" if np.isnan(fps) else f" at {fps:.4g} Hz"
    return (
        f"{observations.n_frames} frames{rate}, {len(observations.camera_names)} cameras, "
        f"{observations.skeleton.n_joints} joints ({observations.skeleton.name})"
    )


def print_presence(console: Console, source: AnySource) -> None:
    """Who comes after whom, or that nobody comes."""
    for change in source.succession.changes if source.succession else ():
        console.print(f"Nobody is there for a while: {change}.", soft_wrap=True)
    if isinstance(source.observations, Observations) and not source.observations.seen.any():
        console.print("Nobody is detected in any image.")


def print_association(console: Console, association: Association, succession: Succession | None = None) -> None:
    """Who is there and when, what no person was found for, and what has happened to whom."""
    people, time_s = association.observations, association.frames.frame_time_s
    console.print(f"{_size(people)}, up to {people.n_most} people in an image")
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


def absence_lines(trajectory: Trajectory) -> list[str]:
    """When nobody is there, if that is ever so."""
    if not trajectory.absent.any():
        return []
    time_s = trajectory.time_s
    spans = [f"{time_s[begin]:.2f} to {time_s[end - 1]:.2f} s" for begin, end in stretches(trajectory.absent)]
    share = 100 * trajectory.absent.mean()
    return [f"{share:.0f} % of the frames are empty in the files, as the person is away: {_first_of(spans)}"]


def left_out_lines(trajectory: Trajectory) -> list[str]:
    """Which frames were left out, if any."""
    if not trajectory.implausible_frames:
        return []
    numbers, time_s = numbered(trajectory), trajectory.time_s
    frames = [f"frame {numbers[frame]} at {time_s[frame]:.2f} s" for frame in trajectory.implausible_frames]
    share = f"{len(frames)} of {trajectory.n_frames} frames"
    return [f"Left out, because the detections make no body: {share}: {_first_of(frames)}"]


def _first_of(items: Sequence[str]) -> str:
    more = len(items) - _MAX_LISTED
    return ", ".join(items[:_MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def result_table(result: Result, names: Mapping[str, str] | None = None) -> Table:
    """One column per trajectory of one person: errors per camera, jitter, how many joints were seen.

    Args:
        result: of a run.
        names: heading of each trajectory that is shown; by default all but the fused pose.
    """
    names = names or {name: _MEANING.get(name, name) for name in result.trajectories if name != "fused"}
    table = new_table("", *names.values())
    trajectories = [result.trajectories[name][0] for name in names]
    for c, camera in enumerate(result.source.rig.names):
        _row(table, f"reprojection error {camera} [px]", trajectories, lambda each, c=c: _median_px(each, c))
    _row(table, "reprojection error, all [px]", trajectories, lambda each: _median_px(each))
    table.add_section()
    # Of frames that do not follow each other it would be another number.
    whole = [name in result.saved or result.compared_every == 1 for name in names]
    jitter = [
        jitter_mps3(each.positions_m, each.time_s) if is_whole else np.nan
        for each, is_whole in zip(trajectories, whole, strict=True)
    ]
    table.add_row("jitter (mean jerk) [m/s^3]", *map(number, jitter))
    for status in (Status.OBSERVED, Status.PREDICTED, Status.UNOBSERVABLE):
        _row(
            table, f"joints {status.name.lower()} [%]", trajectories, lambda each, s=status: 100 * each.status_share(s)
        )
    return table


def people_table(people: Mapping[int, Trajectory]) -> Table:
    """One column per person: the error over all cameras, how many joints were seen."""
    of_people = dict(sorted(people.items()))
    table = new_table("", *(f"person {person}" for person in of_people))
    trajectories = list(of_people.values())
    table.add_row("reprojection error [px]", *(f"{_median_px(each):.1f}" for each in trajectories))
    for status in (Status.OBSERVED, Status.PREDICTED):
        shares = [f"{100 * each.status_share(status):.1f}" for each in trajectories]
        table.add_row(f"joints {status.name.lower()} [%]", *shares)
    if any(each.absent.any() for each in trajectories):
        table.add_row("frames away [%]", *(f"{100 * each.absent.mean():.1f}" for each in trajectories))
    return table


def calibration_table(calibration: CameraCalibration, frame_time_s: np.ndarray) -> Table:
    """How far each camera was moved, how well it is known now, its error before and after, and its time offset with its
    standard deviation, also in frames of the recording (T,)."""
    refinement, offsets = calibration.refinement, calibration.time_offsets
    rows: dict[str, tuple[np.ndarray, int]] = {}
    if refinement is not None:
        rows |= {
            "turned by [deg]": (refinement.rotation_deg, 2),
            "moved by [mm]": (1000 * refinement.translation_m, 0),
            "standard deviation about each axis [deg]": (refinement.rotation_sigma_deg, 2),
            "standard deviation along each axis [mm]": (1000 * refinement.translation_sigma_m, 0),
            "triangulation error before [px]": (refinement.residual_before_px, 1),
            "triangulation error after [px]": (refinement.residual_after_px, 1),
        }
    if offsets is not None:
        fps = frames_per_second(frame_time_s)
        rows |= {
            "taken later [ms]": (1000 * offsets.offsets_s, 1),
            "standard deviation [ms]": (1000 * offsets.sigma_s, 1),
            "taken later [frames]": (fps * offsets.offsets_s, 2),
            "standard deviation [frames]": (fps * offsets.sigma_s, 2),
        }
    cells = {name: [f"{value:.{digits}f}" for value in values] for name, (values, digits) in rows.items()}
    table = new_table("calibration", *calibration.rig.names, rows=cells)
    if offsets is not None:
        table.caption = (
            "taken later: how much later than their times the images were taken (negative: earlier), relative to the "
            "first camera"
        )
        table.caption_justify = "left"
    return table


def latency_table(update_ms: np.ndarray) -> Table:
    """Percentiles of the time that an update takes."""
    quantiles = [f"{value:.1f}" for value in np.percentile(update_ms, (50, 90, 99, 100))]
    rows = {"update of the online estimator [ms]": quantiles}
    return new_table("", "median", "90 %", "99 %", "max", rows=rows)


def _row(table: Table, label: str, trajectories: list[Trajectory], value: Callable[[Trajectory], float]) -> None:
    table.add_row(label, *(number(value(trajectory)) for trajectory in trajectories))


def _median_px(trajectory: Trajectory, camera: int | None = None) -> float:
    if trajectory.residual_px is None:
        return np.nan
    return median_in_parts(trajectory.residual_px if camera is None else trajectory.residual_px[:, camera])


def median_in_parts(values: Float[np.ndarray, "frame ..."]) -> float:
    """The median of those that are known, in single precision; none is negative. All of an hour would be copied, 60 MB:
    so they are counted by their first bits, and only those with the bits of the median are compared. NaN: there is
    none."""

    def known() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for part in parts_of(len(values)):
            own = values[part][np.isfinite(values[part])].astype(np.float32)
            yield own, own.view(np.uint32) >> 16

    counts = np.zeros(2**16, dtype=int)
    for _, bits in known():
        counts += np.bincount(bits, minlength=len(counts))
    ends = np.cumsum(counts)
    if not ends[-1]:
        return np.nan
    middle = np.array([(ends[-1] - 1) // 2, ends[-1] // 2])
    first, last = np.searchsorted(ends, middle, side="right").tolist()
    near = np.sort(np.concatenate([own[(bits >= first) & (bits <= last)] for own, bits in known()]))
    return float(near[middle - (ends[first] - counts[first])].mean())
