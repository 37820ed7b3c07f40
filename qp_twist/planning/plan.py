"""The best joint motion along a path, with a bound and a certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, clause, finite_array, instance
from qp_twist.constraints import refuse_never_apart
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.notebook import html_table
from qp_twist.paths import PathTask
from qp_twist.planning.certificate import Certificate, amount_of
from qp_twist.planning.hard_constraints import WITHIN
from qp_twist.planning.joint_move import JointMoveSearch
from qp_twist.planning.levels import Progress
from qp_twist.planning.objective import Objective
from qp_twist.planning.pace import SLOWED, Pace, PacedStretch, slowest
from qp_twist.planning.path_rows import PathRows
from qp_twist.planning.preferred import PreferredPoses
from qp_twist.planning.problem import PathConstraints, Problem, motion_limits
from qp_twist.planning.search import PlanSearch, SearchResult, Trials
from qp_twist.planning.sentence import Sentence
from qp_twist.referee import (
    Finding,
    JointMotion,
    Passing,
    PathErrors,
    Tolerances,
    examine,
    straight_errors,
)
from qp_twist.referee import motion_limits as known_limits


@dataclass(frozen=True, eq=False)
class Plan:
    """A joint motion along a path task, or why there is none.

    The configurations are on the path at the waypoints; between two of them the joints are
    interpolated linearly. ``between`` proves how far that deviates from the path; ``examined`` is
    the full check of the motion.

    Attributes:
        path_task: The task.
        q: The motion, (N, nq), every configuration on its waypoint, inside the joint limits, the
            hard tolerance bands and constraints, and no step longer than allowed; ``None`` if there
            is none. Between waypoints violations are proven to be at most 0.05° or 0.1 mm, the
            tolerance of a check.
        value: Value of the objective: mean z (centering), degrees (travel, margin), seconds (time),
            or the weighted sum, with the cost of a :class:`~qp_twist.Preference`; NaN if there is
            no motion.
        bound: Bound of the value over all motions, each waypoint taken for itself
            (``planning.bound.pointwise_bound``); NaN if a waypoint has no configuration, and for
            centering and margin if one leaves more than three degrees free.
        certificate: Why there is a motion or none, as a sentence and as data.
        objective: The objective, as passed.
        joint_weights: Weights of joints in the objective, as passed.
        interrupted: Whether Ctrl-C ended the search; the motion is the best by then, and satisfies
            all constraints.
        s: Parameter of the path at each row (``PathTask.at``), (N,), where there are further
            rows inside joint moves; ``None``: a row for each waypoint.

    What needs the motion raises :class:`~qp_twist.InvalidInput` with the reason if there is none.
    """

    path_task: PathTask
    q: Array | None
    value: float
    bound: float
    certificate: Certificate
    objective: str | Mapping[str, float]
    joint_weights: Mapping[str, float] = field(default_factory=dict)
    interrupted: bool = False
    s: Array | None = None

    @property
    def gap(self) -> float:
        """Distance of the value from the bound; the optimal value lies between them."""
        return abs(self.value - self.bound)

    @property
    def start(self) -> Array:
        """The first configuration, (nq,)."""
        start: Array = self.motion()[0]
        return start

    def motion(self) -> Array:
        """The motion, (N, nq), which there has to be."""
        if self.q is None:
            raise InvalidInput(f"{self.path_task.name}: no plan: {self.certificate}")
        return self.q

    @property
    def cuts(self) -> tuple[int, ...]:
        """The task's waypoints, from 1, after which the tool lifts off."""
        return () if self.path_task.cuts == "fewest" else self.path_task.cuts

    @property
    def at_waypoints(self) -> Array:
        """The configurations at the waypoints, (N, nq)."""
        found: Array = self.motion()[self._places == np.floor(self._places)]
        return found

    @property
    def _places(self) -> Array:
        """The parameter of the path at each row, (rows,)."""
        return np.arange(len(self.motion()), dtype=np.float64) if self.s is None else self.s

    @cached_property
    def durations(self) -> Array | None:
        """Time from each row to the next, s, (rows − 1,): at the feed, or longer if limits need it.

        Joints move at constant speed from row to row; in joint moves as fast as they can. ``None``
        without a feed, unless the objective is the time.
        """
        task, q = self.path_task, self.motion()
        counts = self.objective == "time" or (
            isinstance(self.objective, Mapping) and bool(self.objective.get("time"))
        )
        path = task.at(self._places)
        if path.feed_times is None and not counts:
            return None
        pace = Pace.of_run(task, path) if counts else Pace.stated(task, path)
        if not path.moves.any():
            return pace.seconds(q)
        times = JointMoveSearch(task).seconds(q)
        ends = np.flatnonzero(np.diff(path.moves, prepend=True, append=True))
        for first, last in ends.reshape(-1, 2).tolist():  # stretches between joint moves
            times[first:last] = pace.part(first, last).seconds(q[first : last + 1])
        return times

    @property
    def pace(self) -> Array | None:
        """Time of each waypoint, s, (N,): the task's, or longer where the plan is slower.

        ``None`` where :attr:`durations` are. Those of joint moves are the task's.
        """
        if self.durations is None:
            return None
        at_waypoints = self._places == np.floor(self._places)
        times = np.append(0.0, np.cumsum(self.durations))[at_waypoints]
        longer: Array = np.diff(times, prepend=times[0])
        longer[list(self.path_task.joint_moves)] = 0.0
        at_feed = self.path_task.durations
        return longer if at_feed is None else np.maximum(at_feed, longer)

    @property
    def is_slower(self) -> bool:
        """Whether it takes longer than at the feed, or there is none, but its time counts."""
        pace, at_feed = self.pace, self.path_task.durations
        if pace is None or at_feed is None:
            return pace is not None
        return bool((pace > (1.0 + SLOWED) * at_feed).any())

    @cached_property
    def between(self) -> PathErrors:
        """Proven deviation between the waypoints, with linearly interpolated joints."""
        return straight_errors(self.path_task, self.motion(), self.s)

    @property
    def preferred(self) -> str:
        """Ranges of the lean and roll that the task prefers, in words; empty if it has none."""
        preferred = PreferredPoses.of(self.path_task)
        return "" if preferred is None else preferred.described(self.at_waypoints)

    @property
    def promise(self) -> str:
        """What was proven about the motion, at and between the waypoints, in a sentence."""
        found = self.between
        if not len(found.position.between):
            return "on the path at its one waypoint"
        text = (
            "on the path at the waypoints; between them, the joints moving straight, within "
            f"{1e3 * found.position.bound.max():.3g} mm and "
            f"{np.degrees(found.axis.bound.max()):.3g}° of it"
        )
        kinds = {
            "hard bands": self.path_task.bands,
            "constraints": self.path_task.stated_constraints,
        }
        what = " and ".join(name for name, given in kinds.items() if given)
        for unit, scale, name in (("m", 1e3, " mm"), ("rad", 180.0 / np.pi, "°")):
            bounds = [of.bound.max() for of in found.bands if of.unit == unit]
            if bounds:
                excess = scale * max(bounds)
                text += f", outside {what} by at most {excess:.3g}{name}"
        return text

    def examined(self, tolerances: Tolerances | None = None) -> tuple[Finding, ...]:
        """Check of the motion, with linearly interpolated joints.

        Timed by :attr:`durations`, if it has any. Where it does not pass between waypoints, the
        trajectory needs further rows: follow the plan and use :func:`~qp_twist.refine_trajectory`.

        ``tolerances`` are the largest task errors that pass; 0.1 mm and 0.05° if ``None``.
        """
        q = self.motion()
        at_waypoints = self._places == np.floor(self._places)
        pieces = np.ones(len(q) - 1) if self.durations is None else self.durations
        times = np.append(0.0, np.cumsum(pieces))
        passing = Passing(times[at_waypoints], self.durations is not None, by_row=True)
        return examine(self.path_task, JointMotion(times, q), tolerances, passing)

    def __repr__(self) -> str:
        count = len(self.path_task.waypoints)
        ended = ", interrupted" if self.interrupted else ""
        return f"Plan({self.path_task.name!r}, {clause(self.result)}, {count} waypoints{ended})"

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        rows: list[tuple[str, str]] = [("objective", str(self.objective))]
        if self.q is not None:
            rows += [("value", self._amount(self.value)), ("bound", self._amount(self.bound))]
        rows += [
            ("waypoints", str(len(self.path_task.waypoints))),
            ("certificate", str(self.certificate)),
        ]
        return html_table(f"Plan of {self.path_task.name}", rows)

    @property
    def result(self) -> str:
        """Objective, value and bound, or why there is no motion, in a line."""
        if self.q is None:
            return f"{self.objective}: none: {self.certificate}"
        sign = "<=" if self.objective == "margin" else ">="
        bound = "no bound"
        if np.isfinite(self.bound):
            bound = f"{sign} bound {self._number(self.bound)}"
        return f"{self.objective}: {self._amount(self.value)} {bound}"

    def _amount(self, value: float) -> str:
        """A value or bound with its unit."""
        if np.isnan(value):
            return "not known"
        weighted = self.joint_weights and self.objective in ("centering", "travel", "margin")
        of_z = "mean z " if self.objective == "centering" else ""
        if self.path_task.preference is not None:
            of_z = f"{of_z}and preference ".removeprefix("and ")
        return f"{'weighted ' if weighted else ''}{of_z}{self._number(value)}"

    def _number(self, value: float) -> str:
        """The same without its name."""
        digits = {"centering": ".4f", "time": ".4g"}
        units = {"centering": "", "time": " s"}
        if not isinstance(self.objective, str):
            return f"{value:.5g}"
        return f"{value:{digits.get(self.objective, '.2f')}}{units.get(self.objective, '°')}"


