"""aniposelib 0.8.0 from outside: it brings an OpenCV that would overwrite ours, so it lives in .venv/bench."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float
from timing import Timing

from fgpose.synthetic import Scene

# With the default number of threads the same run, of as many iterations, took 10 or 34 ms a frame on a shared machine;
# with one, always 8 to 10.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1"}

PYTHON = Path(__file__).parents[1] / ".venv" / "bench" / "bin" / "python"


@dataclass(frozen=True)
class PeerSettings:
    """How triangulate_optim is called; its own defaults unless said otherwise. Constraints are always all bones."""

    scores: bool = False
    """Whether it gets the detectors' confidences."""
    optim: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        parts = [f"{name} {value:g}" for name, value in self.optim.items()] + ["scores"] * self.scores
        return ", ".join(parts) or "default"


@dataclass(frozen=True, eq=False)
class PeerResult:
    settings: PeerSettings
    timing: Timing
    positions_m: Float[np.ndarray, "frame joint 3"]


class Peer:
    """A running aniposelib: it stays alive between calls, so that its just-in-time compilation is not timed."""

    def __init__(self, process: subprocess.Popen[str], log: IO[str], folder: Path) -> None:
        self._process, self._log, self._folder = process, log, folder
        self._numbers = itertools.count()

    def solve(self, scene: Scene, settings: PeerSettings) -> PeerResult:
        """Triangulate a scene from its 2D detections; timed inside the other process, without the transfer.

        Raises:
            RuntimeError: the process died; the message ends with what it wrote.
        """
        number = next(self._numbers)
        scene_path, output_path = self._folder / f"{number}.npz", self._folder / f"{number}.npy"
        np.savez(scene_path, allow_pickle=False, **_arrays(scene))
        request = {"scene": str(scene_path), "settings": settings.optim, "scores": settings.scores}
        answer = self._ask(request | {"output": str(output_path)})
        return PeerResult(settings, Timing(answer["wall_s"], answer["cpu_s"]), np.load(output_path))

    def _ask(self, request: dict[str, Any]) -> dict[str, float]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            self._log.seek(0)
            raise RuntimeError(f"aniposelib ended: {self._log.read()[-2000:]}")
        return json.loads(answer)


def _arrays(scene: Scene) -> dict[str, np.ndarray]:
    return {
        "points2d_px": scene.observations.points2d_px,
        "confidence": scene.observations.confidence,
        "bones": np.array(scene.observations.skeleton.bones),
        "K": np.stack([camera.K for camera in scene.rig.cameras]),
        "camera_T_world": np.stack([camera.camera_T_world for camera in scene.rig.cameras]),
    }


@contextmanager
def running_peer() -> Iterator[Peer]:
    """Start aniposelib, and end it afterwards.

    Raises:
        FileNotFoundError: its environment is missing.
    """
    if not PYTHON.exists():
        raise FileNotFoundError(f"{PYTHON} is missing: make benchmark sets it up")
    server = [str(PYTHON), str(Path(__file__).with_name("peer_server.py"))]
    pipe = subprocess.PIPE
    # Leaving the block closes the server's input, at which it ends, and waits for it.
    with (
        tempfile.TemporaryDirectory() as folder,
        tempfile.TemporaryFile("w+") as log,
        subprocess.Popen(
            server, stdin=pipe, stdout=pipe, stderr=log, text=True, env=os.environ | _ENVIRONMENT
        ) as process,
    ):
        yield Peer(process, log, Path(folder))
