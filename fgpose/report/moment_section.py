"""The five worst moments, with pictures where there are images."""

from __future__ import annotations

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Block, Moment, Note, Section
from fgpose.report.moments import WorstMoment, worst_moments


def moment_section(recording: FinishedRecording) -> Section:
    """In the order of time."""
    moments = worst_moments(recording)
    if not moments:
        return Section("Worst moments", "worst", [Note("Nothing is known by which moments could be judged.", True)])
    blocks: list[Block] = []
    shown = {}
    missing = _why_no_pictures(recording)
    if missing:
        blocks.append(Note(missing, is_missing=True))
    else:
        from fgpose.report.pictures import pictures

        shown = pictures(recording, moments)
    blocks += [
        Moment(_title(recording, moment), f"{moment.reason[0].upper()}{moment.reason[1:]}.", shown.get(moment, ()))
        for moment in moments
    ]
    intro = (
        "Where sigma, reprojection errors or changes of velocity are largest, each over its usual value in this "
        "recording."
    )
    if shown:
        drawn = "blue: detections, " if recording.observations else ""
        intro += f" White: the result; {drawn}orange: the joints that are worst; px: error of the first of them."
    return Section("Worst moments", "worst", blocks, intro)


def _title(recording: FinishedRecording, moment: WorstMoment) -> str:
    called = recording.called(moment.person)
    return f"{moment.time_s:.2f} s (frame {moment.frame}){f', {called}' if called else ''}: {', '.join(moment.joints)}"


def _why_no_pictures(recording: FinishedRecording) -> str:
    if recording.videos is None:
        return "No pictures: the videos were not given (--videos FOLDER)."
    if recording.rig is None:
        return "No pictures: they need the calibration (--rig FILE)."
    return ""
