"""Joint angles over time, with bands."""

from __future__ import annotations

import numpy as np

from fgpose.report.blocks import Block, Note, Section
from fgpose.report.finished import FinishedRecording


def angle_section(recording: FinishedRecording) -> Section:
    return Section("Joint angles", "angles", [Note("The skeleton determines no joint angle.", is_missing=True)])
