"""fgpose report: a finished recording or study as a page."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from fgpose.cli.console import new_console, print_written, progress_bar, quiet_progress
from fgpose.geometry.up_axis import UpChoice


@dataclass(frozen=True, kw_only=True)
class Report:
    """Say in one HTML file what a result is worth.

    Says also what is suspicious. The file opens in any browser, without a network. Of a recording: what each camera
    saw, reprojection errors, uncertainty, bone lengths, joint angles, cameras, people, the worst moments. Of a study:
    one table of all recordings, those unlike the others first, with the report of each. What is not known is said in
    the file.

    Example: fgpose report out --rig Calib.toml --videos videos
    """

    results: Annotated[Positional[Path], arg(metavar="OUT")]
    """Output folder of fgpose run, smooth, track or study; or one file of a trajectory."""
    output: Annotated[
        Path | None,
        arg(
            metavar="FILE",
            aliases=("-o",),
            help_behavior_hint="(default: OUT/report.html, with --name OUT/report_NAME.html)",
        ),
    ] = None
    """The file to be written."""
    name: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="(default: the only one)")] = None
    """Which result of the folder, if it has several."""
    rig: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: as the result says)")] = None
    """Calibration of the cameras that the result was made with."""
    keypoints: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="(default: as the result says)")] = None
    """Detections that the result was made from: they tell late cameras, and are drawn in the pictures."""
    fps: Annotated[float | None, arg(metavar="HZ", help_behavior_hint="(default: from the file)")] = None
    """Frames per second of the keypoints, unless their file contains times, and of folders of images."""
    videos: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: as the result says)")] = None
    """Videos of the cameras, for pictures of the worst moments."""
    world_up: UpChoice = "auto"
    """What is up in the world of the calibration: +x, -x, +y, -y, +z or -z; auto: as people and cameras stand. A study
    says it in its file."""
    recordings: bool = True
    """Of a study: also write the report of each recording, where there is none with its events that is newer than its
    result."""

    def run(self) -> None:
        from fgpose.report.study_results import is_study

        if not self.results.exists():
            raise ValueError(f"{self.results}: there is no such file or folder")
        # Before any work; looked for, not imported: that takes a second.
        if importlib.util.find_spec("bokeh") is None:
            raise ImportError("a report needs Bokeh: pip install 'fgpose[report]'")
        if self.results.is_dir() and is_study(self.results):
            self._study()
        else:
            self._recording()

    def _study(self) -> None:
        from fgpose.io.made_by import check_result
        from fgpose.report import write_study_report
        from fgpose.report.study_results import load_study, study_name

        if self.world_up != "auto":
            raise ValueError("--world-up: a study says what is up in its file (steps.world_up), also of its tables")
        for option in ("name", "rig", "keypoints", "fps", "videos"):
            if getattr(self, option) is not None:
                raise ValueError(f"--{option} is of a single result; {self.results} is a study, which says it itself")
        path = self._path(self.results)
        check_result(path, "report")
        with progress_bar("reporting", "recordings") as progress:
            recordings = load_study(self.results, reports=self.recordings, page=path, progress=progress)
        write_study_report(recordings, path, study_name(self.results))
        print_written(new_console(), path)

    def _recording(self) -> None:
        from fgpose.io.made_by import check_result
        from fgpose.report import write_report
        from fgpose.report.results import find_result, load_finished, maker_text

        result = find_result(self.results, self.name)
        path = self._path(result.parent, self.name)
        check_result(path, "report", (result, self.rig, self.keypoints))
        with quiet_progress("judging the result") as progress:
            recording = load_finished(
                result,
                rig=self.rig,
                keypoints=self.keypoints,
                fps=self.fps,
                videos=self.videos,
                world_up=self.world_up,
            )
            judged = write_report(recording, path, progress)
        console = new_console()
        made = maker_text(result)
        console.print(f"{result}{f', made by {made}' if made else ''}", soft_wrap=True)
        for number, finding in enumerate(judged.suspicions, 1):
            console.print(f"{number}. {finding.text}", soft_wrap=True)
        if not judged.suspicions:
            console.print("nothing is suspicious" + (" in what was judged" if judged.unknown else ""))
        if judged.not_judged:
            console.print(judged.not_judged, soft_wrap=True)
        print_written(console, path)

    def _path(self, folder: Path, name: str | None = None) -> Path:
        """Results of one folder that are told apart by names have reports of their own.

        Raises OSError if a link of the name that nobody asked for would be followed: the folder may be of others.
        """
        path = folder / (f"report_{name}.html" if name else "report.html")
        if not self.output and path.is_symlink():
            raise OSError(f"{path} is a link, to {os.readlink(path)}: name it with --output if it is to be written")
        return self.output or path
