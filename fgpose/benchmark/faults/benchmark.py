"""All damages on all recordings, several at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context

from threadpoolctl import threadpool_limits

from fgpose.benchmark.faults.damage import Damage
from fgpose.benchmark.faults.geometry import GEOMETRY
from fgpose.benchmark.faults.in_time import IN_TIME
from fgpose.benchmark.faults.outcome import Outcome, outcome_of
from fgpose.benchmark.faults.people import PEOPLE
from fgpose.benchmark.faults.take import Take

DAMAGES: tuple[Damage, ...] = (*GEOMETRY, *IN_TIME, *PEOPLE)


def find_damages(names: Sequence[str]) -> tuple[Damage, ...]:
    """By name; all where none is given. Raises ValueError for an unknown name."""
    known = {damage.name: damage for damage in DAMAGES}
    for name in names:
        if name not in known:
            raise ValueError(f"there is no damage {name!r}; there are: {', '.join(known)}")
    return tuple(known[name] for name in names) or DAMAGES


def run(
    takes: Sequence[Take],
    damages: Sequence[Damage] = DAMAGES,
    progress: Callable[[Outcome], None] | None = None,
    n_workers: int = 2,
) -> list[Outcome]:
    """Each damage on each recording with enough cameras, and each recording undamaged.

    Args:
        takes: recordings without a fault.
        damages: what is done to them.
        progress: told every outcome.
        n_workers: number of processes; 0: run in this one.
    """
    # The name goes to the worker: damages hold functions that cannot be pickled.
    jobs = [(take, tuple(each.name for each in damages if take.rig.n_cameras >= each.least_cameras)) for take in takes]
    found: list[Outcome] = []

    def keep(outcomes: list[Outcome]) -> None:
        found.extend(outcomes)
        for outcome in outcomes if progress else ():
            progress(outcome)  # pyright: ignore[reportOptionalCall]

    if n_workers == 0:
        for job in jobs:
            keep(_outcomes(*job))
        return found
    undamaged = {}
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn")) as pool:
        first = {pool.submit(_outcomes, take, ()): (take, names) for take, names in jobs}
        for future in as_completed(first):
            keep(future.result())
            undamaged[id(first[future][0])] = future.result()[0].error_mm
        others = [
            pool.submit(partial(_damaged, take, name, undamaged[id(take)])) for take, names in jobs for name in names
        ]
        for future in as_completed(others):
            keep([future.result()])
    return found


def _outcomes(take: Take, names: tuple[str, ...]) -> list[Outcome]:
    with threadpool_limits(1):
        undamaged = outcome_of(take, None)
        return [undamaged, *(_damaged(take, name, undamaged.error_mm) for name in names)]


def _damaged(take: Take, name: str, undamaged_mm: float) -> Outcome:
    with threadpool_limits(1):
        (damage,) = find_damages([name])
        return outcome_of(take, damage, undamaged_mm)
