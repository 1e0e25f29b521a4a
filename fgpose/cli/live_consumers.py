"""What takes the frames of a live system, and the options of `fgpose live` that say so."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from fgpose.cli.console import new_console
from fgpose.cli.options import DeviceChoice
from fgpose.cli.viewers import open_viewer, warn_if_others_reach

if TYPE_CHECKING:
    import numpy as np

    from fgpose.config import Config
    from fgpose.geometry.camera import CameraRig
    from fgpose.live.clock import Clock
    from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
    from fgpose.live.outputs import Output, ViewerOutput
    from fgpose.live.page.status_page import StatusPage
    from fgpose.live.processes.parts import Parts
    from fgpose.live.reception.input_keys import InputKeys
    from fgpose.live.reception.keypoint_socket import KeypointSocket
    from fgpose.live.system import Consumer
    from fgpose.live.tracking.live_tracking import Update
    from fgpose.robot.distance_server import DistanceServer
    from fgpose.skeleton import Skeleton


@dataclass(frozen=True, kw_only=True)
class LiveInputs:
    """Where images or keypoints come from, and what looks for people in them."""

    rig: Annotated[Positional[Path | None], arg(metavar="RIG.toml", help_behavior_hint="(or --replay)")] = None
    """Cameras and sources."""
    model: Annotated[str, arg(metavar="NAME|FILE")] = "blazepose-lite"
    """Network that looks for people in images."""
    max_people: Annotated[int, arg(metavar="N")] = 2
    """How many people to find in each image at most."""
    device: DeviceChoice = None
    """Where the network runs; fgpose models list shows what is there."""
    skeleton: Annotated[str | None, arg(metavar="NAME|FILE", help_behavior_hint="(default: of the network)")] = None
    """Joints of the keypoints where all detectors are elsewhere."""
    jobs: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one for each core)")] = None
    """Images that the network works on at the same time."""
    keypoints_port: Annotated[int, arg(metavar="PORT")] = 5557
    """Where detectors elsewhere send keypoints."""


@dataclass(frozen=True, kw_only=True)
class LiveOutputs:
    """What takes the frames."""

    zmq: Annotated[int | None, arg(metavar="PORT", help_behavior_hint="(default: none)")] = None
    """Publish over ZeroMQ (docs/live_messages.md)."""
    lsl: Annotated[int, arg(metavar="N", help_behavior_hint="(default: none)")] = 0
    """Publish so many people over the Lab Streaming Layer."""
    mcap: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write ROS 2 messages to an MCAP file, for Foxglove and ros2 bag play; no ROS node is made."""
    record: Annotated[Path | None, arg(metavar="FILE.fgpose", help_behavior_hint="(default: none)")] = None
    """Record detections, clocks and estimates."""
    page: Annotated[int | None, arg(metavar="PORT", help_behavior_hint="(default: none)")] = None
    """Serve a status page for the browser; 0 takes any free port."""
    rrd: Annotated[Path | None, arg(metavar="FILE.rrd", help_behavior_hint="(default: none)")] = None
    """Write all that can be seen to a file for the Rerun viewer, which is there when it ends (fgpose view)."""
    view: Annotated[bool, FlagCreatePairsOff] = False
    """Show the same in the Rerun viewer while it runs. It may be closed at any time."""
    no_diagnose: Annotated[bool, FlagCreatePairsOff] = False
    """Do not look every minute for what is probably wrong with keypoints and calibration, as fgpose info does at a
    recording: it takes some seconds of a core that nothing else wants."""
    distances: Annotated[Path | None, arg(metavar="CELL.toml", help_behavior_hint="(default: none)")] = None
    """Publish how far people are from links of a robot and from zones, over ZeroMQ (docs/live_distances.md). THIS IS NO
    SAFETY FUNCTION: nothing here is rated for protecting people."""
    distances_port: Annotated[int, arg(metavar="PORT")] = 5558
    """Where consumers of distances subscribe."""
    poses_port: Annotated[int, arg(metavar="PORT")] = 5559
    """Where the robot sends the poses of its links."""
    host: str = "127.0.0.1"
    """Address of this computer at which outputs are served: page, people, distances. The default is for programs of
    this computer only; nothing here asks for a password."""
    inputs_host: str = "127.0.0.1"
    """The same for inputs: keypoints of detectors elsewhere, poses of the robot. Whoever reaches them can make people
    appear and vanish."""
    input_keys: Annotated[Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: anybody may send)")] = None
    """Take inputs only from those whose keys are in the folder, encrypted (docs/help/security.md)."""


