"""Times of a program's moves in which no joint exceeds its limits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.kinematics import JointRanges
from qp_twist.paths import PathTask
from qp_twist.programs import JointMoves
from qp_twist.referee import (
    EXCEEDED,
    JointMotion,
    motion_limits,
    with_default_accelerations,
)
from qp_twist.referee.joint_rates import largest_accelerations, largest_speeds

_ROOM = 0.01
"""Share of the limits that is left to printed digits: at a point between moves of 8 ms half a digit
of an angle, 0.9e-6 rad, is an acceleration of 0.03 rad/s², and near a singularity a pose's digits
are more."""
_ROUNDS = 200
"""Times at most that moves are made longer, so that a change of speed spreads to those beside."""


class Way(NamedTuple):
    """Joint positions on a move, behind where it begins: shares (K,) to 1 of its time, (K, n)."""

    shares: Array
    q: Array

    @classmethod
    def to(cls, q: Array) -> Way:
        """A joint move to positions (n,)."""
        return cls(np.ones(1), q[None])


class Ramp(NamedTuple):
    """Joint accelerations on a move of the tool, rad/s² or m/s², (n,) each.

    Attributes:
        per_unit: While the tool is accelerated, per m/s².
        steady: At constant speed of the tool.
    """

    per_unit: Array
    steady: Array

    @classmethod
    def of(cls, begin: Array, way: Way, seconds: float, length: float) -> Ramp:
        """On a move of ``length`` m from joint positions (n,) on.

        With q(s) of the way s, q̈ = q″ ṡ² + q′ s̈.
        """
        q, shares = np.vstack([begin, way.q]), np.append(0.0, way.shares)
        rates = np.abs(np.diff(q, axis=0)) / np.diff(shares)[:, None]
        steady = np.zeros(q.shape[1])
        if len(q) > 2:
            steady = largest_accelerations(JointMotion(seconds * shares, q))[1].max(axis=0)
        return cls(rates.max(axis=0) / length, steady)


def travel(begin: Array, ways: Sequence[Way]) -> Array:
    """How far joints go on each of the ways from joint positions (n,) on, (M, n)."""
    begins = [begin, *(way.q[-1] for way in ways[:-1])]
    of = zip(begins, ways, strict=True)
    return np.array(
        [np.abs(np.diff(way.q, axis=0, prepend=at[None])).sum(axis=0) for at, way in of]
    )


def at_rests(travel: Array, durations: Array, ends: Array) -> Array:
    """The least accelerations (M, n) that moves need which begin or end at rest.

    With |q̈| ≤ a a joint goes at most a T²/2 in a time T from rest, whatever its speed at the end;
    to rest again at most that of T/2 twice, a T²/4. So it needs 2 D/T², and 4 D/T² from rest to
    rest.

    Args:
        travel: How far joints go on their ways, D, there and back, (M, n).
        durations: T, s, (M,).
        ends: At how many of its ends each move is at rest, (M,); of 0, nothing is known.
    """
    per_way = np.divide(2.0 * ends, durations**2, out=np.zeros(len(ends)), where=ends > 0)
    needed: Array = travel * per_way[:, None]
    return needed


class JointLimits(NamedTuple):
    """Largest speeds and accelerations of joints, (n,) each; ∞ without a limit."""

    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, path_task: PathTask, names: Sequence[str], *, ramps: bool = False) -> JointLimits:
        """Those that a check of a program asks, in the order of these joints.

        With ``ramps`` of a program that states accelerations, which the defaults limit, too.
        """
        limits, ranges = motion_limits(path_task), JointRanges.of(path_task.model)
        if ramps:
            limits = with_default_accelerations(limits, ranges)
        order = [ranges.names.index(name) for name in names]
        return cls(limits.velocity[order], limits.acceleration[order])

    def slower(
        self, begin: Array, ways: Sequence[Way], durations: Array, ends: Array | None = None
    ) -> Array:
        """By which factors moves (M,) have to take longer, from joint positions (n,) on.

        A move that takes λ times as long has 1/λ of its speeds and 1/λ² of its accelerations; at a
        point, where the controller has half of both moves to change the speed, both take longer.
        ``ends``: at how many of its ends each move in a stated time is at rest, (M,); 0 of others.
        """
        counts = np.array([len(way.q) for way in ways])
        owner = np.repeat(np.arange(len(ways)), counts)
        until = np.cumsum(durations)
        shares = np.concatenate([way.shares for way in ways])
        times = np.append(0.0, (until - durations)[owner] + shares * durations[owner])
        q = np.concatenate([begin[None], *(way.q for way in ways)])
        motion = JointMotion(times, q, points=np.append(0, np.cumsum(counts)))
        found = np.ones(len(ways))
        np.maximum.at(found, owner, (largest_speeds(motion) / self.velocity).max(axis=1))
        if len(q) > 2:
            most = (largest_accelerations(motion)[1] / self.acceleration).max(axis=1)
            for moves in (owner[:-1], owner[1:]):  # the same but at points
                np.maximum.at(found, moves, np.sqrt(most))
        if ends is not None:
            needed = at_rests(travel(begin, ways), durations, ends) / self.acceleration
            np.maximum(found, np.sqrt(needed.max(axis=1)), out=found)
        return found


def within_limits(
    planned: JointMoves, begin: Array, ways: Sequence[Way], limits: JointLimits,
    written: Callable[[JointMoves], JointMoves], calls: Collection[int] = (),
) -> tuple[JointMoves, float]:  # fmt: skip
    """The moves as they are ``written``, as much slower than planned as the limits ask.

    At the points ``calls`` the robot stops, too.

    Returns:
        The moves, and by how much all of them take longer for it, s.
    """
    moves = first = written(planned)
    limits = limits._replace(acceleration=(1.0 - _ROOM) * limits.acceleration)
    for _ in range(_ROUNDS):
        assert planned.durations is not None and moves.durations is not None
        stops = moves.stops | np.isin(np.arange(len(moves.angles)), [*calls])
        ends = (stops[:-1].astype(int) + stops[1:]) * moves.in_times
        factors = limits.slower(begin, ways, moves.durations, ends)
        if factors.max() <= 1.0 + EXCEEDED:
            break
        planned = replace(planned, durations=planned.durations * factors * (1.0 + EXCEEDED))
        moves = written(planned)
    assert first.durations is not None and moves.durations is not None
    return moves, float(moves.durations.sum() - first.durations.sum())
