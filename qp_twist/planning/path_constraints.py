"""What a joint path has to keep, asked by everything that plans: one verdict, with names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.kinematics import JointRanges
from qp_twist.planning.hard_constraints import BETWEEN, SHARES, WITHIN, HardConstraints

Kind = Literal["position", "velocity", "acceleration", "band"]


class Margins(NamedTuple):
    """The margins of a joint path in one kind of constraint."""

    kind: Kind
    names: tuple[str, ...]
    """Of the joints, bands or constraints, (k)."""
    units: tuple[str, ...]
    """Of the margins, ``"rad"`` or ``"m"``, (k)."""
    values: Array
    """At each waypoint, not negative inside, ∞ where there is nothing to keep, (N, k)."""
    between: bool = False
    """Whether they are on the way from the waypoint before."""


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

    def margins(self, q: Array) -> list[Margins]:
        """The margins of a joint path q (N, nv) at its waypoints, by kind.

        Those of a step stand at its second waypoint. Those of accelerations are of the displacement
        in the shortest step that would make up for them. Bands and constraints are looked at
        between waypoints, too, at :meth:`points_between`, where :data:`BETWEEN` is allowed.
        """
        names = self.ranges.names
        units = self.ranges.units
        found = [
            Margins("position", names, units, self.ranges.room(q)),
        ]
        dq = np.diff(q, axis=0)
        steps = np.full(q.shape, np.inf)
        steps[1:] = self.steps - np.abs(dq)
        found.append(Margins("velocity", names, units, steps))
        if np.isfinite(self.speed_changes).any():
            changes = np.full(q.shape, np.inf)
            change = np.abs(np.diff(dq / self.durations[:, None], axis=0))
            changes[1:-1] = (self.speed_changes - change) * self.durations.min()
            found.append(Margins("acceleration", names, units, changes))
        if self.hard:
            margins = self.hard.margins(q, np.arange(len(q)))
            found.append(Margins("band", self.hard.names, self.hard.units, margins))
            at, share = self.points_between()
            between = np.full(margins.shape, np.inf)
            there = self.hard.margins_between(q[at], q[at + 1], at, share)
            np.minimum.at(between, at + 1, there + self.allowed_between)
            found.append(Margins("band", self.hard.names, self.hard.units, between, True))
        return found

    def points_between(self) -> tuple[Indices, Array]:
        """Where that is looked at between waypoints: numbers of the ones before, shares, (K,)."""
        count, (at, share) = len(self.steps), self.points
        every = np.repeat(np.arange(count), len(SHARES))
        return np.concatenate([every, at]), np.concatenate([np.tile(SHARES, count), share])

    @property
    def allowed_between(self) -> Array:
        """:data:`BETWEEN` in the unit of each margin, (k,)."""
        return np.array([BETWEEN[unit] for unit in (self.hard.units if self.hard else ())])

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
        return excess - self.allowed_between, share

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
