"""Benchmarks on data that the user brings. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from fgpose.cli.console import new_console, progress_bar

if TYPE_CHECKING:
    from fgpose_benchmarks.human36m.labels import PoseSequence
    from fgpose_benchmarks.human36m.predictions import Predictions

_LABELS = (
    "Your copy of Human3.6M: human36m-multiview-labels-*.npy of Learnable Triangulation, or the folder processed of "
    "h36m-fetch."
)
_CAMERAS = (
    "For h36m-fetch, which has no extrinsics: camera-parameters.json of karfly/human36m-camera-parameters, or a folder "
    "with a calibration for each subject (S9.toml, S11.toml)."
)


@dataclass(frozen=True, kw_only=True)
class LabelOptions:
    """Where the user's copy of Human3.6M is."""

    labels: Annotated[Positional[Path], arg(help=_LABELS)]
    cameras: Annotated[Path | None, arg(metavar="FILE|FOLDER", help_behavior_hint="(default: none)", help=_CAMERAS)] = (
        None
    )
    step: Annotated[int, arg(metavar="N")] = 64
    """Take every n-th frame of the 50 Hz videos."""
    subjects: Annotated[tuple[str, ...], arg(metavar="NAME ...")] = ("S9", "S11")
    """Subjects whose sequences are used; the protocol has S9 and S11."""

    def sequences(self) -> list[PoseSequence]:
        """Those of the subjects. Raises ValueError and OSError as load_labels and load_annotations."""
        from fgpose_benchmarks.human36m.h36m_fetch import load_annotations, load_subject_rigs
        from fgpose_benchmarks.human36m.labels import load_labels

        if not self.labels.is_dir():
            return load_labels(self.labels, self.subjects)
        if self.cameras is None:
            raise ValueError(f"{self.labels}: the annotations of h36m-fetch have no extrinsics; give --cameras")
        return load_annotations(self.labels, load_subject_rigs(self.cameras), self.subjects)


@dataclass(frozen=True, kw_only=True)
class Human36M(LabelOptions):
    """Score 3D poses on your own copy of Human3.6M: S9 and S11, every 64th frame, one column for each action.

    Prints the two tables of the field in Markdown: absolute errors, without the three sequences of S9 whose truth is
    damaged, and errors relative to the pelvis. Predictions are npz files of any method with subject, action, frame and
    positions_m (or positions_mm), see fgpose_benchmarks.human36m.predictions. With --views, fgpose estimates the poses
    from what each camera alone gives (SUBJECT/ACTION.npz, see fgpose_benchmarks.human36m.per_view), and they are scored
    beside the others.

    Example: fgpose benchmark human36m labels.npy --predictions adafuse.npz transfusion.npz --views per_view/
    """

    predictions: Annotated[tuple[Path, ...], arg(metavar="FILE ...", help_behavior_hint="(default: none)")] = ()
    """Results of methods; each gets a line in the tables, named after its file."""
    views: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: none)")] = None
    """Poses of each camera alone, from which fgpose estimates poses."""
    estimation: Literal["smooth", "refine", "fuse"] = "smooth"
    """How fgpose estimates: the whole motion; each frame alone by the paper's method; the fusion of eq. 1-2 alone."""
    config: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """TOML file of parameters for it, as those in configs/."""
    allow_missing: bool = False
    """Score the frames that are there if others are missing; the last column states the share of missing joints."""
    output: Annotated[Path | None, arg(metavar="FOLDER", aliases=("-o",), help_behavior_hint="(default: none)")] = None
    """Folder for the tables (human36m.md) and for the poses that fgpose estimates (fgpose_ESTIMATION.npz)."""

    def run(self) -> None:
        from fgpose.io.atomic import check_writable, write_text
        from fgpose_benchmarks.human36m.predictions import save_predictions
        from fgpose_benchmarks.human36m.protocol import evaluate, to_markdown

        if self.output is not None:
            check_writable(self.output)
        methods, sequences = self._loaded(), self.sequences()
        if self.views is not None:
            own = self._estimated(self.views, sequences)
            methods[f"fgpose {self.estimation}"] = own
            if self.output is not None:
                save_predictions(own, self.output / f"fgpose_{self.estimation}.npz")
        scores = {}
        for name, each in methods.items():
            try:
                scores[name] = evaluate(sequences, each, step=self.step, allow_missing=self.allow_missing)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from None
        markdown = to_markdown(scores)
        new_console().print(markdown, soft_wrap=True)
        if self.output is not None:
            write_text(self.output / "human36m.md", markdown)

    def _loaded(self) -> dict[str, Predictions]:
        from fgpose_benchmarks.human36m.predictions import load_predictions

        if not self.predictions and self.views is None:
            raise ValueError("there is nothing to score: give --predictions, --views or both")
        names = [path.stem for path in self.predictions]
        if len(set(names)) < len(names):
            raise ValueError(f"files of predictions need different names: {', '.join(map(str, self.predictions))}")
        return {path.stem: load_predictions(path) for path in self.predictions}

    def _estimated(self, views: Path, sequences: list[PoseSequence]) -> Predictions:
        from fgpose.config import Config, load_config
        from fgpose_benchmarks.human36m.per_view import estimate, load_views

        config = Config() if self.config is None else load_config(self.config)
        observations = load_views(views, sequences)
        with progress_bar("estimating", "sequences") as progress:
            return estimate(sequences, observations, self.estimation, config, progress)


