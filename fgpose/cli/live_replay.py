"""A recording of the live system run again, from the command line."""

from __future__ import annotations

import dataclasses
import math
from contextlib import ExitStack
from typing import TYPE_CHECKING

from fgpose.cli.live_consumers import Consumers
from fgpose.cli.options import new_console

if TYPE_CHECKING:
    from fgpose.cli.live_command import Live
    from fgpose.live.frame import LiveFrame
    from fgpose.live.replay import Agreement

# What a recording has already, or has no use for.
_OF_CAMERAS = ("rig", "model", "max_people", "skeleton", "jobs", "keypoints_port", "duration_s")


def run_replay(live: Live) -> None:
    """Publish the frames of live.replay again, and say how they agree with the recorded ones.

    Raises:
        ValueError: there are options of cameras, or the recording is damaged.
        OSError: a file cannot be read or written.
    """
    from fgpose.config import load_config
    from fgpose.live.clock import Clock
    from fgpose.live.recording import load_live_recording
    from fgpose.live.replay import replay

    assert live.replay is not None
    _refuse_options(live)
    recording = load_live_recording(live.replay)
    config = None if live.config is None else load_config(live.config)
    with ExitStack() as stack:
        consumers = Consumers()
        consumers.open(stack, live, recording.rig, recording.skeleton, config or recording.config)

        def publish(frame: LiveFrame) -> None:
            for consumer in consumers.frames:
                consumer.publish(frame)

        with new_console(stderr=True).status("") as status:
            agreement = replay(
                recording,
                publish,
                consumers.observers,
                config,
                None if live.fast else Clock(),
                lambda time_s: status.update(f"{live.replay}: {time_s:.1f} s"),
            )
    new_console().print(_said(agreement), soft_wrap=True)
    consumers.say_states()


def _refuse_options(live: Live) -> None:
    given = [
        field.name
        for field in dataclasses.fields(live)
        if field.name in _OF_CAMERAS and getattr(live, field.name) != field.default
    ]
    if given:
        names = ", ".join("RIG.toml" if name == "rig" else f"--{name.replace('_', '-')}" for name in given)
        raise ValueError(f"--replay runs a recording, which has its own cameras and detections: leave out {names}")


def _said(agreement: Agreement) -> str:
    text = f"{agreement.n_frames} frames again"
    if agreement.n_people and not math.isnan(agreement.largest_mm):
        text += f"; people within {agreement.largest_mm:.4f} mm of those recorded"
    return text + (f"; {agreement.n_others} times somebody was in one of them only" if agreement.n_others else "")
