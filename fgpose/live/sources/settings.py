"""What a rig file says of a camera's source."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class CameraSource:
    """The table ``[cameras.NAME]`` of a rig file."""

    source: str = field(repr=False)
    """URL (rtsp, http), device (/dev/video0), video file, folder of images, or ``zmq``: keypoints of a detector
    elsewhere. May have a password, so it is not shown; in a rig file ``${FGPOSE_X}`` is that environment variable."""
    fps: float = 0.0
    """Images a second; 0: as the source has it. Needed for a folder; a device is asked for it; a video is played so."""
    loop: bool = False
    """A file or folder begins anew when it ends."""
    pace: Literal["real time", "fast"] = "real time"
    """Of a file or folder. fast: each image as soon as the one before it was taken; none is left out."""
    latency_s: float = 0.0
    """The least time from taking an image to its arrival, see ClockModel."""
    clock: Literal["auto", "own", "synchronised"] = "auto"
    """Of a camera or detector that sends Unix time. own: it is set by hand, say latency_s. synchronised: by NTP or PTP
    to this computer's, so images that come late are late. auto: believed where it agrees with when images come."""
    key: str = field(default="", repr=False)
    """``zmq``: a text that the messages of its detector must have; see docs/live_messages.md."""
    timeout_s: float = 5.0
    """Without an answer or an image for so long, a device or URL is opened again."""
    transport: Literal["tcp", "udp"] = "tcp"
    """Of RTSP. UDP is faster, and loses parts of images where the network loses packets."""
    video_size: str = ""
    """Of the images of a device: 1280x720."""
    pixel_format: str = ""
    """Of a device: mjpeg, yuyv422, ... (of most USB cameras only mjpeg is fast enough)."""
