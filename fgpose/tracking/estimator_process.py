"""Estimators in a process of their own.

It is sent first what the estimators need, and answers when they are ready; then for each update what is new of each
person and what is known of the clocks, and the answers are the estimates and what the motion tells of the clocks, or
the error.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from fgpose.child_process import ChildProcess, StoppedTwice, parent
from fgpose.config import Config
from fgpose.estimation.online.clock_offsets import OffsetEvidence
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimators import Estimators, NewDetections, load_libraries
from fgpose.trajectory import Estimate

_TIDY, _READY = "tidy", "ready"
# On a computer that is busy starting other things.
_STARTS_WITHIN_S = 30.0
ANSWERS_WITHIN_S = 60.0
"""Where there is no hurry."""

Clocks = tuple[np.ndarray, np.ndarray, OffsetEvidence]
"""Standard deviations of the prior of each camera's offset, by how much its clock was set (both in seconds), and what
the motion of other people tells."""


class EstimatorProcess:
    """The estimators of some of the people, in a process that ends with this one, or when closed.

    If it ends before, or does not answer in time, it is started again, which takes a second; its people are then
    nobody's.

    Args:
        rig, skeleton, config: as of Estimators.
        answers_within_s: it hangs if it does not, or is stopped.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(
        self, rig: CameraRig, skeleton: Skeleton, config: Config, answers_within_s: float = ANSWERS_WITHIN_S
    ) -> None:
        self._needs, self._answers_within_s = (rig, skeleton, config), answers_within_s
        self.n_restarts = 0
        self._began_s = time.monotonic()
        self._newest: dict[int, NewDetections] = {}
        self.told = self._nothing = OffsetEvidence.nothing(rig.n_cameras)
        """What the motion of its people tells of the clocks."""
        self._is_ready = self._starts_again = False
        self._start()

    @property
    def process_id(self) -> int:
        return self._process.process_id

    @property
    def takes_people(self) -> bool:
        """Not while it starts again: nobody who was followed should wait for that.

        Raises:
            OSError: the process ended again.
        """
        if self._starts_again and self._process.has_message():
            try:
                self._await_ready()
            except EOFError as error:
                self.close()
                raise OSError(f"an estimator process ended twice, with status {self._process.status}") from error
        elif self._starts_again and self._is_overdue:
            self._restart("does not start")
        return not self._starts_again

    def await_ready(self) -> None:
        """Wait until it can take people. Raises OSError if it has ended, or does not start."""
        try:
            self._await_ready()
        except (EOFError, TimeoutError) as error:
            self.close()
            raise OSError(f"an estimator process does not start: {error}") from error

    def send(self, newest: Mapping[int, NewDetections], clocks: Clocks) -> bool:
        """Let the estimators take what is new of each person. Whether there will be an answer: there is none where
        nobody was and nobody is, or where the process has ended.

        Args:
            newest: by the number of the track.
            clocks: what is known of them elsewhere.

        Warns:
            UserWarning: the process had ended.
        """
        is_asked = bool(newest or self._newest)
        self._newest = dict(newest)
        if not is_asked:
            # It would not fade as long as nobody is added.
            self.told = self._nothing
            self.look()  # it is started again before somebody comes
        else:
            try:
                self._process.write((self._newest, clocks), self._answers_within_s)
            except (BrokenPipeError, TimeoutError) as error:
                self._restart(_why(error))
                return False
        return is_asked

    def look(self) -> bool:
        """Start it again if it has ended, or is stopped where there is hurry. Whether it was. Not to be called between
        send and receive.

        Warns:
            UserWarning: it was.
        """
        is_stopped = self._looks.again(self._is_stopped)
        if self._starts_again or not (is_stopped or self._process.status is not None):
            return False
        self._restart("is stopped" if is_stopped else "")
        return True

    def receive(self) -> dict[int, Estimate]:
        """Their answer; nothing if the process has ended or hangs.

        Raises:
            Exception: what an estimator raised.

        Warns:
            UserWarning: the process ended, or did not answer.
        """
        try:
            self._await_ready()
            answer = self._process.read(self._answers_within_s)
        except (EOFError, TimeoutError) as error:
            self._restart(_why(error))
            return {}
        if isinstance(answer, Exception):
            raise answer
        estimates, self.told = answer
        return estimates

    def tidy(self) -> None:
        """Let the estimators tidy; there is no answer."""
        if self._newest:
            # The next update notices that it has ended.
            with suppress(BrokenPipeError, TimeoutError):
                self._process.write(_TIDY, self._answers_within_s)

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        self._process.close()

    @property
    def _is_stopped(self) -> bool:
        return math.isfinite(self._answers_within_s) and self._process.is_stopped

    @property
    def _is_overdue(self) -> bool:
        return math.isfinite(self._answers_within_s) and time.monotonic() > self._began_s + _STARTS_WITHIN_S

    def _restart(self, why: str = "") -> None:
        """Because it has ended, or for another reason."""
        if why:
            self._process.kill()
        self.close()
        warnings.warn(
            f"an estimator process {why or f'ended with status {self._process.status}'} and is started again: "
            f"the estimates of {len(self._newest)} people begin anew",
            stacklevel=2,
        )
        self._newest, self._is_ready, self._starts_again, self.told = {}, False, True, self._nothing
        self.n_restarts += 1
        self._start()

    def _start(self) -> None:
        self._process, self._began_s, self._looks = ChildProcess(__name__), time.monotonic(), StoppedTwice()
        self._process.write(self._needs)

    def _await_ready(self) -> None:
        if not self._is_ready:
            self._process.read(math.inf if math.isinf(self._answers_within_s) else _STARTS_WITHIN_S)
            self._is_ready, self._starts_again = True, False


def _why(error: OSError | EOFError) -> str:
    """Empty: it has ended."""
    return "does not answer" if isinstance(error, TimeoutError) else ""


def serve() -> None:
    """The other side: answer what EstimatorProcess asks, until it is closed."""
    with parent() as (receive, send):
        estimators = Estimators(*receive())
        load_libraries()
        send(_READY)
        while True:
            try:
                message = receive()
            except EOFError:
                return
            try:
                if message == _TIDY:
                    estimators.tidy()
                    continue
                newest, clocks = message
                offsets = estimators.offsets
                offsets.sigma_s, offsets.set_by_s, offsets.elsewhere = clocks
                answer = estimators.update(newest), estimators.offsets.evidence
            except Exception as error:  # raised by EstimatorProcess.receive
                answer = error
            send(answer)
