"""The pose of a part, or of a robot's base, that is best for the whole path."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, instance, number
from qp_twist.constraints import Clearance
from qp_twist.errors import InvalidInput
from qp_twist.following import plan
from qp_twist.paths import PathTask
from qp_twist.planning import Plan
from qp_twist.studies.placing import Placing, placing
from qp_twist.studies.sample import with_largest_step
from qp_twist.studies.workers import Rows, check_jobs, each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATIONS = 21
"""Waypoints of the plans that compare placements: on deburring their mean z is within 4 % of
that of all 401, their travel 1 to 10 % less, at an eighth of the time."""
_LONGEST = 45.0
"""Largest joint step between two of them, degrees. Without it a search compares all configurations
of one with all of the next (ten times as long)."""
_UNTIMED = 15.0
"""Largest step from waypoint to waypoint without a feed, degrees, as in plans."""
_SCREENING = 0.4
"""Share of the time for points all over the box; as much is for descents from the best of them, and
the rest for whole plans."""
LARGEST = "margin", "clearance"
"""Objectives of which the largest value is the best."""
_APART, _FAR, _SHARP = 0.005, 0.5, 1.2
"""Distances, m, between which the largest is searched that may be added to a clearance, and the
ratio of those between which that ends."""
_OF_STATIONS = 1.0, 0.8, 0.5
"""Shares of what some waypoints keep beyond the clearance that are tried on all of them."""
_DESCENTS = 3
"""Number of points from which descents start."""
_ENDS = 1e-3
"""Share of the box by which the last steps of a descent move a placement."""


@dataclass(frozen=True, eq=False)
class BestPlacement:
    """The best placement of a box, and all that were tried.

    Attributes:
        offset: Shift in world axes, m, and rotation vector, rad, (6,): the part, or the base, is
            turned about ``about``, then shifted. ``None`` if no placement has a plan.
        plan: The plan there, whose ``path_task`` is the task at that placement; ``None`` likewise.
        here: The plan of the task as it is, if the box contains it; ``None`` otherwise.
        offsets: Placements that were tried, (K, 6), those all over the box first.
        values: Values of plans of some waypoints there, (K,), by which they are compared; NaN where
            there is none.
        spread: Number of placements all over the box.
        objective: The objective, as passed.
        moves: What is placed.
        about: The point about which it is turned, m, (3,).
        body: The body of the scene that moves along.
        reason: Why there is no plan where the part is, or in the middle of the box, if none was
            found anywhere.
        interrupted: Whether Ctrl-C ended the search.
    """

    offset: Array | None
    plan: Plan | None
    here: Plan | None
    offsets: Array
    values: Array
    spread: int
    objective: str | Mapping[str, float]
    moves: Literal["part", "base"]
    about: Array
    body: str | None = None
    reason: str = ""
    interrupted: bool = False

    @property
    def value(self) -> float:
        """The value of the whole plan there; of ``"clearance"`` the least distance, m."""
        return np.nan if self.plan is None else score(self.plan, self.objective)

    @property
    def value_here(self) -> float:
        """The same of ``here``; NaN without one."""
        return np.nan if self.here is None else score(self.here, self.objective)

    @property
    def reachable(self) -> float:
        """Share of the placements all over the box that have a plan."""
        spread = self.values[: self.spread]
        return float(np.isfinite(spread).mean()) if len(spread) else np.nan

    def figure(self) -> Figure:
        """A map of the placements: which have a plan, and of which value."""
        from qp_twist.studies.placement_map import placement_figure  # with matplotlib

        return placement_figure(self)

    def to_dict(self) -> dict[str, Any]:
        """The result as data."""
        best = self.plan
        return {
            "objective": self.objective, "moves": self.moves, "about_m": self.about.tolist(),
            "offset": None if self.offset is None else self.offset.tolist(),
            "value": None if np.isnan(self.value) else self.value,
            "bound": None if best is None or np.isnan(best.bound) else best.bound,
            "value_here": None if np.isnan(self.value_here) else self.value_here,
            "tried": len(self.values), "spread": self.spread, "reachable": self.reachable,
            "interrupted": self.interrupted,
        }  # fmt: skip


def best_placement(
    path_task: PathTask,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    objective: str | Mapping[str, float] = "centering",
    *,
    moves: Literal["part", "base"] = "part",
    body: str | None = None,
    about: npt.ArrayLike | None = None,
    seconds: float = 60.0,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> BestPlacement:
    r"""Search the pose of the part, or of the robot's base, that is best for the whole path.

    In a box of poses :math:`\mathbf x = (\mathbf p, \boldsymbol\phi)`, the best value of the best
    plan:

    .. math:: \min_{\mathbf x_{min} \le \mathbf x \le \mathbf x_{max}} f^*(\mathbf x), \qquad
        f^*(\mathbf x) = \min_{\mathbf q_1 \dots \mathbf q_N}
        f(\mathbf q_1 \dots \mathbf q_N; \mathbf x)

    First plans of 21 waypoints compare points spread evenly over the box (Sobol's sequence), then
    those on descents from the best of them (COBYQA); whole plans of the best decide. The result is
    the best that was found, not proven to be the best there is. It has a plan of all waypoints,
    with everything that a plan promises.

    Args:
        path_task: The task.
        lower: Lower bounds of the shift, m, and of the rotation vector, rad, added to where the
            part (or the base) is, (6,); three numbers: it is not turned.
        upper: Upper bounds, likewise. An entry that equals its lower bound is fixed.
        objective: As of :func:`~qp_twist.plan`, or ``"clearance"``: the largest distance that a
            plan keeps from what it must not touch, within a fifth, on its whole way.
        moves: ``"part"``, or ``"base"``: the robot's base body.
        body: The part's body in the scene, fixed to the world, which moves along; ``None``: that
            of the task's ``[study.placement]``, if there is one. What else is in the scene stays.
        about: The point of the part about which it is turned, m, (3,); ``None``: that of
            ``[study.placement]``, else the middle of the path. A base turns about its own origin.
        seconds: Time for the search, s; it ends with the whole plan that then runs, and after
            eight places at least, ``2 * jobs`` if these are more.
        jobs: Processes for the points all over the box. More than one need the extra ``study``.
        scheduler: Address of a Dask scheduler, whose workers are used instead.
        progress: Called with the current phase and its share done.

    Raises:
        InvalidInput: If an argument is wrong, the task has one waypoint, or a plan refuses it.
        KeyboardInterrupt: On Ctrl-C before there is a whole plan; later the best one is returned.

    Example:
        >>> import qp_twist as qt
        >>> task = qt.load_task("planar_line")
        >>> found = qt.best_placement(task, [-0.1, -0.1, 0], [0.1, 0.1, 0], seconds=2.0)
        >>> found.plan.value < found.here.value
        True
    """
    instance("best_placement(path_task, …)", path_task, PathTask)
    box = Box.of(lower, upper)
    if moves not in ("part", "base"):
        raise InvalidInput(f"best_placement(moves=…): expected 'part' or 'base', got {moves!r}.")
    number("best_placement(seconds=…)", seconds, above=0.0)
    check_jobs(jobs)
    _refuse_without_clearance(path_task, objective)
    place = placing(path_task, moves, body, about)
    place(np.zeros(6))  # refuses a body that does not exist
    search = _Search(place, box, objective, seconds, progress or (lambda what, at: None))
    interrupted = False
    try:
        search.run(jobs, scheduler)
    except KeyboardInterrupt:
        if not search.plans:
            raise
        interrupted = True
    best, here = search.best(), search.plans.get(tuple(np.zeros(6)))
    tried = list(search.values)
    return BestPlacement(
        None if best is None else np.array(best), None if best is None else search.plans[best],
        here, np.array(tried).reshape(-1, 6), np.array([search.values[x] for x in tried]),
        search.spread, objective, moves, place.about, place.body,
        "" if best is not None else str(next(iter(search.plans.values())).certificate), interrupted,
    )  # fmt: skip


def _refuse_without_clearance(task: PathTask, objective: str | Mapping[str, float]) -> None:
    if objective == "clearance" and not task.clearances:
        raise InvalidInput(
            f"{task.name}: has no [clearance], so that no placement keeps more of it than another; "
            "add one to the task, or choose another objective."
        )


class Box(NamedTuple):
    """Bounds of an offset, (6,) each, and the entries that may vary."""

    lower: Array
    upper: Array
    free: npt.NDArray[np.intp]

    @classmethod
    def of(cls, lower: npt.ArrayLike, upper: npt.ArrayLike) -> Box:
        """The box, of three or six numbers.

        Raises:
            InvalidInput: If they are none, or a lower bound is above the upper one.
        """
        ends = []
        for name, given in (("lower", lower), ("upper", upper)):
            end = finite_array(f"best_placement({name})", np.atleast_1d(given), (None,))
            if len(end) not in (3, 6):
                raise InvalidInput(
                    f"best_placement({name}): expected three numbers, m, or six, with a rotation "
                    f"vector in rad; got {len(end)}."
                )
            ends.append(np.pad(end, (0, 6 - len(end))))
        if (ends[0] > ends[1]).any():
            k = int(np.argmax(ends[0] > ends[1]))
            raise InvalidInput(
                f"best_placement: entry {k + 1} of lower, {ends[0][k]:g}, is above that of upper, "
                f"{ends[1][k]:g}."
            )
        free = np.flatnonzero(ends[1] > ends[0])
        if not len(free):
            raise InvalidInput("best_placement: lower equals upper; plan that placement instead.")
        return cls(ends[0], ends[1], free)

    def at(self, unit: Array) -> tuple[float, ...]:
        """The offset at coordinates from 0 to 1 of the free entries."""
        x = self.lower.copy()
        x[self.free] += np.clip(unit, 0.0, 1.0) * (self.upper - self.lower)[self.free]
        return tuple(x.tolist())

    def unit(self, x: Sequence[float]) -> Array:
        """The coordinates of an offset."""
        free = self.free
        return (np.array(x) - self.lower)[free] / (self.upper - self.lower)[free]


class _Screen(NamedTuple):
    """The job of one point: its value."""

    place: Placing
    objective: str | Mapping[str, float]
    points: list[tuple[float, ...]]

    def __call__(self, index: int) -> Rows:
        return [{"value": value_of(self.place(self.points[index]), self.objective)}]

    def failed(self, index: int, message: str) -> Rows:
        return [{"value": np.nan}]


def value_of(task: PathTask, objective: str | Mapping[str, float]) -> float:
    """The value of the best plan of some waypoints of a task; NaN without one."""
    stations = _stations(task)
    options: dict[str, Any] = {"max_step_deg": _LONGEST, "seeds": ()}
    if objective != "clearance":
        return float(plan(stations, objective, **options).value)
    best = plan(stations, **options)
    low, high = 0.0, _FAR  # more than the task asks for
    while best.q is not None and high > _SHARP * max(low, _APART):
        middle = float(np.sqrt(max(low, _APART / _SHARP) * high))
        wider = _wider_plan(stations, middle, **options)
        if wider is None:
            high = middle
        else:
            best, low = wider, middle
    return score(best, objective)


def _wider_plan(task: PathTask, more: float, **options: Any) -> Plan | None:
    """The plan of a task with clearances that are larger, m; ``None`` without a motion."""
    wider = [
        Clearance(c.model, c.distance + more, c.ignored, pairs=c.pairs)
        if isinstance(c, Clearance) else c
        for c in task.constraints
    ]  # fmt: skip
    try:
        found = plan(replace(task, constraints=tuple(wider)), **options)
    except InvalidInput:  # two links of the arm are never so far apart
        return None
    return None if found.q is None else replace(found, path_task=task)


def score(found: Plan, objective: str | Mapping[str, float]) -> float:
    """What placements are compared by; NaN without a motion.

    The plan's value or, of ``"clearance"``, the least distance on the straight ways of its joints.
    """
    if found.q is None or objective != "clearance":
        return float(found.value)
    nearest = [each.nearest(found.q) for each in found.path_task.clearances]
    return min((each.distance for each in nearest if each is not None), default=np.inf)


def _stations(task: PathTask) -> PathTask:
    """The task of some of its waypoints, among them both ends of joint moves and of segments."""
    last = len(task.waypoints) - 1
    moves = np.array(task.joint_moves, dtype=np.intp)
    ends = np.concatenate([moves, moves - 1, [segment.first for segment in task.segments]])
    chosen = np.concatenate([np.linspace(0, last, STATIONS).round(), ends])
    index = np.unique(chosen.astype(np.intp))
    if task.durations is None:
        task = with_largest_step(task, _UNTIMED)
    return task.part(index)


class _OutOfTime(Exception):
    """The time of a phase is over."""


class _Search:
    """The search: values of some waypoints by offset, and whole plans of the best."""

    def __init__(
        self,
        place: Placing,
        box: Box,
        objective: str | Mapping[str, float],
        seconds: float,
        progress: Callable[[str, float], None],
    ) -> None:
        self.place, self.box, self.objective = place, box, objective
        self.progress, self.seconds = progress, seconds
        #: Values by offset, in the order in which they were asked for.
        self.values: dict[tuple[float, ...], float] = {}
        #: Whole plans by offset.
        self.plans: dict[tuple[float, ...], Plan] = {}
        self.spread = 0
        self.sign = -1.0 if objective in LARGEST else 1.0
        self._begin = perf_counter()

    def run(self, jobs: int, scheduler: str | None) -> None:
        """Search until the time is over."""
        zero = np.zeros(6)
        if ((self.box.lower <= zero) & (zero <= self.box.upper)).all():
            self._plan(tuple(zero.tolist()))
        screened = self._spent + _SCREENING * (self.seconds - self._spent)
        self._screen(jobs, scheduler, screened)
        self._descend(self._spent + _SCREENING / (1.0 - _SCREENING) * (self.seconds - self._spent))
        ranked = self._ranked()
        for count, x in enumerate(ranked):
            # The first are close together; where none of them has a whole plan, others follow.
            if count and self.best() is not None and self._spent > self.seconds:
                break
            self.progress("whole plans", count / len(ranked))
            if x not in self.plans:
                self._plan(x)
        if not self.plans:
            self._plan(self.box.at(np.full(len(self.box.free), 0.5)))

    def best(self) -> tuple[float, ...] | None:
        """The offset of the best whole plan; ``None`` without one."""
        found = [x for x, made in self.plans.items() if made.q is not None]
        return min(
            found, key=lambda x: self.sign * score(self.plans[x], self.objective), default=None
        )

    @property
    def _spent(self) -> float:
        return perf_counter() - self._begin

    def _plan(self, x: tuple[float, ...]) -> None:
        task = self.place(x)
        if self.objective != "clearance":
            self.plans[x] = plan(task, self.objective)
            return
        if x not in self.values:
            self.values[x] = value_of(task, self.objective)
        more = self.values[x] - min(each.distance for each in task.clearances)
        wider = (_wider_plan(task, share * more) for share in _OF_STATIONS if more > 0.0)
        self.plans[x] = next((found for found in wider if found), None) or plan(task)

    def _ranked(self) -> list[tuple[float, ...]]:
        """Offsets that have a value, the best first."""
        found = [x for x, value in self.values.items() if np.isfinite(value)]
        return sorted(found, key=lambda x: self.sign * self.values[x])

    def _screen(self, jobs: int, scheduler: str | None, until: float) -> None:
        """Values at points all over the box."""
        from scipy.stats.qmc import Sobol  # imported on demand: 0.3 s

        begin, points = self._spent, Sobol(len(self.box.free), rng=0)
        while self._spent < until or not self.spread:
            drawn = [self.box.at(unit) for unit in points.random(max(8, 2 * jobs))]
            screen = _Screen(self.place, self.objective, drawn)
            every = range(len(drawn))
            if jobs == 1 and scheduler is None:
                found = ((k, screen(k)) for k in every)
            else:
                found = each(screen, every, jobs=jobs, scheduler=scheduler)
            with closing(found) as results:
                for k, rows in results:
                    self.values[drawn[k]] = rows[0]["value"]
                    self.spread += 1
                    self.progress("all over the box", (self._spent - begin) / (until - begin))

    def _descend(self, until: float) -> None:
        """Values on descents from the best points."""
        from scipy.optimize import minimize

        begin = self._spent

        def value(unit: Array) -> float:
            if self._spent > until:
                raise _OutOfTime
            self.progress("descents", (self._spent - begin) / (until - begin))
            x = self.box.at(unit)
            if x not in self.values:
                self.values[x] = value_of(self.place(x), self.objective)
            found = self.sign * self.values[x]
            return found if np.isfinite(found) else np.inf

        count = len(self.box.free)
        # The distance between points that are spread evenly over a box of this many dimensions.
        apart = self.spread ** (-1.0 / count)
        try:
            for x in self._ranked()[:_DESCENTS]:
                minimize(
                    value, self.box.unit(x), method="COBYQA", bounds=[(0.0, 1.0)] * count,
                    options={"initial_tr_radius": min(0.5, apart), "final_tr_radius": _ENDS},
                )  # fmt: skip
        except _OutOfTime:
            pass