def make_plan(
    path_task: PathTask,
    objective: str | Mapping[str, float],
    start: npt.ArrayLike | None,
    max_step_deg: float | None,
    runs: Trials,
    progress: Progress | None = None,
    joint_weights: Mapping[str, float] | None = None,
    *,
    paced: bool = True,
    slow_down: bool = False,
) -> Plan:
    """Search the best motion; see :func:`qp_twist.plan`.

    ``start`` is on the first waypoint. ``runs`` returns joint paths (N, nq) of other methods.
    ``paced``: where the speed prevents a motion, how much slower there is one.
    """
    goal = stated_objective(path_task, objective, joint_weights).along(path_task)
    ranges = goal.ranges
    rows = PathRows(path_task)
    first = None
    if start is not None:
        first = finite_array("start", start, (path_task.model.nq,))
        _check_start(ranges, rows, first)

    def limits(times: float = 1.0, *, slow_down: bool = False) -> PathConstraints:
        """Those of a path that takes so many times as long, or the time that it needs."""
        task = replace(
            path_task,
            velocity_limits=times * known_limits(path_task).velocity,
            acceleration_limits=times**2 * path_task.acceleration_limits,
        )
        return motion_limits(task, ranges, max_step_deg, rows.hard, slow_down=slow_down)

    says, timed = progress or (lambda what, share: None), path_task.durations is not None
    problem = Problem(path_task, rows, limits(slow_down=bool(goal.time)), goal, first)
    slower = limits if paced and timed and not slow_down and not goal.time else None
    # Where a slower motion may follow, the speed is a reason that needs no other search.
    may_slow = slow_down and timed and not goal.time
    search = PlanSearch(problem, runs, says, slower, may_slow=may_slow)
    found = search.run()
    at_feed: Certificate | None = None
    if may_slow and _may_be_speed(found):
        at_feed = found.certificate
        slowed = replace(
            problem, limits=limits(slow_down=True), objective=goal.slowed(path_task), stated=goal
        )
        found = PlanSearch(slowed, runs, says).run()
        if found.path is None:
            certificate = replace(at_feed, at_other_speed=found.certificate)
            found = replace(found, certificate=certificate)
        elif slower_than_feed([(0, path_task, found.path.q)], goal)[0] == 1.0:  # it is kept
            found = search.near(found)
    path, certificate = found.path, found.certificate
    if path is not None and timed:
        factor, where = slower_than_feed([(0, path_task, path.q)], goal)
        if factor > 1.0:
            certificate = replace(certificate, slower=factor, note=where, at_other_speed=at_feed)
    return Plan(
        path_task, None if path is None else path.q,
        np.nan if path is None else goal.value(path.q), found.bound, certificate, objective,
        dict(joint_weights or {}), found.interrupted,
    )  # fmt: skip


