"""The commands that read a recording or results. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import Positional, arg

from fgpose.cli.calibration import calibrated
from fgpose.cli.options import ParameterOptions, RecordingOptions, new_console, progress_bar
from fgpose.geometry.up_axis import UpChoice

if TYPE_CHECKING:
    from fgpose.association.recording import Association
    from fgpose.calibration.moved_views import Recording
    from fgpose.geometry.camera import CameraRig
    from fgpose.people import PeopleObservations
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
        outputs.check(saved, (self.keypoints, self.rig), calibration=calibration)
        return outputs


@dataclass(frozen=True, kw_only=True)
class Smooth(EstimatorOptions):
    """Smooth a whole recording: the most probable motion given all frames.

    Writes NAME.parquet, NAME.trc and NAME.rrd into the output folder. Of several people, all are in NAME.parquet, and
    each has a NAME_personN.trc. With --solver.no-covariance it is faster and does not state how uncertain each joint
    is.

    Example: fgpose smooth pose/ --rig Calib.toml --skeleton body_25b --fps 60 --motion.max-unseen-s 5
    """

    step: ClassVar[str] = "smooth"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver
        from fgpose.cli.live import live_viewer
        from fgpose.pipeline import run_smooth

        outputs = self.checked_outputs("smoothed")
        source = self.load()
        with live_viewer(outputs, source, ("fused", "refined", "smoothed")) as viewer:
            with progress_bar("smoothing") as progress:
                result = run_smooth(source, self.parameters, progress, compare=outputs.shown)
            return deliver(result, outputs, viewer, strict=self.strict)


@dataclass(frozen=True, kw_only=True)
class Refine(EstimatorOptions):
    """Estimate every frame alone by the paper's method: reprojection error with limb symmetry, no smoothing.

    Writes NAME.parquet, NAME.trc and NAME.rrd into the output folder, where NAME ends with _refined unless it is given.
    Of the parameters only --fusion.*, --refinement.* and --solver.max-iterations matter here.

    Example: fgpose refine pose/ --rig Calib.toml --skeleton body_25b --fps 60
    """

    step: ClassVar[str] = "refine"
    name_ends: ClassVar[str] = "_refined"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver
        from fgpose.cli.live import live_viewer
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
class Track(EstimatorOptions):
    """Replay a recording frame by frame through the online estimator, as if it were live, and time it.

    Writes NAME_online.* (the newest pose after each frame) and NAME_smoothed.* (each frame once it is --online.lag-s
    old), and NAME_online.rrd. With --live, viewers see every frame as soon as it is estimated. Prints latencies in
    milliseconds.

    Example: fgpose track pose/ --rig Calib.toml --skeleton body_25b --fps 60 --online.lag-s 0.3
    """

    step: ClassVar[str] = "track"
    rrd_ends: ClassVar[str] = "online"

    def run(self) -> int:
        from fgpose.cli.delivery import deliver
        from fgpose.cli.live import live_viewer
        from fgpose.pipeline import run_track, show

        outputs = self.checked_outputs("smoothed", "online")
        source = self.load()
        with live_viewer(outputs, source, ("smoothed", "online"), grows=True) as viewer:
            with progress_bar("tracking") as progress:
                result = run_track(source, self.parameters, progress, viewer)
            # A live viewer has seen every frame already.
            display = show if viewer is None else lambda result, viewer: None
            return deliver(result, outputs, viewer, display, strict=self.strict)


@dataclass(frozen=True, kw_only=True)
class Info(RecordingOptions):
    """Report on a recording before solving it: what is seen, and what is probably wrong.

    How many people there seem to be, and when; which cameras see what, how well they agree, whether a calibration is
    wrong, a camera was moved or is late, left and right are exchanged, or millimetres are taken for metres. Takes some
    seconds. Nothing is written. Errors are pixels of the undistorted image.

    Example: fgpose info pose/ --rig Calib.toml --skeleton body_25b --fps 60
    """

    min_gap_s: Annotated[float, arg(metavar="SECONDS")] = 0.5
    """List gaps in which fewer than two cameras see a joint for longer than this, seconds."""

    def run(self) -> None:
        from fgpose.assessment.recording_info import recording_info
        from fgpose.cli.findings import print_findings
        from fgpose.cli.info_tables import print_info
        from fgpose.cli.tables import print_association, print_presence
        from fgpose.diagnosis.diagnose import diagnose
        from fgpose.people import PeopleObservations

        source, console = self.load(), new_console()
        seen = source.observations
        if isinstance(seen, PeopleObservations):
            everybody = source.succession.association if source.succession else _told_apart(seen, source.rig)
            print_association(console, everybody, source.succession)
            source = source.one()
            seen = everybody if everybody.people else source.observations
            console.print("Of the person who is seen most; late and moved cameras by everybody:")
        else:
            if source.chosen is not None and source.chosen.n_people > 1:
                console.print(f"Looked at is {source.chosen}.", soft_wrap=True)
            print_presence(console, source)
        with new_console(stderr=True).status("comparing the cameras"):
            info = recording_info(source.observations, source.rig, self.min_gap_s)
            diagnosis = diagnose(seen, source.rig)
        print_info(console, info)
        print_findings(console, diagnosis)


def _told_apart(people: PeopleObservations, rig: CameraRig) -> Association:
    from fgpose.association.recording import associate

    with progress_bar("telling people apart") as progress:
        return associate(people, rig, progress=progress)


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Compare a result with a reference: errors in millimetres, jitter in m/s^3, and a table of the joints.

    Any trajectory files: parquet, npz, TRC, C3D. Joints are matched by name, frames by time. Nothing is interpolated,
    and only PA-MPJPE aligns the poses. Where one of the files has several people: who was found, told apart and posed
    how well (recall, precision, MOTA, IDF1, HOTA, MPJPE, PCP), over all frames of the reference, and a table of its
    people.

    Example: fgpose evaluate out/pose.parquet mocap.trc --offset-s 0.25
    """

    estimate: Positional[Path]
    """File of the result."""
    reference: Positional[Path]
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
        from fgpose.assessment.people import evaluate_people
        from fgpose.cli.tables import print_evaluation, print_people_evaluation
        from fgpose.io.trajectories import load_upright

        estimate, _ = load_upright(self.estimate, self.world_up)
        reference, _ = load_upright(self.reference, self.reference_up)
        if len(estimate) == len(reference) == 1:
            one, true = next(iter(estimate.values())), next(iter(reference.values()))
            print_evaluation(new_console(), evaluate(one, true, self.offset_s))
        else:
            people = evaluate_people(estimate, reference, truth_offset_s=self.offset_s, match_m=self.match_m)
            print_people_evaluation(new_console(), people)
