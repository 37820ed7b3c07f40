"""Search starts and placements, each tested by a run of the task."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from qp_twist.authoring.reach import Placement, Placements, placements
from qp_twist.checks import Array, clause
from qp_twist.errors import InvalidInput
from qp_twist.following import FoundStart, NoStart, find_starts, plan
from qp_twist.kinematics import JointRanges
from qp_twist.paths import DEFAULT_METHOD, PathTask
from qp_twist.planning import central_configurations, what_forbids
from qp_twist.trajectories import TaskRun, run_task

METHOD = DEFAULT_METHOD
"""Method that tests a start."""
PLANNED = "qp_planned"
"""Method that tests a start if none reaches the end by :data:`METHOD`."""
_STARTS = 48
"""Largest number of starts tried at the present placement."""
_STARTS_ELSEWHERE = 4
_MOST_PLACES = 60
"""Largest number of placements that are run."""
_SHARE_HERE = 0.6
"""Share of the search time for the present placement."""

Progress = Callable[[str, float], None]
"""Called with the current phase and its share done."""


class _TimeIsUp(Exception):
    """Stops a plan or a run."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Result of a test at one placement of the workpiece.

    Attributes:
        path_task: The task there.
        placement: The placement; ``None`` for that of the task file.
        start: The start with the longest run; ``None`` if there is none inside the limits.
        method: Method of that run.
        run: Result of the run from that start.
        why: Why it does not reach the end; empty if it does.
        impossible: Whether a waypoint has no configuration inside the limits.
    """

    path_task: PathTask
    placement: Placement | None = None
    start: FoundStart | None = None
    method: str = METHOD
    run: TaskRun | None = None
    why: str = ""
    impossible: bool = False

    @property
    def kept(self) -> int:
        """Number of waypoints to which the run kept."""
        return 0 if self.run is None else self.run.kept

    @property
    def passes(self) -> bool:
        """Whether the task was run to its end and passed its check."""
        return self.run is not None and self.run.passes

    def or_further(self, other: Trial) -> Trial:
        """Whichever of two trials gets further; this one of equal ones."""
        further = self.start is None or other.passes or other.kept > self.kept
        return other if further else self


@dataclass(eq=False)
class TaskSearchResult:
    """The best trials here and of all, the other places, and how many of them were run.

    ``ended`` says when and by whom the search was stopped early; empty if it was completed.
    """

    here: Trial
    best: Trial
    places: Placements | None = None
    run: int = 0
    ended: str = ""
    by_user: bool = False


class TaskSearch:
    """Searches a start, and a placement of the workpiece, within a time limit, s.

    The time is that of the processor, without that of compiling kernels: neither other programs
    on the machine nor a first call on it shorten the search. Every verdict is that of
    :func:`~qp_twist.trajectories.run_task`, as in ``qp-twist run``; a start is ``rounded`` as in
    the task file.
    """

    def __init__(self, seconds: float, report: Progress, rounded: Callable[[Array], Array]) -> None:
        self.seconds = seconds
        self._report, self._rounded = report, rounded
        self._began, self._compiling = 0.0, _compiling()
        self._folder = Path()

    def run(self, path_task: PathTask, *, elsewhere: bool) -> TaskSearchResult:
        """Search at the present placement of the workpiece, then, if that fails, elsewhere.

        The workpiece is only moved if some waypoint is out of reach; it is not moved if only no
        suitable start was found.

        Interrupted (Ctrl-C), it returns what it has.
        """
        from numba.core import event  # numba takes half a second

        none = Trial(path_task, why="no start was tried")
        found = TaskSearchResult(none, none)
        self._began = time.process_time()
        listening: Any = event.install_listener("numba:compile", self._compiling)
        with tempfile.TemporaryDirectory() as folder, listening:
            self._folder = Path(folder)
            try:
                self._here(found)
                if found.here.impossible:
                    if elsewhere:
                        self._elsewhere(found)
                elif not found.here.passes and self._spent(_SHARE_HERE):
                    found.ended = f"after {self._used:.0f} s of processor time"
            except KeyboardInterrupt:
                found.ended = f"by you after {self._used:.0f} s of processor time"
                found.by_user = True
        return found

    def _here(self, found: TaskSearchResult) -> None:
        """Try starts at the present placement until one passes."""
        self._say("looking for a start")
        path_task = found.best.path_task
        best = Trial(path_task)
        try:
            starts = find_starts(path_task, _STARTS, runs=False)
        except NoStart as error:
            found.here = found.best = replace(best, why=error.why, impossible=True)
            return
        for tried, start in enumerate(starts, start=1):
            self._say(f"start {tried} of {len(starts)}")
            best = best.or_further(self._from(path_task, start))
            spent = self._spent(_SHARE_HERE)
            if not best.passes and (tried in (1, len(starts)) or spent):
                best = _explained(best, tried, len(starts))
            found.here = found.best = best
            if best.passes or best.impossible or spent:
                return
        self._by_plan(found)

    def _by_plan(self, found: TaskSearchResult) -> None:
        """Try the start of a plan, by the method and then by following the plan.

        If the plan is interrupted, so is the search, unless the method passes from its start.
        """
        path_task = found.here.path_task
        free = np.full(path_task.model.nv, np.inf)
        freed = replace(path_task, velocity_limits=free, acceleration_limits=free)
        try:
            planned = plan(freed, progress=self._planning)
            if planned.q is None:
                why = f"{found.here.why}; nor is there a plan: {clause(planned.certificate)}"
                found.here = found.best = replace(found.here, why=why, impossible=True)
                return
            start = _as_found(path_task, planned.start)
            for method in (METHOD,) if planned.interrupted else (METHOD, PLANNED):
                trial = self._from(path_task, start, method, planning=self._planning)
                if trial.passes:
                    found.here = found.best = trial
                    return
        except (_TimeIsUp, InvalidInput):
            return
        if planned.interrupted:
            raise KeyboardInterrupt

    def _planning(self, what: str, share: float) -> None:
        self._say(f"plan of the whole path: {what}")
        if self._spent(_SHARE_HERE):
            raise _TimeIsUp

    def _elsewhere(self, found: TaskSearchResult) -> None:
        """Run the task at other placements until it passes."""
        what, path_task = "looking for places for the workpiece", found.here.path_task
        self._say(what)
        found.places = placements(path_task, progress=lambda: self._say(what))
        places = found.places.found[:_MOST_PLACES]
        for number, place in enumerate(places, start=1):
            if self._spent():
                found.ended = f"after {self._used:.0f} s of processor time"
                return
            found.run = number
            self._say(f"placement {number} of {len(places)}")
            task = place.of(path_task)
            try:
                starts = find_starts(task, _STARTS_ELSEWHERE, runs=False)
            except NoStart:
                starts = []
            for start in (*starts, _as_found(task, place.start)):
                trial = self._from(task, start)
                if trial.passes:
                    found.best = replace(trial, placement=place)
                    return

    def _from(
        self,
        path_task: PathTask,
        start: FoundStart,
        method: str = METHOD,
        planning: Progress | None = None,
    ) -> Trial:
        """The task run from a start, as the task file will have it."""
        start = replace(start, q=self._rounded(start.q))
        reached = 1

        def following(done: int) -> None:
            nonlocal reached
            reached = done + 1
            if self._spent():
                raise _TimeIsUp

        trial = Trial(path_task, None, start, method)
        try:
            run = run_task(
                path_task.started_at(start.q), method, self._folder / "trial.csv", give_up=True,
                progress=following, planning=planning,
            )  # fmt: skip
        except InvalidInput as error:
            return replace(trial, why=clause(error))
        except _TimeIsUp:
            why = f"the time of the search was up at waypoint {reached} of {start.waypoints}"
            return replace(trial, start=replace(start, reached=reached), why=why)
        return replace(
            trial, start=replace(start, reached=run.kept, stopped_by=run.held_by), run=run
        )

    def _say(self, what: str) -> None:
        self._report(what, min(1.0, self._used / self.seconds))

    def _spent(self, share: float = 1.0) -> bool:
        return self._used > share * self.seconds

    @property
    def _used(self) -> float:
        """Processor time of the search, s."""
        compiling = self._compiling.duration if self._compiling.done else 0.0
        return max(0.0, time.process_time() - self._began - compiling)


def _compiling() -> Any:
    """Numba's listener that adds up the time of compiling."""
    from numba.core import event

    listener: Any = event.TimingListener()  # type: ignore[no-untyped-call]
    return listener


def _explained(trial: Trial, tried: int, starts: int) -> Trial:
    """Why a trial does not pass: a waypoint without a configuration, or the active limits."""
    run, count = trial.run, len(trial.path_task.waypoints)
    if run is None or run.kept == 0:
        return replace(trial, why=trial.why or "no start leads to the path")
    if run.kept == count:
        assert run.check is not None
        return replace(trial, why=f"a run {run.check.verdict}")
    which = f"the best of {tried} starts" + (f" of {starts}" if tried < starts else "")
    why = f"from {which} {trial.method} keeps to {run.kept} of {count} waypoints"
    if not central_configurations(trial.path_task, run.kept):
        forbids = what_forbids(trial.path_task, run.kept)
        return replace(trial, why=f"{why}: {forbids}", impossible=True)
    return replace(trial, why=f"{why}: {run.held_by}" if run.held_by else why)


def _as_found(path_task: PathTask, q: Array) -> FoundStart:
    """A configuration as a start without a branch."""
    ranges = JointRanges.of(path_task.model)
    margin = float(ranges.margins(q).min(initial=np.inf))
    z, count = float(ranges.centering(q)), len(path_task.waypoints)
    return FoundStart(q, None, margin, z, sigma_min=np.nan, reached=0, waypoints=count)
