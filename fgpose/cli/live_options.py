"""Options of ``fgpose live``. The docstrings are what --help prints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg


@dataclass(frozen=True, kw_only=True)
class LiveInputs:
    """Where images or keypoints come from, and what looks for people in them."""

    rig: Annotated[Positional[Path | None], arg(metavar="RIG.toml", help_behavior_hint="(or --replay)")] = None
    """Cameras and sources."""
    model: Annotated[str, arg(metavar="NAME|FILE")] = "blazepose-lite"
    """Network that looks for people in images."""
    max_people: Annotated[int, arg(metavar="N")] = 2
    """How many people to find in each image at most."""
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
    """Write ROS 2 messages to an MCAP file."""
    record: Annotated[Path | None, arg(metavar="FILE.fgpose", help_behavior_hint="(default: none)")] = None
    """Record detections, clocks and estimates."""
    page: Annotated[int | None, arg(metavar="PORT", help_behavior_hint="(default: none)")] = None
    """Serve a status page for the browser; 0 takes any free port."""
    rrd: Annotated[Path | None, arg(metavar="FILE.rrd", help_behavior_hint="(default: none)")] = None
    """Write all that can be seen to a file for the Rerun viewer, which is there when it ends (fgpose view)."""
    view: Annotated[bool, FlagCreatePairsOff] = False
    """Show the same in the Rerun viewer while it runs. It may be closed at any time."""
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
