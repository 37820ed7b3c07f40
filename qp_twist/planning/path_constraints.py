"""What a joint path has to keep, asked by everything that plans: one verdict, with names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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


class Violation(NamedTuple):
    """Where a joint path is furthest outside a constraint."""

    kind: Kind
    name: str
    """Of the joint, band or constraint."""
    waypoint: int
    """From 0; of a step, and between two waypoints, the second."""
    excess: float
    """rad or m; between waypoints beyond what is allowed there."""
    unit: str
    between: bool = False
    """Whether it is between the waypoint and the one before it."""


@dataclass(frozen=True, eq=False)
class PathConstraints:
    """What holds at and between the waypoints.

    The task's own rows are not among them: every path that is judged here has been brought onto its
    waypoints by :meth:`~qp_twist.planning.path_rows.PathRows.correct`.

    Attributes:
        ranges: Of the joints.
        steps: Largest displacement of each joint to each waypoint from the one before, rad or m,
            (N − 1, nv).
        speed_changes: Largest change of velocity at each waypoint but the first and last, rad/s or
            m/s, (N − 2, nv); infinite without acceleration limits.
        durations: Time to each waypoint from the one before, s, (N − 1,).
        fixed_start: Whether the first configuration is given.
        hard: The hard bands and the constraints of the task, if there are any.
        points: Where on the ways between waypoints those are looked at, beside
            :data:`~qp_twist.planning.hard_constraints.SHARES` of each of them: numbers of the
            waypoints before, and shares, (K,) each.
    """

    ranges: JointRanges
    steps: Array
    speed_changes: Array
    durations: Array
    fixed_start: bool
    hard: HardConstraints | None = None
    points: tuple[Indices, Array] = (np.zeros(0, dtype=np.intp), np.zeros(0))

    @cached_property
    def kept(self) -> tuple[PathLimit, ...]:
        """All of them, each with its margins and rows.

        The margins of a step stand at its second waypoint. Those of accelerations are of the
        displacement in the shortest step that would make up for them.
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
            every = np.repeat(np.arange(count - 1), len(SHARES))
            at, share = self.points
            found.append(AtWaypoints(self.hard))
            found.append(
                BetweenWaypoints(
                    self.hard,
                    np.concatenate([every, at]),
                    np.concatenate([np.tile(SHARES, count - 1), share]),
                )
            )
        return tuple(found)

    def margins(self, q: Array) -> list[Margins]:
        """The margins of a joint path q (N, nv) at its waypoints, and some between them."""
        return [limit.margins(q) for limit in self.kept]

    def rows(self, q: Array) -> Iterator[tuple[sparse.csr_matrix, Array]]:
        """What keeps the margins above 0, to first order: rows · Δq ≤ rooms, Δq (N·nv,)."""
        return (limit.rows(q) for limit in self.kept)

    def excess(self, q: Array) -> float:
        """By how much a path (N, nv) breaks a constraint, rad or m; at most 0 if none."""
        return -min(float(kept.values.min(initial=np.inf)) for kept in self.margins(q))

    def broken(self, q: Array) -> Indices:
        """The waypoints at which a path (N, nv) breaks one, from 0; of a step the second."""
        least = [kept.values.min(axis=1, initial=np.inf) for kept in self.margins(q)]
        return np.flatnonzero(np.min(least, axis=0) < -WITHIN)

    def beyond_between(self, q: Array) -> tuple[Array, Array]:
        """How far a path is outside between waypoints, beyond what is allowed there, at most.

        Joint ranges, speeds and changes of speed hold between waypoints where they hold at them,
        since joints go straight.

        Returns:
            Of each way and band, rad or m, (N − 1, k), at most 0 where that is proved; and at which
            share of each way the largest is, (N − 1,).
        """
        if not self.hard:
            return np.full((len(q) - 1, 0), -np.inf), np.zeros(len(q) - 1)
        excess, share = self.hard.between(q)
        return excess - np.array([BETWEEN[unit] for unit in self.hard.units]), share

    def worst(self, q: Array) -> Violation:
        """Where a path (N, nv) is furthest outside, at its waypoints or else between them."""
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
    """The largest of some excesses (N, k)."""
    row, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
    most = float(excess[row, column])
    return Violation(kind, names[column], int(row), most, units[column], between)
