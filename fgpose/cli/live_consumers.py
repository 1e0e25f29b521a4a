"""What takes the frames of a live system, as the options of ``fgpose live`` say."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fgpose.cli.live_viewer import open_viewer
from fgpose.cli.options import new_console
from fgpose.cli.reachable import warn_if_others_reach

if TYPE_CHECKING:
    import numpy as np

    from fgpose.cli.live_options import LiveOutputs
    from fgpose.config import Config
    from fgpose.geometry.camera import CameraRig
    from fgpose.live.clock import Clock
    from fgpose.live.outputs import Output, ViewerOutput
    from fgpose.live.page.status_page import StatusPage
    from fgpose.live.processes.parts import Parts
    from fgpose.live.reception.input_keys import InputKeys
    from fgpose.live.reception.keypoint_socket import KeypointSocket
    from fgpose.live.system import Consumer
    from fgpose.live.tracking.live_tracking import Update
    from fgpose.robot.distance_server import DistanceServer
    from fgpose.skeleton import Skeleton


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
    ) -> None:
        """Open all that the options want, before any work; the stack closes it.

        Args:
            began_s: when the frames begin, Unix time; None: now.
        """
        from fgpose.live.outputs import open_lsl_output, open_mcap_output, open_zmq_output
        from fgpose.live.page.status_page import StatusPage
        from fgpose.live.recording.recorder import Recorder

        console, tell, parts = new_console(stderr=True), self.tell, self.parts
        warn_if_others_reach(options.host, "--host", "the outputs (page with pictures, people, distances)")
        if self.who is None:
            warn_if_others_reach(options.inputs_host, "--inputs-host", "the inputs (keypoints, poses of the robot)")
        if options.page is not None:
            page = StatusPage(rig, skeleton, options.page, options.host, faults=self._faults, parts=parts)
            self.page = stack.enter_context(page)
            console.print(f"status page: {self.page.url}", soft_wrap=True)
        if options.distances is not None:
            self._add(stack, self._distance_server(options, rig, skeleton))
        if options.zmq is not None:
            self._add(stack, open_zmq_output(options.zmq, host=options.host, tell=tell, parts=parts))
            console.print(f"publishing over ZeroMQ at tcp://{options.host}:{options.zmq}")
        if options.lsl:
            self._add(stack, open_lsl_output(skeleton, n_slots=options.lsl, tell=tell, parts=parts))
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

    def show_image(self, camera: str, picture_rgb: np.ndarray) -> None:
        """Show a picture of a camera where pictures are shown."""
        if self.page is not None:
            self.page.show_image(camera, picture_rgb)
        if self.viewer is not None:
            self.viewer.show_image(camera, picture_rgb)


def _name(socket: KeypointSocket) -> str:
    return f"keypoints at {socket.address}"
