"""Search starts and placements, each tested by a run of the task."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qp_twist.authoring.reach import Placement, Placements, placements
from qp_twist.authoring.search_clock import SearchClock
from qp_twist.checks import Array, clause
from qp_twist.errors import InvalidInput
from qp_twist.following import FoundStart, NoStart, find_starts, plan
from qp_twist.following.compiled_walk import CompiledWalk, walk_known
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
    """Stops a plan."""


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
    placement: Placement | None
    start: FoundStart | None
    method: str = METHOD
    run: TaskRun | None = None
    why: str = ""
    impossible: bool = False

    @property
    def passes(self) -> bool:
        """Whether the task was run to its end and passed its check."""
        return self.run is not None and self.run.passes


@dataclass(frozen=True, eq=False)
class TaskSearchResult:
    """Result of a search.

    Attributes:
        best: The trial with the longest run.
        here: The trial at the present placement.
        places: The search for other placements, if there was one.
        run: Number of these that were run.
        ended: When and why the search was stopped early; empty if it was completed.
        by_user: Whether it was interrupted.
    """

    best: Trial
    here: Trial
    places: Placements | None = None
    run: int = 0
    ended: str = ""
    by_user: bool = False


class TaskSearch:
    """Searches a start, and a placement of the workpiece, within a time limit.

    The time is that of the processor, without that of compiling kernels: neither other programs
    on the machine nor a first call on it shorten the search. Every verdict is that of
    :func:`~qp_twist.trajectories.run_task`, as in ``qp-twist run``.

    Args:
        seconds: Limit of the search, s of processor time.
        clock: What counts them.
        report: Called with the current phase and the share of the time that is used.
        rounded: Rounds a start as in the task file.
    """

    def __init__(
        self,
        seconds: float,
        clock: SearchClock,
        report: Progress,
        rounded: Callable[[Array], Array],
    ) -> None:
        self.seconds = seconds
        self._clock, self._report, self._rounded = clock, report, rounded
        self._folder = Path()

    def run(self, path_task: PathTask, *, elsewhere: bool) -> TaskSearchResult:
        """Search at the present placement of the workpiece, then, if that fails, elsewhere.

        The workpiece is only moved if some waypoint is out of reach; it is not moved if only no
        suitable start was found.

        Interrupted (Ctrl-C), it returns what it has.
        """
        _load(path_task)
        self._clock.restart()
        here = best = Trial(path_task, None, None, why="no start was tried")
        places: Placements | None = None
        count = 0
        ended = ""
        with tempfile.TemporaryDirectory() as folder:
            self._folder = Path(folder)
            try:
                for trial in self._here(path_task):
                    here = best = trial
                if not here.passes and not here.impossible and self._spent(_SHARE_HERE):
                    ended = f"after {self._elapsed()} s of processor time"
                if here.passes or not elsewhere or not here.impossible:
                    return TaskSearchResult(best, here, ended=ended)
                what = "looking for places for the workpiece"
                self._say(what)
                places = placements(path_task, progress=lambda: self._say(what))
                for place in places.found[:_MOST_PLACES]:
                    if self._spent():
                        ended = f"after {self._elapsed()} s of processor time"
                        break
                    count += 1
                    self._say(f"placement {count} of {min(len(places.found), _MOST_PLACES)}")
                    trial = self._there(path_task, place)
                    if trial.passes:
                        best = trial
                        break
            except KeyboardInterrupt:
                ended = f"by you after {self._elapsed()} s of processor time"
                return TaskSearchResult(best, here, places, count, ended, by_user=True)
        return TaskSearchResult(best, here, places, count, ended)

    # ------------------------------------------------------------ the present placement

    def _here(self, path_task: PathTask) -> Iterable[Trial]:
        """Trials at the present placement, each at least as good as the one before."""
        self._say("looking for a start")
        best = Trial(path_task, None, None)
        tried = 0
        try:
            starts = find_starts(path_task, _STARTS, runs=False)
        except NoStart as error:
            yield dataclasses.replace(best, why=error.why, impossible=True)
            return
        for start in starts:
            tried += 1
            self._say(f"start {tried} of {len(starts)}")
            best = _further(best, self._from(path_task, start, METHOD))
            yield best
            if best.passes:
                return
            if tried == 1 or self._spent(_SHARE_HERE):
                best = self._explained(best, tried, len(starts))
                yield best
                if best.impossible or self._spent(_SHARE_HERE):
                    return
        best = self._explained(best, tried, len(starts))
        yield best
        if not best.impossible:
            yield from self._by_plan(path_task, best)

    def _explained(self, trial: Trial, tried: int, starts: int) -> Trial:
        """Why a trial does not pass: a waypoint without a configuration, or the active limits."""
        run, count = trial.run, len(trial.path_task.waypoints)
        if run is None or run.kept == 0:
            return dataclasses.replace(trial, why=trial.why or "no start leads to the path")
        if run.kept == count:
            assert run.check is not None
            return dataclasses.replace(trial, why=f"a run {run.check.verdict}")
        which = f"the best of {tried} starts"
        if tried < starts:
            which = f"the first of {starts} starts" if tried == 1 else f"{which} of {starts}"
        why = f"from {which} {trial.method} keeps to {run.kept} of {count} waypoints"
        if not central_configurations(trial.path_task, run.kept):
            forbids = what_forbids(trial.path_task, run.kept)
            return dataclasses.replace(trial, why=f"{why}: {forbids}", impossible=True)
        if run.held_by:
            why += f": {run.held_by}"
        return dataclasses.replace(trial, why=why)

    def _by_plan(self, path_task: PathTask, best: Trial) -> Iterable[Trial]:
        """The start of a plan, by the method and then by following the plan.

        If the plan is interrupted, so is the search, unless the method passes from its start.
        """
        free = np.full(path_task.model.nv, np.inf)
        freed = dataclasses.replace(path_task, velocity_limits=free, acceleration_limits=free)
        try:
            found = plan(freed, progress=self._planning)
            if found.q is None:
                why = f"{best.why}; nor is there a plan: {clause(found.certificate)}"
                yield dataclasses.replace(best, why=why, impossible=True)
                return
            start = self._as_found(path_task, found.start)
            for method in (METHOD,) if found.interrupted else (METHOD, PLANNED):
                trial = self._from(path_task, start, method, planning=self._planning)
                if trial.passes:
                    yield trial
                    return
            if found.interrupted:
                raise KeyboardInterrupt
        except (_TimeIsUp, InvalidInput):
            return

    def _planning(self, what: str, share: float) -> None:
        self._say(f"plan of the whole path: {what}")
        if self._spent(_SHARE_HERE):
            raise _TimeIsUp

    # ------------------------------------------------------------ elsewhere

    def _there(self, path_task: PathTask, place: Placement) -> Trial:
        """A trial with the workpiece at a place."""
        task = place.of(path_task)
        try:
            starts = find_starts(task, _STARTS_ELSEWHERE, runs=False)
        except NoStart:
            starts = []
        best = Trial(task, place, None)
        for start in (*starts, self._as_found(task, place.start)):
            best = _further(best, self._from(task, start, METHOD, place))
            if best.passes:
                break
        return best

    # ------------------------------------------------------------ one trial

    def _from(
        self,
        path_task: PathTask,
        start: FoundStart,
        method: str,
        place: Placement | None = None,
        planning: Progress | None = None,
    ) -> Trial:
        """The task run from a start, as the task file will have it."""
        start = dataclasses.replace(start, q=self._rounded(start.q))
        task = path_task.started_at(start.q)
        reached = 1

        def following(done: int) -> None:
            nonlocal reached
            reached = done + 1
            if self._spent():
                raise _TimeIsUp

        out = self._folder / "trial.csv"
        try:
            run = run_task(task, method, out, give_up=True, progress=following, planning=planning)
        except InvalidInput as error:
            return Trial(path_task, place, start, method, why=clause(error))
        except _TimeIsUp:
            why = f"the time of the search was up at waypoint {reached} of {start.waypoints}"
            start = dataclasses.replace(start, reached=reached)
            return Trial(path_task, place, start, method, why=why)
        start = dataclasses.replace(start, reached=run.kept, stopped_by=run.held_by)
        return Trial(path_task, place, start, method, run)

    def _as_found(self, path_task: PathTask, q: Array) -> FoundStart:
        ranges = JointRanges.of(path_task.model)
        return FoundStart(
            q=q,
            branch=None,
            margin=float(ranges.margins(q).min(initial=np.inf)),
            z=float(ranges.centring(q)),
            sigma_min=np.nan,
            reached=0,
            waypoints=len(path_task.waypoints),
        )

    # ------------------------------------------------------------ time

    def _say(self, what: str) -> None:
        self._report(what, min(1.0, self._clock.seconds / self.seconds))

    def _spent(self, share: float = 1.0) -> bool:
        return self._clock.seconds > share * self.seconds

    def _elapsed(self) -> str:
        return f"{self._clock.seconds:.0f}"


def _load(path_task: PathTask) -> None:
    """Load or compile the machine code of the runs."""
    settings = path_task.settings(METHOD)
    if walk_known(path_task, METHOD, settings):
        CompiledWalk(path_task, METHOD, settings)


def _further(best: Trial, trial: Trial) -> Trial:
    """Whichever of two trials gets further; the first of equal ones."""
    if best.start is None or trial.passes:
        return trial
    kept = [0 if one.run is None else one.run.kept for one in (best, trial)]
    return trial if kept[1] > kept[0] else best
