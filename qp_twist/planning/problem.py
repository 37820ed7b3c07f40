"""What a joint path has to satisfy, and what it optimises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse

from qp_twist.checks import Array, Indices, Mask, number
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.planning.hard_constraints import SHARES, WITHIN, HardConstraints
from qp_twist.planning.layer import TURN
from qp_twist.planning.objective import Objective
from qp_twist.planning.on_the_path import OnThePath
from qp_twist.planning.path_rows import PathRows
from qp_twist.referee import motion_limits as known_limits

Kind = Literal["position", "velocity", "acceleration", "band"]

OF_PATH = "the path between waypoints"
"""Name of what a motion breaks that jumps from one waypoint to the next."""

UNTIMED_STEP = np.radians(15.0)
"""Largest step of a joint to the next waypoint without a limit, rad or m.

Above it a step counts as a reconfiguration (the comparison's ``reconfigurations``).
"""
INSET = 1e-7
"""Distance from every limit that the programs keep, for rounding, rad or m."""
_FAR = 0.1
"""Sum of the joints' motions between waypoints above which clearances are evaluated there, rad."""
_BESIDE = 0.06
"""Distance of the shares on both sides of a violation that are evaluated with it."""


class Margins(NamedTuple):
    """The margins of a joint path in one kind of constraint."""

    kind: Kind
    names: tuple[str, ...]
    """Names of the joints, bands or constraints, (k)."""
    units: tuple[str, ...]
    """``"rad"`` or ``"m"``, (k)."""
    values: Array
    """Margins at each waypoint, nonnegative inside, ∞ without a constraint, (N, k)."""
    between: bool = False
    """Whether they belong to the interval before the waypoint."""

    def violation(self) -> Violation:
        """The largest violation."""
        row, column = np.unravel_index(int(np.argmin(self.values)), self.values.shape)
        excess, unit = -float(self.values[row, column]), self.units[column]
        return Violation(self.kind, self.names[column], int(row), excess, unit, self.between)


class Violation(NamedTuple):
    """The largest violation of a joint path, in a joint, band or constraint of that ``name``."""

    kind: Kind
    name: str
    waypoint: int
    """The waypoint, from 0; for a step, or between two waypoints, the second one."""
    excess: float
    """Violation, rad or m; between waypoints beyond the tolerance."""
    unit: str
    between: bool
    """Whether it is between the waypoint and the one before it."""


@dataclass(frozen=True, eq=False)
class PathConstraints:
    """Constraints at and between the waypoints.

    Not the task's own rows: every path has been corrected onto its waypoints.

    Attributes:
        ranges: The joint ranges.
        steps: Largest displacement of each joint between consecutive waypoints, rad or m, (N − 1,
            nv).
        speed_changes: Largest change of velocity at each waypoint but the first and last, rad/s or
            m/s, (N − 2, nv); infinite without acceleration limits.
        durations: Time between consecutive waypoints, s, (N − 1,).
        hard: The hard bands and the constraints of the task.
        points: Points between waypoints at which these are evaluated: indices and shares of
            intervals, (K,) each.
        step_limit: What limits ``steps``, in words.
        on_path: Motions between waypoints that stay on the path, if these have to keep bands and
            constraints, too, beside the straight ones.
    """

    ranges: JointRanges
    steps: Array
    speed_changes: Array
    durations: Array
    hard: HardConstraints
    points: tuple[Indices, Array] = (np.zeros(0, dtype=np.intp), np.zeros(0))
    step_limit: str = "the speed limits"
    on_path: OnThePath | None = None

    @cached_property
    def _linear(self) -> list[tuple[Kind, sparse.csr_matrix, Array, Array]]:
        """lower ≤ G q ≤ upper for ranges, steps, and changes of speed: (kind, G, lower, upper).

        The rows of a step or a change of speed belong to its second waypoint. Changes of speed are
        given as displacements in the shortest step.
        """
        count, nv = len(self.steps) + 1, len(self.ranges.names)
        whole = sparse.identity(count * nv, format="csr")
        change = whole[nv:] - whole[:-nv]
        found: list[tuple[Kind, sparse.csr_matrix, Array, Array]] = [
            ("position", whole, self.ranges.lower, self.ranges.upper),
            ("velocity", change, -self.steps, self.steps),
        ]
        if np.isfinite(self.speed_changes).any():
            shortest = self.durations.min()
            speed = sparse.diags(shortest / np.repeat(self.durations, nv)) @ change
            most = shortest * self.speed_changes
            found.append(("acceleration", (speed[nv:] - speed[:-nv]).tocsr(), -most, most))
        return found

    def evaluated_along(self, q: Array) -> PathConstraints:
        """With the points between waypoints that programs need at first near a path (N, nv).

        Where the joints move little, a clearance is kept between waypoints almost as at them.
        """
        if not self.hard:
            return self
        moved = np.abs(np.diff(q, axis=0)).sum(axis=1)
        return self._with_shares(np.flatnonzero(moved > (_FAR if self.hard.lazy else -1.0)))

    def with_points(self, intervals: Indices, shares: Array) -> PathConstraints:
        """With further points at shares of some intervals, (K,), at which a margin is violated."""
        more = self._with_shares(np.setdiff1d(intervals, self.points[0]))
        at, share = more.points
        beside = np.clip(shares + _BESIDE * np.array([[-1.0], [0.0], [1.0]]), 0.0, 1.0)
        points = np.concatenate([at, np.tile(intervals, 3)]), np.append(share, beside)
        return replace(self, points=points)

    def _with_shares(self, intervals: Indices) -> PathConstraints:
        at, share = self.points
        at = np.concatenate([at, np.repeat(intervals, len(SHARES))])
        return replace(self, points=(at, np.concatenate([share, np.tile(SHARES, len(intervals))])))

    def margins(self, q: Array) -> list[Margins]:
        """The margins of a joint path q (N, nv), at its waypoints and at points between."""
        found = []
        for kind, G, lower, upper in self._linear:
            values = (G @ q.ravel()).reshape(-1, q.shape[1])
            first = 0 if kind == "position" else 1
            margins = np.full(q.shape, np.inf)
            margins[first : first + len(values)] = np.minimum(values - lower, upper - values)
            found.append(Margins(kind, self.ranges.names, self.ranges.units, margins))
        if self.hard:
            own = self.hard.margins(q, np.arange(len(q)))
            found.append(Margins("band", self.hard.names, self.hard.units, own))
        at, share = self.points
        if self.hard and len(at):
            least = np.full((len(q), len(self.hard.names)), np.inf)
            np.minimum.at(least, at + 1, self.hard.margins_between(q[at], q[at + 1], at, share))
            if self.on_path is not None:
                own, which = self.on_path.margins(q, at, share)
                np.minimum.at(least, at[which] + 1, own)
            least += self.hard.between_allowed
            found.append(Margins("band", self.hard.names, self.hard.units, least, between=True))
        return found

    def rows(self, q: Array) -> Iterator[tuple[sparse.csr_matrix, Array]]:
        """Linear rows that keep the margins above 0: rows · Δq ≤ rooms, Δq (N·nv,).

        Between waypoints half of the tolerance is kept for the points that are not evaluated.
        """
        nv = q.shape[1]
        for _, G, lower, upper in self._linear:
            values = (G @ q.ravel()).reshape(-1, nv)
            rooms = np.ravel([upper - values, values - lower]) - INSET
            yield sparse.vstack([G, -G], format="csr"), rooms
        if self.hard:
            rows, rooms, of = self.hard.rows(q, np.arange(len(q)))
            inset = np.minimum(INSET, 0.25 * self.hard.halves)
            yield block_diagonal(rows), (rooms - inset[of]).ravel()
        at, share = self.points
        if self.hard and len(at):
            yield self._between(q, at, share, *self.hard.rows_between(q, at, share))
            if self.on_path is not None:
                rows, rooms, of, which = self.on_path.bounds(q, at, share)
                yield self._between(q, at[which], share[which], rows, rooms, of)

    def _between(
        self, q: Array, at: Indices, share: Array, rows: Array, rooms: Array, of: Indices
    ) -> tuple[sparse.csr_matrix, Array]:
        """Rows (K, m, nv) on points of a path q (N, nv) at shares (K,) of intervals, as its own."""
        nv = q.shape[1]
        joints = (nv * at[:, None] + np.arange(nv)).ravel()
        whole = sparse.identity(q.size, format="csr")
        of_end = sparse.diags(np.repeat(share, nv))
        moved = whole[joints] + of_end @ (whole[joints + nv] - whole[joints])
        return (
            block_diagonal(rows) @ moved,
            (rooms + 0.5 * self.hard.between_allowed[of]).ravel(),
        )

    def pace(self, q: Array) -> tuple[float, int, str]:
        """How many times slower a path (N, nv) has to be for its steps and changes of speed.

        Returns:
            The factor; the waypoint before the step that needs it, from 0; and the joint. In a time
            f times as long a step may be f times as large, a change of speed f² times.
        """
        change = np.diff(q, axis=0)
        needs = [np.abs(change) / self.steps]
        if np.isfinite(self.speed_changes).any():
            speeds = np.diff(change / self.durations[:, None], axis=0)
            needs.append(np.sqrt(np.abs(speeds) / self.speed_changes))
        need = max(needs, key=lambda values: float(values.max(initial=0.0)))
        waypoint, joint = np.unravel_index(int(np.argmax(need)), need.shape)
        return float(need.max()), int(waypoint), self.ranges.names[int(joint)]

    def excess(self, q: Array) -> float:
        """Largest violation of a path (N, nv), rad or m; at most 0 if there is none."""
        return -min(float(margins.values.min(initial=np.inf)) for margins in self.margins(q))

    def violated(self, q: Array) -> Indices:
        """Waypoints, from 0, at which a path (N, nv) violates a constraint; of steps the second."""
        least = [margins.values.min(axis=1, initial=np.inf) for margins in self.margins(q)]
        return np.flatnonzero(np.min(least, axis=0) < -WITHIN)

    def beyond_between(self, q: Array) -> tuple[Array, Array]:
        """Proven violation of a path between waypoints, beyond the tolerance.

        Joint ranges, speeds and changes of speed hold between waypoints if they hold at them, since
        joints are interpolated linearly.

        Returns:
            The violation in each interval and of each band, rad or m, (N − 1, k), at most 0 if
            proved; and the share of each interval at which it is largest, (N − 1,). If motions have
            to stay on the path, there is a last column, ∞ where one does not.
        """
        excess, share = self.hard.between(q)
        allowed = self.hard.between_allowed
        if self.on_path is not None:
            own, at = self.on_path.violations(q)
            share = np.where(own.max(axis=1) > excess.max(axis=1, initial=0.0), at, share)
            excess = np.maximum(np.column_stack([excess, np.zeros(len(own))]), own)
            allowed = np.append(allowed, 0.0)
        return excess - allowed, share

    def worst(self, q: Array) -> Violation:
        """The largest violation of a path (N, nv), at its waypoints or else between them."""
        worst = max((margins.violation() for margins in self.margins(q)), key=lambda v: v.excess)
        if worst.excess > WITHIN or not (self.hard or self.on_path):
            return worst
        beyond = self.beyond_between(q)[0]
        names, units = (*self.hard.names, OF_PATH), (*self.hard.units, "m")
        margins = np.vstack([np.full((1, beyond.shape[1]), np.inf), -beyond])
        return Margins("band", names, units, margins, True).violation()


def block_diagonal(blocks: Array) -> sparse.csr_matrix:
    """Blocks (K, m, n) as a block-diagonal matrix, (K·m, K·n)."""
    count, rows, columns = blocks.shape
    at, shape = np.arange(count + 1), (count * rows, count * columns)
    return sparse.csr_matrix(sparse.bsr_matrix((blocks, at[:-1], at), shape=shape))


def motion_limits(
    path_task: PathTask,
    ranges: JointRanges,
    max_step_deg: float | None = None,
    hard: HardConstraints | None = None,
    *,
    slow_down: bool = False,
) -> PathConstraints:
    """Constraints of a joint path along the task; ``hard`` are those that are already known.

    One that may ``slow_down`` takes the time that its steps need, so that only their length is
    limited.
    """
    count = len(path_task.waypoints)
    given = path_task.durations
    if given is not None and len(given) != count:
        raise InvalidInput(
            f"{path_task.name}: durations: expected one for each of the {count} waypoints, got "
            f"{len(given)}; replace them with the waypoints, or by None."
        )
    durations = np.ones(count - 1) if given is None else given[1:]
    steps = np.full((count - 1, path_task.model.nv), np.inf)
    step_limit = f"the largest step without a feed, {np.degrees(UNTIMED_STEP):g}°"
    if given is not None:
        velocity = known_limits(path_task).velocity
        steps, step_limit = velocity * durations[:, None], "the speed limits"
        if not np.isfinite(velocity).all():
            step_limit += f", or {np.degrees(UNTIMED_STEP):g}° where [limits.velocity] states none"
        if slow_down:
            steps = np.maximum(steps, UNTIMED_STEP)
            step_limit = f"the largest step, {np.degrees(UNTIMED_STEP):g}° or what the feed allows"
    if max_step_deg is not None:
        steps = np.minimum(steps, np.radians(number("max_step_deg", max_step_deg, above=0.0)))
        largest = f"the largest step, max_step_deg = {max_step_deg:g}"
        step_limit = largest if given is None or slow_down else f"{step_limit} or {largest}"
    steps = np.where(np.isfinite(steps), steps, UNTIMED_STEP)
    # A turn by more than half a turn has the same end as a shorter one in the other direction. A
    # joint with a range may not have that choice; a joint without a range never needs the longer
    # turn.
    endless = ranges.hinge & ~ranges.limited
    steps[:, endless] = np.minimum(steps[:, endless], np.pi)
    # Velocities are constant between waypoints, and change at the waypoints.
    times = 0.5 * (durations[1:] + durations[:-1])
    speed_changes = path_task.acceleration_limits * times[:, None]
    speed_changes = np.full_like(speed_changes, np.inf) if slow_down else speed_changes
    hard = PathRows(path_task).hard if hard is None else hard
    return PathConstraints(ranges, steps, speed_changes, durations, hard, step_limit=step_limit)


@dataclass(frozen=True, eq=False)
class JudgedPath:
    """A joint path (N, nv), its value, and its largest violation of a constraint, rad or m.

    With the ``times`` of its steps, s, (N − 1,), if they count; otherwise empty.
    """

    q: Array
    value: float
    excess: float
    times: Array

    @property
    def feasible(self) -> bool:
        """Whether it violates no constraint."""
        return self.excess <= WITHIN


@dataclass(frozen=True, eq=False)
class Problem:
    """A path, its constraints, and the objective of its motion.

    ``start`` is the first configuration, on the first waypoint, (nv,), if it is fixed. ``stated``
    is the objective whose bound is stated, if it is another one.
    """

    path_task: PathTask
    rows: PathRows
    limits: PathConstraints
    objective: Objective
    start: Array | None = None
    stated: Objective | None = None

    @cached_property
    def free(self) -> Problem:
        """The problem without clearances; itself if it has none."""
        if not self.has_clearance:
            return self
        task = self.path_task.without_clearance()
        rows = PathRows(task)
        on_path = None if self.limits.on_path is None else OnThePath(task)
        limits = replace(self.limits, hard=rows.hard, on_path=on_path)
        return replace(self, path_task=task, rows=rows, limits=limits)

    @property
    def has_clearance(self) -> bool:
        """Whether the path has a clearance."""
        return bool(self.path_task.clearances)

    @property
    def freedom(self) -> int:
        """Largest dimension of the null space at a waypoint."""
        return int(self.rows.freedom.max())

    def judged(self, q: Array) -> JudgedPath:
        """A joint path (N, nv) with its value and its largest violation."""
        times = self.objective.times(q)
        return JudgedPath(q, self.objective.value(q, times), self.limits.excess(q), times)

    def clear(self, q: Array) -> Mask:
        """Which configurations q (K, nv) keep the clearances, (K,)."""
        clear = np.ones(len(q), dtype=bool)
        for clearance in self.path_task.clearances:
            clear[clear] = clearance.inside(q[clear], WITHIN)
        return clear

    @cached_property
    def period(self) -> Array:
        """2π for hinges without limits, whose whole turns do not matter; 0 for others, (nv,)."""
        ranges = self.limits.ranges
        return np.where(ranges.hinge & ~np.isfinite(ranges.upper - ranges.lower), TURN, 0.0)

    def unwound(self, difference: Array) -> Array:
        """Differences of configurations (…, nv), modulo whole turns that do not matter."""
        if not self.period.any():
            return difference
        unwound: Array = difference - self.period * np.round(difference / TURN)
        return unwound

    def interpolated(self, corners: Array, waypoints: list[int]) -> Array | None:
        """The path (N, nv) through configurations at some waypoints; ``None`` if it leaves it."""
        steps = self.unwound(np.diff(corners, axis=0))
        corners = corners[0] + np.vstack([np.zeros(corners.shape[1]), np.cumsum(steps, axis=0)])
        at = np.arange(len(self.path_task.waypoints))
        between = np.array([np.interp(at, waypoints, joint) for joint in corners.T]).T
        path, arrived = self.rows.correct(between, at)
        if self.start is not None:
            path[0] = self.start
        return path if arrived.all() else None
