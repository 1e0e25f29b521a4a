"""Workers that recordings are handed to, by Dask: processes of this machine, or those of a scheduler elsewhere."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, cast

from fgpose.child_process import n_cores
from fgpose.study.process import RecordingOutcome, failed, process
from fgpose.study.study import Resources, StudyDescription
from fgpose.study.trial import Trial

if TYPE_CHECKING:
    from distributed import Client, Future

# A scheduler in the same network answers within a fraction of a second.
_ANSWERS_WITHIN_S = 10.0
_WORKERS_WITHIN_S = 60.0
_LOST = "the scheduler has gone; what is finished is on disk, and the same command goes on from there"
_KILLED = "its worker died at it each time it was tried, perhaps because it took more than resources.memory_gb"


class SchedulerLostError(OSError):
    """The scheduler has gone while recordings were at work."""


@contextmanager
def workers(resources: Resources, scheduler: str = "") -> Iterator[Client]:
    """Workers as the study wants them, or those of the scheduler at this address, until the block ends.

    Raises:
        ImportError: Dask, or what it needs for TLS, is not installed.
        OSError: the scheduler does not answer, or has no workers; or this machine does not start any.
        ValueError: its workers have no fgpose, or another version of it.
    """
    try:
        import distributed
    except ImportError:
        raise ImportError("a study needs Dask: pip install 'fgpose[study]'") from None
    with ExitStack() as stack:
        stack.enter_context(_silent())
        if not scheduler:
            _check_processes()
            cluster = stack.enter_context(_local(resources))
            yield stack.enter_context(distributed.Client(cluster))
            return
        client = stack.enter_context(_connected(scheduler))
        _check_workers(client, scheduler)
        yield client


def _check_processes() -> None:
    """What Dask needs to start processes, and says at length that it has not got. Raises OSError."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise OSError("no worker can be started: the current folder was deleted; change into another one") from None
    try:
        get_context("spawn").Lock()
    except OSError as error:
        raise OSError(f"no worker can be started: {error.strerror or error}; /dev/shm must be writable") from None


@contextmanager
def _silent() -> Iterator[None]:
    """Dask says on stderr of each worker that dies; the outcome of its recording says so too."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.core")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


@contextmanager
def _local(resources: Resources) -> Iterator[Any]:
    from dask import config
    from distributed import LocalCluster, Security

    settings = {
        # A recording whose worker dies is tried once more by Stream.
        "distributed.scheduler.allowed-failures": 0,
        "logging.distributed": "critical",
        # Nobody asks these servers, which have no password.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    try:
        # What reaches a scheduler or a worker is run, and every user of this machine reaches its ports: only who has
        # the credentials, which are nowhere but in these processes, is listened to.
        credentials = Security.temporary()
    except ImportError:
        raise ImportError("a study needs cryptography: pip install 'fgpose[study]'") from None
    memory = "auto" if resources.memory_gb is None else f"{resources.memory_gb}GB"
    with (
        config.set(settings),
        LocalCluster(
            n_workers=resources.workers or n_cores(),
            threads_per_worker=1,
            processes=True,
            memory_limit=memory,
            security=credentials,
            # Without a dashboard there is a server of HTTP all the same, which would want port 8787 of every study.
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
            preload=["fgpose.study.worker_process"],
        ) as cluster,
    ):
        try:
            yield cluster
        except BaseException:
            _kill(cluster)
            raise


def _kill(cluster: Any) -> None:
    """End the workers at once. Dask would wait for their recordings, of which nothing is left half done anyway."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)


def _connected(address: str) -> Client:
    from distributed import Client

    try:
        return Client(address, timeout=f"{_ANSWERS_WITHIN_S:g}s")
    except (OSError, ValueError) as error:
        raise OSError(
            f"no scheduler answers at {address} within {_ANSWERS_WITHIN_S:g} s ({' '.join(str(error).split())}); "
            "`dask scheduler` starts one, and prints its address"
        ) from None


def _check_workers(client: Client, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_WORKERS_WITHIN_S)
    except TimeoutError:
        raise OSError(
            f"the scheduler at {address} has had no worker for {_WORKERS_WITHIN_S:g} s; "
            f"`dask worker {address} --nthreads 1` starts one"
        ) from None
    own = version("fgpose")
    for worker, found in cast(dict[str, str], client.run(_version)).items():
        if found != own:
            raise ValueError(f"worker {worker} has {found or 'no fgpose'}, this is fgpose {own}: install the same")


def _version() -> str:
    try:
        return version("fgpose")
    except PackageNotFoundError:
        return ""


@dataclass
class Stream:
    """Recordings on their way through the workers: at no time more than there are workers, so that none waits behind
    one that kills its worker, and the plan is read as they are done."""

    client: Client
    study: StudyDescription
    recordings: Iterator[Trial]
    work: Callable[[StudyDescription, Trial], RecordingOutcome] = process
    _at_work: dict[Any, Trial] = field(default_factory=dict)
    _n_begun: int = 0

    def outcomes(self) -> Iterator[RecordingOutcome]:
        """As they come. A recording whose worker died is tried once more when the others are done, alone: more may have
        waited at that worker, and then nothing says which of them it died of.

        Raises:
            SchedulerLostError: the scheduler has gone. What is finished is on disk.
        """
        from distributed import as_completed

        suspected = []
        done = as_completed(self._next(self._n_free()))
        for future in done:
            recording = self._at_work.pop(future.key)
            if _has_died(future):
                suspected.append(recording)
            else:
                yield self._outcome(future, recording)
            done.update(self._next(self._n_free()))
        for recording in suspected:
            future = next(iter(as_completed([self._begun(recording)])))
            del self._at_work[future.key]
            yield failed(self.study, recording, _KILLED) if _has_died(future) else self._outcome(future, recording)

    def _n_free(self) -> int:
        """Workers without a recording; one where none is there just now, for they come back."""
        try:
            n_threads = sum(cast(dict[str, int], self.client.nthreads()).values())
        except OSError:
            raise SchedulerLostError(_LOST) from None
        return max(n_threads, 1) - len(self._at_work)

    def _next(self, n_free: int) -> list[Future]:
        return [self._begun(recording) for _, recording in zip(range(n_free), self.recordings, strict=False)]

    def _begun(self, recording: Trial) -> Future:
        self._n_begun += 1
        future = self.client.submit(self.work, self.study, recording, key=f"recording-{self._n_begun}", pure=False)
        self._at_work[future.key] = recording
        return future

    def _outcome(self, future: Future, recording: Trial) -> RecordingOutcome:
        if future.status == "finished":
            return future.result()
        if future.status in ("cancelled", "lost"):
            raise SchedulerLostError(_LOST)
        error = future.exception()
        return failed(self.study, recording, f"{type(error).__name__}: {error}")


def _has_died(future: Future) -> bool:
    """Whether its worker did."""
    from distributed.scheduler import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def run(client: Client, study: StudyDescription, recordings: Iterable[Trial]) -> Iterator[RecordingOutcome]:
    """The outcomes of recordings, as they come. Raises SchedulerLostError as Stream.outcomes."""
    yield from Stream(client, study, iter(recordings)).outcomes()
