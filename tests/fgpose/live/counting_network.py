"""A network for processes of cameras: it finds one joint, whose place tells which image it was."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from made_videos import counted

from fgpose.geometry.camera import Camera
from fgpose.monocular.network import People
from fgpose.skeleton import Skeleton

SKELETON = Skeleton("one joint", ("nose",), (), (0,))


@dataclass(frozen=True)
class CountingNetwork:
    name: str = "counting"
    skeleton: Skeleton = SKELETON

    def tracker(self, camera: Camera) -> CountingTracker:
        return CountingTracker()


class CountingTracker:
    def detect(self, image: np.ndarray) -> People:
        number = counted(image)
        return People(
            np.array([[0.0, 0.0, 1.0, 1.0, 1.0]]),
            np.array([[[float(number), 0.0]]]),
            np.ones((1, 1)),
            np.full((1, 1, 3), np.nan),
            np.full((1, 1, 3, 3), np.nan),
        )


def open_counting() -> CountingNetwork:
    return CountingNetwork()


class HangingTracker(CountingTracker):
    def detect(self, image: np.ndarray) -> People:
        with suppress(FileExistsError):
            Path(os.environ["HANGS_ONCE"]).touch(exist_ok=False)
            time.sleep(1000)
        return super().detect(image)


class HangingNetwork(CountingNetwork):
    """Does not answer for the first image at all."""

    def tracker(self, camera: Camera) -> CountingTracker:
        return HangingTracker()


def open_hanging() -> CountingNetwork:
    return HangingNetwork()


def open_nothing() -> CountingNetwork:
    raise ValueError("these are no weights")


def open_crashing() -> CountingNetwork:
    """As a library that crashes."""
    os.kill(os.getpid(), signal.SIGSEGV)
    raise AssertionError
