"""A recording of the live system run again, from the command line."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import TYPE_CHECKING

from fgpose.cli.live_consumers import Consumers
from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from pathlib import Path

    from fgpose.cli.live_options import LiveOutputs
    from fgpose.live.frame import LiveFrame
    from fgpose.live.recording.replay import Agreement


def run_replay(path: Path, outputs: LiveOutputs, config_path: Path | None, *, is_fast: bool) -> int:
    """Publish the frames of a recording again, and say how they agree with the recorded ones. Returns the exit code.

    Raises:
        ValueError: the recording is damaged.
        OSError: a file cannot be read or written.
    """
    from fgpose.config import load_config
    from fgpose.live.clock import Clock
    from fgpose.live.recording.live_recording import load_live_recording
    from fgpose.live.recording.replay import replay

    recording = load_live_recording(path)
    clock = Clock()
    config = None if config_path is None else load_config(config_path)
    with ExitStack() as stack:
        consumers = Consumers(clock)
        consumers.open(
            stack, outputs, recording.rig, recording.skeleton, config or recording.config, recording.started_s
        )

        def publish(frame: LiveFrame) -> None:
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
            )
    new_console().print(_said(agreement), soft_wrap=True)
    return consumers.say_states()


def _said(agreement: Agreement) -> str:
    text = f"{agreement.n_frames} frames again"
    if agreement.n_people and not math.isnan(agreement.largest_mm):
        text += f"; people within {agreement.largest_mm:.4f} mm of those recorded"
    return text + (f"; {agreement.n_others} times somebody was in one of them only" if agreement.n_others else "")
