"""The page of one recording."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from fgpose.association.recording import Progress
from fgpose.diagnosis.finished import FinishedRecording, Mark
from fgpose.geometry.up_axis import WorldUp
from fgpose.io.atomic import write_text
from fgpose.report.page import Headline, KeyFigure, Page, html
from fgpose.report.quality import Quality, quality
from fgpose.report.sections import sections


def write_report(recording: FinishedRecording, path: str | Path, progress: Progress | None = None) -> Quality:
    """Write the report on a recording as one HTML file, which needs no other file and no network.

    Args:
        recording: what is missing in it is said in the file.
        path: of the file; it appears whole or not at all.
        progress: told how many of how many steps of its diagnosis are done.

    Returns:
        The numbers at its head, and all suspicions.

    Raises:
        ValueError: the videos do not fit the calibration, or one is damaged.
        ImportError: Bokeh is not installed.
        OSError: the file cannot be written, or a video cannot be read.
    """
    judged = quality(recording, progress)
    page = Page(
        title=recording.name,
        kicker="Recording",
        made=_made(judged),
        sections=sections(recording),
        figures=figures(judged),
        verdict=verdict(judged),
        told=digest_of_told(recording.marks, recording.given_up),
    )
    write_text(Path(path), html(page))
    return judged


def digest_of_told(marks: Sequence[Mark], given_up: WorldUp | None) -> str:
    """By which a page tells whether it is still right: of the events of its recording, and of the axis that is up if it
    was given."""
    told = [(mark.time_s, mark.name) for mark in marks], given_up
    return hashlib.blake2b(repr(told).encode(), digest_size=16).hexdigest()


def _made(judged: Quality) -> str:
    people = "one person" if judged.n_people == 1 else f"{judged.n_people} people"
    cameras = (
        f"{judged.n_cameras} camera{'s' if judged.n_cameras != 1 else ''}" if judged.n_cameras else "cameras unknown"
    )
    return f"{people}, {cameras}, {judged.n_joints} joints. Report of {datetime.now():%d %B %Y, %H:%M}."


def figures(judged: Quality) -> list[KeyFigure]:
    """The numbers at the head; what is not known is left out."""

    def share(value: float) -> str:
        return f"{100 * value:.1f}"

    all_of_them = [
        (judged.duration_s, KeyFigure("Duration", f"{judged.duration_s:.1f}", "s")),
        (judged.rate_hz, KeyFigure("Rate", f"{judged.rate_hz:.4g}", "Hz", f"{judged.n_frames} frames")),
        (
            judged.seen_share,
            KeyFigure("Seen by two cameras", share(judged.seen_share), "%", "of all joints and frames"),
        ),
        (judged.predicted_share, KeyFigure("Predicted", share(judged.predicted_share), "%", "from bones and motion")),
        (judged.views, KeyFigure("Cameras per joint", f"{judged.views:.1f}", "", "mean over joints and frames")),
        (judged.reprojection_px, KeyFigure("Reprojection error", f"{judged.reprojection_px:.1f}", "px", "median")),
        (judged.sigma_mm, KeyFigure("Sigma", f"{judged.sigma_mm:.1f}", "mm", "median, largest axis of each joint")),
        (
            judged.hallucinated_share,
            KeyFigure("Hallucinated", share(judged.hallucinated_share), "%", "of the detections"),
        ),
    ]
    return [figure for value, figure in all_of_them if value == value]


def verdict(judged: Quality) -> Headline:
    """What is suspicious, in words."""
    n = len(judged.suspicions)
    where = " in the motion itself" if judged.only_motion else " in what was judged" if judged.unknown else ""
    if n == 0:
        heading = f"Nothing is suspicious{where}"
    else:
        heading = "One thing is suspicious" if n == 1 else f"{n} things are suspicious"
    intro = "The most important first. " if n > 1 else ""
    intro += f"{judged.not_judged[0].upper()}{judged.not_judged[1:]}. " if judged.not_judged else ""
    intro += "Judged from the result itself and published limits of human motion, not from a truth."
    return Headline(heading, intro, judged.suspicions)
