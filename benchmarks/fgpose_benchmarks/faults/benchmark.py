"""All damages on all recordings, several at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context

from threadpoolctl import threadpool_limits

from fgpose.child_process import end_with_parent
from fgpose_benchmarks.faults.damage import Damage
from fgpose_benchmarks.faults.geometry import GEOMETRY
from fgpose_benchmarks.faults.in_time import IN_TIME
from fgpose_benchmarks.faults.outcome import UNDAMAGED, DamageOutcome, outcome_of
from fgpose_benchmarks.faults.people import PEOPLE
from fgpose_benchmarks.faults.take import Take

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
    known: Sequence[DamageOutcome] = (),
    progress: Callable[[DamageOutcome], None] | None = None,
    n_workers: int = 2,
) -> list[DamageOutcome]:
    """Each recording undamaged, and each damage on each recording with enough cameras.

    Args:
        takes: recordings without a fault.
        damages: what is done to them.
        known: outcomes of an earlier run, which need not be found again.
        progress: told every other outcome as soon as it is known.
        n_workers: number of processes; 0: run in this one.
    """
    found = {(each.clip, each.rig, each.damage): each for each in known}

    def keep(outcome: DamageOutcome) -> None:
        found[outcome.clip, outcome.rig, outcome.damage] = outcome
        if progress:
            progress(outcome)

    jobs = [
        (take, name)
        for take in takes
        for name in (UNDAMAGED, *(each.name for each in damages if each.can_befall(take)))
        if (take.clip, take.rig_name, name) not in found
    ]
    if n_workers == 0:
        for job in jobs:
            keep(_outcome(*job))
        return list(found.values())
    with ProcessPoolExecutor(n_workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        try:
            for future in as_completed([pool.submit(_outcome, *job) for job in jobs]):
                keep(future.result())
        except BaseException:
            for worker in active_children():
                worker.terminate()
            pool.shutdown(cancel_futures=True)
            raise
    return list(found.values())


def _outcome(take: Take, name: str) -> DamageOutcome:
    """By the name of the damage: damages hold functions, which cannot be sent to another process."""
    damage = None if name == UNDAMAGED else find_damages([name])[0]
    try:
        with threadpool_limits(1):
            return outcome_of(take, damage)
    except Exception as error:
        raise RuntimeError(f"{take.name}: {name}: {error!r}") from error
