"""The parts of the page of a recording, in their order; each says in one line what it lacks."""

from __future__ import annotations

from fgpose.diagnosis.finished import FinishedRecording
from fgpose.report.blocks import Section
from fgpose.report.sections.angles import angle_section
from fgpose.report.sections.body import bone_section, sigma_section
from fgpose.report.sections.cameras import camera_section, reprojection_section, seen_section
from fgpose.report.sections.marks import draw_marks, mark_section
from fgpose.report.sections.moments import moment_section
from fgpose.report.sections.origin import origin_section
from fgpose.report.sections.people import people_section


def sections(recording: FinishedRecording) -> list[Section]:
    """All of a page but its head."""
    made = [
        seen_section(recording),
        reprojection_section(recording),
        sigma_section(recording),
        bone_section(recording),
        angle_section(recording),
        mark_section(recording),
        camera_section(recording),
        people_section(recording),
        moment_section(recording),
        origin_section(recording),
    ]
    known = [section for section in made if section is not None]
    draw_marks(known, recording)
    return known
