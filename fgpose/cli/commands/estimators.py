"""The commands that read a recording or results. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import arg

from fgpose.cli.calibration import calibrated
from fgpose.cli.console import new_console, progress_bar
from fgpose.cli.options import ParameterOptions, RecordingOptions

if TYPE_CHECKING:
    from fgpose.calibration.moved_views import Recording
    from fgpose.pipeline import Outputs, Source


@dataclass(frozen=True, kw_only=True)
class EstimatorOptions(ParameterOptions, RecordingOptions):
    """What smooth, track and refine have in common."""

    def prepared(self, source: Source[Recording]) -> Source[Recording]:
        outputs, console = self.outputs(self.keypoints), new_console()
        wanted = {"poses": self.refine_calibration, "clocks": self.estimate_time_offsets}
        return calibrated(source, self.parameters, outputs, console, **wanted)

    def checked_outputs(self, *saved: str) -> Outputs:
        """Where the results go, once it is certain that they can be written there."""
        outputs = self.outputs(self.keypoints)
        calibration = self.refine_calibration or self.estimate_time_offsets
        outputs.check(saved, self.inputs, calibration=calibration)
        return outputs

    @property
    def inputs(self) -> tuple[Path, ...]:
        """What must not be overwritten."""
        return self.keypoints, self.rig


@dataclass(frozen=True, kw_only=True)
class OverTimeOptions(EstimatorOptions):
    """What smooth and track have in common."""

    bones: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """An earlier result of the same person (parquet, npz), whose bone lengths it begins with. If they are seen to be
    somebody else's, they are not used, and that is said."""

    @property
    def inputs(self) -> tuple[Path, ...]:
        return (*super().inputs, *([self.bones] if self.bones else []))

    def prepared(self, source: Source[Recording]) -> Source[Recording]:
        return super().prepared(source if self.bones is None else source.with_bones(self.bones))


@dataclass(frozen=True, kw_only=True)
class Smooth(OverTimeOptions):
    """Smooth a recording: the most probable motion of all frames.

    Writes NAME.parquet, NAME.trc and NAME.rrd into the output folder. Of several people, all are in NAME.parquet, and
    each has a NAME_personN.trc. With --solver.no-covariance it is faster and does not state how uncertain each joint
    is.

    Example: fgpose smooth pose/ --rig Calib.toml --skeleton body_25b --fps 60 --motion.max-unseen-s 5
    """

    step: ClassVar[str] = "smooth"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver, smoothed, windows_kept
        from fgpose.cli.viewers import live_viewer

        outputs = self.checked_outputs("smoothed")
        source = self.load()
        with windows_kept(outputs), live_viewer(outputs, source, ("fused", "refined", "smoothed")) as viewer:
            return deliver(smoothed(source, self.parameters, outputs), outputs, viewer, strict=self.strict)


@dataclass(frozen=True, kw_only=True)
class Refine(EstimatorOptions):
    """Estimate every frame alone, by the method of the paper.

    Reprojection error with limb symmetry, no smoothing. Writes NAME.parquet, NAME.trc and NAME.rrd into the output
    folder, where NAME ends with _refined unless it is given. Of the parameters only --fusion.*, --refinement.* and
    --solver.max-iterations matter here.

    Example: fgpose refine pose/ --rig Calib.toml --skeleton body_25b --fps 60
    """

    step: ClassVar[str] = "refine"
    name_ends: ClassVar[str] = "_refined"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver
        from fgpose.cli.viewers import live_viewer
        from fgpose.pipeline import run_refine

        if self.people == "all":
            raise ValueError("refine estimates one person: use --people 1 or --person-region; smooth takes everybody")
        outputs = self.checked_outputs("refined")
        source = replace(self, people="1").load()
        with live_viewer(outputs, source, ("fused", "refined")) as viewer:
            with progress_bar("refining") as progress:
                result = run_refine(source, self.parameters, progress)
            return deliver(result, outputs, viewer, strict=self.strict)


@dataclass(frozen=True, kw_only=True)
class Track(OverTimeOptions):
    """Replay a recording through the online estimator, and time it.

    Frame by frame, as if it were live. Writes NAME_online.* (the newest pose after each frame) and NAME_smoothed.*
    (each frame once it is --online.lag-s old), and NAME_online.rrd. With --live, viewers see every frame as soon as it
    is estimated. Prints latencies in milliseconds.

    Example: fgpose track pose/ --rig Calib.toml --skeleton body_25b --fps 60 --online.lag-s 0.3
    """

    step: ClassVar[str] = "track"
    rrd_ends: ClassVar[str] = "online"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver
        from fgpose.cli.viewers import live_viewer
        from fgpose.pipeline import run_track, show

        outputs = self.checked_outputs("smoothed", "online")
        source = self.load()
        with live_viewer(outputs, source, ("smoothed", "online"), grows=True) as viewer:
            with progress_bar("tracking") as progress:
                result = run_track(source, self.parameters, progress, viewer)
            # A live viewer has seen every frame already.
            display = show if viewer is None else lambda result, viewer: None
            return deliver(result, outputs, viewer, display, strict=self.strict)
