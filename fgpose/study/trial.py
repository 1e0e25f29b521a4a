"""One recording of a study: whose it is, and where its files are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["keypoints", "videos"]


@dataclass(frozen=True)
class Trial:
    """A trial of a session of a subject. Small: it says where the content is and holds none."""

    subject: str
    session: str
    trial: str
    source: Path
    """Folder or file of the keypoints or the videos."""
    kind: Kind
    calibration: Path | None = None
    """None: there is none, or the cameras are calibrated from the people in it."""
    problem: str = ""
    """Why it cannot be estimated, where that is known before any work."""
    calibrated_on: str = ""
    """Key of the trial of its session on which its cameras are calibrated from people."""

    @staticmethod
    def unknown(source: Path, kind: Kind, problem: str) -> Trial:
        """Stands in the table for recordings that cannot be found."""
        return Trial("", "", "", source, kind, problem=problem)

    @property
    def key(self) -> str:
        """subject/session/trial, as exclusions and --only see it."""
        return f"{self.subject}/{self.session}/{self.trial}"

    def folder(self, output: Path) -> Path:
        """Where its results go."""
        return output / "recordings" / self.subject / self.session / self.trial

    def failure(self, output: Path) -> Path:
        """Where the reason is written if it fails: beside its folder, in which older results may be."""
        folder = self.folder(output)
        return folder.with_name(f"{folder.name}.failed.txt")
