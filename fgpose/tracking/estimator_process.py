"""Estimators in a process of their own: Python and GTSAM keep to one core, whatever the number of threads.

Started as a command and not by multiprocessing, which would run the user's script again. Both sides write pickles:
first what the estimators need, then for each update what is new of each person; the answers are the estimates, or the
error.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Mapping
from contextlib import suppress

from fgpose.config import Config
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimators import Estimators, Newest
from fgpose.trajectory import Estimate

_ENDS_WITHIN_S = 5.0  # an update takes milliseconds


class EstimatorProcess:
    """The estimators of some of the people, in a process that ends with this one, or when closed.

    If it ends before, it is started again, and the estimates of its people begin anew.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self, rig: CameraRig, skeleton: Skeleton, config: Config) -> None:
        self._needs = rig, skeleton, config
        self._newest: dict[int, Newest] = {}
        self._process = _start()
        self._write(self._needs)

    @property
    def process_id(self) -> int:
        return self._process.pid

    def send(self, newest: Mapping[int, Newest]) -> bool:
        """Let the estimators take what is new of each person. Whether there will be an answer: there is none where
        nobody was and nobody is.

        Warns:
            UserWarning: the process had ended.
        """
        is_asked = bool(newest or self._newest)
        self._newest = dict(newest)
        if is_asked:
            try:
                self._write(self._newest)
            except BrokenPipeError:
                self._restart()
        return is_asked

    def receive(self) -> dict[int, Estimate]:
        """Their answer.

        Raises:
            OSError: the process ended twice.
            Exception: what an estimator raised.

        Warns:
            UserWarning: the process ended.
        """
        try:
            answer = self._read()
        except EOFError:
            self._restart()
            try:
                answer = self._read()
            except EOFError as error:
                raise OSError(f"an estimator process ended twice, with status {self._process.wait()}") from error
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process. Closing again does nothing."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        with suppress(BrokenPipeError):
            stdin.close()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        stdout.close()

    def _restart(self) -> None:
        self.close()
        warnings.warn(
            f"an estimator process ended with status {self._process.returncode} and is started again: "
            f"the estimates of {len(self._newest)} people begin anew",
            stacklevel=2,
        )
        self._process = _start()
        self._write(self._needs)
        self._write(self._newest)

    def _write(self, message: object) -> None:
        assert self._process.stdin is not None
        pickle.dump(message, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()

    def _read(self) -> dict[int, Estimate] | Exception:
        """Raises EOFError if the process has ended."""
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except pickle.UnpicklingError as error:
            raise EOFError("in the middle of an answer") from error


def _start() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        # Modules are found where this process finds them.
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        # Ctrl-C is for this process, which may still want estimates.
        start_new_session=True,
    )


def serve() -> None:
    """The other side: answer what EstimatorProcess asks, until it is closed."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as answers:
        sys.stdout = sys.stderr  # nothing else may reach the answers
        estimators = Estimators(*pickle.load(sys.stdin.buffer))
        while True:
            try:
                newest = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            try:
                answer = estimators.update(newest)
            except Exception as error:  # raised by receive
                answer = error
            pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
