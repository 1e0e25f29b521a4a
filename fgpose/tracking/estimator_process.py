"""Estimators in a process of their own.

It is sent first what the estimators need, and answers when they are ready; then for each update what is new of each
person and what is known of the clocks, and the answers are the estimates and what the motion tells of the clocks, or
the error.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from fgpose.child_process import ChildProcess, parent
from fgpose.config import Config
from fgpose.estimation.clock_offsets import OffsetEvidence
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimators import Estimators, Newest
from fgpose.trajectory import Estimate

_TIDY, _READY = "tidy", "ready"

Clocks = tuple[np.ndarray, OffsetEvidence]
"""Standard deviations of the prior of each camera's offset, seconds, and what the motion of other people tells."""


class EstimatorProcess:
    """The estimators of some of the people, in a process that ends with this one, or when closed.

    If it ends before, it is started again, which takes a second; its people are then nobody's.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
        self._needs = rig, skeleton, config
        self._newest: dict[int, Newest] = {}
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
        return not self._starts_again

    def send(self, newest: Mapping[int, Newest], clocks: Clocks) -> bool:
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
            # Started again before somebody comes.
            if not self._starts_again and self._process.status is not None:
                self._restart()
        else:
            try:
                self._process.write((self._newest, clocks))
            except BrokenPipeError:
                self._restart()
                return False
        return is_asked

    def receive(self) -> dict[int, Estimate]:
        """Their answer; nothing if the process has ended.

        Raises:
            Exception: what an estimator raised.

        Warns:
            UserWarning: the process ended.
        """
        try:
            self._await_ready()
            answer = self._process.read()
        except EOFError:
            self._restart()
            return {}
        if isinstance(answer, Exception):
            raise answer
        estimates, self.told = answer
        return estimates

    def tidy(self) -> None:
        """Let the estimators tidy; there is no answer."""
        if self._newest:
            # The next update notices that it has ended.
            with suppress(BrokenPipeError):
                self._process.write(_TIDY)

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        self._process.close()

    def _restart(self) -> None:
        self.close()
        warnings.warn(
            f"an estimator process ended with status {self._process.status} and is started again: "
            f"the estimates of {len(self._newest)} people begin anew",
            stacklevel=2,
        )
        self._newest, self._is_ready, self._starts_again, self.told = {}, False, True, self._nothing
        self._start()

    def _start(self) -> None:
        self._process = ChildProcess(__name__)
        self._process.write(self._needs)

    def _await_ready(self) -> None:
        if not self._is_ready:
            self._process.read()
            self._is_ready, self._starts_again = True, False


def serve() -> None:
    """The other side: answer what EstimatorProcess asks, until it is closed."""
    with parent() as (receive, send):
        estimators = Estimators(*receive())
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
                estimators.offsets.sigma_s, estimators.offsets.elsewhere = clocks
                answer = estimators.update(newest), estimators.offsets.evidence
            except Exception as error:  # raised by EstimatorProcess.receive
                answer = error
            send(answer)