@dataclass(frozen=True, kw_only=True)
class OccludeImages(LabelOptions):
    """Make the images of Human3.6M-Occluded from your own copy: objects over the person in three of four views.

    Of every 64th frame of S9 and S11 three views are drawn; in each, two objects are pasted over the person, as the
    generator of the paper's authors does. The fourth image is copied. Writes the images into the same folders below the
    output folder, and occluders.json, which lists the objects and their places.

    Example: fgpose benchmark occlude labels.npy --images processed/ --cutouts VOCdevkit/VOC2012 -o occluded
    """

    images: Annotated[Path, arg(metavar="FOLDER")]
    """Images as h36m-fetch extracts them: SUBJECT/ACTION/imageSequence/CAMERA/img_000001.jpg."""
    cutouts: Annotated[Path, arg(metavar="FOLDER")]
    """Objects: PNG files with alpha, or the folder of Pascal VOC 2012 (with Annotations)."""
    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))]
    """Folder for the images; it is made if it is absent."""
    boxes: Literal["joints", "labels"] = "joints"
    """The person's box: around the joints; or as in the labels, where Learnable Triangulation made it a square."""
    seed: int = 42
    """Seed of the random numbers; the authors' is 42."""

    def run(self) -> None:
        from fgpose_benchmarks.human36m.cutouts import load_cutouts
        from fgpose_benchmarks.human36m.occluded_images import generate, protocol_frames

        frames = protocol_frames(self.sequences(), self.images, self.boxes, self.step)
        cutouts = load_cutouts(self.cutouts)
        with progress_bar("pasting") as progress:
            path = generate(frames, cutouts, self.output, self.seed, progress)
        new_console().print(f"{len(frames)} frames, {len(cutouts)} cut-outs\nwrote {path}", soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class Workcell:
    """Compare a result with a suit of inertial sensors, whose position drifts, as the paper does for its workcells.

    In every frame the reference is moved, not turned, until its neck is where the anchor's is; then absolute errors,
    errors relative to the pelvis, and a table of the joints. Joints are matched by name; segments of Xsens MVN count as
    the joints at which they begin. The reference is interpolated at the times of the result.

    Example: fgpose benchmark workcell out/cell.parquet suit.trc --anchor openptrack.trc --offset-s 0.25
    """

    estimate: Positional[Path]
    """File of the result: parquet, npz, TRC or C3D."""
    reference: Positional[Path]
    """File of the suit: the same formats."""
    anchor: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: the result itself)")] = None
    """File of another tracker, with the clock of the result, whose neck corrects the drift (the paper: OpenPTrack)."""
    offset_s: Annotated[float, arg(metavar="SECONDS")] = 0.0
    """Added to the reference's times, for a suit with a clock of its own, seconds."""
    neck: Annotated[str | None, arg(metavar="JOINT", help_behavior_hint="(default: neck, thorax or shoulders)")] = None
    """Name of the joint that is aligned."""

    def run(self) -> None:
        from fgpose.cli.commands.evaluate import print_evaluation
        from fgpose.io.trajectories import load_trajectory
        from fgpose_benchmarks.human36m.workcell import evaluate_workcell

        estimate, reference = load_trajectory(self.estimate), load_trajectory(self.reference)
        anchor = None if self.anchor is None else load_trajectory(self.anchor)
        evaluation = evaluate_workcell(estimate, reference, anchor, reference_offset_s=self.offset_s, neck=self.neck)
        console = new_console()
        if anchor is None:
            console.print("aligned at the result's own neck, whose error is therefore zero")
        print_evaluation(console, evaluation)
