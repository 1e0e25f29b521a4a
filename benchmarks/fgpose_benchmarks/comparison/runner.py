"""Running methods on recordings, several at a time, and keeping what is finished."""

from __future__ import annotations

import hashlib
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from threadpoolctl import threadpool_limits

import fgpose
import fgpose_factors
from fgpose.child_process import end_with_parent
from fgpose_benchmarks.comparison.recording import Method, ResultT
from fgpose_benchmarks.comparison.scores import Scored, load_scores, save_scores

_Value = TypeVar("_Value")

_FOLDER = Path(__file__).parents[1]
_SOLVER_SOURCES = tuple(Path(next(iter(package.__path__))) for package in (fgpose, fgpose_factors))
_OTHER_ROOMS = {"cli", "monocular", "viewer"}  # of fgpose; no solver uses them
_PEER_SOURCES = ("accuracy/peer.py", "accuracy/peer_server.py", "accuracy/peer_methods.py", "comparison/scores.py")
_AHEAD = 2  # recordings wait for workers, not workers for recordings; more would only fill memory

_warm: set[tuple[str, str]] = set()
"""Benchmarks and methods that this process has used."""


@runtime_checkable
class _Named(Protocol):
    """A recording, of whatever."""

    @property
    def clip(self) -> str: ...

    @property
    def variant(self) -> str: ...


_Recording = TypeVar("_Recording", bound=_Named)
_Score = TypeVar("_Score", bound=Scored)


@dataclass(frozen=True)
class Benchmark(Generic[_Recording, ResultT, _Score]):
    """What is measured on recordings of one kind."""

    name: str
    version: int
    """Of the recordings: scores of another version are measured again."""
    score: Callable[[_Recording, ResultT, Method[_Recording, ResultT]], _Score]
    """Refuses a result with ValueError."""
    kind: type[_Score]
    warm_up: Callable[[], _Recording]
    """A short recording: enough to import and compile everything."""
    sources: tuple[str, ...]
    """Code of the benchmark that scores depend on: files and folders of this package."""


def run(
    benchmark: Benchmark[_Recording, ResultT, _Score],
    recordings: Iterable[_Recording],
    methods: Sequence[Method[_Recording, ResultT]],
    cache: Path | None,
    progress: Callable[[_Score], None] | None = None,
    n_workers: int = 2,
) -> list[_Score]:
    """Every method on every recording.

    Each score is written into the cache as soon as it is known: an interrupted run continues where it was, and a second
    run takes seconds. A score is measured again if something that it depends on has changed: the recording, the version
    of the benchmark, the source code of fgpose (for aniposelib only the code that calls it).

    Args:
        benchmark: what is measured.
        recordings: taken one by one.
        methods: with different names; picklable, unless there are no workers.
        cache: folder, made if absent; None: measure everything.
        progress: told every score, in the order in which they become known.
        n_workers: number of processes, each with one BLAS thread; 0: run in this process.

    Returns:
        The scores in the order of the recordings, then of the methods.

    Raises:
        ValueError: a method refuses a recording, or two methods have one name.
        OSError: the cache cannot be written, or a worker was killed.
    """
    if len({method.name for method in methods}) != len(methods):
        raise ValueError(f"two methods have one name: {', '.join(method.name for method in methods)}")
    scores: dict[int, _Score] = {}
    pending: dict[Future[_Score], int] = {}

    def keep(index: int, known: _Score) -> None:
        scores[index] = known
        if progress:
            progress(known)

    def finish(n_left: int) -> None:
        while len(pending) > n_left:
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                keep(pending.pop(future), future.result())

    with _executor(n_workers) as executor:
        for index, (recording, method, path) in enumerate(_pairs(benchmark, recordings, methods, cache)):
            if path is not None and path.exists():
                keep(index, load_scores(path, benchmark.kind)[0])
                continue
            finish(_AHEAD * n_workers)
            pending[executor.submit(_measure, benchmark, recording, method, path)] = index
        finish(0)
    return [scores[index] for index in sorted(scores)]


