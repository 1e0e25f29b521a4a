"""What workers do in tests, in a module that their processes can import."""

from __future__ import annotations

import os
import signal

from fgpose.study import RecordingOutcome, StudyDescription, Trial


def dies_at_walks(study: StudyDescription, recording: Trial) -> RecordingOutcome:
    """Notes that it was tried, and kills its process at some recordings."""
    with (study.output / f"{recording.subject}_{recording.trial}").open("a") as file:
        file.write("tried\n")
    if recording.trial == "walk" and recording.subject == "S01":
        os.kill(os.getpid(), signal.SIGKILL)
    return RecordingOutcome(recording, "done")