@dataclass
class Consumers:
    """What takes the frames of a live system, and whatever else it says."""

    clock: Clock
    outputs: list[Output] = field(default_factory=list)
    observers: list[Callable[[Update], None]] = field(default_factory=list)
    sockets: list[KeypointSocket] = field(default_factory=list)
    page: StatusPage | None = None
    viewer: ViewerOutput | None = None
    who: InputKeys | None = None
    """May send; None: anybody."""
    diagnosis: LiveDiagnosis | None = None
    parts: Parts = field(init=False)
    """What of the system has ended and was begun again."""

    def __post_init__(self) -> None:
        from fgpose.live.processes.parts import Parts

        self.parts = Parts(self.clock.now_s, self._note)

    def open(
        self,
        stack: ExitStack,
        options: LiveOutputs,
        rig: CameraRig,
        skeleton: Skeleton,
        config: Config,
        began_s: float | None = None,
        replay: str = "",
        is_fast: bool = False,
    ) -> None:
        """Open all that the options want, before any work; the stack closes it.

        Args:
            began_s: when the frames begin, Unix time; None: now.
            replay: name of the recording that is run again.
            is_fast: it is as fast as possible: whatever takes time is waited for.
        """
        from fgpose.live.outputs import open_lsl_output, open_mcap_output, open_zmq_output
        from fgpose.live.page.status_page import StatusPage
        from fgpose.live.recording.recorder import Recorder

        console, tell, parts = new_console(stderr=True), self.tell, self.parts
        if not options.no_diagnose:
            self.diagnosis = stack.enter_context(self._opened_diagnosis(rig, skeleton, waits=is_fast))
        self._warn_of_others(options)
        if options.page is not None:
            page = StatusPage(
                rig,
                skeleton,
                options.page,
                options.host,
                now_s=self.clock.now_s,
                faults=self._faults,
                parts=parts,
                replay=replay,
            )
            self.page = stack.enter_context(page)
            console.print(f"status page: {self.page.url}", soft_wrap=True)
        if options.distances is not None:
            self._add(stack, self._distance_server(options, rig, skeleton))
        if options.zmq is not None:
            self._add(stack, open_zmq_output(options.zmq, host=options.host, tell=tell, parts=parts))
            console.print(f"publishing over ZeroMQ at tcp://{options.host}:{options.zmq}")
        if options.lsl:
            lsl = open_lsl_output(skeleton, now_s=self.clock.now_s, n_slots=options.lsl, tell=tell, parts=parts)
            self._add(stack, lsl)
            console.print(f"publishing {options.lsl} people over the Lab Streaming Layer")
        if options.mcap is not None:
            self._add(stack, open_mcap_output(options.mcap, tell=tell, parts=parts))
        if options.record is not None:
            start_s = self.clock.now_s() if began_s is None else began_s
            recorder = Recorder(options.record, rig, skeleton, config, now_s=lambda: start_s, tell=tell, parts=parts)
            self._add(stack, recorder)
            self.observers.append(lambda update: recorder.record(update.images))
        if options.rrd is not None or options.view:
            self.viewer = open_viewer(options.rrd, rig, skeleton, options.view, tell, parts)
            self._add(stack, self.viewer)
            self.observers.append(self.viewer.observe)

    def _warn_of_others(self, options: LiveOutputs) -> None:
        warn_if_others_reach(options.host, "--host", "the outputs (page with pictures, people, distances)")
        if self.who is None:
            warn_if_others_reach(options.inputs_host, "--inputs-host", "the inputs (keypoints, poses of the robot)")

    def _opened_diagnosis(self, rig: CameraRig, skeleton: Skeleton, *, waits: bool) -> LiveDiagnosis:
        from fgpose.live.diagnosis.live_diagnosis import LiveDiagnosis
        from fgpose.pipeline.diagnosed import diagnose_people

        now_s, parts = self.clock.now_s, self.parts
        return LiveDiagnosis(rig, skeleton, diagnose_people, now_s=now_s, parts=parts, waits=waits)

    @property
    def frames(self) -> list[Consumer]:
        """Everything that takes frames."""
        return [*self.outputs, *([] if self.page is None else [self.page])]

    def tell(self, line: str) -> None:
        """Say what is wrong with an input or output, wherever somebody may look."""
        logging.getLogger("fgpose.live").warning(line)
        self._note(line)

    def _note(self, line: str) -> None:
        """On the page; it is logged already."""
        if self.page is not None:
            self.page.note(line, is_fault=True)

    def say_states(self) -> int:
        """What became of all that came and was published. Returns the exit code: 1 if a file lacks something."""
        console = new_console()
        for socket in self.sockets:
            said = f"{_name(socket)}: {socket.n_received} images"
            refused = socket.rejected_in_words
            console.print(f"{said}; {refused}" if refused else said, soft_wrap=True)
        for state in (output.state for output in self.outputs):
            said = [f"{state.name}: {state.n_published} published, {state.n_skipped} skipped"]
            said += [f"{state.n_lost} MISSING"] if state.n_lost else []
            said += [state.last_error] if state.last_error else []
            console.print("; ".join(said), soft_wrap=True)
        return int(any(output.state.is_incomplete for output in self.outputs))

    def _add(self, stack: ExitStack, output: Output) -> None:
        self.outputs.append(output)
        stack.callback(output.close)

    def _distance_server(self, options: LiveOutputs, rig: CameraRig, skeleton: Skeleton) -> DistanceServer:
        from fgpose.robot.cell import load_cell
        from fgpose.robot.distance_server import DistanceServer
        from fgpose.robot.distances import NO_SAFETY_FUNCTION

        assert options.distances is not None
        server = DistanceServer(
            load_cell(options.distances),
            rig,
            skeleton,
            port=options.distances_port,
            poses_port=options.poses_port,
            host=options.host,
            poses_host=options.inputs_host,
            who=self.who,
            show=None if self.page is None else self.page.show_distances,
            tell=self.tell,
            now_s=self.clock.now_s,
            parts=self.parts,
        )
        console = new_console(stderr=True)
        console.print(f"distances at {server.address}; poses of links come to {server.poses_address}", soft_wrap=True)
        console.print(NO_SAFETY_FUNCTION, soft_wrap=True)
        return server

    def _faults(self) -> dict[str, str]:
        """Of inputs and outputs by name."""
        faults = {_name(socket): socket.rejected_in_words for socket in self.sockets}
        for state in (output.state for output in self.outputs):
            faults[state.name] = state.fault
        return faults

    def show_image(self, camera: str, picture_rgb: np.ndarray, time_s: float) -> None:
        """Show a picture of a camera, taken at this Unix time, where pictures are shown."""
        if self.page is not None:
            self.page.show_image(camera, picture_rgb, time_s)
        if self.viewer is not None:
            self.viewer.show_image(camera, picture_rgb, time_s)


def _name(socket: KeypointSocket) -> str:
    return f"keypoints at {socket.address}"