def slower_than_feed(
    stretches: Sequence[tuple[int, PathTask, Array]], goal: Objective
) -> tuple[float, Sentence]:
    """How many times longer than at the feed a plan takes somewhere, and a sentence where.

    Of a plan for an objective, in ``stretches`` between joint moves: the first waypoint of each in
    the whole path, from 0, its task, and its rows (N, nv).
    """
    pace = Pace.of_run if goal.time else Pace.stated
    paced = [PacedStretch(first, pace(task), q) for first, task, q in stretches]
    return slowest(paced, goal.ranges.names)


def stated_objective(
    path_task: PathTask,
    objective: str | Mapping[str, float],
    joint_weights: Mapping[str, float] | None = None,
) -> Objective:
    """The objective of a plan of a task, which has to be one that can be planned.

    Raises:
        InvalidInput: If it is not, or the objective is wrong or says nothing about its joints.
    """
    instance("plan(path_task, …)", path_task, PathTask)
    if len(path_task.waypoints) < 2:
        raise InvalidInput(f"plan: {path_task.name} has one waypoint; a path has at least two.")
    ranges = JointRanges.of(path_task.model)
    if not ranges.only_hinges_and_slides:
        raise InvalidInput(
            f"plan: {path_task.name}'s scene has ball or free joints; only hinges and slides are "
            "planned. Take free bodies out of the scene, or follow the path with a method."
        )
    for clearance in path_task.clearances:
        refuse_never_apart(path_task.name, clearance)
    goal = Objective.of(ranges, objective, joint_weights)
    if (goal.margin or goal.centering) and not ranges.limited.any():
        raise InvalidInput(
            f"plan: {path_task.name}'s joints have no ranges, so that objective {objective!r} says "
            "nothing; use objective='travel'."
        )
    return goal


def _may_be_speed(found: SearchResult) -> bool:
    """Whether a slower motion may exist where none was found: no waypoint alone excludes it."""
    certificate = found.certificate
    return found.path is None and (
        certificate.kind == "speed"
        or (certificate.kind in ("limits", "band") and bool(certificate.detail))
    )


def _check_start(ranges: JointRanges, rows: PathRows, start: Array) -> None:
    """Refuse a given start (nv,) outside the joint limits or a hard band."""
    outside = ranges.room(start) < -1e-9
    if outside.any():
        name = ranges.names[int(np.argmax(outside))]
        raise InvalidInput(f"plan: the start is outside the limits of {name}.")
    margins = rows.hard.margins(start[None], np.zeros(1, dtype=np.intp))[0]
    for k in np.flatnonzero(margins < -WITHIN):
        raise InvalidInput(
            f"plan: the start on the first waypoint is outside {rows.hard.names[k]} by "
            f"{amount_of(-margins[k], rows.hard.units[k])}; give one inside, or none "
            "(start=None) to have it found."
        )
