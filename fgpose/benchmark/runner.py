"""Running methods on recordings, several at a time, and keeping what is finished."""

from __future__ import annotations

import hashlib
import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

import fgpose_factors
from fgpose.benchmark.recording import Method, Recording
from fgpose.benchmark.scores import Score, load_scores, save_scores, score
from fgpose.benchmark.variants import VERSION, find_variant, record

_Value = TypeVar("_Value")
Progress = Callable[[Score], None]
"""Told every score as soon as it is known."""

_FOLDER = Path(__file__).parent
_SOLVER_SOURCES = (_FOLDER.parent, Path(fgpose_factors.__file__).parent)
_OTHER_ROOMS = {"benchmark", "cli", "monocular", "viewer"}  # of fgpose; no solver uses them
_OWN_SOURCES = ("methods.py", "linear.py", "scores.py")
_PEER_SOURCES = ("peer.py", "peer_server.py", "peer_methods.py", "scores.py")
_WARM_UP = "clean", "cmu_02_03_short", 15  # the shortest clip; enough to import and compile everything
_AHEAD = 2  # recordings wait for workers, not workers for recordings; more would only fill memory

_warm: set[str] = set()
"""Methods that this process has used."""


def run(
    recordings: Iterable[Recording],
    methods: Sequence[Method],
    cache: Path | None,
    progress: Progress | None = None,
    n_workers: int = 2,
) -> list[Score]:
    """Every method on every recording.

    Each score is written into the cache as soon as it is known: an interrupted run continues where it was, and a second
    run takes seconds. A score is measured again if something that it depends on has changed: the recording, the version
    of the benchmark, the source code of fgpose (for aniposelib only the code that calls it).

    Args:
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
    scores: dict[int, Score] = {}
    pending: dict[Future[Score], int] = {}

    def keep(index: int, known: Score) -> None:
        scores[index] = known
        if progress:
            progress(known)

    def finish(n_left: int) -> None:
        while len(pending) > n_left:
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                keep(pending.pop(future), future.result())

    with _executor(n_workers) as executor:
        for index, (recording, method, path) in enumerate(_pairs(recordings, methods, cache)):
            if path is not None and path.exists():
                keep(index, load_scores(path)[0])
                continue
            finish(_AHEAD * n_workers)
            pending[executor.submit(_measure, recording, method, path)] = index
        finish(0)
    return [scores[index] for index in sorted(scores)]


def _pairs(
    recordings: Iterable[Recording], methods: Sequence[Method], cache: Path | None
) -> Iterator[tuple[Recording, Method, Path | None]]:
    for recording in recordings:
        content = None if cache is None else _digest(recording)
        for method in methods:
            path = None if cache is None else cache / _file_name(recording, method, content)
            yield recording, method, path


def _file_name(recording: Recording, method: Method, content: object) -> str:
    key = repr((VERSION, content, method.name, method.group, _source_digest(of_peer=method.group == "peer")))
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
def _source_digest(*, of_peer: bool) -> str:
    """Of the code that a score depends on, whatever made the recording."""
    paths = [_FOLDER / name for name in (_PEER_SOURCES if of_peer else _OWN_SOURCES)]
    if not of_peer:
        paths += [path for folder in _SOLVER_SOURCES for path in _sources(folder)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def _sources(folder: Path) -> list[Path]:
    """Of a package and its rooms."""
    return [path for path in sorted(folder.rglob("*.py")) if path.relative_to(folder).parts[0] not in _OTHER_ROOMS]


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
    threadpool_limits(limits=1)


def _measure(recording: Recording, method: Method, path: Path | None) -> Score:
    _warm_up(method)
    try:
        result = method.solve(recording)
    except ValueError as error:
        raise ValueError(f"{method.name}, {recording.clip} ({recording.variant}): {error}") from None
    known = score(recording, result, method)
    if path is not None:
        save_scores([known], path)
    return known


def _warm_up(method: Method) -> None:
    """Imports, compilation and the start of another process happen once: they do not count as a method's time."""
    if method.group == "file" or method.name in _warm:
        return
    _warm.add(method.name)
    variant, clip, n_frames = _WARM_UP
    method.solve(record(find_variant(variant), clip, n_frames))
