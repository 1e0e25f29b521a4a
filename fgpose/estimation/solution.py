"""What the smoother finds of a window, and the windows that a run has solved so far."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from fgpose.estimation.segment import Recording, Segment
from fgpose.io.arrays import read_arrays, write_arrays
from fgpose.io.code_digest import code_digest
from fgpose.sampling import parts_of
from fgpose.trajectory import Convergence


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum of some frames; NaN where a joint is not estimated."""

    positions_m: Float[np.ndarray, "frame joint 3"]
    covariance_m2: Float[np.ndarray, "frame joint 3 3"] | None
    lengths_m: Float[np.ndarray, " length"]
    convergence: Convergence
    visibility: Float[np.ndarray, "frame camera joint"]
    """Probability that each detection is of its joint."""
    sigma_px: Float[np.ndarray, "frame camera joint"]
    """Standard deviation of each detection with which this was found, if it is of its joint."""
    widening_m2: Float[np.ndarray, "frame joint 3 3"] | None = None
    """What was added to the covariance of joints that fewer than two cameras see."""
    length_sigma_m: Float[np.ndarray, " length"] | None = None
    """Standard deviations of the lengths."""

    @staticmethod
    def of_nobody(segment: Segment) -> Solution:
        """Where no joint is estimated in any frame."""
        shape = segment.active.shape
        positions_m, covariance_m2 = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
        no_lengths_m = np.full(segment.skeleton.n_lengths, np.nan)
        settled = Convergence(True, 0, 0.0, 0.0)
        evidence = segment.evidence
        shown = evidence.visibility, evidence.sigma_px
        return Solution(positions_m, covariance_m2, no_lengths_m, settled, *shown, np.zeros_like(covariance_m2))

    def frames(self, frames: slice) -> Solution:
        """Some of the frames."""
        return replace(
            self,
            positions_m=self.positions_m[frames],
            covariance_m2=None if self.covariance_m2 is None else self.covariance_m2[frames],
            visibility=self.visibility[frames],
            sigma_px=self.sigma_px[frames],
            widening_m2=None if self.widening_m2 is None else self.widening_m2[frames],
        )


def first_known(lengths_m: list[np.ndarray]) -> Float[np.ndarray, " length"]:
    """Each length from the first part in which it is known: a person may come late."""
    known = lengths_m[0]
    for others in lengths_m[1:]:
        known = np.where(np.isnan(known), others, known)
    return known


class SolvedWindows:
    """The solutions of the windows of a recording, in their order.

    Args:
        recording: with everything that its solution depends on.
        folder: where they are kept, among those of other recordings; a run that was killed left there what it had
            solved. None: in memory.

    Raises:
        OSError: the folder cannot be made.
    """

    def __init__(self, recording: Recording, folder: Path | None = None) -> None:
        self._in_memory: list[Solution] = []
        self._folder = None if folder is None else folder / _digest(recording)
        self.n_solved = 0
        """The first ones, so many."""
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)
            while _is_whole(self._path(self.n_solved)):
                self.n_solved += 1

    def append(self, solution: Solution) -> None:
        """Keep the next one. Raises OSError if it cannot be written."""
        if self._folder is None:
            self._in_memory.append(solution)
        else:
            write_arrays(self._path(self.n_solved), _arrays(solution), compressed=False)
        self.n_solved += 1

    def __iter__(self) -> Iterator[Solution]:
        """Raises ValueError or OSError if one that was kept cannot be read."""
        for number in range(self.n_solved):
            yield self._in_memory[number] if self._folder is None else _solution(read_arrays(self._path(number)))

    def _path(self, number: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{number:05}.npz"


_OF_CONVERGENCE = "convergence"


def _arrays(solution: Solution) -> dict[str, np.ndarray]:
    arrays = {field.name: getattr(solution, field.name) for field in fields(solution)}
    arrays[_OF_CONVERGENCE] = np.array(astuple(solution.convergence), dtype=float)
    return {name: array for name, array in arrays.items() if array is not None}


def _solution(arrays: dict[str, np.ndarray]) -> Solution:
    converged, iterations, *errors = arrays.pop(_OF_CONVERGENCE).tolist()
    convergence = Convergence(bool(converged), int(iterations), *errors)
    values: dict[str, Any] = {"covariance_m2": None, **arrays, "convergence": convergence}
    return Solution(**values)


def _is_whole(path: Path) -> bool:
    """Whether a solution can be read. One that a power cut has damaged is solved again, and those after it."""
    try:
        _solution(read_arrays(path))
    except (ValueError, OSError, KeyError, TypeError):
        return False
    return True


def _digest(recording: Recording) -> str:
    """Of all that its solution depends on: the evidence, the cameras, the parameters and the code."""
    digest = hashlib.sha256(code_digest(Path(__file__).parent).encode())
    for part in parts_of(recording.n_frames):
        for name, array in recording.evidence_of(part).arrays.items():
            digest.update(f"{name} {array.shape} {array.dtype}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    for camera in recording.rig.cameras:
        digest.update(repr([_plain(getattr(camera, field.name)) for field in fields(camera)]).encode())
    digest.update(repr((astuple(recording.skeleton), astuple(recording.config))).encode())
    if recording.known is not None:
        digest.update(repr((recording.known.lengths_m.tolist(), recording.known.sigma_m.tolist())).encode())
    return digest.hexdigest()[:16]


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value
