"""A result compared with a reference."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.table import Table
from tyro.conf import Positional, arg

from fgpose.assessment.evaluation import Evaluation
from fgpose.assessment.people import PeopleEvaluation
from fgpose.cli.console import new_console, new_table, number
from fgpose.geometry.up_axis import UpChoice


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare a result with a reference: errors in millimetres.

    Prints errors, jitter in m/s^3, and a table of the joints. Any trajectory files: parquet, npz, TRC, C3D. Joints
    are matched by name, frames by time: at the times of the file that has fewer frames a second, the other one is
    interpolated, but not across gaps. Only PA-MPJPE aligns the poses. Where one of the files has several people:
    who was found, told apart and posed how well (recall, precision, MOTA, IDF1, HOTA, MPJPE, PCP), over all frames
    of the reference, with the nearest frames of the result, and a table of its people.

    Example: fgpose evaluate out/pose.parquet mocap.trc --offset-s 0.25
    """

    estimate: Annotated[Positional[Path], arg(metavar="ESTIMATE")]
    """File of the result."""
    reference: Annotated[Positional[Path], arg(metavar="REFERENCE")]
    """File of the reference."""
    offset_s: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Added to the reference's times, for a reference with a clock of its own, seconds."""

    match_m: Annotated[float, arg(metavar="METRES")] = 0.5
    """Several people: the mean distance of the joints below which an estimated person may be a true one, metres."""
    world_up: UpChoice = "auto"
    """What is up in the world of the result: +x, -x, +y, -y, +z or -z; auto: as its format says, unless people (and
    cameras, which a parquet of fgpose knows) stand otherwise."""
    reference_up: UpChoice = "auto"
    """The same of the reference."""

    def run(self) -> None:
        from fgpose.assessment.evaluation import evaluate
        from fgpose.assessment.people import evaluate_people, has_revisions, revised
        from fgpose.io.trajectories import load_origin, load_upright

        estimate, _ = load_upright(self.estimate, self.world_up)
        reference, _ = load_upright(self.reference, self.reference_up, option="--reference-up")
        if len(estimate) == len(reference) == 1:
            one, true = next(iter(estimate.values())), next(iter(reference.values()))
            print_evaluation(new_console(), evaluate(one, true, self.offset_s))
        else:
            measured = partial(evaluate_people, truth=reference, truth_offset_s=self.offset_s, match_m=self.match_m)
            origin, final = load_origin(self.estimate), None
            if origin is not None and has_revisions(origin.events):
                final = measured(revised(estimate, origin.events))
            print_people_evaluation(new_console(), measured(estimate), final)


def print_evaluation(console: Console, evaluation: Evaluation) -> None:
    """The errors over all joints, then one line per joint."""
    console.print(
        f"{evaluation.n_frames} frames and {evaluation.n_joints} joints in common, "
        f"{100 * evaluation.share_missing:.1f} % of them missing on either side and left out"
    )
    console.print(_evaluation_table(evaluation))
    joints = new_table("joint", "absolute [mm]", "relative [mm]", "PCK [%]", "missing [%]")
    for joint in evaluation.joints:
        values = joint.mpjpe_absolute_mm, joint.mpjpe_relative_mm, 100 * joint.pck, 100 * joint.share_missing
        joints.add_row(joint.joint, *map(number, values))
    console.print(joints)


def _evaluation_table(evaluation: Evaluation) -> Table:
    rows: dict[str, float] = {
        "MPJPE, absolute [mm]": evaluation.mpjpe_absolute_mm,
        "MPJPE, relative to the root [mm]": evaluation.mpjpe_relative_mm,
        "PA-MPJPE, after Procrustes alignment [mm]": evaluation.pa_mpjpe_mm,
        "PCK, absolute errors up to 150 mm [%]": 100 * evaluation.pck,
        "acceleration error [m/s^2]": evaluation.acceleration_error_mps2,
        "jitter of the estimate [m/s^3]": evaluation.jitter_estimate_mps3,
        "jitter of the reference [m/s^3]": evaluation.jitter_reference_mps3,
    }
    if evaluation.nees is not None:
        rows["NEES (3 where the covariance is right)"] = evaluation.nees
    if evaluation.coverage_95 is not None:
        rows["inside the 95 % ellipsoids [%]"] = 100 * evaluation.coverage_95
    return new_table("", "value", rows={label: [number(value)] for label, value in rows.items()})


def print_people_evaluation(
    console: Console, evaluation: PeopleEvaluation, final: PeopleEvaluation | None = None
) -> None:
    """How well people were found, told apart and posed, then one line per true person.

    Args:
        console: to print on.
        evaluation: as everybody was called at the time.
        final: by the numbers that they have in the end, where these are others.
    """
    console.print(
        f"{evaluation.n_frames} frames, {evaluation.n_frames_empty} of them without an estimate; "
        f"{evaluation.n_people} people, {evaluation.n_identities} estimated"
    )
    console.print(_people_evaluation_table(evaluation, final))
    people = new_table("person", "frames", "recall [%]", "switches", "fragmented", "MPJPE [mm]", "PCP [%]")
    for person in evaluation.people:
        people.add_row(
            *map(str, (person.identity, person.n_frames)),
            number(100 * person.recall),
            *map(str, (person.switches, person.fragmentations)),
            *map(number, (person.mpjpe_mm, 100 * person.pcp)),
        )
    console.print(people)


def _people_evaluation_table(evaluation: PeopleEvaluation, final: PeopleEvaluation | None) -> Table:
    rows: dict[str, float] = {
        "recall [%]": 100 * evaluation.recall,
        "precision [%]": 100 * evaluation.precision,
        "F1 [%]": 100 * evaluation.f1,
        "MOTA [%]": 100 * evaluation.mota,
        "ID switches": evaluation.switches,
        "fragmentations": evaluation.fragmentations,
        "IDF1 [%]": 100 * evaluation.idf1,
        **({} if final is None else {"IDF1 by the revised numbers [%]": 100 * final.idf1}),
        "HOTA [%]": 100 * evaluation.hota,
        "MPJPE, absolute [mm]": evaluation.mpjpe_mm,
        "joints missing [%]": 100 * evaluation.share_missing,
        "PCP [%]": 100 * evaluation.pcp,
        "joints on the wrong person [%]": 100 * evaluation.wrong_person,
        "people who returned": len(evaluation.returns),
        "recognised of them": sum(stay.is_recognised for stay in evaluation.returns),
        "arrivals taken for somebody else": sum(stay.is_mistaken for stay in evaluation.arrivals),
        "ID switches of people within 1 m": sum(each.n_switches for each in evaluation.encounters),
        "false tracks": len(evaluation.false_tracks_s),
        "longest false track [s]": max(evaluation.false_tracks_s, default=np.nan),
    }
    cells = {label: [str(value) if isinstance(value, int) else number(value)] for label, value in rows.items()}
    return new_table("", "value", rows=cells)
