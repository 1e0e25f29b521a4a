"""Frames over the Lab Streaming Layer: streams of type MoCap, laid out as the meta-data convention of XDF says
(https://github.com/sccn/xdf/wiki/MoCap-Meta-Data), one for each of a fixed number of people at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float32

from fgpose.live.frame import LiveFrame, LivePerson
from fgpose.live.outputs.output import BackgroundOutput
from fgpose.live.processes.parts import Parts
from fgpose.skeleton import Skeleton

_CHANNELS = (("X", "PositionX", "meters"), ("Y", "PositionY", "meters"), ("Z", "PositionZ", "meters"))
_CONFIDENCE = ("Confidence", "Confidence", "normalized")
_OF_JOINT = (*_CHANNELS, _CONFIDENCE)
# Hundreds of samples, as the library counts for streams without a fixed rate: half a minute at 30 Hz.
_MAX_BUFFERED = 10
_THIS_COMPUTER = "[multicast]\nResolveScope = machine\n"


class PersonSlots:
    """Who is in which of a fixed number of slots: a person keeps theirs while present, whatever their number becomes. A
    slot that somebody has left stays empty for a frame, so that consumers see that somebody else comes."""

    def __init__(self, n_slots: int) -> None:
        self._persons: list[int | None] = [None] * n_slots

    def assign(self, people: tuple[LivePerson, ...]) -> list[LivePerson | None]:
        """Who is in each slot, of the people in the newest frame; who finds no free slot is left out."""
        present = {each.person: each for each in people}
        free = [slot for slot, person in enumerate(self._persons) if person is None]
        now_called = {each.former: each.person for each in people if each.former is not None}
        now = (person if person is None else now_called.get(person, person) for person in self._persons)
        self._persons = [person if person in present else None for person in now]
        newcomers = (person for person in present if person not in self._persons)
        for slot, person in zip(free, list(newcomers), strict=False):
            self._persons[slot] = person
        return [None if person is None else present[person] for person in self._persons]


class LslSink:
    """One outlet per slot.

    Raises:
        ImportError: pylsl is not installed, or its library cannot be loaded.
        RuntimeError: an outlet cannot be opened.
    """

    def __init__(
        self, skeleton: Skeleton, *, name: str, n_slots: int, on_network: bool, now_s: Callable[[], float]
    ) -> None:
        self._lsl = _pylsl()
        if not on_network:
            self._lsl.set_config_content(_THIS_COMPUTER)
        self._now_s, self._slots = now_s, PersonSlots(n_slots)
        self._nobody = np.tile(np.array([math.nan] * 3 + [0.0], dtype=np.float32), skeleton.n_joints)
        infos = (_stream_info(self._lsl, skeleton, f"{name} {slot}") for slot in range(n_slots))
        self._outlets = [self._lsl.StreamOutlet(info, max_buffered=_MAX_BUFFERED) for info in infos]

    def send(self, frame: LiveFrame) -> None:
        # Capture time by the clock of LSL, which is another than Unix time.
        age_s = self._now_s() - frame.time_s if math.isfinite(frame.time_s) else 0.0
        stamp_s = self._lsl.local_clock() - age_s
        for outlet, person in zip(self._outlets, self._slots.assign(frame.people), strict=True):
            sample = self._nobody if person is None else _sample(person)
            outlet.push_sample(sample.tolist(), stamp_s)

    def close(self) -> None:
        self._outlets.clear()


def _sample(person: LivePerson) -> Float32[np.ndarray, " channel"]:
    confidence = np.nan_to_num(person.probability)[:, None]
    return np.concatenate([person.positions_m, confidence], axis=1).astype(np.float32).ravel()


def _stream_info(lsl: Any, skeleton: Skeleton, name: str) -> Any:
    info = lsl.StreamInfo(
        name, "MoCap", len(_OF_JOINT) * skeleton.n_joints, lsl.IRREGULAR_RATE, lsl.cf_float32, f"fgpose {name}"
    )
    channels = info.desc().append_child("channels")
    for joint in skeleton.joints:
        for suffix, kind, unit in _OF_JOINT:
            channel = channels.append_child("channel")
            values = {"label": f"{joint}_{suffix}", "marker": joint, "object": name, "type": kind, "unit": unit}
            for key, value in values.items():
                channel.append_child_value(key, value)
    acquisition = info.desc().append_child("acquisition")
    acquisition.append_child_value("manufacturer", "fgpose")
    acquisition.append_child_value("model", f"skeleton {skeleton.name}")
    setup = info.desc().append_child("setup")
    markers = setup.append_child("markers")
    for joint in skeleton.joints:
        markers.append_child("marker").append_child_value("label", joint)
    setup.append_child("objects").append_child("object").append_child_value("label", name)
    return info


def _pylsl() -> Any:
    try:
        import pylsl
    except ImportError:
        raise ImportError("the Lab Streaming Layer needs pylsl: pip install 'fgpose[live]'") from None
    # pylsl raises RuntimeError where it finds no library, OSError where that needs a newer system.
    except (RuntimeError, OSError) as error:
        raise ImportError(f"the library of pylsl cannot be loaded (on Linux it needs glibc 2.35): {error}") from None
    return pylsl


def open_lsl_output(
    skeleton: Skeleton,
    *,
    now_s: Callable[[], float],
    n_slots: int = 2,
    name: str = "fgpose",
    on_network: bool = False,
    tell: Callable[[str], None] | None = None,
    parts: Parts | None = None,
) -> BackgroundOutput:
    """Frames as MoCap streams ``fgpose 0``, ``fgpose 1``, ...: of each joint the position in metres and, as Confidence,
    the probability that a camera sees it. Samples are stamped with the time when the images were taken. Positions of
    NaN with confidence 0: nobody is in this slot.

    Args:
        skeleton: of the people.
        now_s: Unix time by the clock of the frames: time.time follows NTP, that of a live system does not.
        n_slots: so many people at a time; the number of streams never changes.
        name: of the streams, with a number for each slot.
        on_network: announce them on the network, as LSL's own settings say; else on this computer only. LSL listens on
            all addresses of the computer in either case: to keep others out is a matter of the firewall.
        tell, parts: see BackgroundOutput.

    Raises:
        ImportError: pylsl is not installed, or its library cannot be loaded.
        ValueError: n_slots is not positive.
    """
    if n_slots < 1:
        raise ValueError(f"the number of slots must be positive, got {n_slots}")

    def open_sink() -> LslSink:
        return LslSink(skeleton, name=name, n_slots=n_slots, on_network=on_network, now_s=now_s)

    return BackgroundOutput(f"Lab Streaming Layer ({name})", open_sink, tell=tell, parts=parts)
