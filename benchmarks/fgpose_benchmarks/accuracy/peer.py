"""Other programs in a second process: aniposelib's triangulate_optim, and the Ensemble Kalman Smoother. Their OpenCV
would overwrite ours, so each has its own environment.

The process keeps running between calls and measures its own time. Its start, its just-in-time compilation (in the first
call) and the transfer of data do not count.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float

from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations

# With the default number of threads the same run, with the same number of iterations, took 10 or 34 ms per frame on a
# shared machine; with one thread always 8 to 10.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class PeerProgram:
    """What is measured beside fgpose."""

    name: str
    package: str
    """As pip and peer_server.py know it."""
    environment: Path
    """Where its Python is looked for, in the current folder."""


ANIPOSELIB = PeerProgram("aniposelib", "aniposelib", Path(".venv/bench"))
EKS = PeerProgram("the Ensemble Kalman Smoother", "ensemble-kalman-smoother", Path(".venv/eks"))


@dataclass(frozen=True)
class PeerSettings:
    """How triangulate_optim, or the smoother, is called; its own defaults unless said otherwise. Constraints are always
    all bones."""

    scores: bool = False
    """Whether triangulate_optim gets the detectors' confidences; the smoother always does."""
    optim: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        parts = [f"{name} {value}" for name, value in self.optim.items()] + ["scores"] * self.scores
        return ", ".join(parts) or "default"


@dataclass(frozen=True, eq=False)
class PeerResult:
    positions_m: Float[np.ndarray, "frame joint 3"]
    wall_s: float
    cpu_s: float
    variance_m2: Float[np.ndarray, "frame joint 3"] | None = None
    """Along the axes of the world; None where it states none."""


class Peer:
    """A running program."""

    def __init__(self, name: str, process: subprocess.Popen[str], log: IO[str], folder: Path) -> None:
        self._name, self._process, self._log, self._folder = name, process, log, folder
        self._numbers = itertools.count()
        self.version = str(self._answer()["version"])

    def solve(self, observations: Observations, rig: CameraRig, settings: PeerSettings) -> PeerResult:
        """Triangulate a recording from its 2D detections; timed inside the other process, without the transfer.

        Raises:
            OSError: the process died; the message ends with the last line that it wrote.
        """
        number = next(self._numbers)
        recording, output = self._folder / f"{number}.npz", self._folder / f"{number}_solved.npz"
        np.savez(recording, allow_pickle=False, **_arrays(observations, rig))
        request = {"recording": str(recording), "settings": settings.optim, "scores": settings.scores}
        answer = self._ask(request | {"output": str(output)})
        with np.load(output) as solved:
            result = PeerResult(wall_s=answer["wall_s"], cpu_s=answer["cpu_s"], **solved)
        recording.unlink()
        output.unlink()
        return result

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:  # it has ended, and the missing answer tells why
            with suppress(BrokenPipeError):
                self._process.stdin.close()  # or else leaving running_peer would try to send the rest
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            self._log.seek(0)
            last = self._log.read().strip().splitlines()[-1:]
            raise OSError(f"{self._name} ended: {''.join(last) or 'without a word'}")
        return json.loads(answer)


def _arrays(observations: Observations, rig: CameraRig) -> dict[str, np.ndarray]:
    return {
        "undistorted_px": rig.undistort(observations.points2d_px),
        "confidence": observations.confidence,
        "bones": np.array(observations.skeleton.bones),
        "K": rig.K,
        "camera_T_world": rig.camera_T_world,
    }


def find_peer(python: Path | None = None, program: PeerProgram = ANIPOSELIB) -> Path | None:
    """The Python that has a program: the given one, else that of its environment in the current folder, else None.

    Raises:
        OSError: the given one does not exist.
    """
    if python is None:
        default = program.environment / "bin" / "python"
        return default.absolute() if default.exists() else None
    if not python.exists():
        raise OSError(f"there is no Python for {program.name} at {python}")
    return python.absolute()  # not resolve(): a virtual environment's Python is a link


@contextmanager
def running_peer(python: Path, program: PeerProgram = ANIPOSELIB) -> Iterator[Peer]:
    """Start a program, and end it afterwards.

    Args:
        python: of an environment that has it, Python 3.11 or newer.

    Raises:
        OSError: it does not start; the message ends with the last line that it wrote.
    """
    # -P: the modules beside the server have names that other packages' modules have too.
    server = [str(python), "-P", str(Path(__file__).with_name("peer_server.py")), program.package]
    pipe = subprocess.PIPE
    # Leaving the block closes the server's input, at which it ends, and waits for it.
    with (
        tempfile.TemporaryDirectory() as folder,
        tempfile.TemporaryFile("w+") as log,
        subprocess.Popen(
            server, stdin=pipe, stdout=pipe, stderr=log, text=True, env=os.environ | _ENVIRONMENT
        ) as process,
    ):
        yield Peer(program.name, process, log, Path(folder))
