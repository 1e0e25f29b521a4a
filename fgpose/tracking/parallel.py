"""Everybody's estimators, divided among processes."""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import ExitStack

from fgpose.child_process import n_cores
from fgpose.config import Config
from fgpose.estimation.online.clock_offsets import OffsetEvidence, RunningOffsets
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import Skeleton
from fgpose.tracking.estimator_process import ANSWERS_WITHIN_S, EstimatorProcess
from fgpose.tracking.estimators import Estimators, NewDetections, load_libraries
from fgpose.trajectory import Estimate


class ParallelEstimators:
    """The first person is estimated in this process, who comes next in that with the fewest people.

    All processes are started at once: to start one takes a second, which nobody who is followed by then should wait. If
    one ends, or does not answer within a time, its people are estimated here.
    """

    def __init__(
        self, rig: CameraRig, skeleton: Skeleton, config: Config, answers_within_s: float = ANSWERS_WITHIN_S
    ) -> None:
        needs = rig, skeleton, config
        self._here, self._nothing = Estimators(*needs), OffsetEvidence.nothing(rig.n_cameras)
        n_processes = min(config.tracking.max_processes, n_cores())
        self._others = [EstimatorProcess(*needs, answers_within_s) for _ in range(n_processes - 1)]
        self._process_of: dict[int, int] = {}
        """Of each person; 0 is this one."""
        self.close = weakref.finalize(self, _close, self._others)
        """Ends the other processes."""

    def __getstate__(self) -> dict[str, object]:
        if self._others:
            raise TypeError(
                "this Tracker cannot be saved or copied: the estimators of some people are in other processes. Choose "
                "tracking.max_processes = 1, or give its memory() to a new one, which recognises whom it knew."
            )
        return dict(vars(self))

    @property
    def offsets(self) -> RunningOffsets:
        """What everybody's motion tells of the cameras' clocks, in all processes."""
        return self._here.offsets

    @property
    def n_restarts(self) -> int:
        """How often a process was started again."""
        return sum(process.n_restarts for process in self._others)

    def await_ready(self) -> None:
        """Wait until all processes can take people, this one too. Raises OSError: one has ended."""
        load_libraries()
        for process in self._others:
            process.await_ready()

    def update(self, newest: Mapping[int, NewDetections]) -> dict[int, Estimate]:
        """The pose of each of these; who is not among them any more is forgotten.

        Raises:
            OSError: a process cannot be started again, or ended again meanwhile.

        Warns:
            UserWarning: a process ended and was started again.
        """
        self._assign(newest)
        shares: list[dict[int, NewDetections]] = [{} for _ in range(1 + len(self._others))]
        for number, new in newest.items():
            shares[self._process_of[number]][number] = new
        asked = [
            process
            for process, share in zip(self._others, shares[1:], strict=True)
            if process.send(share, (self.offsets.sigma_s, self.offsets.set_by_s, self._told_elsewhere(process)))
        ]
        estimates: dict[int, Estimate] = {}
        # Every answer is read, whatever is raised: one that stays in its pipe would be taken for the next.
        with ExitStack() as answers:
            for process in asked:
                answers.callback(lambda process=process: estimates.update(process.receive()))
            estimates |= self._here.update(shares[0])
        self.offsets.elsewhere = sum((process.told for process in self._others), self._nothing)
        estimates |= self._taken_here({number: new for number, new in newest.items() if number not in estimates})
        return {number: estimates[number] for number in newest}

    def _told_elsewhere(self, process: EstimatorProcess) -> OffsetEvidence:
        """What the motion of those who are not estimated in a process tells of the clocks."""
        others = (other.told for other in self._others if other is not process)
        return sum(others, self._here.offsets.evidence)

    def _taken_here(self, newest: Mapping[int, NewDetections]) -> dict[int, Estimate]:
        """The people of a process that has ended: their estimates begin anew."""
        self._process_of |= dict.fromkeys(newest, 0)
        return self._here.add(newest)

    def look(self) -> None:
        """Start processes again that have ended, or are stopped where there is hurry, also where nothing is new.

        Warns:
            UserWarning: there was one.
        """
        for at, process in enumerate(self._others, start=1):
            if process.look():
                self._process_of = {number: 0 if its == at else its for number, its in self._process_of.items()}

    def tidy(self) -> None:
        """See Estimator. Other processes do so while this one goes on."""
        for process in self._others:
            process.tidy()
        self._here.tidy()

    def _assign(self, people: Collection[int]) -> None:
        self._process_of = {number: at for number, at in self._process_of.items() if number in people}
        may_take = [0, *(at for at, process in enumerate(self._others, start=1) if process.takes_people)]
        for number in people:
            if number not in self._process_of:
                n_people = Counter(self._process_of.values())
                self._process_of[number] = min(may_take, key=lambda at: (n_people[at], at))


def _close(processes: list[EstimatorProcess]) -> None:
    for process in processes:
        process.close()
