"""A diagnosis in a process of its own, which ends with it: it takes seconds of a core, and some hundred megabytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from fgpose.child_process import ChildProcess, parent
from fgpose.live.processes.priority import session_gives_way

# What is imported here is imported before the process gives way.
if TYPE_CHECKING:
    from fgpose.diagnosis.diagnose import Diagnosis
    from fgpose.geometry.camera import CameraRig
    from fgpose.people_observations import Detections, PeopleObservations
    from fgpose.skeleton import Skeleton

Diagnose: TypeAlias = "Callable[[PeopleObservations, CameraRig], Diagnosis]"
"""Looks at everybody's detections; a function of a module, which can be pickled."""

# Everybody else who wants a core gets it.
_NICE = 19
# Of its own time: usually it takes ten seconds.
_ANSWERS_WITHIN_S = 120.0
# While images are sent, the thread that tracks waits for a fraction of a millisecond.
_IMAGES_AT_ONCE, _PAUSE_S = 20, 0.002


@dataclass(frozen=True, eq=False)
class DiagnosisJob:
    """What a process of the diagnosis is to do; the images follow."""

    diagnose: Diagnose
    rig: CameraRig
    """With the clocks as they are known."""
    skeleton: Skeleton
    began_s: float
    """Unix time from which the times of the diagnosis count."""


@dataclass(frozen=True)
class Failed:
    """What the diagnosis raised."""

    reason: str


class DiagnosisProcess(ChildProcess):
    """Starts the process.

    Raises:
        OSError: it cannot be started.
    """

    def __init__(self) -> None:
        super().__init__(__name__)

    def answer(
        self, job: DiagnosisJob, images: tuple[Detections, ...], wait: Callable[[float], object]
    ) -> Diagnosis | Failed:
        """Let it look at these images; it ends then.

        Args:
            job: what it is to do.
            images: in any order.
            wait: for a time, in seconds, as time.sleep does.

        Raises:
            EOFError: it has ended.
            TimeoutError: it does not answer, or is stopped.
        """
        try:
            self.write(job, _ANSWERS_WITHIN_S)
            for first in range(0, len(images), _IMAGES_AT_ONCE):
                self.write(images[first : first + _IMAGES_AT_ONCE], _ANSWERS_WITHIN_S)
                wait(_PAUSE_S)
            self.write(None, _ANSWERS_WITHIN_S)
        except BrokenPipeError:
            raise EOFError("the process has ended") from None
        return self.read(_ANSWERS_WITHIN_S)


def serve() -> None:
    """Do what DiagnosisProcess sends."""
    session_gives_way(_NICE)
    with parent() as (receive, send):
        try:
            job: DiagnosisJob = receive()
            images: list[Detections] = []
            while some := receive():
                images += some
        # Nobody wants to know any more.
        except EOFError:
            return
        send(_looked_at(job, images))


def _looked_at(job: DiagnosisJob, images: list[Detections]) -> Diagnosis | Failed:
    import warnings

    from fgpose.people_observations import PeopleObservations

    # As of a recording on disk: times since it began, and one image of a camera at a time.
    seen = {(each.camera, each.time_s): each.at(each.time_s - job.began_s) for each in reversed(images)}
    try:
        with warnings.catch_warnings(action="ignore"):
            return job.diagnose(PeopleObservations(job.skeleton, job.rig.names, tuple(seen.values())), job.rig)
    except Exception as error:
        return Failed(f"{type(error).__name__}: {error}")
