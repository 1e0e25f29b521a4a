"""The live system from the command line."""

from __future__ import annotations

import logging
import math
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, arg

from fgpose.cli.console import new_console
from fgpose.cli.live_consumers import Consumers, LiveInputs, LiveOutputs
from fgpose.cli.process import forgiving_streams
from fgpose.live.frame import CameraState, LiveFrame, LiveJudgement

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from fgpose.live.cameras.rig_file import LiveRig
    from fgpose.live.processes.camera_feed import CameraFeed
    from fgpose.live.recording.replay import ReplayComparison
    from fgpose.live.statistics import LiveStatistics
    from fgpose.monocular.network import Network
    from fgpose.monocular.networks.devices import Device
    from fgpose.skeleton import Skeleton

_OF_THE_PRESENT = {"distances", "distances_port", "poses_port", "input_keys", "duration_s", "resume"}
_EVERY_S = 0.5  # the line of the terminal changes so often
_ROUNDING_MM = 0.01  # a recording has single precision: 5 m to 0.0005 mm


@dataclass(frozen=True, kw_only=True)
class Live(LiveOutputs, LiveInputs):
    """Poses of everybody from cameras as they run, until Ctrl-C.

    RIG names the cameras, their calibration and their sources: USB devices, RTSP or HTTP URLs, videos or folders played
    in real time, or zmq for the keypoints of a detector elsewhere (docs/live_cameras.md). Publishes also when nobody is
    there, and says which cameras can be trusted. Nothing that is published is a safety function.

    Example: fgpose live rig.toml --zmq 5556 --record session.fgpose
    """

    config: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """TOML file of parameters, as those in configs/."""
    resume: Annotated[Path | None, arg(metavar="FILE.json", help_behavior_hint="(default: none)")] = None
    """Go on from this file, if it is there: with the numbers of people, how they are recognised, and what motion has
    told of the clocks. It is kept up to date for the next start."""
    replay: Annotated[Path | None, arg(metavar="FILE.fgpose", help_behavior_hint="(default: none)")] = None
    """Run a recording again in place of cameras: the same detections through the same estimator, in real time. Says how
    far the people are from those recorded."""
    fast: Annotated[bool, FlagCreatePairsOff] = False
    """Run it as fast as possible."""
    duration_s: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: until Ctrl-C)")] = None
    """Stop after this time."""

    def run(self) -> int:
        with forgiving_streams():
            return self._run()

    def _run(self) -> int:
        from fgpose.config import Config, load_config
        from fgpose.io.live.tracker_memory import load_memory
        from fgpose.io.made_by import refuse_others
        from fgpose.live.cameras.rig_file import load_live_rig
        from fgpose.live.clock import Clock
        from fgpose.live.processes.camera_feed import CameraFeed
        from fgpose.live.reception.input_keys import InputKeys
        from fgpose.live.recording.memory_file import MemoryFile
        from fgpose.live.system import LiveSystem
        from fgpose.live.tracking.live_tracking import LiveTracking
        from fgpose.live.tracking.observed import volume_points_m

        console = new_console(stderr=True)
        logging.basicConfig(format="fgpose: %(message)s", level=logging.INFO, handlers=[ConsoleLog(console)])
        if self.rrd is not None:
            refuse_others([self.rrd], "live", remedy="choose another with --rrd, or remove it")
        if self.replay is not None:
            self._refuse_options_of_cameras()
            with _on_signals(_interrupt):
                return run_replay(self.replay, self, self.config, is_fast=self.fast)
        if self.rig is None or self.fast:
            raise ValueError(
                "--fast needs --replay" if self.fast else "give a rig file, RIG.toml, or --replay FILE.fgpose"
            )
        config = Config() if self.config is None else load_config(self.config)
        live_rig, clock = load_live_rig(self.rig), Clock()
        open_network, skeleton = self._detector(live_rig, config.monocular.device)
        memory = None
        if self.resume is not None and self.resume.exists():
            memory = load_memory(self.resume, live_rig.rig, skeleton, config)
        with _on_signals(_interrupt), ExitStack() as stack:
            consumers = Consumers(clock)
            show, parts = consumers.show_image, consumers.parts
            if self.input_keys is not None:
                consumers.who = stack.enter_context(InputKeys(self.input_keys, parts))
            feed = stack.enter_context(
                CameraFeed(live_rig, clock, open_network, config.online.lag_s, self.jobs, show=show, parts=parts)
            )
            consumers.open(stack, self, feed.rig, skeleton, config)
            tracking = LiveTracking(feed.rig, skeleton, config, volume_points_m(feed.rig), parts, memory)
            stack.callback(tracking.close)
            if self.resume is not None:
                kept = MemoryFile(self.resume, tracking, live_rig.rig, config, consumers.tell, parts)
                stack.callback(kept.close)
                consumers.observers.append(kept.observe)
            self._receive(stack, feed, skeleton, consumers)
            line = stack.enter_context(StatusLine(console))
            outputs, diagnosis = [*consumers.frames, line], consumers.diagnosis
            system = LiveSystem(feed, tracking, outputs, consumers.observers, clock, parts, diagnosis)
            with _on_signals(system.stop), system.never_silent():
                system.run(float("inf") if self.duration_s is None else clock.now_s() + self.duration_s)
        new_console().print(_table(system.report))
        return consumers.say_states()

    def _refuse_options_of_cameras(self) -> None:
        """A recording has its own cameras and detections, and distances from a robot are of the present."""
        others = _OF_THE_PRESENT | {field.name for field in fields(LiveInputs)}
        given = [
            field.name for field in fields(self) if field.name in others and getattr(self, field.name) != field.default
        ]
        if given:
            options = ", ".join("RIG.toml" if name == "rig" else f"--{name.replace('_', '-')}" for name in given)
            raise ValueError(f"--replay runs a recording: leave out {options}")

    def _detector(self, live_rig: LiveRig, usual: Device) -> tuple[Callable[[], Network] | None, Skeleton]:
        """How to open the network, where any camera needs it, and the joints."""
        from fgpose.io.skeletons import load_skeleton
        from fgpose.live.processes.camera_feed import ELSEWHERE
        from fgpose.monocular.networks import open_network

        if self.jobs is not None and self.jobs < 1:
            raise ValueError(f"--jobs must be at least 1, got {self.jobs}")
        if all(settings.source == ELSEWHERE for settings in live_rig.sources.values()):
            if self.skeleton is None:
                raise ValueError(f"{self.rig}: all detectors are elsewhere; say with --skeleton what their joints are")
            return None, load_skeleton(self.skeleton)
        device = self.device or usual
        open_it = partial(open_network, self.model, max_people=self.max_people, device=device)
        # Here as well, so that weights are fetched once.
        with new_console(stderr=True).status("opening the network"):
            return open_it, open_it().skeleton

    def _receive(self, stack: ExitStack, feed: CameraFeed, skeleton: Skeleton, consumers: Consumers) -> None:
        """Listen for the keypoints of detectors elsewhere, if there are any."""
        from fgpose.live.reception.keypoint_socket import KeypointSocket
        from fgpose.live.reception.received import KeypointReceiver

        if feed.received:
            rig = feed.rig.subset(feed.received)
            settings = {name: camera.settings for name, camera in feed.received.items()}
            socket = KeypointSocket(
                rig,
                skeleton,
                port=self.keypoints_port,
                host=self.inputs_host,
                keys={name: each.key for name, each in settings.items() if each.key},
                synchronised=[name for name, each in settings.items() if each.clock == "synchronised"],
                who=consumers.who,
                tell=consumers.tell,
            )
            consumers.sockets.append(socket)
            stack.callback(KeypointReceiver(socket, feed.received, feed.deliver, consumers.parts).close)
            new_console(stderr=True).print(f"keypoints of {', '.join(rig.names)} come to {socket.address}")


