"""What takes the frames of a live system, as the options of ``fgpose live`` say."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fgpose.cli.options import new_console

if TYPE_CHECKING:
    import numpy as np

    from fgpose.cli.live_command import Live
    from fgpose.config import Config
    from fgpose.geometry.camera import CameraRig
    from fgpose.live.outputs import Output
    from fgpose.live.page import StatusPage
    from fgpose.live.system import Consumer
    from fgpose.live.tracking import Update
    from fgpose.skeleton import Skeleton


@dataclass
class Consumers:
    """What takes the frames of a live system, and whatever else it says."""

    outputs: list[Output] = field(default_factory=list)
    observers: list[Callable[[Update], None]] = field(default_factory=list)
    page: StatusPage | None = None

    def open(self, stack: ExitStack, live: Live, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
        """Open all that the options want, before any work; the stack closes it."""
        from fgpose.live.outputs import open_lsl_output, open_mcap_output, open_zmq_output
        from fgpose.live.page import StatusPage
        from fgpose.live.recorder import Recorder

        console = new_console(stderr=True)
        tell = logging.getLogger("fgpose.live").warning
        if live.zmq is not None:
            self.outputs.append(open_zmq_output(live.zmq, host=live.host, tell=tell))
            console.print(f"publishing over ZeroMQ at tcp://{live.host}:{live.zmq}")
        if live.lsl:
            self.outputs.append(open_lsl_output(skeleton, n_slots=live.lsl, tell=tell))
            console.print(f"publishing {live.lsl} people over the Lab Streaming Layer")
        if live.mcap is not None:
            self.outputs.append(open_mcap_output(live.mcap, tell=tell))
        if live.record is not None:
            recorder = Recorder(live.record, rig, skeleton, config, tell=tell)
            self.outputs.append(recorder)
            self.observers.append(lambda update: recorder.record(update.images))
        for output in self.outputs:
            stack.callback(output.close)
        if live.page is not None:
            page = stack.enter_context(StatusPage(rig, skeleton, live.page, live.host))
            self.page = page
            console.print(f"status page: {page.url}", soft_wrap=True)

    @property
    def frames(self) -> list[Consumer]:
        """Everything that takes frames."""
        return [*self.outputs, *([] if self.page is None else [self.page])]

    def say_states(self) -> None:
        """What became of all that was published."""
        for state in (output.state for output in self.outputs):
            said = f"{state.name}: {state.n_published} frames, {state.n_skipped} skipped"
            new_console().print(f"{said}; {state.last_error}" if state.last_error else said, soft_wrap=True)

    def show_image(self, camera: str, picture_rgb: np.ndarray) -> None:
        """Show a picture of a camera where pictures are shown."""
        if self.page is not None:
            self.page.show_image(camera, picture_rgb)