def _pairs(
    benchmark: Benchmark[_Recording, ResultT, _Score],
    recordings: Iterable[_Recording],
    methods: Sequence[Method[_Recording, ResultT]],
    cache: Path | None,
) -> Iterator[tuple[_Recording, Method[_Recording, ResultT], Path | None]]:
    for recording in recordings:
        content = None if cache is None else _digest(recording)
        for method in methods:
            path = None if cache is None else cache / _file_name(benchmark, recording, method, content)
            yield recording, method, path


def _file_name(benchmark: Benchmark, recording: _Named, method: Method, content: object) -> str:
    sources = _source_digest(_PEER_SOURCES) if method.group == "peer" else _source_digest(benchmark.sources, ours=True)
    key = repr((benchmark.version, content, method.name, method.group, sources))
    return f"{recording.variant}-{recording.clip}-{hashlib.sha256(key.encode()).hexdigest()[:24]}.json"


def _digest(value: object) -> str:
    """Of everything in a recording, down to the numbers of its arrays."""
    if isinstance(value, np.ndarray):
        content = repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    elif is_dataclass(value):
        content = repr([(field.name, _digest(getattr(value, field.name))) for field in fields(value)]).encode()
    elif isinstance(value, tuple):
        content = repr([_digest(item) for item in value]).encode()
    else:
        content = repr(value).encode()
    return hashlib.sha256(content).hexdigest()


@lru_cache
def _source_digest(names: tuple[str, ...], *, ours: bool = False) -> str:
    """Of the code that a score depends on, whatever made the recording: of this package, and of ours the solvers."""
    paths = [path for name in names for path in _modules(_FOLDER / name)]
    if ours:
        paths += [path for folder in _SOLVER_SOURCES for path in _sources(folder)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def _modules(path: Path) -> list[Path]:
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


def _sources(folder: Path) -> list[Path]:
    """Of a package and its rooms."""
    return [path for path in _modules(folder) if path.relative_to(folder).parts[0] not in _OTHER_ROOMS]


@contextmanager
def _executor(n_workers: int) -> Iterator[Executor]:
    if n_workers == 0:
        with threadpool_limits(limits=1):
            yield _Here()
        return
    # spawn: a forked process would inherit the locks of BLAS threads.
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(n_workers, mp_context=context, initializer=_become_worker)
    try:
        yield executor
    except BrokenProcessPool:
        raise OSError("a worker was killed; with enough memory a second run goes on where this one was") from None
    except BaseException:
        # Nobody waits for what they do.
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


class _Here(Executor):
    """Does the work at once, in this process."""

    def submit(self, fn: Callable[..., _Value], /, *args: Any, **kwargs: Any) -> Future[_Value]:
        future: Future[_Value] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def _become_worker() -> None:
    # Ctrl-C reaches the workers too: they end at once, without a traceback each.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    end_with_parent()
    threadpool_limits(limits=1)


def _measure(
    benchmark: Benchmark[_Recording, ResultT, _Score],
    recording: _Recording,
    method: Method[_Recording, ResultT],
    path: Path | None,
) -> _Score:
    _warm_up(benchmark, method)
    try:
        result = method.solve(recording)
    except ValueError as error:
        raise ValueError(f"{method.name}, {recording.clip} ({recording.variant}): {error}") from None
    known = benchmark.score(recording, result, method)
    if path is not None:
        save_scores([known], path)
    return known


def _warm_up(benchmark: Benchmark[_Recording, ResultT, _Score], method: Method[_Recording, ResultT]) -> None:
    """Imports, compilation and the start of another process happen once: they do not count as a method's time."""
    name = benchmark.name, method.name
    if method.group == "file" or name in _warm:
        return
    _warm.add(name)
    method.solve(benchmark.warm_up())