@contextmanager
def _on_signals(call: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C, Ctrl-\\, SIGTERM and the end of the terminal are how a live system ends: everything is closed, and the
    report is printed. Under nohup it outlives its terminal."""
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = [signal.signal(number, lambda *_: call()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _interrupt() -> None:
    """What is open already is closed."""
    raise KeyboardInterrupt


def _table(report: LiveStatistics) -> Table:
    """What happened to each camera, and how late the frames were."""
    from rich import box
    from rich.table import Table

    table = Table(
        title=f"{report.n_frames} frames; {_latency(report)}",
        title_justify="left",
        box=box.HORIZONTALS,
        collapse_padding=True,
    )
    table.add_column("camera", no_wrap=True)
    # Broken by hand, so that no word is cut on a terminal of 80 columns.
    for heading in ("images", "used", "not\nused", "[Hz]", *(f"{state.value}\n[s]" for state in CameraState)):
        table.add_column(heading, justify="right")
    for camera in report.cameras:
        seconds = [f"{report.seconds_in(camera.name, state):.0f}" for state in CameraState]
        # Of those that are neither used nor lost a newer one came before a network had looked at them.
        counts = [str(number) for number in (camera.n_images, camera.n_used, camera.n_images - camera.n_used)]
        table.add_row(camera.name, *counts, f"{camera.rate_hz:.1f}", *seconds)
    return table


def _latency(report: LiveStatistics) -> str:
    from fgpose.live.statistics import LONGEST_MS

    def of(percent: float) -> str:
        latency_ms = report.latency_ms(percent)
        return f"more than {LONGEST_MS} ms" if math.isinf(latency_ms) else f"{latency_ms:.0f} ms"

    if math.isnan(report.latency_ms(50.0)):
        return "no image came"
    return f"from image to frame: median {of(50.0)}, 95 % {of(95.0)}, 99 % {of(99.0)}"


class StatusLine:
    """A consumer of frames, while it is open. There is no line where the console is no terminal."""

    def __init__(self, console: Console) -> None:
        self._status = console.status("", refresh_per_second=2 / _EVERY_S)
        self._said_s = 0.0
        self._n_frames = 0

    def publish(self, frame: LiveFrame) -> None:
        """Count the frame, and say from time to time what frames say."""
        self._n_frames += 1
        elapsed_s = frame.published_s - self._said_s
        if elapsed_s >= _EVERY_S:
            self._status.update(in_words(frame, self._n_frames / elapsed_s))
            self._said_s, self._n_frames = frame.published_s, 0

    def __enter__(self) -> StatusLine:
        self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._status.stop()


class ConsoleLog(logging.Handler):
    """Prints what is logged above the line."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        self._console.print(self.format(record), soft_wrap=True)


def in_words(frame: LiveFrame, rate_hz: float) -> str:
    """A line on people, cameras, frames and their age."""
    n_people, n_cameras = len(frame.people), len(frame.cameras)
    states = Counter(camera.state for camera in frame.cameras)
    cameras = f"{states[CameraState.OK]} of {n_cameras} cameras ok"
    others = [f"{camera.name} {camera.state.value}" for camera in frame.cameras if camera.state is not CameraState.OK]
    age = f", {1e3 * frame.age_s:.0f} ms old" if any(camera.n_used for camera in frame.cameras) else ""
    return " · ".join(
        [
            *_diagnosis_in_words(frame.diagnosis),
            "1 person" if n_people == 1 else f"{n_people} people",
            f"{cameras} ({', '.join(others)})" if others else cameras,
            f"{rate_hz:.0f} frames/s{age}",
            f"{frame.observed_share:.0%} of the volume observed",
        ]
    )


def _diagnosis_in_words(diagnosis: LiveJudgement | None) -> list[str]:
    """What is wrong; or that nobody knows yet."""
    if diagnosis is None or (diagnosis.is_judged and not diagnosis.findings):
        return []
    codes = ", ".join(dict.fromkeys(finding.code for finding in diagnosis.findings))
    return [f"{'PROBABLY WRONG' if diagnosis.is_wrong else 'doubtful'}: {codes}" if codes else "not diagnosed yet"]


def run_replay(path: Path, outputs: LiveOutputs, config_path: Path | None, *, is_fast: bool) -> int:
    """Publish the frames of a recording again, and say how they agree with the recorded ones. Returns the exit code.

    Raises:
        ValueError: the recording is damaged.
        OSError: a file cannot be read or written.
    """
    from fgpose.config import load_config
    from fgpose.live.clock import Clock
    from fgpose.live.recording.live_recording import load_live_recording
    from fgpose.live.recording.replay import RecordedClock, replay

    recording = load_live_recording(path)
    clock, recorded = Clock(), RecordedClock(recording.started_s)
    config = None if config_path is None else load_config(config_path)
    with ExitStack() as stack:
        consumers = Consumers(recorded)
        used = config or recording.config
        of_recording = recording.rig, recording.skeleton, used, recording.started_s, path.name
        consumers.open(stack, outputs, *of_recording, is_fast=is_fast)

        def publish(frame: LiveFrame) -> None:
            recorded.publish(frame)
            for consumer in consumers.frames:
                consumer.publish(frame)

        with new_console(stderr=True).status("") as status:
            agreement = replay(
                recording,
                publish,
                consumers.observers,
                config,
                None if is_fast else clock,
                lambda time_s: status.update(f"{path}: {time_s:.1f} s"),
                consumers.diagnosis,
            )
    new_console().print(_said(agreement, is_same=config is None), soft_wrap=True)
    return consumers.say_states()


def _said(agreement: ReplayComparison, *, is_same: bool) -> str:
    text = f"{agreement.n_frames} frames again"
    if agreement.n_people and not math.isnan(agreement.largest_mm):
        text += f"; people within {agreement.largest_mm:.4f} mm of those recorded"
    text += f"; {agreement.n_others} times somebody was in one of them only" if agreement.n_others else ""
    if is_same and (agreement.n_others or agreement.largest_mm > _ROUNDING_MM):
        text += (
            ". Detections and parameters are the same: the estimate has gone another way from the last bit on (another "
            "version, computer or order of threads), where the cameras hardly tell where somebody is"
        )
    return text
