"""All constraints of a joint path in a plan, and where a path violates them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.planning.hard_constraints import BETWEEN, SHARES, WITHIN, HardConstraints
from qp_twist.planning.path_limits import (
    AtWaypoints,
    BetweenWaypoints,
    Kind,
    LinearLimit,
    Margins,
    PathLimit,
)

_FAR = 0.1
"""Sum of the joints' motions between waypoints above which clearances are evaluated there, rad."""

_BESIDE = 0.06
"""Distance of the shares on both sides of a violation that are evaluated with it."""


class Violation(NamedTuple):
    """The largest violation of a joint path."""

    kind: Kind
    name: str
    """Name of the joint, band or constraint."""
    waypoint: int
    """The waypoint, from 0; for a step, or between two waypoints, the second one."""
    excess: float
    """Violation, rad or m; between waypoints beyond the tolerance."""
    unit: str
    between: bool = False
    """Whether it is between the waypoint and the one before it."""


@dataclass(frozen=True, eq=False)
class PathConstraints:
    """Constraints at and between the waypoints.

    The task's own rows are not included: every path has been corrected onto its waypoints by
    :meth:`~qp_twist.planning.path_rows.PathRows.correct`.

    Attributes:
        ranges: The joint ranges.
        steps: Largest displacement of each joint between consecutive waypoints, rad or m, (N − 1,
            nv).
        speed_changes: Largest change of velocity at each waypoint but the first and last, rad/s or
            m/s, (N − 2, nv); infinite without acceleration limits.
        durations: Time between consecutive waypoints, s, (N − 1,).
        fixed_start: Whether the first configuration is fixed.
        hard: The hard bands and the constraints of the task, if there are any.
        points: Points between waypoints at which these are evaluated: indices and shares of
            intervals, (K,) each.
        step_limit: What limits ``steps``, in words.
    """

    ranges: JointRanges
    steps: Array
    speed_changes: Array
    durations: Array
    fixed_start: bool
    hard: HardConstraints | None = None
    points: tuple[Indices, Array] = (np.zeros(0, dtype=np.intp), np.zeros(0))
    step_limit: str = "the speed limits"

    @cached_property
    def kept(self) -> tuple[PathLimit, ...]:
        """The constraints, each with its margins and rows.

        The margins of a step belong to its second waypoint. Margins of accelerations are
        displacements in the shortest adjacent step.
        """
        count, nv = len(self.steps) + 1, len(self.ranges.names)
        whole = sparse.identity(count * nv, format="csr")
        change = whole[nv:] - whole[:-nv]
        found: list[PathLimit] = [
            LinearLimit("position", self.ranges, whole, self.ranges.lower, self.ranges.upper, 0),
            LinearLimit("velocity", self.ranges, change, -self.steps, self.steps, 1),
        ]
        if np.isfinite(self.speed_changes).any():
            shortest = self.durations.min()
            speed = sparse.diags(shortest / np.repeat(self.durations, nv)) @ change
            most = shortest * self.speed_changes
            changes = (speed[nv:] - speed[:-nv]).tocsr()
            found.append(LinearLimit("acceleration", self.ranges, changes, -most, most, 1))
        if self.hard:
            found.append(AtWaypoints(self.hard))
            if len(self.points[0]):
                found.append(BetweenWaypoints(self.hard, *self.points))
        return tuple(found)

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
        return [limit.margins(q) for limit in self.kept]

    def rows(self, q: Array) -> Iterator[tuple[sparse.csr_matrix, Array]]:
        """Linear rows that keep the margins above 0: rows · Δq ≤ rooms, Δq (N·nv,)."""
        return (limit.rows(q) for limit in self.kept)

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
        number, joint = np.unravel_index(int(np.argmax(need)), need.shape)
        return float(need.max()), int(number), self.ranges.names[int(joint)]

    def excess(self, q: Array) -> float:
        """Largest violation of a path (N, nv), rad or m; at most 0 if there is none."""
        return -min(float(kept.values.min(initial=np.inf)) for kept in self.margins(q))

    def broken(self, q: Array) -> Indices:
        """Waypoints, from 0, at which a path (N, nv) violates a constraint; of steps the second."""
        least = [kept.values.min(axis=1, initial=np.inf) for kept in self.margins(q)]
        return np.flatnonzero(np.min(least, axis=0) < -WITHIN)

    def beyond_between(self, q: Array) -> tuple[Array, Array]:
        """Proven violation of a path between waypoints, beyond the tolerance.

        Joint ranges, speeds and changes of speed hold between waypoints if they hold at them, since
        joints are interpolated linearly.

        Returns:
            The violation in each interval and of each band, rad or m, (N − 1, k), at most 0 if
            proved; and the share of each interval at which it is largest, (N − 1,).
        """
        if not self.hard:
            return np.full((len(q) - 1, 0), -np.inf), np.zeros(len(q) - 1)
        excess, share = self.hard.between(q)
        return excess - np.array([BETWEEN[unit] for unit in self.hard.units]), share

    def worst(self, q: Array) -> Violation:
        """The largest violation of a path (N, nv), at its waypoints or else between them."""
        found = []
        for kept in self.margins(q):
            found.append(_furthest(kept.kind, kept.names, kept.units, -kept.values, kept.between))
        worst = max(found, key=lambda violation: violation.excess)
        if worst.excess > WITHIN or not self.hard:
            return worst
        beyond = np.vstack([np.full(len(self.hard.names), -np.inf), self.beyond_between(q)[0]])
        return _furthest("band", self.hard.names, self.hard.units, beyond, between=True)


def _furthest(
    kind: Kind, names: tuple[str, ...], units: tuple[str, ...], excess: Array, between: bool
) -> Violation:
    """The largest of some violations (N, k)."""
    row, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
    most = float(excess[row, column])
    return Violation(kind, names[column], int(row), most, units[column], between)
